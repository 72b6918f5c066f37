"""Places by their cities, times that know their zone beside times that do not, and photos that are missing."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest

from salad.datasets.training_place import PlaceRow, TrainingPlace, by_city, clock, places_of
from salad.errors import BenchmarkError


def test_cities_in_the_order_they_come() -> None:
    places = [TrainingPlace(str(number), city, ()) for number, city in enumerate("baab")]
    assert by_city(places) == {"b": [0, 3], "a": [1, 2]}
    assert list(by_city(places)) == ["b", "a"]
    assert by_city([]) == {}


def test_clocks_sort_whether_they_know_their_zone_or_not() -> None:
    noon = datetime(2020, 5, 1, 12)
    east = timezone(timedelta(hours=9))
    times = [noon.replace(tzinfo=UTC, hour=13), noon, None, noon.replace(tzinfo=east, hour=11)]
    assert [time and time.hour for time in sorted(times, key=clock)] == [None, 11, 12, 13]


def test_what_is_missing_is_one_sentence(tmp_path: Path) -> None:
    table, gone = tmp_path / "places.csv", [tmp_path / "in" / name for name in ("a.jpg", "b.jpg", "c.jpg")]
    rows = [PlaceRow(path, False, "city", "place", None, 0) for path in gone]
    heard: list[str] = []
    assert places_of(table, [], None) == []
    assert places_of(table, rows[:1], heard.append) == []
    assert places_of(table, rows, heard.append) == []
    assert [sentence.removeprefix(f"{table} names a.jpg, which is not in {gone[0].parent}") for sentence in heard] == [
        ": left out",
        " (nor are 2 more): left out",
    ]
    with pytest.raises(BenchmarkError, match=r"a\.jpg, which is not in .* 2 more\): fetch what is missing"):
        places_of(table, rows, None)
