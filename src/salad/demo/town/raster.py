"""Rays through every pixel against textured parallelograms: the drawing engine of the town.

A scene is a list of faces, each a parallelogram in space with a texture on it. Depth, and the place on a face
that a ray meets, are ratios of functions linear in the pixel, so one face costs a handful of array operations
inside its bounding box. Holes in a texture (leaves, gables, railings) let the ray pass.

Space is local metres: x east, y north, z up. Images are rows from the top.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from salad.demo.town.camera import Camera

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]

NEAR = 0.3
"""Nothing nearer to the camera than this is drawn, in metres."""

HOLE, MATTE, DISPLAY, LAMP, LEAF, WINDOW = 0, 1, 2, 3, 4, 10
"""What a texel is: a hole, plain, shop window, lamp glass, foliage; from WINDOW on, that window's glass."""


@dataclass(frozen=True)
class Texture:
    """Colours and kinds of one surface, with halved copies for distance (mip levels).

    Attributes:
        levels: pairs of colours ``uint8 [H, W, 3]`` and kinds ``uint8 [H, W]``, each half the last.
        pixels_per_metre: of the first level.
        fits: whether it is stretched over a face once, instead of repeating at its own scale.
    """

    levels: tuple[tuple[Bytes, Bytes], ...]
    pixels_per_metre: float
    fits: bool = True

    @classmethod
    def of(
        cls, rgb: NDArray[np.generic], kind: Bytes, pixels_per_metre: float, *, fits: bool = True
    ) -> Texture:
        """Halve `rgb` (averaged) and `kind` (every other one) until a side would vanish."""
        colours = np.clip(rgb, 0, 255).astype(np.float32)
        levels = [(colours.astype(np.uint8), kind)]
        while min(kind.shape) >= 4 and len(levels) < 7:
            height, width = kind.shape[0] // 2, kind.shape[1] // 2
            blocks = colours[: height * 2, : width * 2].reshape(height, 2, width, 2, 3)
            colours = blocks.mean(axis=(1, 3))
            kind = np.ascontiguousarray(kind[: height * 2 : 2, : width * 2 : 2])
            levels.append((colours.astype(np.uint8), kind))
        return cls(tuple(levels), pixels_per_metre, fits)

    def sample(self, across: Floats, up: Floats, level: NDArray[np.int8]) -> tuple[Bytes, Bytes]:
        """Colours ``[N, 3]`` and kinds ``[N]`` at places in widths and heights of the texture; it repeats."""
        rgb = np.empty((len(across), 3), np.uint8)
        kind = np.empty(len(across), np.uint8)
        for wanted in range(int(level.min()), int(level.max()) + 1):
            here = np.flatnonzero(level == wanted)
            if len(here):
                colours, kinds = self.levels[wanted]
                height, width = kinds.shape
                column = (across[here] * np.float32(width)).astype(np.int32) % width
                row = height - 1 - (up[here] * np.float32(height)).astype(np.int32) % height
                flat = row * width + column
                rgb[here] = colours.reshape(-1, 3)[flat]
                kind[here] = kinds.ravel()[flat]
        return rgb, kind


