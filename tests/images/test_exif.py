"""EXIF, both ways; whatever is broken says nothing and never crashes."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from salad.errors import PhotoError
from salad.geo import GeoPoint, metres_between
from salad.images.decode import open_rgb
from salad.images.exif import changed, from_exif, save_jpeg, to_exif
from salad.images.metadata import Position
from tests.images.drawn import headings, times


def exif_of(gps: dict[int, Any] | None = None, shot: dict[int, Any] | None = None) -> Image.Exif:
    """EXIF as it comes out of a file: written to bytes and read again."""
    exif = Image.Exif()
    if gps is not None:
        exif[0x8825] = gps
    if shot is not None:
        exif[0x8769] = shot
    again = Image.Exif()
    again.load(exif.tobytes())
    return again


def dms(*numbers: float) -> tuple[IFDRational, ...]:
    return tuple(IFDRational(number) for number in numbers)


@given(st.builds(GeoPoint, st.floats(-90, 90), st.floats(-180, 180)), st.none() | headings, st.none() | times)
def test_exif_there_and_back(where: GeoPoint, heading: float | None, time: datetime | None) -> None:
    exif = Image.Exif()
    exif.load(to_exif(Position(where, heading, time)).tobytes())
    told = from_exif(exif)
    assert told.where is not None
    assert metres_between(told.where, where) < 1e-3
    assert told.time == time
    assert (told.time is None) or (told.time.utcoffset() == (time and time.utcoffset()))
    if heading is None:
        assert told.heading is None
    else:
        assert told.heading is not None
        assert abs((told.heading - heading + 180) % 360 - 180) <= 0.0051


def test_nothing_known_writes_nothing() -> None:
    assert from_exif(to_exif(Position())) == Position()
    assert not to_exif(Position())


@pytest.mark.parametrize(
    ("lat", "ref", "degrees"),
    [
        (dms(37, 30, 36), "N", 37.51),
        (dms(37, 30, 36), "S", -37.51),
        (dms(37, 30.6, 0), "n", 37.51),
        (dms(37, 30.6), "N ", 37.51),
        (dms(37.51), "S", -37.51),
        (dms(37, 30, 36), "South", -37.51),
        (dms(37, 30, 36), "S\0x", -37.51),
        ((*dms(37, 30.6), IFDRational(0, 0)), "S", -37.51),
        ((IFDRational(3751, 100), IFDRational(0, 0), IFDRational(0, 0)), "S", -37.51),
        ((37, 30, 36), "S", -37.51),
        ("37.51", "S", -37.51),
    ],
)
def test_degrees_come_in_one_two_or_three_numbers(lat: Any, ref: str, degrees: float) -> None:
    told = from_exif(Given({1: ref, 2: lat, 3: "W", 4: dms(122, 0, 0)}))
    assert told.where is not None
    assert told.where.lat == pytest.approx(degrees)
    assert told.where.lon == -122


@pytest.mark.parametrize(
    "gps",
    [
        {1: "N", 2: dms(37, 30, 36)},
        {1: "N", 3: "E"},
        {2: dms(37, 30, 36), 4: dms(122, 0, 0)},
        {1: "X", 2: dms(37, 30, 36), 3: "W", 4: dms(122, 0, 0)},
        {1: "", 2: dms(37, 30, 36), 3: "W", 4: dms(122, 0, 0)},
        {1: "N", 2: dms(97, 30, 36), 3: "W", 4: dms(122, 0, 0)},
        {1: "N", 2: (IFDRational(0, 0),) * 3, 3: "W", 4: (IFDRational(0, 0),) * 3},
        {1: "N", 2: dms(1, 2, 3, 4), 3: "W", 4: dms(122, 0, 0)},
    ],
)
def test_a_broken_position_is_none_and_said(gps: dict[int, Any]) -> None:
    told = from_exif(exif_of(gps))
    assert told.where is None
    assert bool(told.remark) == (2 in gps or 4 in gps)
    assert "nan" not in told.remark


@pytest.mark.parametrize(
    ("gps", "said"),
    [
        ({2: dms(37, 30, 36), 4: dms(122, 0, 0)}, "none of the letters N or S"),
        ({1: "N", 2: dms(37, 30, 36), 3: "\0W", 4: dms(122, 0, 0)}, "none of the letters E or W"),
        ({1: "E", 2: dms(37, 30, 36), 3: "S", 4: dms(122, 0, 0)}, "'E' in place of N or S"),
        ({1: "N", 2: dms(37, 30, 36)}, "no longitude"),
        ({1: "N", 2: (IFDRational(0, 0),) * 3, 3: "W", 4: dms(122, 0, 0)}, r"not understood \(0/0 0/0 0/0 N\)"),
        ({1: "N", 2: (37, IFDRational(0, 0)), 3: "W", 4: dms(122, 0, 0)}, "latitude in its EXIF is not understood"),
        ({1: "N", 2: (-37, 30, 36), 3: "W", 4: dms(122, 0, 0)}, "latitude in its EXIF is not understood"),
        ({1: "N", 2: dms(37, 30, 36), 3: "W", 4: dms(361, 0, 0)}, "longitude in its EXIF is not understood"),
        ({1: "N", 2: dms(37, 30, 36), 3: "W", 4: dms(122, 0, 0), 17: 65535}, "direction"),
    ],
)
def test_what_is_not_understood_is_said_and_never_guessed(gps: dict[int, Any], said: str) -> None:
    told = from_exif(Given(gps))
    assert told.where is None or 17 in gps
    assert re.search(said, told.remark)


@given(st.floats(180, 360), st.sampled_from("EW"))
def test_longitudes_go_on_beyond_180(degrees: float, letter: str) -> None:
    told = from_exif(Given({1: "N", 2: (10,), 3: letter, 4: (degrees,)})).where
    assert told is not None
    assert metres_between(told, shifted_round(10, degrees if letter == "E" else -degrees)) < 1e-3


def shifted_round(lat: float, lon: float) -> GeoPoint:
    return GeoPoint(lat, math.degrees(math.atan2(math.sin(math.radians(lon)), math.cos(math.radians(lon)))))


def test_a_minus_that_says_the_same_as_the_letter_is_no_riddle() -> None:
    told = from_exif(Given({1: "S", 2: (-36, -48, 0), 3: "E", 4: (174.75,)}))
    assert told.where == GeoPoint(-36.8, 174.75)


class Given(dict[int, Any]):
    """An EXIF whose tables all hold the same, of whatever types."""

    def get_ifd(self, tag: int) -> dict[int, Any]:
        return dict(self)


class Cursed(dict[int, Any]):
    """An EXIF whose tables raise when they are read."""

    def get_ifd(self, tag: int) -> dict[int, Any]:
        raise KeyError(tag)


def test_tables_that_cannot_be_read_say_nothing() -> None:
    assert from_exif(Cursed()) == Position()


@pytest.mark.parametrize(
    ("direction", "heading"),
    [(90.25, 90.25), (0, 0), (360, 0), (360.5, 0.5), (450, 90), (-90, 270), (65535, None), (-1e9, None)],
)
def test_image_direction_is_the_heading(direction: float, heading: float | None) -> None:
    # As a real number, since EXIF's fractions have no sign.
    assert from_exif(Given({17: direction})).heading == heading
    assert from_exif(Given({17: IFDRational(0, 0)})) == Position()


@pytest.mark.parametrize(
    ("text", "offset", "time"),
    [
        ("2020:01:02 03:04:05", None, datetime(2020, 1, 2, 3, 4, 5)),
        ("2020:01:02 03:04:05\0", "", datetime(2020, 1, 2, 3, 4, 5)),
        (
            "2020:01:02 03:04:05",
            "-03:30",
            datetime(2020, 1, 2, 3, 4, 5, tzinfo=timezone(-timedelta(hours=3.5))),
        ),
        ("2020:01:02 03:04:05", "later", datetime(2020, 1, 2, 3, 4, 5)),
        ("0000:00:00 00:00:00", "+01:00", None),
        ("    :  :     :  :  ", None, None),
        ("yesterday", None, None),
    ],
)
def test_original_time_with_its_offset(text: str, offset: str | None, time: datetime | None) -> None:
    told = from_exif(exif_of(shot={0x9003: text} | ({} if offset is None else {0x9011: offset})))
    assert told.time == time
    assert time is None or (told.time is not None and told.time.tzinfo == time.tzinfo)


ORIGINAL, DIGITISED, FILE = (
    {0x9003: "2020:01:02 03:04:05"},
    {0x9004: "2020:01:02 03:04:06"},
    {0x132: "2020:01:03 00:00:00"},
)
GPS_TIME = {29: "2020:01:02", 7: (2, 4, 5.5)}


def test_the_first_time_that_says_something_counts() -> None:
    utc = datetime(2020, 1, 2, 2, 4, 5, 500000, tzinfo=UTC)
    for tags, time in (
        ({**ORIGINAL, **DIGITISED, **GPS_TIME}, datetime(2020, 1, 2, 3, 4, 5)),
        ({0x9003: "0001:01:01 00:00:00", **DIGITISED, **GPS_TIME}, datetime(2020, 1, 2, 3, 4, 6)),
        (GPS_TIME, utc),
        ({**GPS_TIME, 7: (25, 0, 0)}, None),
        ({29: "2020:01:02"}, None),
        ({7: (1, 2, 3)}, None),
        (FILE, None),
    ):
        assert from_exif(Given(tags)).time == time
    assert changed(Given(FILE)).time == datetime(2020, 1, 3)
    assert changed(Given(FILE)).source is None


def test_fractions_and_offsets_belong_to_their_time() -> None:
    tags = {**ORIGINAL, **DIGITISED, 0x9291: "25", 0x9292: "5", 0x9011: "+02:00", 0x9012: "-01:00", 0x9010: "+09:00"}
    east = timezone(timedelta(hours=2))
    assert from_exif(Given(tags)).time == datetime(2020, 1, 2, 3, 4, 5, 250000, tzinfo=east)
    del tags[0x9011]
    assert from_exif(Given(tags)).time == datetime(2020, 1, 2, 3, 4, 5, 250000, tzinfo=timezone(timedelta(hours=9)))
    del tags[0x9003]
    assert from_exif(Given(tags)).time == datetime(2020, 1, 2, 3, 4, 6, 500000, tzinfo=timezone(timedelta(hours=-1)))


@given(
    st.dictionaries(
        st.sampled_from([1, 2, 3, 4, 7, 16, 17, 29, 0x132, 0x9003, 0x9011, 0x9291]),
        st.text(max_size=6)
        | st.binary(max_size=6)
        | st.none()
        | st.floats()
        | st.lists(st.one_of(st.floats(), st.text(max_size=2), st.just(IFDRational(0, 0))), max_size=4).map(tuple),
    )
)
@example({17: -1e-300})
def test_no_tag_crashes(gps: dict[int, Any]) -> None:
    told = from_exif(Given(gps))
    assert told.heading is None or 0 <= told.heading < 360


# --- writing -------------------------------------------------------------------------------


def test_save_jpeg_takes_images_of_any_mode_and_replaces(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    save_jpeg(Image.new("RGBA", (8, 8), (0, 0, 0, 0)), path)
    assert (np.asarray(open_rgb(path)) == 255).all()
    save_jpeg(np.zeros((8, 8, 3), np.uint8), str(path), quality=50)
    assert not np.asarray(open_rgb(path)).any()
    assert [p.name for p in tmp_path.iterdir()] == ["a.jpg"]


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    image = Image.new("RGB", (8, 8))
    (tmp_path / "file").touch()
    (tmp_path / "folder.jpg").mkdir()
    for path in (tmp_path / "gone/a.jpg", tmp_path / "file/a.jpg", tmp_path / "folder.jpg"):
        with pytest.raises(PhotoError, match="cannot be written"):
            save_jpeg(image, path)
    with pytest.raises(PhotoError, match="cannot be written"):
        save_jpeg(Image.new("L", (70_000, 1)), tmp_path / "wide.jpg")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.jpg"]
