"""What people write into tables: what can mean only one thing comes back, what may mean two is refused."""

from __future__ import annotations

from contextlib import suppress
from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.errors import PositionError
from salad.geo import GeoPoint
from salad.images.as_written import columns, degrees, position, time, unknown

MICRO = 3_600_000_000  # millionths of a second of arc in a degree
ANGLES = st.integers(-180 * MICRO, 180 * MICRO)


@pytest.mark.parametrize(
    "form",
    [
        *(
            "{d}° {m}' {s}\" {letter}",
            "{d}°{m}'{s}\"{letter}",
            "{letter} {d}° {m}' {s}\"",
            "{d}º{m}\u2032{s}\u2033{letter}",
        ),
        *("{d} deg {m}' {s}\" {letter}", "{d}:{m}:{s} {letter}", "{sign}{d}° {m}' {s}\"", "{d}°{m}'{s}''{letter}"),
        *("{sign}{d}:{m}:{s}", "{d}° {m}\u2019 {s}\u201d {letter}", '{d}°{m}\'{s}""{letter}'),
    ],
)
@given(angle=ANGLES)
def test_degrees_minutes_and_seconds_come_back(form: str, angle: int) -> None:
    whole, rest = divmod(abs(angle), MICRO)
    minutes, seconds = divmod(rest, MICRO // 60)
    sign, letter = ("-", "W") if angle < 0 else ("", "E")
    text = form.format(d=whole, m=minutes, s=f"{seconds / 1e6:.6f}", sign=sign, letter=letter)
    found = degrees(text, "lon")
    assert found is not None
    assert abs(found - angle / MICRO) < 1e-12 * 180


@given(st.floats(-180, 180), st.sampled_from(["", " ", "\u00a0", "\u2009", "\u202f", "\u200e"]), st.booleans())
def test_decimal_degrees_come_back_however_they_are_set(value: float, space: str, comma: bool) -> None:
    text = space + str(value).replace("-", "\u2212" if space else "-").replace(".", "," if comma else ".") + space
    for written in (text, text + "°"):
        assert degrees(written, "lon") == value


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("-33.9 S", "has a sign and a letter: keep one"),
        *((text, "is not a number of degrees") for text in ("47°60'", "47°30'60\"", "47.5° 30'", "47 30 12", "8.7 E")),
        *((text, "is not a number of degrees") for text in ("N 47 S", "1.234,5", "1,234,5", "4 7", "47O", "١", "--1")),
        ("47° " * 20_000, r"^its lat '47° .*'\.\.\. is not a number of degrees$"),
    ],
)
def test_what_may_mean_two_things_is_refused(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says) as told:
        degrees(text, "lat")
    assert len(str(told.value)) < 150


def test_a_heading_has_no_letters_and_is_no_huge_number() -> None:
    assert degrees("90°", "heading") == 90
    for text in ("90 E", "1e9"):
        with pytest.raises(ValueError, match=r"its heading .* is not a number of degrees"):
            degrees(text, "heading")


def test_a_position_is_both_or_none_and_what_looks_wrong_is_said() -> None:
    assert position("47,5", "8° 15' 0\" W") == GeoPoint(47.5, -8.25)
    assert position(None, float("nan")) is None
    assert position(33.5, 70.25, lat_ref="South", lon_ref="W") == GeoPoint(-33.5, -70.25)
    assert position(-33.5, 70.25, lat_ref="S", lon_ref="E") == GeoPoint(-33.5, 70.25)
    for lat, lon, says in (
        ("1", "", "its lon '' is not known, but its lat is"),
        (None, "1", "its lat None is not known, but its lon is"),
        ("139.7", "35.7", "it and longitude 35.7 may be exchanged"),
        ("5262345.1", "478123.2", "are metres on some map, such as UTM"),
    ):
        with pytest.raises(ValueError, match=says):
            position(lat, lon)
    with pytest.raises(PositionError, match=r"longitude 237\.6 is not between"):
        position("47.5", "237.6")


@given(
    st.datetimes(datetime(1900, 1, 1), datetime(2100, 1, 1)),
    st.none() | st.integers(-14 * 60, 14 * 60).map(lambda minutes: timezone(timedelta(minutes=minutes))),
)
def test_times_come_back_in_every_form_that_means_one_thing(moment: datetime, zone: timezone | None) -> None:
    moment = moment.replace(tzinfo=zone)
    assert time(moment) is moment
    offset = "" if zone is None else moment.strftime("%z")
    for form in ("%Y:%m:%d %H:%M:%S.%f", "%Y/%m/%d %H:%M:%S,%f", "%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y, %H:%M:%S.%f"):
        assert time(moment.strftime(form) + offset) == moment
    assert time(moment.isoformat()) == time(moment.isoformat(" ")) == moment
    to_the_minute = moment.replace(second=0, microsecond=0)
    assert time(f"{moment.day}.{moment.month}.{moment.year} {moment.hour}:{moment:%M}{offset}") == to_the_minute


def test_times_that_are_none_and_times_that_may_be_two() -> None:
    assert time("2023:07:14 10:20:30Z") == datetime(2023, 7, 14, 10, 20, 30, tzinfo=UTC)
    assert time("31.5.2024") == datetime(2024, 5, 31)
    for text in ("", "NaT", "0000:00:00 00:00:00", "0000-00-00", "0001:01:01 00:00:00", "-"):
        assert time(text) is None
    for text, says in (
        ("7/14/2023 10:20", "may begin with the day or the month, and is not written as 2024-05-31T14:00:00"),
        ("14-07-23", "may begin with the day or the month"),
        ("45121.43090277778", "counts days or seconds from some day on"),
        ("1689329430", "counts days or seconds"),
        ("2023:13:01 10:00:00", "its time '2023:13:01 10:00:00' is not written as"),
        ("noon" * 9999, r"its time 'noon.*'\.\.\. is not written as"),
    ):
        with pytest.raises(ValueError, match=says):
            time(text)


@given(st.text(max_size=40) | st.integers() | st.floats() | st.none())
def test_nothing_crashes(value: object) -> None:
    for read in (lambda: degrees(value, "lat"), lambda: time(value), lambda: position(value, value)):
        with suppress(ValueError, PositionError):
            assert (read() is None) <= (unknown(value) or isinstance(value, str))


def test_columns_are_called_as_ours_where_one_is_meant() -> None:
    assert columns([" Path", "LAT", "long", "weather"]) == ["path", "lat", "lon", "weather"]
    assert columns(["SourceFile", "FileName", "GPSLatitude"]) == ["path", "filename", "lat"]
    assert columns(["file", "name"]) == ["file", "name"]
    assert columns(["path", "name", "lat", "latitude"]) == ["path", "name", "lat", "latitude"]
    assert columns(["lng", "LNG"]) == ["lon", "lon"]  # told of as two, by whoever needs one
