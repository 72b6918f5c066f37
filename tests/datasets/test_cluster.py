"""Places from geotagged photos: together what shows the same, apart what does not, and every photo accounted for."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.datasets.cluster import Clustering, find_cells
from salad.datasets.neighbours import squares
from salad.errors import BenchmarkError
from salad.geo import GeoPoint, centre, in_degrees, metres_between, shifted, to_utm
from salad.images.photo import Photo

HOME = GeoPoint(48.1, 11.5)


def middle_of_a_square(near: GeoPoint, side: float = 10.0) -> GeoPoint:
    """A point whose surroundings of some metres are one square."""
    around = [shifted(near, north, east) for north in range(-8, 9) for east in range(-8, 9)]
    rows, columns = squares(in_degrees(around), side)
    homes = list(zip(rows.tolist(), columns.tolist(), strict=True))
    ((most, _),) = Counter(homes).most_common(1)
    own = [point for point, home in zip(around, homes, strict=True) if home == most]
    return centre(own)


def spot(name: str, where: GeoPoint, *headings: float | None) -> list[Photo]:
    """A photo for each heading, all within two metres."""
    return [
        Photo(Path(f"{name}{number}.jpg"), shifted(where, number % 3 - 1.0, 1.0 - number % 2), heading)
        for number, heading in enumerate(headings)
    ]


def names(found: Clustering) -> list[set[str]]:
    return [{photo.path.name[0] for photo in place.photos} for place in found.places]


def test_photos_of_one_spot_and_view_are_a_place() -> None:
    here = middle_of_a_square(HOME)
    there = middle_of_a_square(shifted(HOME, 500, 0))
    photos = spot("a", here, *[None] * 5) + spot("b", there, *[None] * 4) + spot("c", shifted(here, 900, 0), None, None)
    found = find_cells(photos)
    assert names(found) == [{"a"}, {"b"}]
    assert found.as_dict() == {
        "photos": 11,
        "used": 9,
        "places": 2,
        "cities": 1,
        "left_out": {
            "no position": 0,
            "unreadable": 0,
            "too few in their cell": 2,
            "too near another place": 0,
        },
    }
    assert metres_between(found.places[0].where, here) < 2
    assert found.places[0].name.startswith("48.1")
    assert found.places[0].name.endswith("_any")
    assert found.places[0].place.photos == tuple(photo.path for photo in found.places[0].photos)


def test_looking_another_way_is_another_place() -> None:
    here = middle_of_a_square(HOME)
    photos = (
        spot("n", here, 350, 0, 10, 22)
        + spot("e", here, 80, 90, 100, 110)
        + spot("u", here, None, None, None, None)
        + spot("s", here, 180, 181, 182)
    )
    found = find_cells(photos, apart_m=0)
    assert sorted(map(sorted, names(found))) == [["e"], ["n"], ["u"]]
    assert {place.name[-3:] for place in found.places} == {"000", "090", "any"}
    assert len(found.left_out["too few in their cell"]) == 3
    assert len(find_cells(photos, turn=360).places) == 1


def test_where_places_crowd_those_with_more_photos_stay() -> None:
    line = [middle_of_a_square(shifted(HOME, 0, 60.0 * number)) for number in range(4)]
    photos = [
        photo
        for name, where, count in zip("abcd", line, (4, 6, 5, 4), strict=True)
        for photo in spot(name, where, *[None] * count)
    ]
    found = find_cells(photos)
    assert names(found) == [{"b"}, {"d"}]  # a and c lie 60 m from b
    assert len(found.left_out["too near another place"]) == 9
    assert len(find_cells(photos, apart_m=0).places) == 4


@pytest.mark.parametrize(
    "home", [GeoPoint(48.1, 12.0), GeoPoint(-17.0, 180.0), GeoPoint(0.0, 6.0), GeoPoint(73.0, 9.0)]
)
def test_at_a_zones_edge_places_are_as_anywhere(home: GeoPoint) -> None:
    """A street along which every 12 m four photos were taken gives one place in each 100 m or so."""
    photos = [
        photo
        for number in range(-30, 31)
        for photo in spot(f"{number:+03d}", middle_of_a_square(shifted(home, 0, 12.0 * number)), *[None] * 4)
    ]
    zones = {to_utm(photo.where).zone for photo in photos if photo.where}
    assert len(zones) == 2
    found = find_cells(photos)
    assert 3 <= len(found.places) <= 8
    assert len({place.city for place in found.places}) == 1
    for one, other in itertools.combinations(found.places, 2):
        assert metres_between(one.where, other.where) >= 100


def test_photos_of_a_place_stand_oldest_first() -> None:
    start = datetime(2020, 1, 1, 12)
    times = [start + timedelta(days=3), None, start, start.replace(tzinfo=UTC) + timedelta(days=1)]
    here = middle_of_a_square(HOME)
    photos = [Photo(Path(f"{number}.jpg"), here, None, time) for number, time in enumerate(times)]
    (place,) = find_cells(photos).places
    assert [photo.path.name for photo in place.photos] == ["1.jpg", "2.jpg", "3.jpg", "0.jpg"]


def test_unreadable_photos_are_left_out_before_anybody_counts() -> None:
    here, there = middle_of_a_square(HOME), middle_of_a_square(shifted(HOME, 300, 0))
    photos = spot("a", here, *[None] * 4) + spot("b", there, *[None] * 6) + [Photo(Path("x.jpg"))]
    asked: list[Path] = []

    def unreadable(paths: Sequence[Path]) -> dict[Path, str]:
        asked.extend(paths)
        return {path: f"{path} is broken" for path in paths if path.name in ("a0.jpg", "b3.jpg")}

    found = find_cells(photos, unreadable=unreadable)
    assert names(found) == [{"b"}]
    assert {reason: len(paths) for reason, paths in found.left_out.items()} == {
        "no position": 1,
        "unreadable": 2,
        "too few in their cell": 3,
        "too near another place": 0,
    }
    assert found.trouble == ("a0.jpg is broken", "b3.jpg is broken")
    assert Path("x.jpg") not in asked


def test_cities_are_what_hangs_together() -> None:
    town = [middle_of_a_square(shifted(HOME, 8000.0 * step, 0)) for step in range(5)]
    far = middle_of_a_square(shifted(HOME, 0, 90_000))
    photos = [photo for number, where in enumerate([*town, far]) for photo in spot(f"{number}", where, *[None] * 4)]
    found = find_cells(photos)
    cities = Counter(place.city for place in found.places)
    assert sorted(cities.values()) == [1, 5]


def test_no_photos_make_no_places() -> None:
    assert find_cells([]).as_dict()["photos"] == 0
    assert find_cells([Photo(Path("a.jpg"))]).left_out["no position"] == (Path("a.jpg"),)


@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(
            st.floats(-150, 150),
            st.floats(-150, 150),
            st.one_of(st.none(), st.floats(0, 359.9)),
            st.booleans(),
        ),
        max_size=60,
    ),
    st.sampled_from([HOME, GeoPoint(48.1, 12.0), GeoPoint(-17.0, 180.0)]),
    st.sampled_from([10.0, 40.0]),
    st.sampled_from([45.0, 90.0, 360.0]),
    st.sampled_from([0.0, 30.0, 100.0]),
)
def test_every_photo_is_in_one_place_or_left_out_for_one_reason(
    taken: list[tuple[float, float, float | None, bool]],
    home: GeoPoint,
    side_m: float,
    turn: float,
    apart_m: float,
) -> None:
    photos = [
        Photo(Path(f"{number}.jpg"), shifted(home, north, east) if known else None, heading)
        for number, (north, east, heading, known) in enumerate(taken)
    ]
    found = find_cells(photos, side_m=side_m, turn=turn, apart_m=apart_m)
    used = [photo for place in found.places for photo in place.photos]
    left = list(itertools.chain.from_iterable(found.left_out.values()))
    assert Counter([*(photo.path for photo in used), *left]) == Counter(photo.path for photo in photos)
    for place in found.places:
        assert len(place.photos) >= 4
        for one, other in itertools.combinations(place.photos, 2):
            assert one.where
            assert other.where
            assert metres_between(one.where, other.where) <= 1.42 * side_m
            if turn < 360:
                assert (one.heading is None) == (other.heading is None)
            if turn < 360 and one.heading is not None and other.heading is not None:
                assert abs((one.heading - other.heading + 180) % 360 - 180) <= turn + 1e-9
    for one, other in itertools.combinations(found.places, 2):
        assert metres_between(one.where, other.where) >= apart_m
    backwards = find_cells(photos[::-1], side_m=side_m, turn=turn, apart_m=apart_m)
    assert backwards.places == found.places


@pytest.mark.parametrize(
    "wrong",
    [{"side_m": 0}, {"side_m": float("nan")}, {"turn": 0}, {"turn": 361}, {"fewest": 3}, {"apart_m": -1}],
)
def test_numbers_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BenchmarkError, match="makes no sense for"):
        find_cells([], **wrong)
