"""Paints a house's walls: windows, doors, shops, cornices and gables, all from its `Style`."""

from __future__ import annotations

import numpy as np

from salad.data.town.canvas import Canvas, clad, noise, smudge
from salad.data.town.openings import door, window
from salad.data.town.shop import shop_front
from salad.data.town.style import NAMES, Style

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
