"""What a house of the drawn town looks like: drawn by lot once, the same on every visit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Colour = tuple[int, int, int]

PLASTERS: tuple[Colour, ...] = (
    (226, 214, 190), (214, 186, 140), (222, 170, 128), (196, 122, 98), (236, 230, 218), (178, 192, 176),
    (164, 184, 198), (214, 196, 200), (232, 208, 132), (150, 160, 156), (202, 146, 138), (126, 150, 164),
    (188, 178, 160), (112, 128, 108), (240, 224, 196), (170, 96, 80),
)  # fmt: skip
BRICKS: tuple[Colour, ...] = (
    (150, 78, 60), (166, 96, 70), (122, 64, 54), (178, 130, 92), (196, 160, 112), (112, 82, 70),
    (138, 98, 84),
)  # fmt: skip
BOARDS: tuple[Colour, ...] = (
    (220, 222, 218), (110, 140, 158), (146, 60, 54), (200, 176, 110), (92, 116, 98), (70, 82, 102),
    (206, 190, 170),
)  # fmt: skip
STONES: tuple[Colour, ...] = ((186, 176, 158), (168, 158, 144), (204, 192, 168), (150, 146, 140))
TRIMS: tuple[Colour, ...] = ((238, 234, 226), (222, 212, 190), (196, 186, 170), (120, 110, 100), (84, 70, 60))
ACCENTS: tuple[Colour, ...] = (
    (42, 84, 70), (120, 34, 38), (36, 58, 98), (70, 54, 42), (28, 34, 38), (150, 106, 44), (86, 104, 66),
    (148, 74, 46), (96, 60, 96), (34, 104, 118),
)  # fmt: skip
AWNINGS: tuple[Colour, ...] = (
    (170, 44, 42), (36, 90, 70), (40, 70, 130), (206, 150, 50), (122, 52, 84), (60, 60, 64), (212, 110, 52),
)  # fmt: skip
TILES: tuple[Colour, ...] = (
    (150, 84, 62),
    (126, 70, 56),
    (86, 88, 96),
    (98, 80, 70),
    (70, 76, 82),
    (164, 104, 76),
)
FRAMES: tuple[Colour, ...] = ((240, 240, 236), (236, 232, 222), (64, 48, 38), (44, 66, 58), (60, 62, 66))
NAMES = (
    "BAKERY", "CAFE LUNA", "BOOKS", "PHARMACY", "FLORIST", "OPTIK", "BISTRO", "TAILOR", "CYCLES", "WINE & CO",
    "KIOSK", "BARBER", "CHOCOLAT", "POTTERY", "HOTEL ALBA", "MUSIC", "TOYS", "GALLERY", "CERAMICS", "SHOES",
    "TEA ROOM", "PASTA", "FALAFEL", "LAUNDRY", "HARDWARE", "CHEESE", "VINYL", "STUDIO 9", "LOCKSMITH",
    "PRINT",
)  # fmt: skip


@dataclass(frozen=True)
class Style:
    """One house's looks; lengths in metres, colours 0 to 255.

    Attributes:
        wall: ``plaster``, ``brick``, ``boards`` or ``stone``.
        roof: ``flat``, ``gable`` and ``stepped`` (towards the street), ``eaves`` (along it), ``mansard``.
        columns: windows side by side.
        extras: of ``shutters``, ``quoins``, ``bands``, ``balcony``, ``ivy``, ``arches``, ``pediments``,
            ``chimney``, ``timber``, ``pipe``, ``blade`` (a hanging sign), ``dormers``, ``boxes`` (flowers).
    """

    seed: tuple[int, ...]
    wall: str
    colour: Colour
    base_colour: Colour
    trim: Colour
    accent: Colour
    frame: Colour
    roof: str
    tiles: Colour
    storeys: int
    ground: float
    storey: float
    rise: float
    columns: int
    window: tuple[float, float]
    mullions: tuple[int, int]
    shop: str
    awning: Colour | None
    door: int
    extras: frozenset[str]

    @property
    def eaves(self) -> float:
        """Height of the walls."""
        return self.ground + self.storey * (self.storeys - 1) + 0.6


EXTRAS = {
    "shutters": 0.28, "quoins": 0.22, "bands": 0.45, "balcony": 0.3, "ivy": 0.12, "arches": 0.2,
    "pediments": 0.25,
    "chimney": 0.6, "timber": 0.16, "pipe": 0.5, "blade": 0.5, "dormers": 0.5, "boxes": 0.22,
}  # fmt: skip


def pick(rng: np.random.Generator, table: tuple[Colour, ...], shake: int = 9) -> Colour:
    """One colour of `table`, a little off."""
    chosen = np.array(table[int(rng.integers(len(table)))]) + rng.integers(-shake, shake + 1, 3)
    red, green, blue = (int(part) for part in chosen.clip(0, 255))
    return red, green, blue


def invent(seed: tuple[int, ...], width: float) -> Style:
    """The looks of a house `width` metres wide; the same for the same `seed`."""
    rng = np.random.default_rng(seed)
    wall = str(rng.choice(["plaster", "brick", "boards", "stone"], p=[0.46, 0.3, 0.12, 0.12]))
    palette = {"plaster": PLASTERS, "brick": BRICKS, "boards": BOARDS, "stone": STONES}[wall]
    roofs = ["flat", "gable", "stepped", "eaves", "mansard"]
    odds = [0.22, 0.2, 0.1, 0.36, 0.12] if width < 10 else [0.36, 0.08, 0.04, 0.36, 0.16]
    storeys = int(rng.choice([2, 3, 4, 5], p=[0.3, 0.38, 0.24, 0.08]))
    storeys = min(storeys, 3) if wall == "boards" else storeys
    pitch = rng.uniform(1.55, 2.9)
    shop = str(rng.choice(NAMES)) if rng.random() < 0.36 else ""
    columns = max(2, round((width - 0.6) / pitch))
    return Style(
        seed=seed,
        wall=wall,
        colour=pick(rng, palette),
        base_colour=pick(rng, STONES if rng.random() < 0.6 else palette),
        trim=pick(rng, TRIMS, 5),
        accent=pick(rng, ACCENTS),
        frame=pick(rng, FRAMES, 4),
        roof=str(rng.choice(roofs, p=odds)),
        tiles=pick(rng, TILES),
        storeys=storeys,
        ground=float(rng.uniform(3.4, 4.3) if shop else rng.uniform(3.0, 3.7)),
        storey=float(rng.uniform(2.75, 3.45)),
        rise=float(rng.uniform(0.55, 1.0)),
        columns=columns,
        window=(
            float(min(rng.uniform(0.85, 1.4), (width - 0.6) / columns * 0.72)),
            float(rng.uniform(1.3, 2.05)),
        ),
        mullions=(int(rng.choice([1, 2, 2, 3])), int(rng.choice([1, 2, 2, 3, 4]))),
        shop=shop,
        awning=pick(rng, AWNINGS) if shop and rng.random() < 0.65 else None,
        door=int(rng.integers(columns)),
        extras=frozenset(name for name, odd in EXTRAS.items() if rng.random() < odd),
    )