@dataclass
class Faces:
    """Many parallelograms: corner, the two edges from it (right and up, seen from outside), what is on them.

    Attributes:
        skins: per face, a key the painter turns into a `Texture`.
        both: per face, whether it is seen from behind too.
    """

    corner: list[Sequence[float]] = field(default_factory=list)
    right: list[Sequence[float]] = field(default_factory=list)
    up: list[Sequence[float]] = field(default_factory=list)
    skins: list[tuple[object, ...]] = field(default_factory=list)
    both: list[bool] = field(default_factory=list)

    def add(
        self,
        corner: Sequence[float] | NDArray[np.floating],
        right: Sequence[float] | NDArray[np.floating],
        up: Sequence[float] | NDArray[np.floating],
        skin: tuple[object, ...],
        *,
        both: bool = False,
    ) -> None:
        """Add one face."""
        self.corner.append(tuple(corner))
        self.right.append(tuple(right))
        self.up.append(tuple(up))
        self.skins.append(skin)
        self.both.append(both)

    def extend(self, other: Faces) -> None:
        """Add all faces of `other`."""
        for mine, theirs in zip(vars(self).values(), vars(other).values(), strict=True):
            mine.extend(theirs)

    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Corners and edges as ``[F, 3]`` each."""
        corner, right, up = (
            np.array(part, np.float64).reshape(-1, 3) for part in (self.corner, self.right, self.up)
        )
        return corner, right, up


@dataclass
class Seen:
    """What the rays met, ``[H, W]``, colours ``[H, W, 3]``; where nothing, `face` is -1 and `nearness` 0."""

    rgb: Bytes
    kind: Bytes
    face: NDArray[np.int32]
    nearness: Floats
    """One over the depth in metres."""


def cast(camera: Camera, faces: Faces, paint: Callable[[tuple[object, ...]], Texture]) -> Seen:
    """Send a ray through every pixel of `camera` and keep the nearest face it meets."""
    width, height = camera.size
    seen = Seen(
        np.zeros((height, width, 3), np.uint8),
        np.zeros((height, width), np.uint8),
        np.full((height, width), -1, np.int32),
        np.zeros((height, width), np.float32),
    )
    corner, right, up = faces.arrays()
    normal = np.cross(right, up)
    offset = np.einsum("fi,fi->f", corner - camera.position, normal)
    boxes, depth = _boxes(camera, corner, right, up)
    visible = (boxes[:, 1] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 2]) & (np.abs(offset) > 1e-9)
    visible &= (offset < 0) | np.array(faces.both, bool)
    chosen = np.flatnonzero(visible)
    chosen = chosen[np.argsort(depth[chosen], kind="stable")]
    planes = _planes(camera, corner[chosen], right[chosen], up[chosen], normal[chosen], offset[chosen])
    for number, plane in zip(chosen, planes, strict=True):
        size = (float(np.linalg.norm(right[number])), float(np.linalg.norm(up[number])))
        _cast_one(camera, seen, int(number), boxes[number], plane, size, faces.skins[number], paint)
    return seen


def _planes(
    camera: Camera,
    corner: NDArray[np.float64],
    right: NDArray[np.float64],
    up: NDArray[np.float64],
    normal: NDArray[np.float64],
    offset: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Per face, linear functions of the pixel ``[F, 3, 4]``: nearness, and the two places times nearness."""
    area = np.einsum("fi,fi->f", normal, normal)[:, None]
    duals = [normal / offset[:, None], np.cross(up, normal) / area, np.cross(normal, right) / area]
    shift = np.stack(
        [
            np.zeros(len(corner)),
            *(np.einsum("fi,fi->f", camera.position - corner, dual) for dual in duals[1:]),
        ],
        -1,
    )
    linear = np.stack([camera.linear(dual) for dual in duals], axis=1)
    return np.concatenate([linear, shift[:, :, None]], axis=-1).astype(np.float32)


