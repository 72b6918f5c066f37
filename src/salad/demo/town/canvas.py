"""A wall to paint on, in metres, and the materials that walls are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from salad.demo.town.raster import MATTE, Floats, Texture

Paint = Sequence[float] | NDArray[Any]
GRAIN = 32.0  # texels a metre on facades


class Canvas:
    """A rectangle of wall, painted in metres from its lower left corner.

    Args:
        width: In metres.
        height: In metres.
        colour: Of the bare wall.
        grain: Texels a metre.
        fits: Whether it is stretched over a face of any size, instead of repeating at its own scale.
    """

    def __init__(self, width: float, height: float, colour: Paint, grain: float = GRAIN, *, fits: bool = True) -> None:
        self.width, self.height, self.grain, self.fits = width, height, grain, fits
        # Two texels at least, or a texture has no inside to sample.
        shape = max(2, round(height * grain)), max(2, round(width * grain))
        self.rgb: Floats = np.empty((*shape, 3), np.float32)
        self.rgb[:] = colour
        self.kind = np.full(shape, MATTE, np.uint8)

    def box(self, left: float, low: float, right: float, high: float) -> tuple[slice, slice]:
        """The rows and columns of a rectangle, cut off at the edges."""
        rows, columns = self.kind.shape
        # Rows count from the top, metres from the ground.
        limits = np.array([rows - high * self.grain, rows - low * self.grain, left * self.grain, right * self.grain])
        top, bottom, start, stop = (int(limit) for limit in np.floor(limits + 0.5).clip(0))
        return slice(min(top, rows), min(bottom, rows)), slice(min(start, columns), min(stop, columns))

    def rect(
        self,
        left: float,
        low: float,
        right: float,
        high: float,
        colour: Paint,
        kind: int | None = None,
    ) -> None:
        """Fill a rectangle."""
        where = self.box(left, low, right, high)
        self.rgb[where] = colour
        if kind is not None:
            self.kind[where] = kind

    def tone(self, left: float, low: float, right: float, high: float, factor: float) -> None:
        """Darken or lighten a rectangle."""
        self.rgb[self.box(left, low, right, high)] *= np.float32(factor)

    def grid(self) -> tuple[Floats, Floats]:
        """Metres from the left and from the ground, of every texel ``[H, W]``."""
        rows, columns = self.kind.shape
        up = (rows - 0.5 - np.arange(rows, dtype=np.float32)) / np.float32(self.grain)
        across = (np.arange(columns, dtype=np.float32) + 0.5) / np.float32(self.grain)
        return np.broadcast_to(across, self.kind.shape), np.broadcast_to(up[:, None], self.kind.shape)

    def write(self, text: str, left: float, low: float, right: float, high: float, colour: Paint) -> None:
        """Letters that fill a rectangle's height and stay within its width."""
        rows, columns = self.box(left, low, right, high)
        height, width = rows.stop - rows.start, columns.stop - columns.start
        # Smaller letters would be a smear.
        if height < 4 or width < 8:
            return
        # Drawn large and shrunk: so letters keep their shape at any size.
        font = ImageFont.load_default(48)
        ink = Image.new("L", (int(font.getlength(text)) + 8, 64), 0)
        ImageDraw.Draw(ink).text((4, 2), text, fill=255, font=font)
        ink = ink.crop(ink.getbbox())
        scale = min(height / ink.height, width / ink.width)
        small = ink.resize((max(1, int(ink.width * scale)), max(1, int(ink.height * scale))), Image.Resampling.BOX)
        cover = np.asarray(small, np.float32)[..., None] / 255
        top = rows.start + (height - small.height) // 2
        start = columns.start + (width - small.width) // 2
        part = self.rgb[top : top + small.height, start : start + small.width]
        part[:] = part * (1 - cover) + cover * np.array(colour, np.float32)

    def texture(self) -> Texture:
        """The finished wall."""
        return Texture.of(self.rgb, self.kind, self.grain, fits=self.fits)

    def clad(self, wall: str, seed: Sequence[int], low: float = 0.0, high: float | None = None) -> None:
        """Turn the plain colour between two heights into brick, plaster, boards or stone."""
        rows, columns = self.box(0, low, self.width, self.height if high is None else high)
        if rows.stop <= rows.start:
            return
        shape = rows.stop - rows.start, columns.stop - columns.start
        rng = np.random.default_rng([*seed, 11])
        relief = MATERIALS[wall](shape, rng) if wall in MATERIALS else np.ones((*shape, 1), np.float32)
        stains = noise(shape, [*seed, 12], 3, 5)
        # Plaster has no joints, so its stains carry the texture.
        roughness = 0.035 if wall != "plaster" else 0.05
        grain = rng.standard_normal(shape, np.float32) * np.float32(0.015)
        self.rgb[rows, columns] *= relief * (1 + roughness * stains + grain)[..., None]

    def smudge(self, seed: Sequence[int]) -> None:
        """Dirt near the ground and rain streaks from the top, so that no wall is new."""
        _, up = self.grid()
        rng = np.random.default_rng([*seed, 13])
        columns = self.kind.shape[1]
        streaks = np.repeat(rng.random(columns // 6 + 1), 6)[:columns].astype(np.float32)
        dirt = 0.22 * np.exp(-up / 0.5) + 0.1 * (streaks > 0.72) * np.exp(-(self.height - up) / 2.5)
        self.rgb *= (1 - dirt)[..., None]


def ramp(top: NDArray[np.floating], bottom: NDArray[np.floating], shape: tuple[int, int]) -> Floats:
    """Colours ``[H, W, 3]`` that fade from `top` down to `bottom`."""
    part = np.linspace(0, 1, shape[0], dtype=np.float32)[:, None, None]
    return np.broadcast_to(top * (1 - part) + bottom * part, (*shape, 3)).astype(np.float32)


def noise(shape: tuple[int, int], seed: Sequence[int], coarsest: int = 4, octaves: int = 5) -> Floats:
    """Smooth fractal noise about 0 with deviation 1, that repeats at its edges, float32 `shape`."""
    rng = np.random.default_rng(list(seed))
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        # Each octave is twice as fine and about half as strong, as in clouds and stains.
        cells = coarsest * 2**octave
        if cells > min(shape):
            break
        lattice = rng.standard_normal((cells, cells)).astype(np.float32)
        total += _stretch(_stretch(lattice, shape[0], 0), shape[1], 1) * np.float32(0.55**octave)
    spread = total.std()
    return np.asarray((total - total.mean()) / (spread if spread > 0 else 1), np.float32)


def _stretch(values: Floats, length: int, axis: int) -> Floats:
    """Values interpolated smoothly and periodically to `length` along an axis."""
    cells = values.shape[axis]
    # Indices are taken modulo the lattice, so that the noise repeats without a seam.
    place = np.arange(length, dtype=np.float32) * np.float32(cells / length)
    cell = place.astype(np.int64)
    part = place - cell
    part = part * part * (3 - 2 * part)  # smoothstep: no creases at the lattice's lines
    part = part[:, None] if axis == 0 else part
    low, high = np.take(values, cell % cells, axis), np.take(values, (cell + 1) % cells, axis)
    return np.asarray(low + (high - low) * part, np.float32)


def _blocks(
    shape: tuple[int, int], rng: np.random.Generator, course: int, length: int, spread: float, joint: float
) -> Floats:
    """Courses of blocks of random shades, with joints, as factors."""
    row = np.arange(shape[0])[:, None] // course
    column = (np.arange(shape[1])[None] + (row % 2) * (length // 2)) // length
    shades = rng.normal(1, spread, (int(row.max()) + 1, int(column.max()) + 1)).astype(np.float32)
    wall = shades[row, column]
    wall[(np.arange(shape[0]) % course) == 0] *= joint
    upright = ((np.arange(shape[1])[None] + (row % 2) * (length // 2)) % length) == 0
    wall[np.broadcast_to(upright, shape)] *= joint
    # A tint of one wall's: no two are of one clay.
    tint = np.array([1.0, rng.normal(1, 0.01), rng.normal(1, 0.02)], np.float32)
    return np.asarray(wall[..., None] * tint, np.float32)


def _boards(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    period = int(rng.integers(5, 8))
    ramp = np.linspace(1.05, 0.95, period, dtype=np.float32)
    # The gap under each board is in its own shade.
    ramp[-1] = 0.68
    wall = ramp[np.arange(shape[0]) % period][:, None, None]
    shades = rng.normal(1, 0.02, shape[0] // period + 1).astype(np.float32)[np.arange(shape[0]) // period]
    return np.broadcast_to(wall * shades[:, None, None], (*shape, 1)).astype(np.float32)


# Walls that are more than a colour; plaster is not.
MATERIALS: dict[str, Callable[[tuple[int, int], np.random.Generator], Floats]] = {
    "brick": lambda shape, rng: _blocks(shape, rng, 3, 8, 0.1, float(rng.choice([1.22, 0.8]))),
    "stone": lambda shape, rng: _blocks(shape, rng, int(rng.integers(10, 16)), int(rng.integers(20, 32)), 0.06, 0.72),
    "boards": _boards,
}
