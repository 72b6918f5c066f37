"""What is behind and above the town: sky, clouds, hills, and the glow of lamps in the air."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salad.data.town.camera import Camera
from salad.data.town.canvas import noise
from salad.data.town.raster import Floats
from salad.data.town.weather import LAMP_GLOW, Light, towards


@dataclass(frozen=True)
class Rays:
    """Every pixel's ray, ``[H, W]`` each, as long as it reaches one metre forward."""

    east: Floats
    north: Floats
    up: Floats

    @classmethod
    def of(cls, camera: Camera) -> Rays:
        """The rays of a camera."""
        columns = np.arange(camera.size[0], dtype=np.float32)
        rows = np.arange(camera.size[1], dtype=np.float32)[:, None]
        parts = camera.linear(np.eye(3)).astype(np.float32)
        return cls(*(part[0] * columns + (part[1] * rows + part[2]) for part in parts))


def heavens(rays: Rays, sky: NDArray[np.bool_], light: Light, seed: Sequence[int]) -> Floats:
    """The sky behind everything: gradient, glow of the sun, clouds, hills ``[N, 3]``."""
    east, north, up = rays.east[sky], rays.north[sky], rays.up[sky]
    size = np.sqrt(east**2 + north**2 + up**2)
    rise = np.clip(up / size, 0, 1)
    fade = (np.minimum(rise * 2.1, 1) ** 0.6)[:, None]
    colour = np.array(light.horizon, np.float32) * (1 - fade) + np.array(light.zenith, np.float32) * fade
    glow = np.clip((np.stack([east, north, up], -1) @ towards(light).astype(np.float32)) / size, 0, 1)
    colour += (70 * glow**12 + 90 * glow**90)[:, None] * np.array(light.direct, np.float32)
    texture = noise((256, 256), [*seed, 62], 3, 6)
    tall = np.maximum(up / size, 0.02) + 0.12
    column = ((east / size / tall * 22 + 999).astype(np.int32)) & 255
    row = ((north / size / tall * 22 + 999).astype(np.int32)) & 255
    dense = texture[row, column]
    cover = np.clip((dense - (1.4 - 2.6 * light.clouds)) * 0.8, 0, 1) * np.clip(rise * 6, 0, 1) * 0.92
    relief = np.clip(1.0 - 0.07 * dense, 0.75, 1.06)
    colour += (np.array(light.cloud, np.float32) * relief[:, None] - colour) * cover[:, None]
    angle = np.arctan2(east, north)
    hills = 0.055 + 0.022 * np.sin(3 * angle + 1) + 0.012 * np.sin(8 * angle) + 0.006 * np.sin(23 * angle + 2)
    ridge = (rise < hills) & (up > -0.01)
    veil = np.float32(np.exp(-160 / light.sight) * 0.6)
    hill = np.array([74, 92, 78], np.float32) * np.array(light.sky, np.float32) * 1.1
    colour[ridge] += (hill - colour[ridge]) * veil
    return np.asarray(colour, np.float32)


def halos(rgb: Floats, camera: Camera, depth: Floats, lamps: NDArray[np.float64]) -> None:
    """A glow around every lamp in sight."""
    height, width = depth.shape
    rows, columns = np.arange(height, dtype=np.float32)[:, None], np.arange(width, dtype=np.float32)
    for column, row, away in camera.project(lamps):
        if away < 2 or not (-40 < column < width + 40 and -40 < row < height + 40):
            continue
        at = depth[int(np.clip(row, 0, height - 1)), int(np.clip(column, 0, width - 1))]
        if 0 < at < away - 0.6:
            continue
        radius = np.float32(camera.focal * 0.55 / away + 2)
        square = (rows - np.float32(row)) ** 2 + (columns - np.float32(column)) ** 2
        bloom = np.exp(-square / (2 * radius**2)) * 110 + 46 / (1 + square / radius**2 / 4)
        rgb += (bloom * (bloom > 2))[..., None] * (LAMP_GLOW / 255)
