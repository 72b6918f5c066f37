"""Which places are near to one another, and squares that cover the earth; neither knows any edge of a zone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from salad.geo import EARTH_RADIUS_M, GeoPoint, metres

_AROUND = list(itertools.product((-1, 0, 1), repeat=3))


class Neighbours:
    """Who is nearer than `apart_m` metres to whom; prepared once, asked often.

    Points are sorted into cubes of that side that fill the space around the earth's centre, so that two points
    near each other are always in the same cube or in two that touch: across the edge of a UTM zone, across the
    date line and at the poles as anywhere else.

    Args:
        points: one a place; None where nobody knows, which is near to nothing.
        apart_m: in metres; at 0 nothing is near to anything.
    """

    def __init__(self, points: Sequence[GeoPoint | None], apart_m: float) -> None:
        self._apart_m = apart_m
        self._lat = np.array([math.nan if point is None else point.lat for point in points], dtype=np.float64)
        self._lon = np.array([math.nan if point is None else point.lon for point in points], dtype=np.float64)
        self._cubes: dict[tuple[int, int, int], list[int]] = {}
        known = np.flatnonzero(np.isfinite(self._lat)) if apart_m > 0 else np.zeros(0, np.int64)
        self._cube_of = dict(zip(known.tolist(), self._cube(known), strict=True))
        for number, cube in self._cube_of.items():
            self._cubes.setdefault(cube, []).append(number)

    def of(self, number: int) -> NDArray[np.int64]:
        """Ascending numbers of the points nearer than `apart_m` to that one, itself not among them."""
        if number not in self._cube_of:
            return np.zeros(0, dtype=np.int64)
        x, y, z = self._cube_of[number]
        touching = (self._cubes.get((x + i, y + j, z + k), []) for i, j, k in _AROUND)
        others = np.array(sorted(itertools.chain.from_iterable(touching)), dtype=np.int64)
        away = metres(self._lat[number], self._lon[number], self._lat[others], self._lon[others])
        near: NDArray[np.int64] = others[(away < self._apart_m) & (others != number)]
        return near

    def _cube(self, numbers: NDArray[np.int64]) -> list[tuple[int, int, int]]:
        lat, lon = np.radians(self._lat[numbers]), np.radians(self._lon[numbers])
        unit = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
        side = self._apart_m * (1 + 1e-6) + 1e-3  # a little larger, so that rounding loses no neighbour
        cubes: list[list[int]] = np.floor(unit * EARTH_RADIUS_M / side).astype(np.int64).tolist()
        return [(x, y, z) for x, y, z in cubes]


def squares(
    lat: NDArray[np.float64], lon: NDArray[np.float64], side_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The square of the earth that each point lies in: its row from the south pole and its place in that row.

    Rows are `side_m` high. Each is cut into a whole number of pieces at most that wide, so it closes at the date
    line without a rest, and needs no UTM zone.

    Args:
        lat: `[N]` degrees.
        lon: `[N]` degrees.
        side_m: metres.

    Returns:
        Two arrays `[N]`.
    """
    high = math.degrees(side_m / EARTH_RADIUS_M)
    rows = np.floor((lat + 90) / high)
    middle = np.radians(np.minimum((rows + 0.5) * high - 90, 90))
    pieces = np.ceil(2 * math.pi * EARTH_RADIUS_M * np.cos(middle) / side_m).clip(min=1)
    columns = np.floor((lon + 180) / 360 * pieces) % pieces
    return rows.astype(np.int64), columns.astype(np.int64)
