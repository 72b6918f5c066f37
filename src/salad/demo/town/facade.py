"""Paints a house's walls: windows, doors, shops, cornices and gables, all from its `Style`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salad.demo.town.plan import NAMES, Style
from salad.demo.town.raster import DISPLAY, LAMP, WINDOW, Canvas, clad, noise, ramp, smudge

# --- Paints windows and doors ---


def window(
    canvas: Canvas,
    style: Style,
    middle: float,
    low: float,
    width: float,
    height: float,
    rng: np.random.Generator,
    number: int,
) -> None:
    """One window: surround, reveal, glass with what is behind it, frame, sill, and what hangs beside it."""
    left, right, high = middle - width / 2, middle + width / 2, low + height
    canvas.rect(left - 0.11, low - 0.05, right + 0.11, high + 0.12, style.trim)
    if "pediments" in style.extras and style.wall != "boards":
        canvas.rect(left - 0.2, high + 0.2, right + 0.2, high + 0.32, style.trim)
        canvas.tone(left - 0.2, high + 0.12, right + 0.2, high + 0.2, 0.62)
    canvas.rect(left, low, right, high, (44, 44, 48))
    _glass(canvas, (left + 0.03, low + 0.02, right - 0.02, high - 0.1), rng, WINDOW + number % 240)
    across, up = style.mullions
    for edge in range(across + 1):
        place = left + 0.02 + edge * (width - 0.07) / across
        canvas.rect(place, low, place + 0.07, high - 0.06, style.frame, 1)
    for edge in range(up + 1):
        place = low + edge * (height - 0.13) / up
        canvas.rect(left + 0.02, place, right - 0.02, place + 0.07, style.frame, 1)
    canvas.rect(left, high - 0.09, right, high, (58, 56, 54), 1)
    canvas.tone(left, low, left + 0.05, high, 0.62)
    if "arches" in style.extras:
        _arch(canvas, style, middle, high, width)
    canvas.rect(left - 0.16, low - 0.13, right + 0.16, low - 0.03, np.array(style.trim) * 1.05)
    canvas.tone(left - 0.14, low - 0.22, right + 0.14, low - 0.13, 0.66)
    if "shutters" in style.extras:
        _shutters(canvas, style, (left, low, right, high), rng)
    if "boxes" in style.extras and low > 3 and rng.random() < 0.7:
        _flowers(canvas, left, low, right, rng)


def _arch(canvas: Canvas, style: Style, middle: float, high: float, width: float) -> None:
    rows, columns = canvas.box(middle - width / 2 - 0.06, high - 0.32, middle + width / 2 + 0.06, high)
    across, up = (part[rows, columns] for part in canvas.grid())
    corner = up > high - 0.3 + 0.3 * np.sqrt(np.clip(1 - ((across - middle) / (width / 2)) ** 2, 0, 1))
    canvas.rgb[rows, columns][corner] = style.trim
    canvas.kind[rows, columns][corner] = 1


def _glass(
    canvas: Canvas, pane: tuple[float, float, float, float], rng: np.random.Generator, kind: int
) -> None:
    """Reflected sky above, a dark room below, curtains or a blind in some."""
    left, low, right, high = pane
    rows, columns = canvas.box(*pane)
    shape = rows.stop - rows.start, columns.stop - columns.start
    bright = rng.uniform(0.55, 1.15)
    top, bottom = np.array([128, 146, 164]) * bright, np.array([46, 52, 58]) * bright
    canvas.rgb[rows, columns] = ramp(top, bottom, shape)
    canvas.kind[rows, columns] = kind
    cloth = np.array(
        [[226, 220, 206], [198, 180, 150], [170, 190, 200], [200, 130, 110]][int(rng.integers(4))]
    )
    cloth = cloth * rng.uniform(0.6, 0.85)
    dress = rng.random()
    if dress < 0.4:
        reach = (right - left) * rng.uniform(0.16, 0.34)
        canvas.rect(left, low, left + reach, high, cloth)
        canvas.rect(right - reach, low, right, high, cloth)
        for fold in np.arange(left, right, 0.16):
            canvas.tone(fold, low, fold + 0.06, high, 0.92)
    elif dress < 0.66:
        canvas.rect(left, high - (high - low) * rng.uniform(0.2, 0.75), right, high, cloth)
    elif dress < 0.76:
        canvas.rect(left, low, right, low + (high - low) * 0.45, cloth * 1.1)


def _shutters(
    canvas: Canvas, style: Style, pane: tuple[float, float, float, float], rng: np.random.Generator
) -> None:
    left, low, right, high = pane
    reach = (right - left) * 0.46
    closed = rng.random() < 0.1
    places = (
        ((left, right),)
        if closed
        else ((left - reach - 0.05, left - 0.05), (right + 0.05, right + reach + 0.05))
    )
    for start, stop in places:
        canvas.rect(start, low, stop, high, style.accent, 1)
        for slat in np.arange(low + 0.08, high - 0.08, 0.13):
            canvas.tone(start + 0.06, slat, stop - 0.06, slat + 0.05, 0.72)
        canvas.tone(stop, low - 0.04, stop + 0.05, high, 0.7)


def _flowers(canvas: Canvas, left: float, low: float, right: float, rng: np.random.Generator) -> None:
    canvas.rect(left, low - 0.12, right, low + 0.08, (92, 70, 52), 1)
    bloom = [(206, 60, 70), (226, 150, 60), (220, 120, 170), (236, 226, 210)][int(rng.integers(4))]
    for _ in range(int((right - left) * 40)):
        across, up = rng.uniform(left, right), low + 0.02 + abs(rng.normal(0, 0.12))
        colour = bloom if rng.random() < 0.4 else (60 + int(rng.integers(40)), 104, 52)
        canvas.rect(across, up, across + 0.07, up + 0.07, colour, 1)


def door(canvas: Canvas, style: Style, middle: float, width: float, height: float) -> None:
    """A door with its surround, light, step, number and lamp."""
    left, right = middle - width / 2, middle + width / 2
    canvas.rect(left - 0.2, 0, right + 0.2, height + 0.55, style.trim)
    canvas.rect(left - 0.3, height + 0.55, right + 0.3, height + 0.68, style.trim)
    canvas.tone(left - 0.3, height + 0.47, right + 0.3, height + 0.55, 0.6)
    canvas.rect(left, 0.12, right, height + 0.45, (40, 38, 36))
    canvas.rect(left + 0.06, height + 0.06, right - 0.06, height + 0.38, (112, 124, 132), WINDOW + 239)
    canvas.rect(left + 0.06, 0.14, right - 0.06, height, style.accent)
    for side in (left + 0.16, middle + 0.06):
        for low, high in ((0.3, height * 0.42), (height * 0.5, height - 0.15)):
            canvas.tone(side, low, side + width / 2 - 0.24, high, 0.74)
            canvas.tone(side + 0.04, low + 0.04, side + width / 2 - 0.24, high, 1.2)
    canvas.rect(middle + 0.3, 1.0, middle + 0.38, 1.12, (214, 186, 96))
    canvas.rect(left - 0.3, 0, right + 0.3, 0.14, (150, 146, 138))
    canvas.rect(right + 0.28, height - 0.35, right + 0.44, height - 0.08, (236, 220, 180), LAMP)
    canvas.write(str(1 + sum(style.seed) % 97), left - 0.19, 1.6, left - 0.01, 1.8, (30, 40, 70))


# --- Paints shop fronts ---


def shop_front(canvas: Canvas, style: Style, rng: np.random.Generator) -> None:
    """Panes with goods behind them, a glass door, and the sign above."""
    width, top = canvas.width, style.ground - 0.35
    sign = top - 0.62
    wood = np.array(style.accent, np.float64)
    canvas.rect(0.2, 0, width - 0.2, top, wood)
    bays = max(2, round(width / 2.4))
    door = int(rng.integers(bays))
    for bay in range(bays):
        left = 0.34 + bay * (width - 0.68) / bays
        right = left + (width - 0.68) / bays - 0.12
        low = 0.1 if bay == door else 0.62
        canvas.rect(left, low, right, sign - 0.12, (36, 36, 40))
        rows, columns = canvas.box(left + 0.05, low + 0.05, right - 0.05, sign - 0.2)
        shape = rows.stop - rows.start, columns.stop - columns.start
        canvas.rgb[rows, columns] = ramp(np.array([70, 74, 78]), np.array([128, 120, 104]), shape) * _panel(
            shape, rng
        )
        canvas.kind[rows, columns] = DISPLAY
        if bay == door:
            canvas.rect((left + right) / 2 - 0.03, low, (left + right) / 2 + 0.03, sign - 0.2, wood, 1)
            canvas.rect(left + 0.05, 2.15, right - 0.05, 2.24, wood, 1)
        else:
            _goods(canvas, left + 0.1, low + 0.08, right - 0.1, rng)
            canvas.rect(left, low - 0.1, right, low, np.clip(wood * 1.25, 0, 255))
    canvas.rect(0.1, sign, width - 0.1, top, np.clip(wood * 1.12, 0, 255))
    canvas.rect(0.04, top, width - 0.04, top + 0.1, style.trim)
    canvas.tone(0.1, sign - 0.09, width - 0.1, sign, 0.55)
    letters = (246, 236, 208) if sum(style.accent) < 330 else (34, 30, 28)
    canvas.write(style.shop, 0.5, sign + 0.1, width - 0.5, top - 0.1, letters)


def _panel(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.floating]:
    """Walls and shelves far inside a shop, as factors ``[H, W, 1]``."""
    shades = rng.uniform(0.72, 1.05, (4, 7))
    return np.kron(shades, np.ones((shape[0] // 4 + 1, shape[1] // 7 + 1)))[: shape[0], : shape[1], None]


def _goods(canvas: Canvas, left: float, low: float, right: float, rng: np.random.Generator) -> None:
    for shelf in (low, low + 0.75):
        canvas.rect(left, shelf, right, shelf + 0.05, (120, 96, 70))
        for place in np.arange(left, right - 0.15, 0.24):
            if rng.random() < 0.75:
                colour = rng.integers(50, 225, 3) * 0.55 + rng.uniform(30, 90)
                canvas.rect(place, shelf + 0.05, place + 0.19, shelf + 0.05 + rng.uniform(0.15, 0.55), colour)


CORNICE = 0.6
PARAPET = 0.7


def front_height(style: Style, width: float) -> float:
    """Height of the front in metres, its gable or parapet included."""
    extra = {"flat": PARAPET, "gable": width / 2 * style.rise, "stepped": width / 2 * style.rise + 0.9}
    return style.eaves + extra.get(style.roof, 0.0)


def paint_front(style: Style, width: float) -> Canvas:
    """The wall towards the street."""
    rng = np.random.default_rng([*style.seed, 21])
    canvas = Canvas(width, front_height(style, width), style.colour)
    clad(canvas, style.wall, style.seed)
    _ground_floor_wall(canvas, style)
    if "timber" in style.extras and style.wall == "plaster":
        _timber(canvas, style)
    smudge(canvas, style.seed)
    if "quoins" in style.extras and style.wall != "boards":
        _quoins(canvas, style)
    _upper_windows(canvas, style, rng)
    _ground_floor(canvas, style, rng)
    _cornice(canvas, style)
    if "ivy" in style.extras and not style.shop:
        _ivy(canvas, style, rng)
    if "pipe" in style.extras:
        canvas.rect(width - 0.2, 0, width - 0.1, style.eaves - 0.3, np.array(style.trim) * 0.55)
        canvas.tone(width - 0.1, 0, width - 0.04, style.eaves - 0.3, 0.7)
    _roof_line(canvas, style)
    return canvas


def paint_side(style: Style, width: float, wall: int) -> Canvas:
    """A wall that does not face the street: plain, a few windows, and a gable where the roof has one."""
    gable = style.roof == "eaves" and wall in (1, 3)
    canvas = Canvas(
        width, style.eaves + (width / 2 * style.rise if gable else 0.0), np.array(style.colour) * 0.94, 20.0
    )
    clad(canvas, style.wall, [*style.seed, wall])
    smudge(canvas, [*style.seed, wall])
    rng = np.random.default_rng([*style.seed, 22, wall])
    for floor in range(style.storeys):
        count = max(1, round(width / 3.1))
        low = 0.9 if floor == 0 else style.ground + style.storey * (floor - 1) + 0.8
        for column in range(count):
            if rng.random() < 0.7:
                place = (column + 0.5) * width / count
                window(canvas, style, place, low, 0.9, 1.4, rng, floor * 4 + column)
    if wall != 2 and rng.random() < 0.3:
        _painted_sign(canvas, style, rng)
    if gable:
        across, up = canvas.grid()
        canvas.kind[up > style.eaves + (width / 2 - np.abs(across - width / 2)) * style.rise] = 0
    return canvas


def _painted_sign(canvas: Canvas, style: Style, rng: np.random.Generator) -> None:
    """An old advertisement on a bare wall."""
    left, right, low = canvas.width * 0.12, canvas.width * 0.88, style.ground + 0.1
    canvas.rect(left, low, right, low + 2.2, np.array(style.accent) * 0.6 + 70, 1)
    canvas.rect(left + 0.1, low + 0.1, right - 0.1, low + 2.1, np.array(style.accent) * 0.85 + 20)
    word = NAMES[int(rng.integers(len(NAMES)))]
    canvas.write(word, left + 0.4, low + 0.6, right - 0.4, low + 1.7, (232, 220, 190))
    rows, columns = canvas.box(left, low, right, low + 2.2)
    canvas.rgb[rows, columns] *= rng.uniform(
        0.86, 1.1, (rows.stop - rows.start, columns.stop - columns.start, 1)
    )


def paint_mansard(style: Style, width: float, height: float) -> Canvas:
    """The steep roof above the eaves, with its dormer windows."""
    rng = np.random.default_rng([*style.seed, 23])
    canvas = Canvas(width, height, style.tiles)
    clad(canvas, "brick", [*style.seed, 23])
    for column in range(style.columns):
        middle = (column + 0.5) * width / style.columns
        half = style.window[0] / 2 + 0.16
        canvas.rect(middle - half, 0.15, middle + half, height - 0.35, style.trim)
        canvas.tone(middle + half, 0.15, middle + half + 0.12, height - 0.4, 0.6)
        window(canvas, style, middle, 0.35, style.window[0] * 0.85, height - 1.0, rng, 200 + column)
    canvas.rect(0, height - 0.14, width, height, np.array(style.trim) * 0.7)
    return canvas


def _ground_floor_wall(canvas: Canvas, style: Style) -> None:
    if sum(style.seed) % 5 < 2 or style.shop:
        top = style.ground - 0.25
        canvas.rect(0, 0, canvas.width, top, style.base_colour)
        clad(canvas, "stone" if sum(style.seed) % 2 else "plaster", style.seed, 0, top)
        canvas.rect(0, top, canvas.width, top + 0.14, style.trim)
        canvas.tone(0, top - 0.07, canvas.width, top, 0.6)
    else:
        canvas.rect(0, 0, canvas.width, 0.55, np.array(style.base_colour) * 0.8)
        clad(canvas, "plaster", style.seed, 0, 0.55)


def _timber(canvas: Canvas, style: Style) -> None:
    beam = np.array(style.frame if sum(style.frame) < 300 else (74, 52, 38)) * 1.0
    for floor in range(style.storeys):
        low = style.ground + style.storey * floor
        canvas.rect(0, low - 0.1, canvas.width, low + 0.08, beam)
    count = style.columns * 2 + 1
    for number in range(count):
        place = number * (canvas.width - 0.16) / (count - 1)
        canvas.rect(place, style.ground, place + 0.15, canvas.height, beam)
    across, up = canvas.grid()
    slope = np.abs(((across + up - style.ground) % (canvas.width / style.columns)) - 0.2) < 0.08
    braced = slope & (up > style.ground) & ((up - style.ground) % style.storey < 0.85)
    canvas.rgb[braced] = beam


def _quoins(canvas: Canvas, style: Style) -> None:
    for number in range(int(style.eaves / 0.42)):
        reach = 0.5 if number % 2 else 0.32
        for left, right in ((0, reach), (canvas.width - reach, canvas.width)):
            canvas.rect(left, number * 0.42, right, number * 0.42 + 0.39, style.trim)
            canvas.tone(left, number * 0.42, right, number * 0.42 + 0.05, 0.75)


def _upper_windows(canvas: Canvas, style: Style, rng: np.random.Generator) -> None:
    pitch = canvas.width / style.columns
    for floor in range(1, style.storeys):
        low = style.ground + style.storey * (floor - 1)
        if "bands" in style.extras:
            canvas.rect(0, low - 0.08, canvas.width, low + 0.1, style.trim)
            canvas.tone(0, low - 0.16, canvas.width, low - 0.08, 0.68)
        height = min(style.window[1] * (1.0 if floor < 3 else 0.8), style.storey - 1.0)
        for column in range(style.columns):
            window(
                canvas,
                style,
                (column + 0.5) * pitch,
                low + 0.72,
                style.window[0],
                height,
                rng,
                floor * 9 + column,
            )
    if style.roof in ("gable", "stepped") and canvas.width > 5.5:
        window(canvas, style, canvas.width / 2, style.eaves + 0.5, 0.8, 1.05, rng, 190)


def _ground_floor(canvas: Canvas, style: Style, rng: np.random.Generator) -> None:
    pitch = canvas.width / style.columns
    if style.shop:
        shop_front(canvas, style, rng)
        return
    for column in range(style.columns):
        middle = (column + 0.5) * pitch
        if column == style.door:
            door(canvas, style, middle, min(1.25, pitch * 0.7), min(2.5, style.ground - 0.5))
        else:
            window(canvas, style, middle, 1.0, style.window[0], min(1.7, style.ground - 1.5), rng, column)


def _cornice(canvas: Canvas, style: Style) -> None:
    if style.roof in ("gable", "stepped"):
        return
    low = style.eaves - CORNICE * 0.55
    canvas.rect(0, low, canvas.width, style.eaves, style.trim)
    canvas.tone(0, low + 0.16, canvas.width, low + 0.22, 0.8)
    canvas.tone(0, low - 0.14, canvas.width, low, 0.58)
    if style.wall in ("stone", "plaster"):
        for place in np.arange(0.1, canvas.width - 0.1, 0.36):
            canvas.tone(place, low, place + 0.15, low + 0.14, 0.66)


def _roof_line(canvas: Canvas, style: Style) -> None:
    """Cut the sky out of the front's upper end."""
    across, up = canvas.grid()
    half = canvas.width / 2
    if style.roof == "flat":
        canvas.rect(0, canvas.height - 0.12, canvas.width, canvas.height, style.trim)
        if sum(style.seed) % 3 == 0:
            for place in np.arange(0.3, canvas.width - 0.5, 0.34):
                canvas.cut(place, style.eaves + 0.12, place + 0.2, canvas.height - 0.14)
    elif style.roof == "gable":
        edge = style.eaves + (half - np.abs(across - half)) * style.rise
        canvas.rgb[up > edge - 0.2] = style.trim
        canvas.rgb[(up > edge - 0.28) & (up <= edge - 0.2)] *= 0.65
        canvas.kind[up > edge] = 0
    elif style.roof == "stepped":
        steps = 5
        step = np.floor((half - np.abs(across - half)) / half * steps) / steps
        edge = style.eaves + step * half * style.rise + 0.75
        canvas.rgb[up > edge - 0.14] = style.trim
        canvas.kind[up > edge] = 0


def _ivy(canvas: Canvas, style: Style, rng: np.random.Generator) -> None:
    """Leaves that have climbed up one side."""
    across, up = canvas.grid()
    edge = across if rng.random() < 0.5 else canvas.width - across
    growth = 1.15 - edge / rng.uniform(1.6, 3.2) - up / (canvas.height * rng.uniform(0.6, 0.95))
    leaves = growth + 0.3 * noise(canvas.kind.shape, [*style.seed, 24], 6, 4) > 0.25
    leaves &= canvas.kind == 1
    rows, columns = np.nonzero(leaves)
    shade = rng.uniform(0.45, 1.35, (canvas.kind.shape[0] // 3 + 1, canvas.kind.shape[1] // 4 + 2))
    canvas.rgb[rows, columns] = (
        np.array([62, 90, 48]) * shade[rows // 3, (columns + rows // 3 % 2 * 2) // 4, None]
    )
