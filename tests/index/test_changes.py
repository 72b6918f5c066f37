"""What an index says otherwise of photos it holds, counted."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from salad.geo import GeoPoint
from salad.images.photo import Photo
from salad.index.changes import Changes
from salad.index.facts import AT_NULL_ISLAND

PHOTO = Photo(Path("/photos/a.jpg"), GeoPoint(47.1, 8.1), 90.0, datetime(2024, 5, 31, 14))


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        (
            PHOTO,
            replace(PHOTO, where=GeoPoint(47.2, 8.2)),
            "1 position changed; the first: a.jpg, 47.1,8.1 -> 47.2,8.2",
        ),
        (PHOTO, replace(PHOTO, heading=0.0), "1 heading changed; the first: a.jpg, 90 -> 0"),
        (replace(PHOTO, heading=None), PHOTO, "1 heading changed; the first: a.jpg, none -> 90"),
        (
            PHOTO,
            replace(PHOTO, time=datetime(2024, 5, 31, 14, tzinfo=UTC)),
            "1 time changed; the first: a.jpg, 2024-05-31T14:00:00 -> 2024-05-31T14:00:00+00:00",
        ),
        (
            replace(PHOTO, where=None, time=None),
            PHOTO,
            "1 position, 1 time changed; the first: a.jpg, none -> 47.1,8.1",
        ),
        (
            replace(PHOTO, where=None, remark=AT_NULL_ISLAND),
            replace(PHOTO, where=None),
            "1 position changed; the first: a.jpg, 0,0 -> none",
        ),
        (PHOTO, PHOTO, ""),
        (PHOTO, replace(PHOTO, path=Path("/else/b.jpg"), source="exif", remark="its altitude makes no sense"), ""),
        (PHOTO, replace(PHOTO, where=GeoPoint(47.1 + 1e-14, 8.1), heading=90.0 + 1e-12), ""),
    ],
)
def test_what_is_new_of_a_photo(before: Photo, after: Photo, says: str) -> None:
    changes = Changes()
    assert changes.note(before, after) == bool(says)
    assert str(changes) == says


def test_many_are_counted_and_the_first_is_told() -> None:
    changes = Changes()
    for number in range(1200):
        moved = replace(PHOTO, path=Path(f"/photos/{number}.jpg"), where=GeoPoint(10.5, number / 10))
        changes.note(PHOTO, moved if number % 2 else replace(moved, heading=1.5))
    assert str(changes) == "1,200 positions, 600 headings changed; the first: 0.jpg, 47.1,8.1 -> 10.5,0"
