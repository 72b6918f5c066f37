"""The ground of the town: asphalt, markings, kerbs, paving, and how high the shadows reach."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from salad.demo.town.canvas import noise
from salad.demo.town.plan import FRONT, ROAD, Thing, TownPlan
from salad.demo.town.raster import Floats

CELL = 0.5  # side of a cell of every map of the town, in metres


@dataclass(frozen=True)
class Field:
    """A map of the town: values ``[H, W, C]`` on a grid of `CELL`, row 0 in the south."""

    values: Floats
    west: float
    south: float

    def at(self, east: Floats, north: Floats) -> Floats:
        """Values ``[N, C]`` between the cells, smoothly."""
        rows, columns, channels = self.values.shape
        x = np.clip((east - np.float32(self.west)) / np.float32(CELL), 0, columns - 1.001)
        y = np.clip((north - np.float32(self.south)) / np.float32(CELL), 0, rows - 1.001)
        # Bilinear by hand, in float32: it runs for every pixel of every photo, on four neighbours at once.
        column, row = x.astype(np.int32), y.astype(np.int32)
        x, y = (x - column.astype(np.float32))[:, None], (y - row.astype(np.float32))[:, None]
        flat, corner = self.values.reshape(-1, channels), row * columns + column
        below = flat[corner] * (1 - x) + flat[corner + 1] * x
        above = flat[corner + columns] * (1 - x) + flat[corner + columns + 1] * x
        return np.asarray(below * (1 - y) + above * y, np.float32)


def _cells(plan: TownPlan, margin: float = 0.0) -> tuple[Floats, Floats, float, float]:
    west, south, east, north = plan.box
    columns = np.arange(west - margin, east + margin, CELL).astype(np.float32)
    rows = np.arange(south - margin, north + margin, CELL).astype(np.float32)
    return *np.meshgrid(columns, rows), west - margin, south - margin


@dataclass(frozen=True)
class Ground:
    """What the ground's colours are made from.

    Attributes:
        streets: Distance from the nearest street's middle, the same with a sign for its left, and distance
            along that street to its nearer end, three channels.
        shade: How far buildings darken what is near them, 0 to 1.
        grain: Repeating noise ``[512, 512]``.
    """

    streets: Field
    shade: Field
    grain: Floats

    @classmethod
    def of(cls, plan: TownPlan) -> Ground:
        """Survey the town."""
        x, y, west, south = _cells(plan)
        # Farther from every street than any yard is wide.
        found = np.full((*x.shape, 3), 99.0, np.float32)
        for street in plan.streets:
            for number, (start, stop) in enumerate(pairwise(street.line)):
                # Only the cells near this metre of street: not the whole town for every metre.
                rows, columns = _near((start + stop) / 2, 14.0, x, y)
                size = float(np.linalg.norm(stop - start))
                way = (stop - start) / size
                right, up = x[rows, columns] - start[0], y[rows, columns] - start[1]
                forward = np.clip(right * way[0] + up * way[1], 0, size)
                away = np.hypot(right - forward * way[0], up - forward * way[1])
                left = np.where(way[0] * up - way[1] * right > 0, away, -away)
                along = street.along[number] + forward
                nearer = away < found[rows, columns, 0]
                entry = np.stack([away, left, np.minimum(along, street.length - along)], axis=-1)
                found[rows, columns][nearer] = entry[nearer]
        # A blurred plan of the houses: corners near walls see less sky.
        high = (heights(plan, ()).values > 0).astype(np.float32)
        for axis in (0, 1):
            high = np.mean([np.roll(high, step, axis) for step in range(-3, 4)], axis=0, dtype=np.float32)
        return cls(Field(found, west, south), Field(high, west, south), noise((512, 512), [plan.seed, 51], 8, 6))

    def colours(self, east: Floats, north: Floats, depth: Floats) -> Floats:
        """Colours ``[N, 3]`` of the ground at points ``[N]``, seen from `depth` metres."""
        # Contiguous, since each channel is used as an array of its own many times below.
        aside, side, end = np.ascontiguousarray(self.streets.at(east, north).T)
        coarse, fine = self.rough(east, north, 9.0), self.rough(east, north, 75.0)
        rgb = np.empty((len(east), 3), np.float32)
        rgb[:] = (92, 92, 94)
        rgb *= (1 + 0.03 * coarse + 0.07 * fine)[:, None]
        # Wheels have darkened two tracks on each side of the middle.
        rgb[(np.abs(np.abs(side) - 1.5) < 0.35) & (aside < ROAD)] *= 0.93
        # Asphalt that was mended; the threshold leaves a few patches a street.
        patch = (self.rough(east, north, 3.1) > 1.5) & (aside < ROAD)
        rgb[patch] *= 0.8
        rgb[aside > ROAD - 0.35] *= 0.82
        self._markings(rgb, side, aside, end, fine)
        self._paving(rgb, aside, end, coarse, fine, depth)
        return rgb

    def rough(self, east: Floats, north: Floats, scale: float) -> Floats:
        """Noise at points, `scale` texels a metre."""
        # Masking is modulo 512, the texture's size, for negative places too.
        column = (east * np.float32(scale)).astype(np.int32) & 511
        row = (north * np.float32(scale)).astype(np.int32) & 511
        return np.asarray(self.grain.ravel()[row * 512 + column], np.float32)

    def _markings(self, rgb: Floats, side: Floats, aside: Floats, end: Floats, fine: Floats) -> None:
        worn = fine < 1.3
        # Markings keep clear of crossings: `end` is the distance to the nearer one.
        dash = (np.abs(side) < 0.07) & (end > 13) & (end % 5 < 2.6)
        stripe = (side % 1.05 < 0.52) & (end > 8.6) & (end < 11.6) & (aside < ROAD - 0.3)
        stop = (end > 12.2) & (end < 12.6) & (side > 0.2) & (aside < ROAD - 0.3)
        bay = (np.abs(aside - 2.15) < 0.05) & (end > 13) & (end % 5.9 < 4)
        rgb[(dash | stripe | stop | bay) & worn] = (206, 204, 196)

    def _paving(self, rgb: Floats, aside: Floats, end: Floats, coarse: Floats, fine: Floats, depth: Floats) -> None:
        kerb = aside > ROAD
        rgb[kerb] = (166, 162, 154)
        rgb[kerb & (aside < ROAD + 0.18)] = (188, 186, 180)
        rgb[kerb & (aside < ROAD + 0.04)] = (70, 70, 72)
        # Joints beyond 26 m are finer than a pixel and would only flicker.
        slabs = kerb & (aside > ROAD + 0.18) & (depth < 26)
        joints = slabs & (((aside - ROAD) % 0.62 < 0.03) | (end % 0.62 < 0.03))
        rgb[joints] *= 0.76
        rgb[kerb] *= (1 + 0.05 * coarse + 0.035 * fine)[kerb, None]
        # Behind the house fronts the ground is grass.
        yard = aside > FRONT + 1.4
        rgb[yard] = (104, 116, 72)
        rgb[yard] *= (1 + 0.12 * coarse + 0.1 * fine)[yard, None]


def heights(plan: TownPlan, cars: tuple[Thing, ...], margin: float = 0.0) -> Field:
    """How high everything stands: houses to half their roofs, tree crowns with gaps, cars."""
    x, y, west, south = _cells(plan, margin)
    high = np.zeros(x.shape, np.float32)
    for house in plan.houses:
        right, back = house.corners[1] - house.corners[0], house.corners[3] - house.corners[0]
        rows, columns = _near(house.corners.mean(axis=0), 16.0, x, y)
        east, north = x[rows, columns] - house.corners[0, 0], y[rows, columns] - house.corners[0, 1]
        across, deep = ((east * e[0] + north * e[1]) / (e @ e) for e in (right, back))
        inside = (across > 0) & (across < 1) & (deep > 0) & (deep < 1)
        # Half a roof's height on average: enough for a shadow's length, and cheap.
        roof = 0.0 if house.style.roof == "flat" else house.style.rise * 4.5 * (0.5 - np.abs(deep - 0.5)) * 2
        high[rows, columns] = np.where(inside, house.style.eaves + roof, high[rows, columns])
    rng = np.random.default_rng([plan.seed, 52])
    for things, reach, gaps in ((plan.trees, 0.28, 0.35), (cars, 1.0, 0.0)):
        for thing in things:
            tall = thing.height if gaps else 1.35
            rows, columns = _near(np.array(thing.where), reach * tall, x, y)
            away = np.hypot(x[rows, columns] - thing.where[0], y[rows, columns] - thing.where[1])
            crown = (away < reach * tall) & (rng.random(away.shape) >= gaps)
            high[rows, columns] = np.maximum(high[rows, columns], np.where(crown, tall * 0.95, 0))
    return Field(high[..., None], west, south)


def _near(point: NDArray[np.float64], reach: float, x: Floats, y: Floats) -> tuple[slice, slice]:
    columns = np.searchsorted(x[0], [point[0] - reach, point[0] + reach])
    rows = np.searchsorted(y[:, 0], [point[1] - reach, point[1] + reach])
    return slice(*rows), slice(*columns)


def shadows(high: Field, towards: NDArray[np.float64]) -> Field:
    """Up to which height each cell lies in the shade of what stands `towards` the sun (a unit vector)."""
    level = float(np.hypot(towards[0], towards[1]))
    top = float(high.values.max(initial=0.0))
    shade = np.zeros_like(high.values[..., 0])
    rows, columns = shade.shape
    # One cell a step along the longer way, so that nothing is stepped over.
    stride = CELL * level / float(np.abs(towards[:2]).max())
    reach = min(top / towards[2] * level, 120.0) + stride
    margin = round(reach / CELL) + 1  # nothing stands out there, and no step looks beyond it
    tall = np.pad(high.values[..., 0], margin)
    for step in np.arange(stride, reach, stride):
        east, north = (margin + round(step * part / level / CELL) for part in towards[:2])
        drop = np.float32(step * towards[2] / level)
        np.maximum(shade, tall[north : north + rows, east : east + columns] - drop, out=shade)
    return Field(shade[..., None], high.west, high.south)
