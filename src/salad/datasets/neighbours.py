"""Who is at most so many metres away, among millions: a grid of cubes, kept as one sorted array of numbers.

No matrix of pairs is built and nothing is kept for an empty cube: 2.8 million references take some 100 MB and a sort.
Two measures are known. Along the earth, by latitude and longitude, no zone, date line or pole is special. On the map,
by the metres of one UTM zone, as published sets measure; two photos of different zones are then measured along the
earth, since their metres east have nothing to do with one another.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.typing import NDArray

from salad.datasets.compact_lists import Ragged
from salad.errors import BenchmarkError
from salad.geo import EARTH_RADIUS_M, GeoPoint, metres

_BITS = 21  # of a cube's number along each axis: three of them fill a positive int64
_AT_ONCE = 1 << 21  # pairs measured at once: some 100 MB
_STRETCH = 1.02  # more than a UTM zone and the sphere stretch any distance

Measure = Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Spots:
    """Where photos stand, on the map and on the earth, as far as each is known.

    Attributes:
        grid: `[N, 2]` metres east and north, as written.
        zone: `[N]` the UTM zone they are counted in, negative south of the equator, 0 where nobody says.
        globe: `[N, 2]` latitudes and longitudes in degrees, NaN where unknown.
    """

    grid: Float64[np.ndarray, "n 2"]
    zone: Int64[np.ndarray, " n"]
    globe: Float64[np.ndarray, "n 2"]

    def __len__(self) -> int:
        return len(self.grid)


def near_on_earth(
    queries: Float64[np.ndarray, "q 2"], references: Float64[np.ndarray, "r 2"], radius: float
) -> Ragged:
    """For each query the rows of the references at most `radius` metres away along the great circle, ascending.

    Args:
        queries: latitudes and longitudes in degrees.
        references: the same.
        radius: metres, above 0.
    """

    def apart(ours: NDArray[np.int64], theirs: NDArray[np.int64]) -> NDArray[np.float64]:
        return metres(*queries[ours].T, *references[theirs].T)

    return _measured(_space(queries), _space(references), _side(radius), radius, apart)


def near_on_map(queries: Spots, references: Spots, radius: float) -> Ragged:
    """For each query the rows of the references at most `radius` metres away on the map, ascending.

    Raises:
        BenchmarkError: photos are of different zones, or some of none, and one has no latitude and longitude.
    """

    def flat(ours: NDArray[np.int64], theirs: NDArray[np.int64]) -> NDArray[np.float64]:
        away: NDArray[np.float64] = np.hypot(*(queries.grid[ours] - references.grid[theirs]).T)
        return away

    def apart(ours: NDArray[np.int64], theirs: NDArray[np.int64]) -> NDArray[np.float64]:
        around = metres(*queries.globe[ours].T, *references.globe[theirs].T)
        return np.where(queries.zone[ours] == references.zone[theirs], flat(ours, theirs), around)

    zones = np.unique(np.concatenate([queries.zone, references.zone]))
    if len(zones) == 1:
        origin = references.grid.min(axis=0)
        return _measured(queries.grid - origin, references.grid - origin, _side(radius), radius, flat)
    _check_zones(queries, references, zones)
    return _measured(_space(queries.globe), _space(references.globe), _side(radius * _STRETCH), radius, apart)


def _side(radius: float) -> float:
    """Of cubes that hold a radius; a little larger, so that rounding loses no neighbour."""
    return radius * (1 + 1e-6) + 1e-3


def _check_zones(queries: Spots, references: Spots, zones: Int64[np.ndarray, " z"]) -> None:
    lost = sum(int(np.isnan(spots.globe[:, 0]).sum()) for spots in (queries, references))
    if lost:
        raise BenchmarkError(
            f"photos are counted in {len(zones)} UTM zones (0 where none is said: {zones.tolist()}), and {lost} have "
            "no latitude and longitude to compare across zones: write zone and letter into every name"
        )


def _space(globe: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 3"]:
    """Metres from the earth's centre; two points near each other are near in space, wherever they are."""
    lat, lon = np.radians(globe.reshape(-1, 2)).T
    unit = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
    space: NDArray[np.float64] = unit * EARTH_RADIUS_M
    return space


