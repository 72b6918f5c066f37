"""`@` names, both ways; whatever is broken says nothing and never crashes."""

from __future__ import annotations

import string
from datetime import datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.errors import PositionError
from salad.geo import GeoPoint, Utm, from_utm, metres_between, shifted, to_utm
from salad.images.at_names import at_name, parse_at_name
from salad.images.metadata import Position
from tests.images.drawn import headings, times

points = st.builds(GeoPoint, st.floats(-79.9, 83.9), st.floats(-180, 180))
plain = st.text(string.ascii_letters + string.digits + " -_.ßжあ", max_size=12)
HERE = from_utm(Utm(545350.23, 4174054.95, 10, "S"))


@given(points, st.none() | headings, st.none() | times, plain, plain)
def test_at_names_there_and_back(
    where: GeoPoint, heading: float | None, time: datetime | None, panoid: str, note: str
) -> None:
    name = at_name(where, heading=heading, time=time, panoid=panoid, note=note)
    assert name.count("@") == 15
    told = parse_at_name(name)
    assert told is not None
    assert told.where is not None
    assert metres_between(told.where, where) < 0.2
    assert told.time == (None if time is None else time.replace(tzinfo=None))
    if heading is None:
        assert told.heading is None
    else:
        assert told.heading is not None
        assert abs((told.heading - heading + 180) % 360 - 180) <= 0.5001


def test_an_at_name_is_written_as_data_sets_write_it() -> None:
    name = at_name(HERE, heading=7.4, time=datetime(2008, 5, 1, 13, 2, 3), panoid="63x00", note="n")
    assert name == "@0545350.23@4174054.95@10@S@037.71262@-122.48547@63x00@@007@@@@20080501_130203@n@.jpg"


def test_at_names_keep_17_m_across_a_zones_edge() -> None:
    edge = GeoPoint(45, 6)
    west, east = (parse_at_name(at_name(shifted(edge, 0, side))) for side in (-8.5, 8.5))
    assert west is not None
    assert east is not None
    assert west.where is not None
    assert east.where is not None
    assert metres_between(west.where, east.where) == pytest.approx(17, abs=0.02)


@pytest.mark.parametrize("text", ["a@b", "a/b", "a\\b", "nul\0"])
def test_texts_that_would_break_the_name_are_refused(text: str) -> None:
    with pytest.raises(PositionError, match="leave out"):
        at_name(HERE, note=text)


@pytest.mark.parametrize(
    "name",
    [
        "holiday.jpg",
        "me@home.jpg",
        "@home@work.jpg",
        "@",
        "@@@.jpg",
        "@nan@inf@10@S@.jpg",
        "@1e5@4174054@10@S@.jpg",
        "@0545350.23@.jpg",
        "x@0545350.23@4174054.95@10@S@.jpg",
        "@0545350.23@4174054.95@10@S@/plain.jpg",
        "@٠545350.23@4174054.95@10@S@.jpg",
        "SanFrancisco_0000001_2011_04_000_37.7049199_-122.4719100_p0098x00.jpg",
    ],
)
def test_other_names_say_nothing(name: str) -> None:
    assert parse_at_name(name) is None


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("@0545350.23@4174054.95@10@S@@@@@@@@@@@.jpg", HERE),
        ("folder@1@2@/@0545350.23@4174054.95@10@S@.JPG", HERE),
        ("@545350.23@4174054.95@10@s", HERE),  # short, in small letters, without a suffix
        ("@0545350.23@4174054.95@@@037.5@-122.5@.jpg", GeoPoint(37.5, -122.5)),
        ("@0545350.23@4174054.95@99@S@037.5@-122.5@.jpg", GeoPoint(37.5, -122.5)),
        ("@0545350.23@4174054.95@10@S@37.5@-122.5@.jpg", HERE),  # both: the grid counts
        ("@545350,23@4174054,95@10@S@37,5@-122,5@.jpg", HERE),  # with the comma of some countries
        ("@5.4535023e+05@4.17405495E+06@10@S@.jpg", HERE),
        ("@0545350.23@4174054.95@10S@@37.5@-122.5@.jpg", HERE),  # zone and letter in one field
        ("@0545350.23@4174054.95@10@@37.5@-122.5@.jpg", HERE),  # no letter, but on which side of the equator
        ("@0545350.23@4174054.95@.jpg", None),
        ("@0545350.23@4174054.95@99@S@137.5@-122.5@.jpg", None),
        ("@0545350.23@4174054.95@10@@x@-122.5@.jpg", None),
    ],
)
def test_where_an_at_name_points(name: str, where: GeoPoint | None) -> None:
    told = parse_at_name(name)
    assert told is not None
    assert told.where == where


