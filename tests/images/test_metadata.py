"""Whose word counts of where, which way and when a photo was taken."""

from __future__ import annotations

from datetime import datetime
from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.geo import GeoPoint, null_island
from salad.images.metadata import SOURCES, Position, settled

NOON = datetime(2024, 5, 31, 12)


@given(st.permutations(SOURCES), st.integers(0, len(SOURCES) - 1))
def test_the_first_that_knows_wins_in_whatever_order_they_are_asked(order: list[str], silent: int) -> None:
    said = [
        Position(GeoPoint(SOURCES.index(source), 10) if SOURCES.index(source) >= silent else None, source=source)
        for source in order
    ]
    known = settled(said)
    assert known.where == GeoPoint(silent, 10)
    assert known.source == SOURCES[silent]


def test_position_heading_and_time_may_come_from_different_sources() -> None:
    said = [
        Position(None, None, NOON, "takeout"),
        Position(GeoPoint(1, 2), None, None, "exif"),
        Position(GeoPoint(3, 4), 90.0, None, "xmp"),
    ]
    for order in permutations(said):
        assert settled(order) == Position(GeoPoint(1, 2), 90.0, NOON)
        assert settled(order).source == "exif"


@pytest.mark.parametrize("source", SOURCES)
def test_null_island_is_no_position_whoever_says_it_and_is_named(source: str) -> None:
    alone = settled([Position(GeoPoint(0.0, -0.0), 12.0, NOON, source)])
    assert alone == Position(None, 12.0, NOON)
    assert alone.source is None
    assert "0,0" in alone.remark
    if source != SOURCES[-1]:
        after = settled([Position(GeoPoint(0, 0), source=source), Position(GeoPoint(1, 2), source=SOURCES[-1])])
        assert (after.where, after.source) == (GeoPoint(1, 2), SOURCES[-1])
        assert "0,0" in after.remark


def test_remarks_end_with_the_source_that_counts() -> None:
    said = [
        Position(None, source="sidecar", remark="first"),
        Position(GeoPoint(1, 2), source="exif", remark="second"),
        Position(None, source="xmp", remark="third"),
    ]
    assert settled(said).remark == "first; second"
    assert settled([Position(source="name"), Position(source="exif")]).remark == ""


@pytest.mark.parametrize(
    ("where", "is_one"),
    [
        (None, False),
        (GeoPoint(0, 0), True),
        (GeoPoint(-0.0, 0.0), True),
        (GeoPoint(0, 32.5), False),
        (GeoPoint(51.48, 0), False),
        (GeoPoint(1e-9, 0), False),
    ],
)
def test_null_island_is_exactly_that(where: GeoPoint | None, is_one: bool) -> None:
    assert null_island(where) is is_one
