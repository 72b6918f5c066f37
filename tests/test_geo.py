"""Points, metres and UTM against independent formulas and published figures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from salad.errors import PositionError
from salad.geo import (
    EARTH_RADIUS_M,
    GeoPoint,
    Utm,
    centre,
    from_utm,
    in_degrees,
    metres,
    metres_between,
    on_unit_sphere,
    shifted,
    spread,
    to_utm,
    zone_number,
)

points = st.builds(GeoPoint, st.floats(-90, 90), st.floats(-180, 180))
gridded = st.builds(GeoPoint, st.floats(-80, 84), st.floats(-180, 180))


def degrees(d: float, m: float, s: float) -> float:
    return math.copysign(abs(d) + m / 60 + s / 3600, d)


def unit(point: GeoPoint) -> np.ndarray:
    lat, lon = math.radians(point.lat), math.radians(point.lon)
    return np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


@pytest.mark.parametrize(
    ("lat", "lon"),
    [(90.1, 0), (-91, 0), (0, 180.1), (0, -181), (math.nan, 0), (0, math.nan), (math.inf, 0), (0, -math.inf)],
)
def test_a_point_off_the_earth_is_refused(lat: float, lon: float) -> None:
    with pytest.raises(PositionError, match="check the order"):
        GeoPoint(lat, lon)


@pytest.mark.parametrize(
    ("a", "b", "geodesic"),
    [
        # Flinders Peak to Buninyong, the worked example of the GDA technical manual
        (
            GeoPoint(degrees(-37, 57, 3.72030), degrees(144, 25, 29.52440)),
            GeoPoint(degrees(-37, 39, 10.15610), degrees(143, 55, 35.38390)),
            54_972.271,
        ),
        (GeoPoint(0, 0), GeoPoint(90, 0), 10_001_965.729),  # the WGS84 meridian quadrant
        (GeoPoint(0, 10), GeoPoint(0, 11), 111_319.491),  # a degree of the equator
        (GeoPoint(0, 179.5), GeoPoint(0, -179.5), 111_319.491),  # the same across the date line
    ],
)
def test_distances_are_within_half_a_percent_of_geodesics(a: GeoPoint, b: GeoPoint, geodesic: float) -> None:
    assert metres_between(a, b) == pytest.approx(geodesic, rel=0.005)


@given(points, points)
def test_distance_agrees_with_the_chord_between_unit_vectors(a: GeoPoint, b: GeoPoint) -> None:
    chord = float(np.linalg.norm(unit(a) - unit(b)))
    assume(chord < 1.99)  # at antipodes the arcsine loses its digits
    assert metres_between(a, b) == pytest.approx(2 * EARTH_RADIUS_M * math.asin(chord / 2), abs=1e-3)
    assert metres_between(a, b) == metres_between(b, a)
    assert metres_between(a, a) == 0


def test_points_that_nobody_knows_keep_their_rows_as_arrays() -> None:
    known = in_degrees([GeoPoint(0, 90), None, GeoPoint(-90, 0)])
    np.testing.assert_array_equal(known, [[0, 90], [math.nan] * 2, [-90, 0]])
    np.testing.assert_allclose(on_unit_sphere(known[[0, 2]]).T, [[0, 1, 0], [0, 0, -1]], atol=1e-15)
    assert in_degrees([]).shape == (0, 2)
    assert on_unit_sphere(in_degrees([])).shape == (3, 0)


def test_metres_broadcasts_queries_against_references() -> None:
    lat, lon = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    table = metres(lat[:, None], lon[:, None], lat[None, :2], lon[None, :2])
    assert table.shape == (3, 2)
    assert table[2, 1] == metres_between(GeoPoint(3, 6), GeoPoint(2, 5))
    assert table[0, 0] == 0


def krueger(point: GeoPoint, zone: int) -> tuple[float, float]:
    """UTM by Krüger's series to the third order (Karney 2011): another formula than the library's."""
    f = 1 / 298.257223563
    n = f / (2 - f)
    radius = 6_378_137 / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    alphas = (n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16, 13 * n**2 / 48 - 3 * n**3 / 5, 61 * n**3 / 240)
    lat, lon = math.radians(point.lat), math.radians(point.lon - (6 * zone - 183))
    e = 2 * math.sqrt(n) / (1 + n)
    t = math.sinh(math.atanh(math.sin(lat)) - e * math.atanh(e * math.sin(lat)))
    xi, eta = math.atan2(t, math.cos(lon)), math.atanh(math.sin(lon) / math.hypot(1, t))
    waves = list(enumerate(alphas, start=1))
    east = eta + sum(a * math.cos(2 * j * xi) * math.sinh(2 * j * eta) for j, a in waves)
    north = xi + sum(a * math.sin(2 * j * xi) * math.cosh(2 * j * eta) for j, a in waves)
    return 500_000 + 0.9996 * radius * east, 0.9996 * radius * north + (1e7 if point.lat < 0 else 0)


@given(st.floats(-79.9, 83.9), st.floats(-179.9, 179.9))
def test_utm_agrees_with_kruegers_series(lat: float, lon: float) -> None:
    assume(not (56 <= lat < 64 and 0 <= lon < 12) and not lat >= 72)  # where zones are wider
    point = GeoPoint(lat, lon)
    grid = to_utm(point)
    assume(lat >= 0 or lat < -1e-9)  # northing 0 or 10,000,000 at the equator itself
    assert (grid.easting, grid.northing) == pytest.approx(krueger(point, grid.zone), abs=0.01)


@given(gridded)
def test_utm_there_and_back_is_the_same_place(point: GeoPoint) -> None:
    wide = point.lat >= 56  # Norway's and Svalbard's zones reach twice as far from their middle
    assert metres_between(from_utm(to_utm(point)), point) < (0.2 if wide else 0.005)


@pytest.mark.parametrize("lat", [-45.0, 0.5, 37.7, 52.0])
def test_photos_17_m_apart_across_a_zones_edge_are_17_m_apart(lat: float) -> None:
    edge = GeoPoint(lat, 6.0)
    west, east = to_utm(shifted(edge, 0, -8.5)), to_utm(shifted(edge, 0, 8.5))
    assert (west.zone, east.zone) == (31, 32)
    assert abs(west.easting - east.easting) > 300_000
    assert metres_between(from_utm(west), from_utm(east)) == pytest.approx(17, abs=0.01)


@pytest.mark.parametrize(
    "grid",
    [
        Utm(500_000, 4_000_000, 0, "S"),
        Utm(500_000, 4_000_000, 61, "S"),
        Utm(500_000, 4_000_000, 10, "I"),
        Utm(500_000, 4_000_000, 10, ""),
        Utm(5, 4_000_000, 10, "S"),
        Utm(500_000, -1, 10, "S"),
        Utm(math.nan, 4_000_000, 10, "S"),
    ],
)
def test_a_coordinate_off_the_grid_is_refused(grid: Utm) -> None:
    with pytest.raises(PositionError, match="UTM grid"):
        from_utm(grid)


@given(st.floats(1e5, 999_999), st.floats(0, 1e7), st.integers(1, 60), st.sampled_from("CDEFGHJKLMNPQRSTUVWX"))
def test_any_coordinate_is_a_point_or_refused(easting: float, northing: float, zone: int, letter: str) -> None:
    try:
        point = from_utm(Utm(easting, northing, zone, letter))
    except PositionError:
        return
    assert -90 <= point.lat <= 90


@pytest.mark.parametrize("lat", [84.5, -80.5, 90.0])
def test_the_poles_have_no_utm(lat: float) -> None:
    with pytest.raises(PositionError, match="no UTM coordinate"):
        to_utm(GeoPoint(lat, 0))


@given(points, st.floats(-1e5, 1e5), st.floats(-1e5, 1e5))
def test_shifted_lies_as_far_away_as_asked(point: GeoPoint, north: float, east: float) -> None:
    assert metres_between(point, shifted(point, north, east)) == pytest.approx(math.hypot(north, east), abs=1e-3)


def test_shifted_goes_north_and_east_and_round_the_date_line() -> None:
    start = GeoPoint(10, 179.9999)
    assert shifted(start, 100, 0).lat == pytest.approx(10 + math.degrees(100 / EARTH_RADIUS_M))
    assert shifted(start, 100, 0).lon == pytest.approx(start.lon)
    assert -180 <= shifted(start, 0, 100).lon < -179.999
    assert metres_between(shifted(start, 0, 0), start) < 1e-6


@given(st.lists(st.tuples(st.floats(-500, 500), st.floats(-500, 500)), min_size=1, max_size=8), gridded)
def test_centre_of_points_near_each_other_is_their_mean_on_the_plane(
    offsets: list[tuple[float, float]], origin: GeoPoint
) -> None:
    north, east = (sum(axis) / len(offsets) for axis in zip(*offsets, strict=True))
    middle = centre([shifted(origin, *offset) for offset in offsets])
    assert metres_between(middle, shifted(origin, north, east)) < 0.01


def test_centre_across_the_date_line() -> None:
    middle = centre([GeoPoint(10, 179.9), GeoPoint(10, -179.9)])
    assert abs(middle.lon) == pytest.approx(180)
    assert middle.lat == pytest.approx(10, abs=1e-3)


def test_weights_pull_the_centre_and_zero_leaves_out() -> None:
    a, b, far = GeoPoint(0, 0), shifted(GeoPoint(0, 0), 0, 100), GeoPoint(50, 50)
    assert metres_between(centre([a, b, far], [3, 1, 0]), shifted(a, 0, 25)) < 1e-3
    assert spread([a, b, far], [1, 1, 0]) == pytest.approx(50, abs=1e-3)
    assert spread([a, a]) == pytest.approx(0, abs=1e-6)
    assert spread([a, b], [1e308, 1e308]) == pytest.approx(50, abs=1e-3)


@pytest.mark.parametrize(
    ("where", "weights", "says"),
    [
        ([], None, "no points"),
        ([GeoPoint(0, 0)], [1, 2], "2 weights do not fit 1 points"),
        ([GeoPoint(0, 0)], [0], "not all zero"),
        ([GeoPoint(0, 0), GeoPoint(1, 1)], [2, -1], "none negative"),
        ([GeoPoint(0, 0)], [math.nan], "finite"),
        ([GeoPoint(0, 0)], [math.inf], "finite"),
        ([GeoPoint(0, 0), GeoPoint(0, 180)], None, "evenly around the earth"),
    ],
)
def test_a_centre_that_there_is_not(where: list[GeoPoint], weights: list[float] | None, says: str) -> None:
    for of in (centre, spread):
        with pytest.raises(PositionError, match=says):
            of(where, weights)


@pytest.mark.parametrize(("text", "zone"), [("17T", 17), ("54s", 54), ("54K", -54), ("61T", 0), ("17O", 0), ("", 0)])
def test_zones_by_number(text: str, zone: int) -> None:
    assert zone_number(text) == zone
