"""Who is near, against a plain look at every pair: in towns, at zone edges, the date line and the poles."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.datasets import neighbours
from salad.datasets.coordinates import Coordinates
from salad.datasets.neighbours import Neighbours, near_on_earth, near_on_map, squares
from salad.errors import BenchmarkError
from salad.geo import GeoPoint, metres, metres_between, shifted, to_utm

STARTS = [
    GeoPoint(41.65, -0.88),
    GeoPoint(0.0, 6.0),  # equator and the edge of two zones
    GeoPoint(52.1, 12.0),
    GeoPoint(-16.9, 179.9999),
    GeoPoint(69.65, 18.0),
    GeoPoint(90.0, 0.0),
    GeoPoint(-89.9999, 33.0),
]
Offsets = st.lists(st.tuples(st.integers(-70, 70), st.integers(-70, 70)), min_size=1, max_size=25)


def around(start: GeoPoint, offsets: list[tuple[int, int]]) -> np.ndarray:
    points = [shifted(start, north, east) for north, east in offsets]
    return np.array([(point.lat, point.lon) for point in points])


def plain(queries: np.ndarray, references: np.ndarray, radius: float, slack: float) -> list[set[int]]:
    """Every pair, one by one."""
    return [
        set(np.flatnonzero(metres(lat, lon, references[:, 0], references[:, 1]) <= radius + slack).tolist())
        for lat, lon in queries
    ]


@settings(max_examples=150)
@given(
    start=st.sampled_from(STARTS),
    ours=Offsets,
    theirs=Offsets,
    radius=st.one_of(st.floats(0.01, 200), st.just(2.1e7)),
)
def test_on_earth_against_every_pair(
    start: GeoPoint, ours: list[tuple[int, int]], theirs: list[tuple[int, int]], radius: float
) -> None:
    queries, references = around(start, ours), around(start, theirs)
    found = near_on_earth(queries, references, radius)
    assert len(found) == len(queries)
    sure, maybe = plain(queries, references, radius, -1e-6), plain(queries, references, radius, 1e-6)
    for rows, least, most in zip(found, sure, maybe, strict=True):
        assert least <= set(rows.tolist()) <= most
        assert rows.tolist() == sorted(set(rows.tolist()))
        assert rows.dtype == np.int64


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), radius=st.floats(1e3, 1e7))
def test_all_over_the_earth(seed: int, radius: float) -> None:
    chance = np.random.default_rng(seed)
    lat, lon = np.degrees(np.arcsin(chance.uniform(-1, 1, 60))), chance.uniform(-180, 180, 60)
    points = np.stack([lat, lon], axis=1)
    found = near_on_earth(points[:20], points, radius)
    assert [set(rows.tolist()) for rows in found] == plain(points[:20], points, radius, 0.0)


def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    chance = np.random.default_rng(3)
    points = np.stack([chance.uniform(48, 48.002, 300), chance.uniform(11, 11.002, 300)], axis=1)
    whole = near_on_earth(points, points, 40.0)
    monkeypatch.setattr(neighbours, "_AT_ONCE", 7)
    blocked = near_on_earth(points, points, 40.0)
    assert whole.values.tolist() == blocked.values.tolist()
    assert whole.ends.tolist() == blocked.ends.tolist()
    assert whole.lengths.min() >= 1


def spots(points: list[GeoPoint], *, globe: bool = True, zoned: bool = True) -> Coordinates:
    grids = [to_utm(point) for point in points]
    return Coordinates(
        np.array([(grid.easting, grid.northing) for grid in grids]),
        np.array([(grid.zone if grid.letter >= "N" else -grid.zone) if zoned else 0 for grid in grids]),
        np.array([(p.lat, p.lon) if globe else (np.nan, np.nan) for p in points]),
    )


@settings(max_examples=100)
@given(
    start=st.sampled_from([point for point in STARTS if abs(point.lat) < 80]),
    ours=Offsets,
    theirs=Offsets,
    radius=st.floats(1, 90),
)
def test_on_the_map_zone_by_zone(
    start: GeoPoint, ours: list[tuple[int, int]], theirs: list[tuple[int, int]], radius: float
) -> None:
    queries, references = (spots([shifted(start, n, e) for n, e in side]) for side in (ours, theirs))
    found = near_on_map(queries, references, radius)
    for row, rows in enumerate(found):
        flat = np.hypot(*(references.utm - queries.utm[row]).T)
        curved = metres(*queries.lat_lon[row], *references.lat_lon.T)
        away = np.where(references.zone == queries.zone[row], flat, curved)
        assert set(rows.tolist()) == set(np.flatnonzero(away <= radius).tolist())


def test_a_zones_edge_does_not_part_neighbours() -> None:
    edge = GeoPoint(52.1, 12.0)
    sides = [shifted(edge, 0, -8.5)], [shifted(edge, 0, 8.5)]
    ours, theirs = spots(sides[0]), spots(sides[1])
    assert abs(ours.utm[0, 0] - theirs.utm[0, 0]) > 400_000
    assert [rows.tolist() for rows in near_on_map(ours, theirs, 25.0)] == [[0]]


def test_the_map_alone_is_enough_in_one_zone_and_not_in_two() -> None:
    here, there = GeoPoint(52.1, 11.99), GeoPoint(52.1, 12.01)
    ours = spots([here], globe=False)
    assert [rows.tolist() for rows in near_on_map(ours, spots([here], globe=False), 1.0)] == [[0]]
    plain = spots([here], globe=False, zoned=False)
    assert [rows.tolist() for rows in near_on_map(plain, plain, 1.0)] == [[0]]
    with pytest.raises(BenchmarkError, match=r"2 UTM zones .* 2 have no latitude"):
        near_on_map(ours, spots([there], globe=False), 1.0)


def test_a_radius_that_is_exactly_the_distance_counts() -> None:
    ours = Coordinates(np.array([[0.0, 0.0]]), np.zeros(1, np.int64), np.full((1, 2), np.nan))
    theirs = Coordinates(
        np.array([[15.0, 20.0], [15.0, 20.001], [-25.0, 0.0]]), np.zeros(3, np.int64), np.full((3, 2), np.nan)
    )
    assert near_on_map(ours, theirs, 25.0)[0].tolist() == [0, 2]


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1))
def test_on_earth_the_bound_itself_counts_and_nothing_beyond(seed: int) -> None:
    chance = np.random.default_rng(seed)
    points = np.array([50.0, 8.0]) + chance.normal(0, 0.01, (20, 2))
    bound = float(metres(*points[0], *points[1]))
    assert 1 in near_on_earth(points[:1], points, bound)[0]
    assert 1 not in near_on_earth(points[:1], points, np.nextafter(bound, 0))[0]


def test_coordinates_that_nobody_can_have() -> None:
    """A damaged table may hold any number; far apart is far apart."""
    utm = np.array([[1e300, -1e300], [1e300, -1e300], [0.0, 0.0]])
    odd = Coordinates(utm, np.zeros(3, np.int64), np.full((3, 2), np.nan))
    assert [rows.tolist() for rows in near_on_map(odd, odd, 25.0)] == [[0, 1], [0, 1], [2]]
    assert [rows.tolist() for rows in near_on_map(odd, odd, 1e308)] == [[0, 1, 2]] * 3
    assert near_on_earth(np.zeros((1, 2)), np.array([[0.0, 180.0]]), 1e308)[0].tolist() == [0]


def test_scipy_is_loaded_when_somebody_asks_who_is_near() -> None:
    script = (
        "import sys, salad\n"
        "from salad.datasets import cluster, neighbours, protocols, samplers\n"
        "assert 'scipy' not in sys.modules\n"
        "neighbours.Neighbours([], 1.0)\n"
        "assert 'scipy' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


# --- Neighbours, and squares of the earth ----------------------------------------------------


HOMES = [
    GeoPoint(48.1, 11.5),
    GeoPoint(48.1, 12.0),  # where UTM's zone 32 becomes 33
    GeoPoint(0.0, -180.0),  # the date line, on the equator
    GeoPoint(-16.5, 180.0),
    GeoPoint(89.9999, 30.0),
    GeoPoint(-90.0, 0.0),
]
offsets = st.tuples(st.floats(-300, 300), st.floats(-300, 300))


@settings(max_examples=80)
@given(st.sampled_from(HOMES), st.lists(offsets, min_size=1, max_size=25), st.sampled_from([5.0, 40.0, 100.0]))
def test_neighbours_are_all_those_nearer_than_asked(
    home: GeoPoint, moves: list[tuple[float, float]], apart_m: float
) -> None:
    points: list[GeoPoint | None] = [shifted(home, north, east) for north, east in moves]
    points.insert(len(points) // 2, None)
    near = Neighbours(points, apart_m)
    for number, point in enumerate(points):
        expected = [
            other
            for other, place in enumerate(points)
            if place and point and other != number and metres_between(place, point) < apart_m
        ]
        assert near.of(number).tolist() == expected


def test_a_zones_edge_parts_nobody() -> None:
    west, east = GeoPoint(48.1, 11.9999), GeoPoint(48.1, 12.0001)
    assert to_utm(west).zone != to_utm(east).zone
    assert metres_between(west, east) == pytest.approx(15, abs=1)
    assert Neighbours([west, east], 16).of(0).tolist() == [1]
    assert Neighbours([west, east], 14).of(0).tolist() == []


def test_at_no_distance_nothing_is_near() -> None:
    assert Neighbours([HOMES[0], HOMES[0]], 0).of(0).tolist() == []


def _square(points: list[GeoPoint], side: float) -> list[tuple[int, int]]:
    lat, lon = np.array([point.lat for point in points]), np.array([point.lon for point in points])
    rows, columns = squares(np.stack([lat, lon], axis=1), side)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


@settings(max_examples=80)
@given(
    st.floats(-85, 85),
    st.floats(-180, 180),
    st.lists(offsets, min_size=2, max_size=20),
    st.sampled_from([10.0, 50.0]),
)
def test_points_of_one_square_are_within_its_diagonal(
    lat: float, lon: float, moves: list[tuple[float, float]], side: float
) -> None:
    points = [shifted(GeoPoint(lat, lon), north, east) for north, east in moves]
    where = _square(points, side)
    for one, at in zip(points, where, strict=True):
        for other, there in zip(points, where, strict=True):
            if at == there:
                assert metres_between(one, other) <= math.sqrt(2) * side * 1.001


@pytest.mark.parametrize("lat", [0.0, 37.77, -70.0])
def test_a_line_around_the_earth_is_cut_without_a_rest(lat: float) -> None:
    """Both sides of the date line are squares of their own, and 180 east is 180 west."""
    side = 1000.0
    assert _square([GeoPoint(lat, 180.0)], side) == _square([GeoPoint(lat, -180.0)], side)
    lon = np.linspace(-180, 180, 400_001)[:-1]
    counts = np.bincount(squares(np.stack([np.full_like(lon, lat), lon], axis=1), side)[1])
    assert counts.min() >= counts.max() - 2  # all as wide as each other
    assert len(counts) == math.ceil(2 * math.pi * 6371.0088 * math.cos(math.radians(_middle(lat, side))))


def _middle(lat: float, side: float) -> float:
    high = math.degrees(side / 6_371_008.8)
    return (math.floor((lat + 90) / high) + 0.5) * high - 90


def test_the_poles_are_squares_too() -> None:
    assert len(set(_square([GeoPoint(90, lon) for lon in (-180.0, -3.0, 77.0)], 10.0))) <= 7
    assert _square([GeoPoint(-90, 0)], 10.0)[0][0] == 0
