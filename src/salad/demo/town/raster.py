"""Rays through every pixel against textured parallelograms: the drawing engine of the town.

A scene is a list of faces, each a parallelogram in space with a texture on it. Depth, and the place on a face
that a ray meets, are ratios of functions linear in the pixel, so one face costs a handful of array operations
inside its bounding box. Holes in a texture (leaves, gables, railings) let the ray pass.

Space is local metres: x east, y north, z up. Images are rows from the top.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salad.demo.town.camera import Camera

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Skin = tuple[Any, ...]
"""A function that paints a `Canvas`, and what it is called with."""

NEAR = 0.3  # nothing nearer to the camera than this is drawn, in metres

# What a texel is: a hole, plain, shop window, lamp glass, foliage; from WINDOW on, that window's glass.
HOLE, MATTE, DISPLAY, LAMP, LEAF, WINDOW = 0, 1, 2, 3, 4, 10


@dataclass(frozen=True)
class Texture:
    """Colours and kinds of one surface, with halved copies for distance (mip levels).

    Attributes:
        levels: Pairs of colours ``uint8 [H, W, 3]`` and kinds ``uint8 [H, W]``, each half the last.
        pixels_per_metre: Of the first level.
        fits: Whether it is stretched over a face once, instead of repeating at its own scale.
    """

    levels: tuple[tuple[Bytes, Bytes], ...]
    pixels_per_metre: float
    fits: bool = True

    @classmethod
    def of(cls, rgb: NDArray[np.generic], kind: Bytes, pixels_per_metre: float, *, fits: bool = True) -> Texture:
        """Halve `rgb` (averaged) and `kind` (every other one) until a side would vanish."""
        # Averages are taken of the unrounded level before, or rounding would darken the distance.
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
        # Level by level: most faces need one or two, and each is one gather.
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
        skins: Per face, what paints it and with what: faces of one skin share one `Texture`.
        both: Per face, whether it is seen from behind too.
    """

    corner: list[Sequence[float]] = field(default_factory=list)
    right: list[Sequence[float]] = field(default_factory=list)
    up: list[Sequence[float]] = field(default_factory=list)
    skins: list[Skin] = field(default_factory=list)
    both: list[bool] = field(default_factory=list)

    def add(
        self,
        corner: Sequence[float] | NDArray[np.floating],
        right: Sequence[float] | NDArray[np.floating],
        up: Sequence[float] | NDArray[np.floating],
        skin: Skin,
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
        corner, right, up = (np.array(part, np.float64).reshape(-1, 3) for part in (self.corner, self.right, self.up))
        return corner, right, up

    def outward_normals(self, camera: Camera) -> NDArray[np.float64]:
        """Every face's normal ``[F, 3]``, turned to the camera: what is seen from behind is lit from behind."""
        corner, right, up = self.arrays()
        normals = np.cross(right, up)
        normals[np.einsum("fi,fi->f", corner - camera.position, normals) > 0] *= -1
        return normals

    def boxes(self, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """First and last column and row ``[F, 4]`` that each face may touch, and its nearest depth ``[F]``."""
        corner, right, up = self.arrays()
        ring = np.stack([corner, corner + right, corner + right + up, corner + up], axis=1)
        after = np.roll(ring, -1, axis=1)
        depth = camera.project(ring)[..., 2]
        depth_after = np.roll(depth, -1, axis=1)
        # An edge that runs past the camera is cut where it comes too near: behind it nothing projects.
        crossing = (depth < NEAR) != (depth_after < NEAR)
        part = (NEAR - depth) / np.where(crossing, depth_after - depth, 1.0)
        points = np.concatenate([ring, ring + part[..., None] * (after - ring)], axis=1)
        valid = np.concatenate([depth >= NEAR, crossing], axis=1)
        place = camera.project(points)[..., :2]
        low = np.where(valid[..., None], place, np.inf).min(axis=1)
        high = np.where(valid[..., None], place, -np.inf).max(axis=1)
        limit = np.array(camera.size)
        first = np.clip(np.floor(np.clip(low, -1, limit + 1)), 0, limit).astype(np.int64)
        last = np.clip(np.ceil(np.clip(high, -1, limit + 1)), 0, limit).astype(np.int64)
        boxes = np.stack([first[:, 0], last[:, 0], first[:, 1], last[:, 1]], axis=1)
        return boxes, depth.clip(NEAR).mean(axis=1)

    def planes(self, camera: Camera, chosen: NDArray[np.int64]) -> NDArray[np.float32]:
        """Linear functions of the pixel ``[chosen, 3, 4]``: nearness, and the two places times nearness."""
        corner, right, up = (part[chosen] for part in self.arrays())
        normal = np.cross(right, up)
        offset = np.einsum("fi,fi->f", corner - camera.position, normal)
        area = np.einsum("fi,fi->f", normal, normal)[:, None]
        duals = [normal / offset[:, None], np.cross(up, normal) / area, np.cross(normal, right) / area]
        shift = [np.einsum("fi,fi->f", camera.position - corner, dual) for dual in duals[1:]]
        linear = np.stack([camera.linear(dual) for dual in duals], axis=1)
        shifts = np.stack([np.zeros(len(corner)), *shift], -1)
        return np.concatenate([linear, shifts[:, :, None]], axis=-1).astype(np.float32)


@dataclass
class Seen:
    """What the rays met, ``[H, W]``, colours ``[H, W, 3]``; where nothing, `face` is -1 and `nearness` 0."""

    rgb: Bytes
    kind: Bytes
    face: NDArray[np.int32]
    nearness: Floats
    """One over the depth in metres."""

    def meet(
        self,
        camera: Camera,
        number: int,
        box: NDArray[np.int64],
        plane: Floats,
        size: tuple[float, float],
        texture: Callable[[], Texture],
    ) -> None:
        """Let the rays inside a box meet one face, and keep it where it is the nearest.

        Args:
            camera: Whence the rays go.
            number: Of the face.
            box: First and last column and row.
            plane: The face's linear functions of the pixel ``[3, 4]``.
            size: Of the face, in metres.
            texture: Paints the face; not asked where no ray meets it, since walls are dear.
        """
        left, stop, top, bottom = (int(edge) for edge in box)
        columns = np.arange(left, stop, dtype=np.float32)
        rows = np.arange(top, bottom, dtype=np.float32)
        nearness = plane[0, 0] * columns + (plane[0, 1] * rows + plane[0, 2])[:, None]
        open_rows, open_columns = np.nonzero((nearness > self.nearness[top:bottom, left:stop]) & (nearness < 1 / NEAR))
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
        painted = texture()
        # The footprint of a pixel is longer along the face than across it; the mean of both keeps facades crisp.
        slant = np.abs(plane[0, :2]).sum() * camera.focal
        stretch = np.sqrt(1 + (slant * depth[inside]) ** 2)
        rows_painted, columns_painted = painted.levels[0][1].shape
        grain = rows_painted / size[1] if painted.fits else painted.pixels_per_metre
        times = np.ones(2, np.float32)  # how often the texture stands side by side and on top of itself
        if not painted.fits:
            times[:] = size[0] * grain / columns_painted, size[1] * grain / rows_painted
        texels = grain * depth[inside] / camera.focal * np.sqrt(stretch)
        # Mostly the finer of two levels: a pixel's rays are averaged later, which takes the shimmer away.
        level = np.clip(np.log2(texels) + 0.35, 0, len(painted.levels) - 1).astype(np.int8)
        rgb, kind = painted.sample(across[inside] * times[0], upward[inside] * times[1], level)
        # Rays that meet a hole go on to what is farther away.
        solid = np.flatnonzero(kind != HOLE)
        hit = inside[solid]
        flat = (open_rows[hit] + top) * camera.size[0] + open_columns[hit] + left
        self.rgb.reshape(-1, 3)[flat] = rgb[solid]
        self.kind.ravel()[flat] = kind[solid]
        self.face.ravel()[flat] = number
        self.nearness.ravel()[flat] = near[hit]


def cast(camera: Camera, faces: Faces, paint: Callable[[Skin], Texture]) -> Seen:
    """Send a ray through every pixel of `camera` and keep the nearest face it meets."""
    width, height = camera.size
    seen = Seen(
        np.zeros((height, width, 3), np.uint8),
        np.zeros((height, width), np.uint8),
        np.full((height, width), -1, np.int32),
        np.zeros((height, width), np.float32),
    )
    corner, right, up = faces.arrays()
    offset = np.einsum("fi,fi->f", corner - camera.position, np.cross(right, up))
    boxes, depth = faces.boxes(camera)
    visible = (boxes[:, 1] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 2]) & (np.abs(offset) > 1e-9)
    visible &= (offset < 0) | np.array(faces.both, bool)
    # From near to far: what is hidden is then never sampled.
    chosen = np.flatnonzero(visible)
    chosen = chosen[np.argsort(depth[chosen], kind="stable")]
    for number, plane in zip(chosen.tolist(), faces.planes(camera, chosen), strict=True):
        size = (float(np.linalg.norm(right[number])), float(np.linalg.norm(up[number])))
        skin = faces.skins[number]
        seen.meet(camera, number, boxes[number], plane, size, partial(paint, skin))
    return seen
