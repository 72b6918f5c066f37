"""Paints windows and doors."""

from __future__ import annotations

import numpy as np

from salad.data.town.canvas import Canvas, ramp
from salad.data.town.raster import LAMP, WINDOW
from salad.data.town.style import Style


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
