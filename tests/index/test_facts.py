"""What an index knows of a photo: who says where it was, what news may change, and that 0,0 is nowhere."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.geo import GeoPoint, null_island
from salad.images.metadata import SOURCES
from salad.images.photo import Photo
from salad.index.facts import AT_NULL_ISLAND, with_news
from salad.index.index import Index
from salad.search.filters import Filter
from tests.earlier_indexes import as_format_1, change_row

POINTS = st.builds(GeoPoint, st.sampled_from([0.0, 1.0, -47.5]), st.sampled_from([7.0, 8.7, -180.0]))
TIMES = st.datetimes(datetime(2024, 1, 1), datetime(2024, 1, 3))


@st.composite
def some_photos(draw: st.DrawFn, name: str) -> Photo:
    where = draw(st.none() | POINTS)
    source = draw(st.none() | st.sampled_from(SOURCES)) if where else None
    return Photo(Path(name), where, draw(st.none() | st.floats(0, 360)), draw(st.none() | TIMES), source)


@given(held=some_photos("held.jpg"), news=some_photos("news.jpg"))
def test_news_count_but_for_what_a_table_or_a_correction_says(held: Photo, news: Photo) -> None:
    known = with_news(held, news)
    assert known.path == news.path
    assert (known.where is None) == (held.where is None and news.where is None)  # nothing is taken away
    stays = held.source == "correction" and news.source != "correction"
    stays |= held.source == "table" and news.source not in ("correction", "table")
    first, second = (held, news) if stays else (news, held)
    wanted = first if first.where else second
    assert (known.where, known.source) == (wanted.where, wanted.source)
    assert known.heading == (second.heading if first.heading is None else first.heading)
    assert known.time == (first.time or second.time)
    assert with_news(known, known) == known
    assert with_news(known, Photo(news.path)) == known


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An index of three photos: on null island, on the equator, on Greenwich's meridian."""
    home = tmp_path / "i"
    with Index.create(home, dim=4, fingerprint="f", model="m") as index:
        places = [GeoPoint(7, 7), GeoPoint(0, 32.5), GeoPoint(51.48, 0)]
        photos = [Photo(Path(f"/p/{n}.jpg"), where, 10.0, source="exif") for n, where in enumerate(places)]
        index.add(photos, np.eye(3, 4, dtype=np.float32), identities=list("abc"))
    change_row(home, 0, checksum=True, lat=0.0, lon=0.0)
    return home


def test_sources_come_back(folder: Path) -> None:
    with Index.open(folder) as index:
        assert [photo.source for photo in index.photos()] == [None, "exif", "exif"]
        index.update([Photo(Path("/p/1.jpg"), GeoPoint(1, 1), source="table")], ["b"])
        index.update([Photo(Path("/p/1.jpg"), GeoPoint(2, 2), source="xmp")], ["b"])
        assert [photo.source for photo in index.photos()] == [None, "table", "exif"]
        assert index.find(["b"])["b"].where == GeoPoint(1, 1)
        index.compact()
        assert index.find(["b"])["b"].source == "table"
        assert index.verify() == []


@pytest.mark.parametrize("form", [1, 2])
def test_a_row_at_null_island_knows_no_position(folder: Path, form: int) -> None:
    """Of an index that an earlier version wrote, too; one axis alone may well be zero."""
    if form == 1:
        as_format_1(folder)
    with Index.open(folder) as index:
        zero, equator, greenwich = index.photos()
        assert (zero.where, zero.remark, zero.heading) == (None, AT_NULL_ISLAND, 10.0)
        assert (equator.where, greenwich.where) == (GeoPoint(0, 32.5), GeoPoint(51.48, 0))
        assert (index.info().with_position, index.at_null_island()) == (2, 1)
        assert index.info().box == (0.0, 0.0, 51.48, 32.5)
        assert index.search(np.eye(1, 4), k=1)[0][0].photo.where is None
        for where in (Filter(near=GeoPoint(0, 0), within_m=1e5), Filter(box=(-1.0, -1.0, 1.0, 1.0))):
            assert index.search(np.eye(1, 4), k=3, where=where) == [[]]
        assert index.verify() == []


def test_a_row_at_null_island_is_mended_by_the_next_change(folder: Path) -> None:
    with Index.open(folder) as index:
        index.update([Photo(Path("/p/0.jpg"))], ["a"])
        assert (index.find(["a"])["a"].remark, index.at_null_island()) == ("", 0)
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db:
        assert db.execute("SELECT lat, lon, source FROM photos WHERE row = 0").fetchall() == [(None, None, None)]


@pytest.mark.parametrize("source", ["of a later salad", "", 7, b"exif", "x" * 100_000])
def test_a_source_that_is_none_is_not_told_and_harms_nothing(folder: Path, source: object) -> None:
    change_row(folder, 1, checksum=True, source=source)
    with Index.open(folder) as index:
        known = index.find(["b"])["b"]
        assert (known.where, known.source) == (GeoPoint(0, 32.5), None)
        index.update([replace(known, heading=20.0)], ["b"])
        assert index.verify() == []


def test_null_island_is_exactly_there() -> None:
    assert null_island(GeoPoint(-0.0, 0.0))
    assert not null_island(GeoPoint(1e-300, 0.0))
