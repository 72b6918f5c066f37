"""Paints a house's walls: windows, doors, shops, cornices and gables, all from its `Style`."""

from __future__ import annotations

import numpy as np

from salad.demo.town.canvas import GRAIN, Canvas, Paint, noise, ramp
from salad.demo.town.plan import NAMES, Style
from salad.demo.town.raster import DISPLAY, HOLE, LAMP, MATTE, WINDOW

CORNICE = 0.6  # height of the ledge below a flat roof, in metres
PARAPET = 0.7  # height of the wall above a flat roof's eaves, in metres
# What is drawn by lot is drawn in one order for ever: a number taken more, or earlier, and every town changes.


class Facade(Canvas):
    """A wall of one house, and the lot that decides its details.

    Args:
        style: The house's looks.
        lot: Numbers that, with the house's own, decide what is drawn by lot.
        size: Width and height in metres.
        colour: Of the bare wall.
        grain: Texels a metre.
    """

    def __init__(
        self,
        style: Style,
        lot: tuple[int, ...],
        size: tuple[float, float],
        colour: Paint,
        grain: float = GRAIN,
    ) -> None:
        super().__init__(*size, colour, grain)
        self.style = style
        self.rng = np.random.default_rng([*style.seed, *lot])

    def ledge(self, left: float, low: float, right: float, high: float, *, shade: float, dark: float) -> None:
        """A strip of trim that stands out, with its shadow down to `shade`."""
        self.rect(left, low, right, high, self.style.trim)
        self.tone(left, shade, right, low, dark)

    def window(self, middle: float, low: float, width: float, height: float, number: int) -> None:
        """One window: surround, reveal, glass with what is behind it, frame, sill, and what hangs beside it."""
        style, extras = self.style, self.style.extras
        left, right, high = middle - width / 2, middle + width / 2, low + height
        # From the back to the front: each layer hides the rest of the one before.
        self.rect(left - 0.11, low - 0.05, right + 0.11, high + 0.12, style.trim)
        if "pediments" in extras and style.wall != "boards":
            self.ledge(left - 0.2, high + 0.2, right + 0.2, high + 0.32, shade=high + 0.12, dark=0.62)
        self.rect(left, low, right, high, (44, 44, 48))
        # Every window has a kind of its own, so that each room is lit or dark by itself at night.
        self._glass(left + 0.03, low + 0.02, right - 0.02, high - 0.1, WINDOW + number % 240)
        across, up = style.mullions
        for edge in range(across + 1):
            place = left + 0.02 + edge * (width - 0.07) / across
            self.rect(place, low, place + 0.07, high - 0.06, style.frame, MATTE)
        for edge in range(up + 1):
            place = low + edge * (height - 0.13) / up
            self.rect(left + 0.02, place, right - 0.02, place + 0.07, style.frame, MATTE)
        self.rect(left, high - 0.09, right, high, (58, 56, 54), MATTE)
        # The reveal: the glass lies a hand's breadth behind the wall.
        self.tone(left, low, left + 0.05, high, 0.62)
        if "arches" in extras:
            rows, columns = self.box(middle - width / 2 - 0.06, high - 0.32, middle + width / 2 + 0.06, high)
            x, y = (part[rows, columns] for part in self.grid())
            corner = y > high - 0.3 + 0.3 * np.sqrt(np.clip(1 - ((x - middle) / (width / 2)) ** 2, 0, 1))
            self.rgb[rows, columns][corner] = style.trim
            self.kind[rows, columns][corner] = MATTE
        self.rect(left - 0.16, low - 0.13, right + 0.16, low - 0.03, np.array(style.trim) * 1.05)
        self.tone(left - 0.14, low - 0.22, right + 0.14, low - 0.13, 0.66)
        if "shutters" in extras:
            self._shutters(left, low, right, high)
        # Flowers grow on upper floors only: below, people would walk into them.
        if "boxes" in extras and low > 3 and self.rng.random() < 0.7:
            self._flowers(left, low, right)

    def _glass(self, left: float, low: float, right: float, high: float, kind: int) -> None:
        """Reflected sky above, a dark room below, curtains or a blind in some."""
        rng, (rows, columns) = self.rng, self.box(left, low, right, high)
        bright = rng.uniform(0.55, 1.15)
        top, bottom = np.array([128, 146, 164]) * bright, np.array([46, 52, 58]) * bright
        self.rgb[rows, columns] = ramp(top, bottom, (rows.stop - rows.start, columns.stop - columns.start))
        self.kind[rows, columns] = kind
        cloths = np.array([[226, 220, 206], [198, 180, 150], [170, 190, 200], [200, 130, 110]])
        cloth = cloths[int(rng.integers(4))] * rng.uniform(0.6, 0.85)
        dress = rng.random()
        if dress < 0.4:
            reach = (right - left) * rng.uniform(0.16, 0.34)
            self.rect(left, low, left + reach, high, cloth)
            self.rect(right - reach, low, right, high, cloth)
            for fold in np.arange(left, right, 0.16):
                self.tone(fold, low, fold + 0.06, high, 0.92)
        elif dress < 0.66:
            self.rect(left, high - (high - low) * rng.uniform(0.2, 0.75), right, high, cloth)
        elif dress < 0.76:
            self.rect(left, low, right, low + (high - low) * 0.45, cloth * 1.1)

    def _shutters(self, left: float, low: float, right: float, high: float) -> None:
        reach = (right - left) * 0.46
        closed = self.rng.random() < 0.1
        open_wings = (left - reach - 0.05, left - 0.05), (right + 0.05, right + reach + 0.05)
        for start, stop in ((left, right),) if closed else open_wings:
            self.rect(start, low, stop, high, self.style.accent, MATTE)
            for slat in np.arange(low + 0.08, high - 0.08, 0.13):
                self.tone(start + 0.06, slat, stop - 0.06, slat + 0.05, 0.72)
            self.tone(stop, low - 0.04, stop + 0.05, high, 0.7)

    def _flowers(self, left: float, low: float, right: float) -> None:
        rng = self.rng
        self.rect(left, low - 0.12, right, low + 0.08, (92, 70, 52), MATTE)
        bloom = [(206, 60, 70), (226, 150, 60), (220, 120, 170), (236, 226, 210)][int(rng.integers(4))]
        for _ in range(int((right - left) * 40)):
            across, up = rng.uniform(left, right), low + 0.02 + abs(rng.normal(0, 0.12))
            colour = bloom if rng.random() < 0.4 else (60 + int(rng.integers(40)), 104, 52)
            self.rect(across, up, across + 0.07, up + 0.07, colour, MATTE)

    def door(self, middle: float, width: float, height: float) -> None:
        """A door with its surround, light, step, number and lamp."""
        left, right = middle - width / 2, middle + width / 2
        self.rect(left - 0.2, 0, right + 0.2, height + 0.55, self.style.trim)
        self.ledge(left - 0.3, height + 0.55, right + 0.3, height + 0.68, shade=height + 0.47, dark=0.6)
        self.rect(left, 0.12, right, height + 0.45, (40, 38, 36))
        self.rect(left + 0.06, height + 0.06, right - 0.06, height + 0.38, (112, 124, 132), WINDOW + 239)
        self.rect(left + 0.06, 0.14, right - 0.06, height, self.style.accent)
        # Two panels in each half of the door, each with a shadow and a light edge inside it.
        for side in (left + 0.16, middle + 0.06):
            for low, high in ((0.3, height * 0.42), (height * 0.5, height - 0.15)):
                self.tone(side, low, side + width / 2 - 0.24, high, 0.74)
                self.tone(side + 0.04, low + 0.04, side + width / 2 - 0.24, high, 1.2)
        self.rect(middle + 0.3, 1.0, middle + 0.38, 1.12, (214, 186, 96))
        self.rect(left - 0.3, 0, right + 0.3, 0.14, (150, 146, 138))
        self.rect(right + 0.28, height - 0.35, right + 0.44, height - 0.08, (236, 220, 180), LAMP)
        self.write(str(1 + sum(self.style.seed) % 97), left - 0.19, 1.6, left - 0.01, 1.8, (30, 40, 70))

    def shop_front(self) -> None:
        """Panes with goods behind them, a glass door, and the sign above."""
        style, rng, width, top = self.style, self.rng, self.width, self.style.ground - 0.35
        sign = top - 0.62
        wood = np.array(style.accent, np.float64)
        self.rect(0.2, 0, width - 0.2, top, wood)
        # Panes of about 2.4 m, one of them the door.
        bays = max(2, round(width / 2.4))
        door = int(rng.integers(bays))
        for bay in range(bays):
            left = 0.34 + bay * (width - 0.68) / bays
            right = left + (width - 0.68) / bays - 0.12
            low = 0.1 if bay == door else 0.62
            self.rect(left, low, right, sign - 0.12, (36, 36, 40))
            rows, columns = self.box(left + 0.05, low + 0.05, right - 0.05, sign - 0.2)
            high, wide = rows.stop - rows.start, columns.stop - columns.start
            # Walls and shelves far inside the shop: a coarse pattern of shades over a fading grey.
            inside = np.kron(rng.uniform(0.72, 1.05, (4, 7)), np.ones((high // 4 + 1, wide // 7 + 1)))
            fade = ramp(np.array([70, 74, 78]), np.array([128, 120, 104]), (high, wide))
            self.rgb[rows, columns] = fade * inside[:high, :wide, None]
            self.kind[rows, columns] = DISPLAY
            if bay == door:
                self.rect((left + right) / 2 - 0.03, low, (left + right) / 2 + 0.03, sign - 0.2, wood, MATTE)
                self.rect(left + 0.05, 2.15, right - 0.05, 2.24, wood, MATTE)
            else:
                self._goods(left + 0.1, low + 0.08, right - 0.1)
                self.rect(left, low - 0.1, right, low, np.clip(wood * 1.25, 0, 255))
        self.rect(0.1, sign, width - 0.1, top, np.clip(wood * 1.12, 0, 255))
        self.rect(0.04, top, width - 0.04, top + 0.1, style.trim)
        self.tone(0.1, sign - 0.09, width - 0.1, sign, 0.55)
        # Dark wood takes light letters, light wood dark ones.
        letters = (246, 236, 208) if sum(style.accent) < 330 else (34, 30, 28)
        self.write(style.shop, 0.5, sign + 0.1, width - 0.5, top - 0.1, letters)

    def _goods(self, left: float, low: float, right: float) -> None:
        rng = self.rng
        for shelf in (low, low + 0.75):
            self.rect(left, shelf, right, shelf + 0.05, (120, 96, 70))
            for place in np.arange(left, right - 0.15, 0.24):
                if rng.random() < 0.75:
                    colour = rng.integers(50, 225, 3) * 0.55 + rng.uniform(30, 90)
                    self.rect(place, shelf + 0.05, place + 0.19, shelf + 0.05 + rng.uniform(0.15, 0.55), colour)

    def painted_sign(self) -> None:
        """An old advertisement on a bare wall."""
        left, right, low = self.width * 0.12, self.width * 0.88, self.style.ground + 0.1
        accent = np.array(self.style.accent)
        self.rect(left, low, right, low + 2.2, accent * 0.6 + 70, MATTE)
        self.rect(left + 0.1, low + 0.1, right - 0.1, low + 2.1, accent * 0.85 + 20)
        word = NAMES[int(self.rng.integers(len(NAMES)))]
        self.write(word, left + 0.4, low + 0.6, right - 0.4, low + 1.7, (232, 220, 190))
        rows, columns = self.box(left, low, right, low + 2.2)
        shape = rows.stop - rows.start, columns.stop - columns.start, 1
        self.rgb[rows, columns] *= self.rng.uniform(0.86, 1.1, shape)  # weathered

    def base(self) -> None:
        """The wall of the ground floor: another material where there is a shop, else a plinth."""
        style = self.style
        # Two houses in five, and every shop, have a ground floor of another material.
        if sum(style.seed) % 5 < 2 or style.shop:
            top = style.ground - 0.25
            self.rect(0, 0, self.width, top, style.base_colour)
            self.clad("stone" if sum(style.seed) % 2 else "plaster", style.seed, 0, top)
            self.ledge(0, top, self.width, top + 0.14, shade=top - 0.07, dark=0.6)
        else:
            self.rect(0, 0, self.width, 0.55, np.array(style.base_colour) * 0.8)
            self.clad("plaster", style.seed, 0, 0.55)

    def timber(self) -> None:
        """Beams along the floors, upright and aslant."""
        style = self.style
        # Beams are dark: light frames belong to painted windows, not to timber.
        beam = np.array(style.frame if sum(style.frame) < 300 else (74, 52, 38)) * 1.0
        for floor in range(style.storeys):
            low = style.ground + style.storey * floor
            self.rect(0, low - 0.1, self.width, low + 0.08, beam)
        count = style.columns * 2 + 1
        for number in range(count):
            place = number * (self.width - 0.16) / (count - 1)
            self.rect(place, style.ground, place + 0.15, self.height, beam)
        across, up = self.grid()
        # Braces at 45 degrees, in the lower part of each storey only.
        slope = np.abs(((across + up - style.ground) % (self.width / style.columns)) - 0.2) < 0.08
        self.rgb[slope & (up > style.ground) & ((up - style.ground) % style.storey < 0.85)] = beam

    def quoins(self) -> None:
        """Blocks of stone at both edges, long and short in turn."""
        for number in range(int(self.style.eaves / 0.42)):
            reach = 0.5 if number % 2 else 0.32
            for left, right in ((0, reach), (self.width - reach, self.width)):
                self.rect(left, number * 0.42, right, number * 0.42 + 0.39, self.style.trim)
                self.tone(left, number * 0.42, right, number * 0.42 + 0.05, 0.75)

    def upper_floors(self) -> None:
        """Rows of windows, smaller higher up, and one in the gable."""
        style, pitch = self.style, self.width / self.style.columns
        for floor in range(1, style.storeys):
            low = style.ground + style.storey * (floor - 1)
            if "bands" in style.extras:
                self.ledge(0, low - 0.08, self.width, low + 0.1, shade=low - 0.16, dark=0.68)
            height = min(style.window[1] * (1.0 if floor < 3 else 0.8), style.storey - 1.0)
            for column in range(style.columns):
                self.window((column + 0.5) * pitch, low + 0.72, style.window[0], height, floor * 9 + column)
        if style.roof in ("gable", "stepped") and self.width > 5.5:
            self.window(self.width / 2, style.eaves + 0.5, 0.8, 1.05, 190)

    def ground_floor(self) -> None:
        """A shop, or windows and the door."""
        style, pitch = self.style, self.width / self.style.columns
        if style.shop:
            self.shop_front()
            return
        for column in range(style.columns):
            middle = (column + 0.5) * pitch
            if column == style.door:
                self.door(middle, min(1.25, pitch * 0.7), min(2.5, style.ground - 0.5))
            else:
                self.window(middle, 1.0, style.window[0], min(1.7, style.ground - 1.5), column)

    def cornice(self) -> None:
        """The ledge below a roof that is no gable."""
        if self.style.roof in ("gable", "stepped"):
            return
        low = self.style.eaves - CORNICE * 0.55
        self.rect(0, low, self.width, self.style.eaves, self.style.trim)
        self.tone(0, low + 0.16, self.width, low + 0.22, 0.8)
        self.tone(0, low - 0.14, self.width, low, 0.58)
        if self.style.wall in ("stone", "plaster"):
            for place in np.arange(0.1, self.width - 0.1, 0.36):
                self.tone(place, low, place + 0.15, low + 0.14, 0.66)

    def ivy(self) -> None:
        """Leaves that have climbed up one side."""
        rng, (across, up) = self.rng, self.grid()
        edge = across if rng.random() < 0.5 else self.width - across
        growth = 1.15 - edge / rng.uniform(1.6, 3.2) - up / (self.height * rng.uniform(0.6, 0.95))
        # The plant thins out with height and with the distance from its edge; noise frays its outline.
        leaves = growth + 0.3 * noise(self.kind.shape, [*self.style.seed, 24], 6, 4) > 0.25
        rows, columns = np.nonzero(leaves & (self.kind == MATTE))
        leaves_up, leaves_across = self.kind.shape[0] // 3 + 1, self.kind.shape[1] // 4 + 2
        shade = rng.uniform(0.45, 1.35, (leaves_up, leaves_across))  # a leaf is 3 by 4 texels
        leaf = shade[rows // 3, (columns + rows // 3 % 2 * 2) // 4, None]
        self.rgb[rows, columns] = np.array([62, 90, 48]) * leaf

    def roof_line(self) -> None:
        """Cut the sky out of the front's upper end."""
        style, half, (across, up) = self.style, self.width / 2, self.grid()
        if style.roof == "flat":
            self.rect(0, self.height - 0.12, self.width, self.height, style.trim)
            if sum(style.seed) % 3 == 0:
                for place in np.arange(0.3, self.width - 0.5, 0.34):
                    self.kind[self.box(place, style.eaves + 0.12, place + 0.2, self.height - 0.14)] = HOLE
        elif style.roof == "gable":
            edge = style.eaves + (half - np.abs(across - half)) * style.rise
            self.rgb[up > edge - 0.2] = style.trim
            self.rgb[(up > edge - 0.28) & (up <= edge - 0.2)] *= 0.65
            self.kind[up > edge] = HOLE
        elif style.roof == "stepped":
            steps = 5
            step = np.floor((half - np.abs(across - half)) / half * steps) / steps
            edge = style.eaves + step * half * style.rise + 0.75
            self.rgb[up > edge - 0.14] = style.trim
            self.kind[up > edge] = HOLE


def front_height(style: Style, width: float) -> float:
    """Height of the front in metres, its gable or parapet included."""
    extra = {"flat": PARAPET, "gable": width / 2 * style.rise, "stepped": width / 2 * style.rise + 0.9}
    return style.eaves + extra.get(style.roof, 0.0)


def paint_front(style: Style, width: float) -> Facade:
    """The wall towards the street."""
    front = Facade(style, (21,), (width, front_height(style, width)), style.colour)
    front.clad(style.wall, style.seed)
    front.base()
    if "timber" in style.extras and style.wall == "plaster":
        front.timber()
    # Dirt comes before windows and doors: those are cleaned.
    front.smudge(style.seed)
    if "quoins" in style.extras and style.wall != "boards":
        front.quoins()
    front.upper_floors()
    front.ground_floor()
    front.cornice()
    if "ivy" in style.extras and not style.shop:
        front.ivy()
    if "pipe" in style.extras:
        front.rect(width - 0.2, 0, width - 0.1, style.eaves - 0.3, np.array(style.trim) * 0.55)
        front.tone(width - 0.1, 0, width - 0.04, style.eaves - 0.3, 0.7)
    # Last, since it cuts holes that paint would fill again.
    front.roof_line()
    return front


def paint_side(style: Style, width: float, number: int) -> Facade:
    """A wall that does not face the street: plain, a few windows, and a gable where the roof has one."""
    gable = style.roof == "eaves" and number in (1, 3)
    height = style.eaves + (width / 2 * style.rise if gable else 0.0)
    # Coarser than a front: nobody stands near it.
    side = Facade(style, (22, number), (width, height), np.array(style.colour) * 0.94, 20.0)
    side.clad(style.wall, [*style.seed, number])
    side.smudge([*style.seed, number])
    for floor in range(style.storeys):
        count = max(1, round(width / 3.1))
        low = 0.9 if floor == 0 else style.ground + style.storey * (floor - 1) + 0.8
        for column in range(count):
            if side.rng.random() < 0.7:
                side.window((column + 0.5) * width / count, low, 0.9, 1.4, floor * 4 + column)
    if number != 2 and side.rng.random() < 0.3:
        side.painted_sign()
    if gable:
        across, up = side.grid()
        side.kind[up > style.eaves + (width / 2 - np.abs(across - width / 2)) * style.rise] = HOLE
    return side


def paint_mansard(style: Style, width: float, height: float) -> Facade:
    """The steep roof above the eaves, with its dormer windows."""
    roof = Facade(style, (23,), (width, height), style.tiles)
    roof.clad("brick", [*style.seed, 23])
    for column in range(style.columns):
        middle = (column + 0.5) * width / style.columns
        half = style.window[0] / 2 + 0.16
        roof.rect(middle - half, 0.15, middle + half, height - 0.35, style.trim)
        roof.tone(middle + half, 0.15, middle + half + 0.12, height - 0.4, 0.6)
        roof.window(middle, 0.35, style.window[0] * 0.85, height - 1.0, 200 + column)
    roof.rect(0, height - 0.14, width, height, np.array(style.trim) * 0.7)
    return roof
