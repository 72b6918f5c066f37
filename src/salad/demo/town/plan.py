"""Where everything of the drawn town stands: streets, houses, trees, lamps, parked cars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    (150, 84, 62), (126, 70, 56), (86, 88, 96), (98, 80, 70), (70, 76, 82), (164, 104, 76),
)  # fmt: skip
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
        columns: Windows side by side.
        extras: Of ``shutters``, ``quoins``, ``bands``, ``balcony``, ``ivy``, ``arches``, ``pediments``,
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
    # Narrow houses have gables, wide ones flat roofs.
    roofs = ["flat", "gable", "stepped", "eaves", "mansard"]
    odds = [0.22, 0.2, 0.1, 0.36, 0.12] if width < 10 else [0.36, 0.08, 0.04, 0.36, 0.16]
    storeys = int(rng.choice([2, 3, 4, 5], p=[0.3, 0.38, 0.24, 0.08]))
    # Nobody builds four storeys of boards.
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


Points = NDArray[np.float64]

ROAD = 4.2  # from a street's middle to its kerb, in metres
FRONT = 7.0  # from a street's middle to the house fronts, in metres
SPACING = 12.6  # the references' places are at most so far apart once a town is large enough, in metres


@dataclass(frozen=True)
class Street:
    """A street as points about a metre apart ``[n, 2]``, the length along it at each, and its number."""

    number: int
    line: Points
    along: NDArray[np.float64]

    @property
    def length(self) -> float:
        """Length in metres."""
        return float(self.along[-1])

    def at(self, along: float, left: float = 0.0) -> tuple[Points, Points]:
        """The point so many metres along and to the left, and the street's direction there."""
        # A direction over a metre and a half, so that the corners between the line's points are not felt.
        behind, point, ahead = (
            np.array([np.interp(along + step, self.along, self.line[:, axis]) for axis in (0, 1)])
            for step in (-0.75, 0.0, 0.75)
        )
        direction = (ahead - behind) / np.linalg.norm(ahead - behind)
        return point + left * np.array([-direction[1], direction[0]]), direction

    def plot(self, side: int, along: float, rng: np.random.Generator) -> tuple[Points, float]:
        """The corners of a plot that starts `along` metres up the street, on its left (1) or right (-1)."""
        width = float(rng.choice([rng.uniform(5.2, 8), rng.uniform(8, 11), rng.uniform(11, 15)], p=[0.4, 0.4, 0.2]))
        setback = FRONT + float(rng.choice([0.0, 0.0, rng.uniform(0.1, 0.7)]))
        ends = []
        for place in (along, along + width):
            # Beyond a street's end its last direction goes on, so that corners are built up.
            inside = float(np.clip(place, 0.8, self.length - 0.8))
            point, direction = self.at(inside, side * setback)
            ends.append(point + (place - inside) * direction)
        first, second = ends if side == 1 else ends[::-1]
        right = (second - first) / np.linalg.norm(second - first)
        back = np.array([-right[1], right[0]]) * float(rng.uniform(8.5, 11.5))
        return np.array([first, second, second + back, first + back]), float(np.linalg.norm(second - first))


@dataclass(frozen=True)
class House:
    """A house: corners ``[4, 2]`` (front left, front right, back right, back left, seen from the street)."""

    corners: Points
    style: Style

    @property
    def width(self) -> float:
        """Of the front, in metres."""
        return float(np.linalg.norm(self.corners[1] - self.corners[0]))


@dataclass(frozen=True)
class Thing:
    """A tree, a lamp or a car: where, which of its kind, its height and (cars) its direction in radians."""

    where: tuple[float, float]
    sort: int
    height: float = 1.0
    direction: float = 0.0


@dataclass(frozen=True)
class TownPlan:
    """The town, in metres east and north of its origin."""

    seed: int
    viewpoints: int
    streets: tuple[Street, ...]
    houses: tuple[House, ...]
    trees: tuple[Thing, ...]
    lamps: tuple[Thing, ...]

    @property
    def box(self) -> tuple[float, float, float, float]:
        """West, south, east and north end of everything, with a margin."""
        points = np.concatenate([house.corners for house in self.houses] + [s.line for s in self.streets])
        west, south = points.min(axis=0) - 15
        east, north = points.max(axis=0) + 15
        return float(west), float(south), float(east), float(north)

    def nearest(self, point: Points) -> tuple[Street, float, float]:
        """The street a point lies on, and how far along and to the left of it, in metres."""
        gaps = [np.linalg.norm(street.line - point, axis=1).min() for street in self.streets]
        street = self.streets[int(np.argmin(gaps))]
        along = float(street.along[int(np.argmin(np.linalg.norm(street.line - point, axis=1)))])
        middle, way = street.at(along)
        return street, along, float(way[0] * (point - middle)[1] - way[1] * (point - middle)[0])


