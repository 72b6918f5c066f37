"""Paints shop fronts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salad.data.town.canvas import Canvas, ramp
from salad.data.town.raster import DISPLAY
from salad.data.town.style import Style


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