def _boxes(
    camera: Camera, corner: NDArray[np.float64], right: NDArray[np.float64], up: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """First and last column and row ``[F, 4]`` that each face may touch, and its nearest depth ``[F]``."""
    ring = np.stack([corner, corner + right, corner + right + up, corner + up], axis=1)
    after = np.roll(ring, -1, axis=1)
    depth = camera.project(ring)[..., 2]
    depth_after = np.roll(depth, -1, axis=1)
    crossing = (depth < NEAR) != (depth_after < NEAR)
    share = (NEAR - depth) / np.where(crossing, depth_after - depth, 1.0)
    points = np.concatenate([ring, ring + share[..., None] * (after - ring)], axis=1)
    valid = np.concatenate([depth >= NEAR, crossing], axis=1)
    place = camera.project(points)[..., :2]
    low = np.where(valid[..., None], place, np.inf).min(axis=1)
    high = np.where(valid[..., None], place, -np.inf).max(axis=1)
    width, height = camera.size
    limit = np.array([width, height])
    first = np.clip(np.floor(np.clip(low, -1, limit + 1)), 0, limit).astype(np.int64)
    last = np.clip(np.ceil(np.clip(high, -1, limit + 1)), 0, limit).astype(np.int64)
    return np.stack([first[:, 0], last[:, 0], first[:, 1], last[:, 1]], axis=1), depth.clip(NEAR).mean(axis=1)


def _cast_one(
    camera: Camera,
    seen: Seen,
    number: int,
    box: NDArray[np.int64],
    plane: Floats,
    size: tuple[float, float],
    skin: tuple[object, ...],
    paint: Callable[[tuple[object, ...]], Texture],
) -> None:
    """Meet one face with the rays inside its box."""
    left, stop, top, bottom = (int(edge) for edge in box)
    columns = np.arange(left, stop, dtype=np.float32)
    rows = np.arange(top, bottom, dtype=np.float32)
    nearness = plane[0, 0] * columns + (plane[0, 1] * rows + plane[0, 2])[:, None]
    open_rows, open_columns = np.nonzero(
        (nearness > seen.nearness[top:bottom, left:stop]) & (nearness < 1 / NEAR)
    )
    if not len(open_rows):
        return
    near = nearness[open_rows, open_columns]
    column, row = columns[open_columns], rows[open_rows]
    depth = 1 / near
    across = (plane[1, 0] * column + plane[1, 1] * row + plane[1, 2]) * depth + plane[1, 3]
    upward = (plane[2, 0] * column + plane[2, 1] * row + plane[2, 2]) * depth + plane[2, 3]
    inside = np.flatnonzero((across >= 0) & (across < 1) & (upward >= 0) & (upward < 1))
    if not len(inside):
        return
    texture = paint(skin)
    # The footprint of a pixel is longer along the face than across it; the mean of both keeps facades crisp.
    slant = np.abs(plane[0, :2]).sum() * camera.focal
    stretch = np.sqrt(1 + (slant * depth[inside]) ** 2)
    rows_painted, columns_painted = texture.levels[0][1].shape
    grain = rows_painted / size[1] if texture.fits else texture.pixels_per_metre
    times = np.array(
        [1.0, 1.0] if texture.fits else [size[0] * grain / columns_painted, size[1] * grain / rows_painted]
    )
    times = times.astype(np.float32)
    texels = grain * depth[inside] / camera.focal * np.sqrt(stretch)
    level = np.clip(np.log2(texels) + 0.35, 0, len(texture.levels) - 1).astype(np.int8)
    rgb, kind = texture.sample(across[inside] * times[0], upward[inside] * times[1], level)
    solid = np.flatnonzero(kind != HOLE)
    hit = inside[solid]
    flat = (open_rows[hit] + top) * camera.size[0] + open_columns[hit] + left
    seen.rgb.reshape(-1, 3)[flat] = rgb[solid]
    seen.kind.ravel()[flat] = kind[solid]
    seen.face.ravel()[flat] = number
    seen.nearness.ravel()[flat] = near[hit]


# --- A wall to paint on, in metres, and the materials walls are made of ---


Paint = Sequence[float] | NDArray[Any]
GRAIN = 32.0
"""Texels a metre on facades."""


class Canvas:
    """A rectangle of wall, `width` by `height` metres, painted in metres from its lower left corner."""

    def __init__(self, width: float, height: float, colour: Paint, grain: float = GRAIN) -> None:
        self.width, self.height, self.grain = width, height, grain
        shape = max(2, round(height * grain)), max(2, round(width * grain))
        self.rgb: Floats = np.empty((*shape, 3), np.float32)
        self.rgb[:] = colour
        self.kind = np.full(shape, MATTE, np.uint8)

    def box(self, left: float, low: float, right: float, high: float) -> tuple[slice, slice]:
        """The rows and columns of a rectangle, cut off at the edges."""
        rows, columns = self.kind.shape
        limits = np.array(
            [rows - high * self.grain, rows - low * self.grain, left * self.grain, right * self.grain]
        )
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

    def cut(self, left: float, low: float, right: float, high: float) -> None:
        """Make a hole."""
        self.kind[self.box(left, low, right, high)] = HOLE

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
        if height < 4 or width < 8:
            return
        font = ImageFont.load_default(48)
        ink = Image.new("L", (int(font.getlength(text)) + 8, 64), 0)
        ImageDraw.Draw(ink).text((4, 2), text, fill=255, font=font)
        ink = ink.crop(ink.getbbox())
        scale = min(height / ink.height, width / ink.width)
        small = ink.resize(
            (max(1, int(ink.width * scale)), max(1, int(ink.height * scale))), Image.Resampling.BOX
        )
        cover = np.asarray(small, np.float32)[..., None] / 255
        top = rows.start + (height - small.height) // 2
        start = columns.start + (width - small.width) // 2
        part = self.rgb[top : top + small.height, start : start + small.width]
        part[:] = part * (1 - cover) + cover * np.array(colour, np.float32)

    def texture(self, *, fits: bool = True) -> Texture:
        """The finished wall; `fits` stretches it over a face of any size."""
        return Texture.of(self.rgb, self.kind, self.grain, fits=fits)


def noise(shape: tuple[int, int], seed: Sequence[int], coarsest: int = 4, octaves: int = 5) -> Floats:
    """Smooth fractal noise about 0 with deviation 1, that repeats at its edges, float32 `shape`."""
    rng = np.random.default_rng(list(seed))
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
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
    place = np.arange(length, dtype=np.float32) * np.float32(cells / length)
    whole = place.astype(np.int64)
    share = place - whole
    share = share * share * (3 - 2 * share)
    share = share[:, None] if axis == 0 else share
    low, high = np.take(values, whole % cells, axis), np.take(values, (whole + 1) % cells, axis)
    return np.asarray(low + (high - low) * share, np.float32)


def clad(canvas: Canvas, wall: str, seed: Sequence[int], low: float = 0.0, high: float | None = None) -> None:
    """Turn the plain colour between two heights into brick, plaster, boards or stone."""
    rows, columns = canvas.box(0, low, canvas.width, canvas.height if high is None else high)
    if rows.stop <= rows.start:
        return
    shape = rows.stop - rows.start, columns.stop - columns.start
    rng = np.random.default_rng([*seed, 11])
    makers = {"brick": _bricks, "stone": _ashlar, "boards": _boards}
    relief = makers[wall](shape, rng) if wall in makers else np.ones((*shape, 1), np.float32)
    stains = noise(shape, [*seed, 12], 3, 5)
    roughness = 0.035 if wall != "plaster" else 0.05
    grain = rng.standard_normal(shape, np.float32) * np.float32(0.015)
    canvas.rgb[rows, columns] *= relief * (1 + roughness * stains + grain)[..., None]


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
    tint = np.array([1.0, rng.normal(1, 0.01), rng.normal(1, 0.02)], np.float32)
    return np.asarray(wall[..., None] * tint, np.float32)


def _bricks(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    return _blocks(shape, rng, 3, 8, 0.1, float(rng.choice([1.22, 0.8])))


def _ashlar(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    return _blocks(shape, rng, int(rng.integers(10, 16)), int(rng.integers(20, 32)), 0.06, 0.72)


def _boards(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    period = int(rng.integers(5, 8))
    ramp = np.linspace(1.05, 0.95, period, dtype=np.float32)
    ramp[-1] = 0.68
    wall = ramp[np.arange(shape[0]) % period][:, None, None]
    shades = rng.normal(1, 0.02, shape[0] // period + 1).astype(np.float32)[np.arange(shape[0]) // period]
    return np.broadcast_to(wall * shades[:, None, None], (*shape, 1)).astype(np.float32)


def smudge(canvas: Canvas, seed: Sequence[int]) -> None:
    """Dirt near the ground and rain streaks from the top, so that no wall is new."""
    _, up = canvas.grid()
    rng = np.random.default_rng([*seed, 13])
    streaks = np.repeat(rng.random(canvas.kind.shape[1] // 6 + 1), 6)[: canvas.kind.shape[1]].astype(
        np.float32
    )
    dirt = 0.22 * np.exp(-up / 0.5) + 0.1 * (streaks > 0.72) * np.exp(-(canvas.height - up) / 2.5)
    canvas.rgb *= (1 - dirt)[..., None]


def ramp(top: NDArray[np.floating], bottom: NDArray[np.floating], shape: tuple[int, int]) -> Floats:
    """Colours ``[H, W, 3]`` that fade from `top` down to `bottom`."""
    share = np.linspace(0, 1, shape[0], dtype=np.float32)[:, None, None]
    return np.broadcast_to(top * (1 - share) + bottom * share, (*shape, 3)).astype(np.float32)
