"""Who is near to whom, and squares of the earth: the same everywhere on it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.datasets.neighbours import Neighbours, squares
from salad.geo import GeoPoint, metres_between, shifted, to_utm

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
@given(
    st.sampled_from(HOMES), st.lists(offsets, min_size=1, max_size=25), st.sampled_from([5.0, 40.0, 100.0])
)
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
    rows, columns = squares(lat, lon, side)
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
    counts = np.bincount(squares(np.full_like(lon, lat), lon, side)[1])
    assert counts.min() >= counts.max() - 2  # all as wide as each other
    assert len(counts) == math.ceil(2 * math.pi * 6371.0088 * math.cos(math.radians(_middle(lat, side))))


def _middle(lat: float, side: float) -> float:
    high = math.degrees(side / 6_371_008.8)
    return (math.floor((lat + 90) / high) + 0.5) * high - 90


def test_the_poles_are_squares_too() -> None:
    assert len(set(_square([GeoPoint(90, lon) for lon in (-180.0, -3.0, 77.0)], 10.0))) <= 7
    assert _square([GeoPoint(-90, 0)], 10.0)[0][0] == 0
