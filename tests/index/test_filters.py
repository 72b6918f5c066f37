"""Filters against a plain loop over photos."""

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from salad.errors import StoreError
from salad.geo import GeoPoint, metres_between, null_island, shifted
from salad.images.photo import Photo
from salad.index import filter_sql
from salad.index.catalog import Catalog
from salad.index.filter_sql import allowed, compared_by_the_clock
from salad.index.index import Index
from salad.search.filters import Filter

EAST_3 = timezone(timedelta(hours=3))
LONGITUDES = st.sampled_from([-180.0, -179.9999, 0.0, 1e-7, 179.9999, 180.0]) | st.floats(-180, 180)
LATITUDES = st.sampled_from([-90.0, -89.9999, 0.0, 89.9999, 90.0]) | st.floats(-90, 90)
POINTS = st.builds(GeoPoint, LATITUDES, LONGITUDES)
TIMES = st.datetimes(
    datetime(2024, 2, 28),
    datetime(2024, 3, 2),
    timezones=st.sampled_from([None, UTC, EAST_3, timezone(timedelta(hours=-12))]),
)
HEADINGS = st.sampled_from([0.0, 1.0, 90.0, 180.0, 359.0, 360.0]) | st.floats(0, 360)
FACTS = st.tuples(st.none() | POINTS, st.none() | HEADINGS, st.none() | TIMES)


@st.composite
def boxes(draw: st.DrawFn) -> tuple[float, float, float, float]:
    south, north = sorted([draw(LATITUDES), draw(LATITUDES)])
    return south, draw(LONGITUDES), north, draw(LONGITUDES)


@st.composite
def some_filters(draw: st.DrawFn) -> Filter:
    near = draw(st.none() | POINTS)
    within = st.sampled_from([0.0, 25.0, 1e5, 1.5e7, 2.1e7]) | st.floats(0, 2.1e7)
    since, until = draw(st.none() | TIMES), draw(st.none() | TIMES)
    if since and until and not earlier(since, until):
        until = None
    return Filter(
        box=draw(st.none() | boxes()),
        near=near,
        within_m=None if near is None else draw(within),
        since=since,
        until=until,
        heading=draw(st.none() | HEADINGS | st.floats(-720, 720)),
        heading_within=draw(st.sampled_from([0.0, 45.0, 180.0]) | st.floats(0, 180)),
    )


def earlier(one: datetime, other: datetime) -> bool:
    if one.tzinfo and other.tzinfo:
        return one.astimezone(UTC) <= other.astimezone(UTC)
    return one.replace(tzinfo=None) <= other.replace(tzinfo=None)


def passes(wanted: Filter, photo: Photo) -> bool:
    """The same, told plainly."""
    if null_island(photo.where):
        photo = replace(photo, where=None)
    if wanted.box is not None:
        if photo.where is None:
            return False
        south, west, north, east = wanted.box
        lons = {photo.where.lon, *((-180, 180) if abs(photo.where.lon) == 180 else ())}
        if not south <= photo.where.lat <= north:
            return False
        if not any(west <= lon <= east if west <= east else lon >= west or lon <= east for lon in lons):
            return False
    if wanted.near and (photo.where is None or metres_between(photo.where, wanted.near) > wanted.within_m):
        return False
    if wanted.since and (photo.time is None or not earlier(wanted.since, photo.time)):
        return False
    if wanted.until and (photo.time is None or not earlier(photo.time, wanted.until)):
        return False
    if wanted.heading is None:
        return True
    if photo.heading is None:
        return False
    apart = abs(photo.heading - wanted.heading) % 360
    return min(apart, 360 - apart) <= wanted.heading_within


class UndoneError(Exception):
    pass


@contextmanager
def held(photos: list[Photo], table: Catalog) -> Iterator[None]:
    """Photos that are in the table for as long as this lasts; nothing is written to the disk."""
    with suppress(UndoneError), table.writing():
        table.insert(photos, [str(n) for n in range(len(photos))], [0] * len(photos), row=0)
        yield
        raise UndoneError


@pytest.fixture
def empty(tmp_path: Path) -> Iterator[Catalog]:
    Index.create(tmp_path / "i", dim=2, fingerprint="f", model="m").close()
    made = Catalog(tmp_path / "i", wait=1)
    yield made
    made.close()


def rows_of(wanted: Filter, table: Catalog, count: int) -> list[int]:
    return np.flatnonzero(allowed(wanted, table, np.ones(count, bool))).tolist()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(facts=st.lists(FACTS, max_size=12), wanted=st.lists(some_filters(), min_size=1, max_size=6))
def test_a_filter_is_the_plain_loops(empty: Catalog, facts: list[tuple], wanted: list[Filter]) -> None:
    photos = [Photo(Path(f"/p/{n}"), *fact) for n, fact in enumerate(facts)]
    with held(photos, empty):
        for each in wanted:
            plain = [row for row, photo in enumerate(photos) if passes(each, photo)]
            assert rows_of(each, empty, len(photos)) == plain


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(middle=POINTS, within=st.floats(1, 3e6), turns=st.lists(st.floats(0, 7), min_size=1, max_size=8))
def test_a_circle_is_round_near_the_poles_and_across_the_date_line(
    empty: Catalog, middle: GeoPoint, within: float, turns: list[float]
) -> None:
    rim = [
        shifted(middle, share * within * math.cos(turn), share * within * math.sin(turn))
        for turn in turns
        for share in (0.9999, 1.0001)
    ]
    with held([Photo(Path(f"/p/{n}"), point) for n, point in enumerate(rim)], empty):
        assert rows_of(Filter(near=middle, within_m=within), empty, len(rim)) == list(range(0, len(rim), 2))


