"""Where things fall on a map."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.geo import GeoPoint, metres_between, round_metres, shifted
from salad.report.map import SHAPE, WIDE, Frame, cell_path, regions
from salad.report.mistakes import OUTCOMES


@given(lat=st.floats(-75, 75), lon=st.floats(-180, 180), north=st.floats(-5e3, 5e3), east=st.floats(-5e3, 5e3))
def test_a_map_keeps_distances_and_directions_and_holds_its_points(
    lat: float, lon: float, north: float, east: float
) -> None:
    here = GeoPoint(lat, lon)
    there = shifted(here, north, east)
    frame = Frame.around([(one.lat, one.lon) for one in (here, there)])
    (x, y), (to_x, to_y) = (frame.at((one.lat, one.lon)) for one in (here, there))
    assert math.hypot(to_x - x, to_y - y) / frame.scale == pytest.approx(
        metres_between(here, there), rel=5e-3, abs=0.01
    )
    assert (to_y < y) == (north > 0) or abs(to_y - y) < 2
    assert (to_x > x) == (east > 0) or abs(to_x - x) < 2
    assert all(0 < one < WIDE for one in (x, to_x))
    assert all(0 < one < frame.height for one in (y, to_y))
    assert SHAPE[0] * WIDE <= frame.height <= SHAPE[1] * WIDE


def test_towns_far_apart_are_regions_and_a_road_joins_them() -> None:
    places = {n: (40.0 + 2 * (n % 3), 10.0 + n / 1e4) for n in range(10)}
    assert [len(some) for some in regions(places)] == [4, 3, 3]
    road = {n: (40.0 + 0.2 * n, 10.0 - 0.2 * n) for n in range(10)}
    assert regions(road) == [list(range(10))]


@given(about=st.floats(0.5, 1e5))
def test_a_scale_bar_is_round_and_not_too_long(about: float) -> None:
    length = round_metres(about)
    assert length <= about * 1.001 < length * 2.6
    assert f"{length:g}"[0] in "1250"
    frame = Frame((0.0, 0.0), WIDE / 5 / about, 500.0)
    assert frame.bar_m * frame.scale <= WIDE / 5 * 1.001


def test_a_cell_lies_within_its_column_and_only_the_unanswerable_is_hollow() -> None:
    for kind in OUTCOMES:
        path = cell_path(kind, 100.0, 50.0, 12.0)
        assert path.count("Z") == (2 if kind == "unanswerable" else 1)
        starts = re.findall(r"M([\d.]+) ([\d.]+)h?", path)
        assert all(100 <= float(x) < 112 and abs(float(y) - 50) <= 10 for x, y in starts)
