"""Times as cameras and programs write them."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.images.times import parse_offset, parse_time

MOMENT = datetime(2023, 7, 14, 10, 20, 30)
moments = st.datetimes(datetime(1826, 1, 1), datetime(9999, 12, 31))
zones = st.none() | st.integers(-56, 56).map(lambda quarters: timezone(timedelta(minutes=15 * quarters)))


@given(moments, zones, st.sampled_from("-:/."), st.sampled_from(" T_"), st.sampled_from(":."))
def test_every_separator_that_is_met(
    moment: datetime, zone: timezone | None, day: str, between: str, clock: str
) -> None:
    moment = moment.replace(microsecond=0)
    text = moment.strftime(f"%m{day}%d{between}%H{clock}%M{clock}%S")
    offset = "" if zone is None else datetime(2000, 1, 1, tzinfo=zone).isoformat()[-6:]
    assert parse_time(f"{moment.year}{day}{text}{offset}") == moment.replace(tzinfo=zone)
    assert parse_time(f"{moment.year}{day}{text}", offset=offset) == moment.replace(tzinfo=zone)


@given(moments, zones)
def test_what_python_writes(moment: datetime, zone: timezone | None) -> None:
    written = moment.replace(tzinfo=zone)
    assert parse_time(written.isoformat()) == written


@pytest.mark.parametrize(
    ("text", "time"),
    [
        ("2023:07:14 10:20:30\0\0junk", MOMENT),
        (" 2023: 7:14 10:20:30 ", MOMENT),
        ("20230714 102030", MOMENT),
        ("2023:07:14:10:20:30", MOMENT),
        ("2023-07-14T10:20", MOMENT.replace(second=0)),
        ("2023:07:14", MOMENT.replace(hour=0, minute=0, second=0)),
        ("2023-07-14T10:20:30,25", MOMENT.replace(microsecond=250000)),
        ("2023-07-14T10:20:30.123456789Z", MOMENT.replace(microsecond=123456, tzinfo=UTC)),
        ("2023:07:14 10:20:30 UTC", MOMENT.replace(tzinfo=UTC)),
        ("2023:07:14 10:20:30+1200", MOMENT.replace(tzinfo=timezone(timedelta(hours=12)))),
        ("2023:07:14 10:20:30-24:00", MOMENT),  # no clock shows that
        ("0000:00:00 00:00:00", None),
        ("0001:01:01 00:00:00", None),
        ("    :  :     :  :  ", None),
        ("2023:13:14 10:20:30", None),
        ("2023:02:30 10:20:30", None),
        ("2023:07:14 25:20:30", None),
        ("2023", None),
        ("٢٠٢٣:07:14 10:20:30", None),
        ("yesterday", None),
        ("", None),
        ("2023:07:14" + " " * 100, None),
    ],
)
def test_times(text: str, time: datetime | None) -> None:
    told = parse_time(text)
    assert told == time
    assert told is None or told.utcoffset() == (time and time.utcoffset())


def test_what_stands_elsewhere_comes_after_what_stands_in_the_text() -> None:
    text = "2023:07:14 10:20:30.5Z"
    assert parse_time(text, offset="+02:00", fraction="25") == MOMENT.replace(microsecond=500000, tzinfo=UTC)
    assert parse_time("2023:07:14 10:20:30", fraction="25 ") == MOMENT.replace(microsecond=250000)
    assert parse_time("2023:07:14 10:20:30", offset="   :  ", fraction="x") == MOMENT


@given(st.text(max_size=70) | st.text("0123456789:-+. TZ/", max_size=70), st.text(max_size=9), st.text(max_size=9))
def test_no_text_crashes(text: str, offset: str, fraction: str) -> None:
    told = parse_time(text, offset=offset, fraction=fraction)
    assert told is None or told.year >= 1826
    parse_offset(text)