def plan_town(seed: int, viewpoints: int) -> TownPlan:
    """Lay out the largest town whose streets `viewpoints` places still cover densely."""
    streets = lay_streets(seed, 2, 2)
    # One crossing more at a time, across and along in turn, until the references would stand too far apart.
    for step in range(1, 40):
        larger = lay_streets(seed, 2 + (step + 1) // 2, 2 + step // 2)
        if sum(usable(street) for street in larger) / viewpoints > SPACING:
            break
        streets = larger
    houses = build_houses(seed, streets)
    return TownPlan(seed, viewpoints, streets, houses, *place_furniture(seed, streets))


def usable(street: Street) -> float:
    """How many metres of a street references are taken from: all but its crossings."""
    return max(street.length - 10.0, 1.0)


def lay_streets(seed: int, across: int, along: int) -> tuple[Street, ...]:
    """An irregular grid of bent streets with `across` by `along` crossings."""
    nodes = {
        (column, row): np.array([column * 76.0, row * 66.0])
        + np.random.default_rng([seed, 1, column, row]).uniform(-8, 8, 2)
        for column in range(across)
        for row in range(along)
    }
    ways = [((c, r), (c + 1, r)) for r in range(along) for c in range(across - 1)]
    ways += [((c, r), (c, r + 1)) for c in range(across) for r in range(along - 1)]
    streets = []
    for number, (start, stop) in enumerate(ways):
        # Each street is drawn by its own ends: a larger town has the smaller one's streets in it.
        bow = np.random.default_rng([seed, 2, *start, *stop]).uniform(-5, 5)
        step = nodes[stop] - nodes[start]
        part = np.linspace(0, 1, int(np.linalg.norm(step)) + 1)[:, None]
        side = np.array([-step[1], step[0]]) / np.linalg.norm(step)
        line = nodes[start] + part * step + np.sin(np.pi * part) * bow * side
        lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
        streets.append(Street(number, line, np.concatenate([[0.0], np.cumsum(lengths)])))
    return tuple(streets)


def build_houses(seed: int, streets: tuple[Street, ...]) -> tuple[House, ...]:
    """Terraces on both sides of every street, wherever a house fits."""
    houses: list[House] = []
    asphalt = np.concatenate([street.line for street in streets])
    for street in streets:
        for side in (-1, 1):
            rng = np.random.default_rng([seed, 3, street.number, side + 1])
            along = -11.0
            while along < street.length + 4:
                corners, width = street.plot(side, along, rng)
                if _free(corners, asphalt, houses):
                    style = invent((seed, 4, street.number, side + 1, len(houses)), width)
                    houses.append(House(corners, style))
                    along += width + (rng.uniform(1.2, 3.2) if rng.random() < 0.14 else 0.02)
                else:
                    along += 0.5
    return tuple(houses)


def _free(corners: Points, asphalt: Points, houses: list[House]) -> bool:
    """Whether a footprint keeps clear of streets and of the houses that stand already."""
    width, depth = (float(np.linalg.norm(corners[far] - corners[0])) for far in (1, 3))
    # On the inside of a bend a plot may be squeezed.
    if width < 4.5:
        return False
    # In the plot's own axes the distance to a rectangle is what is left after clipping.
    axes = np.stack([(corners[1] - corners[0]) / width, (corners[3] - corners[0]) / depth])
    near = (asphalt - corners[0]) @ axes.T
    gaps = near - near.clip(0, [width, depth])
    if (np.einsum("ni,ni->n", gaps, gaps) < (FRONT - 0.25) ** 2).any():
        return False
    if not houses:
        return True
    theirs = np.array([house.corners for house in houses])
    return bool((_apart(corners[None], theirs) | _apart(theirs, corners[None])).all())


def _apart(ours: Points, theirs: Points, slack: float = 0.06) -> NDArray[np.bool_]:
    """Which rectangles ``[., 4, 2]`` are parted by a line along a side of `ours`, up to `slack` metres."""
    edges = np.stack([ours[:, 1] - ours[:, 0], ours[:, 3] - ours[:, 0]], axis=1)
    sizes = np.linalg.norm(edges, axis=-1)
    places = np.einsum("nci,nei->nec", theirs - ours[:, :1], edges / sizes[..., None])
    low, high = places.min(axis=-1), places.max(axis=-1)
    return np.asarray(((high < slack) | (low > sizes - slack)).any(axis=-1))


def place_furniture(seed: int, streets: tuple[Street, ...]) -> tuple[tuple[Thing, ...], tuple[Thing, ...]]:
    """Trees and lamps along the kerbs."""
    trees, lamps = [], []
    for street in streets:
        rng = np.random.default_rng([seed, 5, street.number])
        # A street has one kind of tree, mostly, or hardly any.
        leafy, sort = rng.random() < 0.6, int(rng.integers(6))
        for side in (-1, 1):
            along = 11.0 + rng.uniform(0, 4)
            while along < street.length - 10:
                if rng.random() < (0.62 if leafy else 0.12):
                    where, _ = street.at(along, side * (ROAD + 0.85))
                    kind = sort if rng.random() < 0.8 else int(rng.integers(6))
                    spot, height = (float(where[0]), float(where[1])), float(rng.uniform(4.6, 8.2))
                    trees.append(Thing(spot, kind, height))
                along += rng.uniform(10, 17)
        # Lamps every 21 m, on the left and on the right in turn.
        for turn, along in enumerate(np.arange(9.0 + rng.uniform(0, 3), street.length - 8, 21.0)):
            where, _ = street.at(float(along), (ROAD + 0.45) * (1 if turn % 2 else -1))
            lamps.append(Thing((float(where[0]), float(where[1])), 0, 5.2))
    return tuple(trees), tuple(lamps)


def park_cars(plan: TownPlan, visit: int) -> tuple[Thing, ...]:
    """The cars that stand along the kerbs on one visit; other visits see others."""
    cars = []
    for street in plan.streets:
        rng = np.random.default_rng([plan.seed, 6, visit, street.number])
        crowd = rng.uniform(0.15, 0.6)
        for side in (-1, 1):
            for along in np.arange(14.0, street.length - 13, 5.9):
                if rng.random() < crowd:
                    where, way = street.at(float(along + rng.uniform(-0.5, 0.5)), side * (ROAD - 1.05))
                    turn = float(np.arctan2(way[1], way[0])) + (np.pi if side == 1 else 0.0)
                    spot, sort = (float(where[0]), float(where[1])), int(rng.integers(64))
                    cars.append(Thing(spot, sort, 1.0, turn + rng.normal(0, 0.015)))
    return tuple(cars)