@pytest.fixture
def table(empty: Catalog) -> Iterator[Catalog]:
    noon = datetime(2024, 5, 1, 12)
    photos = [
        Photo(Path("/p/0"), GeoPoint(-17, 179.5), 350.0, noon),
        Photo(Path("/p/1"), GeoPoint(-17, -179.5), 10.0, noon.replace(tzinfo=UTC)),
        Photo(Path("/p/2"), GeoPoint(-17, 0.0), 180.0, noon.replace(tzinfo=EAST_3)),
        Photo(Path("/p/3")),
    ]
    with held(photos, empty):
        yield empty


@pytest.mark.parametrize(
    ("wanted", "rows"),
    [
        (Filter(), [0, 1, 2, 3]),
        (Filter(box=(-20, 179, -10, -179)), [0, 1]),  # across the date line
        (Filter(box=(-20, -179, -10, 179)), [2]),  # the other way around
        (Filter(heading=0, heading_within=10), [0, 1]),
        (Filter(heading=-180, heading_within=0), [2]),
        (Filter(near=GeoPoint(-17, 180), within_m=60_000), [0, 1]),
        (Filter(since=datetime(2024, 5, 1, 12)), [0, 1, 2]),  # clocks on the wall
        (Filter(since=datetime(2024, 5, 1, 12, tzinfo=UTC)), [0, 1]),  # 12:00+03:00 is 9:00 there
        (Filter(until=datetime(2024, 5, 1, 9, tzinfo=UTC)), [2]),
        (Filter(until=datetime(2024, 5, 1, 14, tzinfo=EAST_3)), [0, 2]),
        (Filter(since=datetime.min, until=datetime.max), [0, 1, 2]),
    ],
)
def test_each_part_by_itself(table: Catalog, wanted: Filter, rows: list[int]) -> None:
    assert rows_of(wanted, table, 4) == rows


def test_only_living_rows_of_the_snapshot_pass(table: Catalog, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(filter_sql, "_PAGE", 2)
    alive = np.array([True, False, True])  # and the ledger has gone on to a fourth
    for wanted in (Filter(), Filter(since=datetime(2024, 1, 1))):
        assert allowed(wanted, table, alive).tolist() == [True, False, True]


def test_facts_that_are_none_pass_nothing(table: Catalog) -> None:
    table.select("UPDATE photos SET time = '2024-05-01T25', lat = 'north', heading = 'up' WHERE row = 0")
    for wanted in (
        Filter(since=datetime(2024, 1, 1)),
        Filter(box=(-90, -180, 90, 180)),
        Filter(near=GeoPoint(0, 0), within_m=2.1e7),
        Filter(heading=0, heading_within=180),
    ):
        assert rows_of(wanted, table, 4) == [1, 2]


def test_a_search_finds_the_best_of_what_passes(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    vectors = rng.standard_normal((50, 8))
    vectors = (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)
    photos = [Photo(Path(f"/p/{n}"), GeoPoint(n % 5, 7)) for n in range(50)]
    with Index.create(tmp_path / "i", dim=8, fingerprint="f", model="m") as index:
        index.add(photos, vectors, identities=[str(n) for n in range(50)])
        every = index.search(vectors, k=50)
        some = index.search(vectors, k=5, where=Filter(box=(2, 0, 3, 10)))
        assert index.search(vectors[:2], where=Filter(heading=0)) == [[], []]
    for best, few in zip(every, some, strict=True):
        assert few == [match for match in best if match.photo.where.lat in (2, 3)][:5]


@pytest.mark.parametrize(
    ("nonsense", "sentence"),
    [
        ({"box": (2, 0, 1, 1)}, "south not above north"),
        ({"box": (0, 0, 1, 181)}, "box .* cannot be"),
        ({"box": (math.nan, 0, 1, 1)}, "box"),
        ({"near": GeoPoint(0, 0)}, "give both, or neither"),
        ({"within_m": 5.0}, "give both, or neither"),
        ({"near": GeoPoint(0, 0), "within_m": -1.0}, r"radius of -1\.0 m"),
        ({"near": GeoPoint(0, 0), "within_m": math.inf}, "radius of inf m"),
        ({"since": datetime(2024, 5, 2), "until": datetime(2024, 5, 1, tzinfo=UTC)}, "exchange"),
        ({"heading": math.nan}, "heading of nan"),
        ({"heading": 1.0, "heading_within": 181.0}, "0 to 180"),
    ],
)
def test_nonsense_is_refused(nonsense: dict, sentence: str) -> None:
    with pytest.raises(StoreError, match=sentence):
        Filter(**nonsense)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(facts=st.lists(FACTS, max_size=12), wanted=some_filters())
def test_times_that_only_clocks_compare_are_counted(empty: Catalog, facts: list[tuple], wanted: Filter) -> None:
    photos = [Photo(Path(f"/p/{n}"), *fact) for n, fact in enumerate(facts)]
    bounds = [bound for bound in (wanted.since, wanted.until) if bound]
    apart = [p for p in photos if p.time and any((p.time.tzinfo is None) != (b.tzinfo is None) for b in bounds)]
    with held(photos, empty):
        assert compared_by_the_clock(wanted, empty) == len(apart)