def _measured(
    ours: Float64[np.ndarray, "q d"],
    theirs: Float64[np.ndarray, "r d"],
    side: float,
    radius: float,
    apart: Measure,
) -> Ragged:
    """Measure the pairs in touching cubes of that side, and keep those within the radius."""
    grid = _Cubes(theirs, max(side, _extent(theirs) / (1 << (_BITS - 1))))
    values: list[NDArray[np.int64]] = []
    counts = np.zeros(len(ours), dtype=np.int64)
    for queries, references in grid.candidates(ours):
        near: Bool[np.ndarray, " p"] = apart(queries, references) <= radius
        hit, found = queries[near], references[near]
        values.append(found[np.lexsort((found, hit))])
        counts += np.bincount(hit, minlength=len(ours))
    ends = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return Ragged(np.concatenate([np.zeros(0, np.int64), *values]), ends)


def _extent(points: Float64[np.ndarray, "n d"]) -> float:
    """How wide points lie; half as many cubes as there are numbers for fit into it."""
    return float(np.ptp(points, axis=0).max()) if len(points) else 0.0


class _Cubes:
    """Points by the cube they lie in: each cube a number, the numbers sorted."""

    def __init__(self, points: Float64[np.ndarray, "n d"], side: float) -> None:
        self._side = side
        self._origin = points.min(axis=0) - 2 * side  # so that no neighbour's number is negative
        keys = self._keys(points)
        self._order = np.argsort(keys, kind="stable")
        self._sorted = keys[self._order]

    def candidates(
        self, points: Float64[np.ndarray, "q d"]
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """Pairs of a query's and a reference's row, from cubes that touch, whole queries at a time in their order."""
        starts, stops = self._ranges(points)
        totals = np.cumsum((stops - starts).sum(axis=1))
        begin = 0
        while begin < len(points):
            before = int(totals[begin - 1]) if begin else 0
            end = max(begin + 1, int(np.searchsorted(totals, before + _AT_ONCE, side="right")))
            yield self._pairs(begin, starts[begin:end], stops[begin:end])
            begin = end

    def _ranges(
        self, points: Float64[np.ndarray, "q d"]
    ) -> tuple[Int64[np.ndarray, "q k"], Int64[np.ndarray, "q k"]]:
        """Where the cubes around each point begin and end; three along the last axis are one range."""
        keys = self._keys(points)
        around = list(itertools.product((-1, 0, 1), repeat=points.shape[1] - 1))
        steps = np.array(
            [sum(step << (_BITS * place) for place, step in enumerate(at, 1)) for at in around],
            dtype=np.int64,
        )
        middles = keys[:, None] + steps
        starts = np.searchsorted(self._sorted, middles - 1, side="left")
        stops = np.searchsorted(self._sorted, middles + 1, side="right")
        return starts.astype(np.int64), stops.astype(np.int64)

    def _pairs(
        self, begin: int, starts: Int64[np.ndarray, "q k"], stops: Int64[np.ndarray, "q k"]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Spell ranges out: the query's row and the reference's row of each member."""
        lengths = (stops - starts).ravel()
        ends = np.cumsum(lengths)
        inside = np.arange(ends[-1]) - np.repeat(ends - lengths, lengths)
        references = self._order[np.repeat(starts.ravel(), lengths) + inside]
        queries = begin + np.repeat(np.repeat(np.arange(len(starts)), starts.shape[1]), lengths)
        return queries, references

    def _keys(self, points: Float64[np.ndarray, "n d"]) -> Int64[np.ndarray, " n"]:
        """A number for each point's cube; who is far outside counts as at the edge, where no reference is."""
        cubes = np.floor((points - self._origin) / self._side)
        cubes = np.clip(cubes, 0, (1 << _BITS) - 2).astype(np.int64)
        keys = np.zeros(len(points), dtype=np.int64)
        for axis in range(points.shape[1]):
            keys |= cubes[:, axis] << (_BITS * axis)
        return keys


# --- Which places are near to one another, and squares that cover the earth; neither knows any edge of a zone ---


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
