"""Metres on the grid and degrees: as the one-point conversion has it, and nowhere where nobody can stand."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from salad.datasets.coordinates import Coordinates, lat_lon_of
from salad.geo import GeoPoint, from_utm, metres_between, to_utm, zone_number


@given(st.lists(st.tuples(st.floats(-79.9, 83.9), st.floats(-179.9, 179.9)), min_size=1, max_size=8))
@example([(72.0, 33.0)])
def test_many_at_once_as_one_by_one(places: list[tuple[float, float]]) -> None:
    points = [GeoPoint(*place) for place in places]
    grid = [to_utm(point) for point in points]
    metres = np.array([(place.easting, place.northing) for place in grid])
    zones = np.array([zone_number(f"{place.zone}{place.letter}") for place in grid])
    for point, on_grid, (lat, lon) in zip(points, grid, lat_lon_of(metres, zones).tolist(), strict=True):
        # Beyond a half circle's end 180.0 east may be told as 180.0 west.
        found = GeoPoint(lat, (lon + 180) % 360 - 180)
        assert metres_between(from_utm(on_grid), found) < 1e-6
        # Svalbard's zones are twice as wide, and at their edge the grid's series is off by centimetres.
        assert metres_between(point, found) < 0.1


def test_where_nobody_can_stand() -> None:
    metres = np.array([[500_000.0, 4_000_000.0], [0.0, 1000.0], [500_000.0, 1e8], [500_000.0, 4_000_000.0]])
    lat_lon = lat_lon_of(metres, np.array([17, 17, 17, 0]))
    assert np.isnan(lat_lon[:, 0]).tolist() == [False, True, True, True]


def test_a_zone_for_all_or_none() -> None:
    metres = np.array([[500_000.0, 4_000_000.0]])
    assert Coordinates.in_zone(metres, "17T").zone.tolist() == [17]
    nowhere = Coordinates.in_zone(metres, "")
    assert nowhere.zone.tolist() == [0]
    assert np.isnan(nowhere.lat_lon).all()
