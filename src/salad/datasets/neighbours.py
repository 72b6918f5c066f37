"""Who is at most so many metres away, among millions: a tree of points, asked a block of queries at a time.

No matrix of pairs is built. Two measures are known. Along the earth, by latitude and longitude, no zone, date line or
pole is special. On the map, by the metres of one UTM zone, as published sets measure; two photos of different zones are
then measured along the earth, since their metres east have nothing to do with one another.

The tree only proposes who may be near, by straight lines through space. Who is near is settled by the metres that
everything else here is told in, so that a distance exactly on the bound counts as it should.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from salad.datasets.compact_lists import Ragged
from salad.datasets.coordinates import Coordinates
from salad.errors import BenchmarkError
from salad.geo import EARTH_RADIUS_M, GeoPoint, in_degrees, metres, on_unit_sphere

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_AT_ONCE = 1 << 21  # pairs measured at once: some 200 MB, most of it lists of Python's numbers
_STRETCH = 1.02  # more than a UTM zone and the sphere stretch any distance
_FAR = 1e149  # metres: the tree squares distances, and those of a damaged table's numbers must not overflow


def near_on_earth(queries: Float64[np.ndarray, "q 2"], references: Float64[np.ndarray, "r 2"], radius: float) -> Ragged:
    """For each query the rows of the references at most `radius` metres away along the great circle, ascending.

    Both sides are latitudes and longitudes in degrees.
    """

    def distance(query: NDArray[np.int64], reference: NDArray[np.int64]) -> NDArray[np.float64]:
        return metres(*queries[query].T, *references[reference].T)

    return _within(_in_space(queries), _in_space(references), radius, distance)


def near_on_map(queries: Coordinates, references: Coordinates, radius: float) -> Ragged:
    """For each query the rows of the references at most `radius` metres away on the map, ascending.

    Raises:
        BenchmarkError: If photos are of different zones, or some of none, and one has no latitude and longitude; or if
            degrees stand where metres belong.
    """

    def on_map(query: NDArray[np.int64], reference: NDArray[np.int64]) -> NDArray[np.float64]:
        away: NDArray[np.float64] = np.hypot(*(queries.utm[query] - references.utm[reference]).T)
        return away

    def distance(query: NDArray[np.int64], reference: NDArray[np.int64]) -> NDArray[np.float64]:
        around = metres(*queries.lat_lon[query].T, *references.lat_lon[reference].T)
        return np.where(queries.zone[query] == references.zone[reference], on_map(query, reference), around)

    zones = np.unique(np.concatenate([queries.zone, references.zone]))
    if len(zones) == 1:
        ours, theirs = (np.clip(side.utm, -_FAR, _FAR) for side in (queries, references))
        if zones[0] == 0:
            _check_metres(np.concatenate([ours, theirs]), radius)
        return _within(ours, theirs, radius, on_map)
    unknown = sum(int(np.isnan(side.lat_lon[:, 0]).sum()) for side in (queries, references))
    if unknown:
        raise BenchmarkError(
            f"photos are counted in {len(zones)} UTM zones (0 where none is said: {zones.tolist()}), and {unknown} "
            "have no latitude and longitude to compare across zones: write zone and letter into every name"
        )
    places = _in_space(queries.lat_lon), _in_space(references.lat_lon)
    return _within(*places, radius, distance, reach=radius * _STRETCH)


def _check_metres(numbers: Float64[np.ndarray, "n 2"], radius: float) -> None:
    """Refuse degrees in place of metres: everything would count as right for everything.

    Raises:
        BenchmarkError: If they could be longitudes and latitudes, have more digits than centimetres, and all of them
            lie within the radius.
    """
    could_be = (np.abs(numbers) <= (180, 90)).all() and (np.abs(numbers * 100 - np.rint(numbers * 100)) > 1e-6).any()
    if could_be and np.hypot(*np.ptp(numbers, axis=0)) <= radius:
        east, north = numbers[0].tolist()
        raise BenchmarkError(
            f"the names say {east:g} and {north:g} where metres east and north belong, and no two of them are over "
            f"{radius:g} apart: if these are degrees, say where the photos are by a table or by EXIF"
        )


def _within(
    queries: Float64[np.ndarray, "q d"],
    references: Float64[np.ndarray, "r d"],
    radius: float,
    distance: Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.float64]],
    reach: float | None = None,
) -> Ragged:
    """For each query the rows of the references whose `distance` is at most `radius`, ascending; all in metres.

    `distance` measures rows of queries and rows of references pair by pair. Only what is within `reach` in a straight
    line is measured, or within the radius where no reach is given.
    """
    tree, reach = _tree(references), _widened(radius if reach is None else reach)
    # Counted first, which is cheap: a block of queries must not propose more pairs than fit into memory.
    proposed = np.cumsum(tree.query_ball_point(queries, reach, return_length=True))
    found: list[NDArray[np.int64]] = []
    counts = np.zeros(len(queries), dtype=np.int64)
    begin = 0
    while begin < len(queries):
        before = int(proposed[begin - 1]) if begin else 0
        end = max(begin + 1, int(np.searchsorted(proposed, before + _AT_ONCE, side="right")))
        rows = tree.query_ball_point(queries[begin:end], reach, return_sorted=True)
        lengths = np.diff(proposed[begin:end], prepend=before)
        query = np.repeat(np.arange(begin, end), lengths)
        reference = np.fromiter(itertools.chain.from_iterable(rows), np.int64, len(query))
        near = distance(query, reference) <= radius
        found.append(reference[near])
        counts += np.bincount(query[near], minlength=len(queries))
        begin = end
    return Ragged(np.concatenate([np.zeros(0, np.int64), *found]), counts)


class Neighbours:
    """Who is nearer than `apart_m` metres to whom; prepared once, asked often.

    Args:
        points: One a place; None where nobody knows, which is near to nothing.
        apart_m: In metres; at 0 nothing is near to anything.
    """

    def __init__(self, points: Sequence[GeoPoint | None], apart_m: float) -> None:
        self._apart_m = apart_m
        # Those that nobody knows keep their numbers, but are not in the tree, which takes no NaN.
        self._lat_lon = in_degrees(points)
        self._known = np.flatnonzero(np.isfinite(self._lat_lon[:, 0]))
        self._space = _in_space(self._lat_lon)
        self._tree = _tree(self._space[self._known])

    def of(self, number: int) -> NDArray[np.int64]:
        """Ascending numbers of the points nearer than `apart_m` to that one, itself not among them."""
        here = self._lat_lon[number]
        if np.isnan(here[0]):
            return np.zeros(0, dtype=np.int64)
        rows = self._tree.query_ball_point(self._space[number], _widened(self._apart_m), return_sorted=True)
        others = self._known[rows]
        away = metres(*here, *self._lat_lon[others].T)
        near: NDArray[np.int64] = others[(away < self._apart_m) & (others != number)]
        return near


def squares(lat_lon: Float64[np.ndarray, "n 2"], side_m: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The square of the earth that each point lies in: its row from the south pole and its place in that row.

    Rows are `side_m` high. Each is cut into a whole number of pieces at most that wide, so it closes at the date
    line without a rest, and needs no UTM zone.

    Points are `[N, 2]` degrees; what comes back is two arrays `[N]`.
    """
    lat, lon = lat_lon.T
    high = math.degrees(side_m / EARTH_RADIUS_M)
    rows = np.floor((lat + 90) / high)
    middle = np.radians(np.minimum((rows + 0.5) * high - 90, 90))
    # By the row's middle: rows get shorter towards the poles, and squares must stay about as wide as they are high.
    pieces = np.ceil(2 * math.pi * EARTH_RADIUS_M * np.cos(middle) / side_m).clip(min=1)
    columns = np.floor((lon + 180) / 360 * pieces) % pieces
    return rows.astype(np.int64), columns.astype(np.int64)


def _in_space(lat_lon: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 3"]:
    """Metres from the earth's centre; two points near each other are near in space, wherever they are."""
    return (on_unit_sphere(lat_lon.reshape(-1, 2)) * EARTH_RADIUS_M).T


def _widened(reach: float) -> float:
    """A little more than asked for, so that rounding loses no neighbour."""
    return min(reach * (1 + 1e-6) + 1e-3, 10 * _FAR)


def _tree(points: Float64[np.ndarray, "n d"]) -> cKDTree:
    # Imported here: it takes a third of a second, and most commands never ask who is near.
    from scipy.spatial import cKDTree

    # Split in the middle of space, not at the median: 2.8 million photos along streets take 1.9 s in place of 3.0.
    return cKDTree(points, balanced_tree=False, compact_nodes=False)