@given(st.builds(GeoPoint, st.floats(-79.9, -0.1), st.floats(-180, 180)), st.sampled_from("sS"), st.booleans())
def test_s_may_stand_for_the_south(where: GeoPoint, letter: str, with_degrees: bool) -> None:
    grid = to_utm(where)
    degrees = f"{where.lat:.6f}@{where.lon:.6f}" if with_degrees else "@"
    told = parse_at_name(f"@{grid.easting:.2f}@{grid.northing:.2f}@{grid.zone}@{letter}@{degrees}@@@@@@@@@.jpg")
    assert told is not None
    assert told.where is not None
    if with_degrees or not -59 < where.lat < -49:  # where Patagonia has the metres of Kentucky, only degrees can tell
        assert metres_between(told.where, where) < 0.1


@given(st.builds(GeoPoint, st.floats(32, 39.999), st.floats(-180, 180)))
def test_s_is_a_band_of_the_north_too(where: GeoPoint) -> None:
    grid = to_utm(where)
    told = parse_at_name(f"@{grid.easting:.2f}@{grid.northing:.2f}@{grid.zone}@S@.jpg")
    assert grid.letter == "S"
    assert told is not None
    assert told.where is not None
    assert metres_between(told.where, where) < 0.1


def test_a_name_that_points_nowhere_says_why() -> None:
    for name, why in (
        ("@478000.00@5262000.00@.jpg", "its name gives metres, but no UTM zone"),
        ("@478000.00@5262000.00@32@@.jpg", "its name gives metres, but no UTM zone"),
        ("@8.7@47.5@32@T@.jpg", "its name gives metres that are off the UTM grid"),
        ("@478000.00@5262000.00@32@T@.jpg", ""),
    ):
        told = parse_at_name(name)
        assert told is not None
        assert told.remark == why


@pytest.mark.parametrize(
    ("kind", "where"),
    [
        *((kind, GeoPoint(47.511, 8.708)) for kind in ("full", "comma", "exponent", "zone_and_letter_together")),
        ("hemisphere_S", GeoPoint(-33.877, 151.205)),
        *((kind, None) for kind in ("utm_no_zone", "utm_no_zone_tail", "pseudo", "lonlat")),
    ],
)
def test_names_of_people(cases: Path, kind: str, where: GeoPoint | None) -> None:
    for path in (cases / "12-own-at-names" / kind).rglob("@*.jpg"):
        told = parse_at_name(path.name)
        assert told is not None
        if where is None:
            assert told.where is None
            assert told.remark == "its name gives metres, but no UTM zone"
        else:
            assert told.where is not None
            assert metres_between(told.where, where) < 1000  # as far apart as they are


@pytest.mark.parametrize(
    ("stamp", "time"),
    [
        ("2008", datetime(2008, 1, 1)),
        ("200805", datetime(2008, 5, 1)),
        ("2008053", datetime(2008, 5, 1)),  # cut within a field: what is whole counts
        ("20080531", datetime(2008, 5, 31)),
        ("20080531_", datetime(2008, 5, 31)),
        ("20080531_23", datetime(2008, 5, 31, 23)),
        ("20080531_2359", datetime(2008, 5, 31, 23, 59)),
        ("20080531_235958", datetime(2008, 5, 31, 23, 59, 58)),
        ("200", None),
        ("", None),
        ("20081301", None),
        ("00000101", None),
        ("2008-05-31", None),
        ("20080531235958", None),
        ("20080531_2359589", None),
        ("٢٠٠٨", None),
        ("YYYY", None),
    ],
)
def test_any_left_part_of_a_timestamp(stamp: str, time: datetime | None) -> None:
    told = parse_at_name(f"@0545350.23@4174054.95@10@S@@@@@370.5@@@@{stamp}@@.jpg")
    assert told == Position(HERE, 10.5, time)


@given(st.text(max_size=60) | st.lists(st.text("0123456789.-_SNa٣", max_size=16)).map(lambda f: "@" + "@".join(f)))
def test_no_name_crashes(name: str) -> None:
    told = parse_at_name(name)
    assert told is None or told.heading is None or 0 <= told.heading < 360


def test_real_names_agree_with_their_degrees(shared: Path) -> None:
    names = [path.name for path in (shared / "data/eval/sfxl-30/images/test/database").glob("@*.jpg")]
    assert len(names) > 200
    for name in names:
        told = parse_at_name(name)
        assert told is not None
        assert told.where is not None
        assert metres_between(told.where, GeoPoint(*map(float, name.split("@")[5:7]))) < 1
        assert told.time is not None
