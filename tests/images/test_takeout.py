"""The JSON of Google Takeout: what it is called, and what it says."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.geo import GeoPoint
from salad.images.metadata import Position
from salad.images.takeout import parse_takeout, takeout_names

HERE = {"latitude": -36.8, "longitude": 174.75, "altitude": 12.0}
NOWHERE = {"latitude": 0.0, "longitude": 0.0}


@pytest.mark.parametrize(
    ("photo", "beside"),
    [
        ("a.jpg", "a.jpg.json"),
        ("a.jpg", "a.jpg.supplemental-metadata.json"),
        ("a(1).jpg", "a.jpg(1).json"),
        ("a(1).jpg", "a(1).jpg.json"),  # where the photo was called so before
        ("a(1).jpg", "a.jpg.supplemental-metadata(1).json"),
        ("a-edited.jpg", "a.jpg.json"),
        ("PXL_20230714_102030123.PORTRAIT.jpg", "PXL_20230714_102030123.PORTRAIT.jpg.supplement.json"),
        (f"{'x' * 47}.jpg", f"{'x' * 46}.json"),
        (f"{'x' * 44}.jpg", f"{'x' * 44}.j.json"),
        (f"{'x' * 44}(2).jpg", f"{'x' * 44}.j(2).json"),
    ],
)
def test_what_it_may_be_called(photo: str, beside: str) -> None:
    assert beside in takeout_names(photo)


@given(st.text(min_size=1, max_size=80))
def test_names_are_bounded_and_each_there_once(name: str) -> None:
    names = takeout_names(name)
    assert len(set(names)) == len(names)
    assert all(len(one) <= 46 + len("(12345).json") and one.endswith(".json") for one in names)


def said(**held: Any) -> Position | None:
    return parse_takeout(json.dumps(held).encode(), "a.jpg")


def test_where_and_when() -> None:
    told = said(title="a.jpg", photoTakenTime={"timestamp": "1689286830"}, geoData=HERE, geoDataExif=NOWHERE)
    assert told == Position(GeoPoint(-36.8, 174.75), None, datetime(2023, 7, 13, 22, 20, 30, tzinfo=UTC))
    assert told.source == "takeout"


def test_the_albums_position_comes_before_the_photos_own_and_0_0_is_none_of_them() -> None:
    for album, photo, where in (
        (HERE, {"latitude": 1, "longitude": 2}, GeoPoint(-36.8, 174.75)),
        (NOWHERE, HERE, GeoPoint(-36.8, 174.75)),
        (NOWHERE, NOWHERE, GeoPoint(0, 0)),  # which `settled` names
        (None, None, None),
        ({"latitude": 99, "longitude": 0}, "there", None),
        ({"latitude": "x", "longitude": None}, [], None),
    ):
        told = said(geoData=album, geoDataExif=photo)
        assert told is not None
        assert told.where == where


@pytest.mark.parametrize("timestamp", ["0", "", "soon", None, [], "1e999", "nan", 1e300])
def test_times_that_are_none(timestamp: Any) -> None:
    assert said(photoTakenTime={"timestamp": timestamp}) == Position()


@pytest.mark.parametrize(
    ("name", "title", "same"),
    [
        ("a.jpg", "a.jpg", True),
        ("a(1).jpg", "a.jpg", True),
        ("a-edited.jpg", "a.jpg", True),
        ("a_b.jpg", "a&b.jpg", True),
        ("a.jpg", "a.heic", True),
        ("x" * 47 + ".jpg", "x" * 60 + ".jpg", True),
        ("x" * 46 + "y.jpg", "x" * 46 + "z.jpg", False),
        ("a.jpg", "b.jpg", False),
        ("a.jpg", "ab.jpg", False),
    ],
)
def test_a_title_tells_photos_apart_whose_names_were_cut(name: str, title: str, same: bool) -> None:
    data = json.dumps({"title": title, "geoData": HERE}).encode()
    assert (parse_takeout(data, name) is not None) == same


@pytest.mark.parametrize("data", [b"[]", b"{}", b"1", b'{"geo": 1}', b'{"title": "a.jpg"}'])
def test_other_json_says_nothing(data: bytes) -> None:
    assert parse_takeout(data, "a.jpg") is None


@pytest.mark.parametrize("data", [b"", b"{", b"\xff\xfe", b"[" * 100_000])
def test_what_is_no_json_is_said(data: bytes) -> None:
    told = parse_takeout(data, "a.jpg")
    assert told == Position()
    assert told.remark == "the JSON beside it cannot be read"
