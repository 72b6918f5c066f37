"""Who is near, against a plain look at every pair: in towns, at zone edges, the date line and the poles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.datasets import neighbours
from salad.datasets.compact_lists import Ragged
from salad.datasets.neighbours import Spots, near_on_earth, near_on_map
from salad.errors import BenchmarkError
from salad.geo import GeoPoint, metres, shifted, to_utm

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


def spots(points: list[GeoPoint], *, globe: bool = True, zoned: bool = True) -> Spots:
    grids = [to_utm(point) for point in points]
    return Spots(
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
        flat = np.hypot(*(references.grid - queries.grid[row]).T)
        curved = metres(*queries.globe[row], *references.globe.T)
        away = np.where(references.zone == queries.zone[row], flat, curved)
        assert set(rows.tolist()) == set(np.flatnonzero(away <= radius).tolist())


def test_a_zones_edge_does_not_part_neighbours() -> None:
    edge = GeoPoint(52.1, 12.0)
    sides = [shifted(edge, 0, -8.5)], [shifted(edge, 0, 8.5)]
    ours, theirs = spots(sides[0]), spots(sides[1])
    assert abs(ours.grid[0, 0] - theirs.grid[0, 0]) > 400_000
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
    ours = Spots(np.array([[0.0, 0.0]]), np.zeros(1, np.int64), np.full((1, 2), np.nan))
    theirs = Spots(
        np.array([[15.0, 20.0], [15.0, 20.001], [-25.0, 0.0]]), np.zeros(3, np.int64), np.full((3, 2), np.nan)
    )
    assert near_on_map(ours, theirs, 25.0)[0].tolist() == [0, 2]


def test_ragged_is_a_sequence_of_arrays() -> None:
    held = Ragged.of([np.array([3, 4]), np.array([], dtype=np.int64), np.array([5])])
    assert [rows.tolist() for rows in held] == [[3, 4], [], [5]]
    assert held[-1].tolist() == [5]
    assert [rows.tolist() for rows in held[1:]] == [[], [5]]
    assert held.lengths.tolist() == [2, 0, 1]
    with pytest.raises(IndexError):
        held[3]
    assert len(Ragged.of([])) == 0
