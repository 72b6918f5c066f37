"""Sequences kept in flat arrays behave as sequences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from salad.datasets.benchmark import Benchmark
from salad.datasets.compact_lists import PhotoList, Ragged, Strings, headings, positions
from salad.errors import BenchmarkError
from salad.geo import GeoPoint
from salad.images.photo import Photo


def test_ragged_is_a_sequence_of_arrays() -> None:
    held = Ragged.of([np.array([3, 4]), np.array([], dtype=np.int64), np.array([5])])
    assert [rows.tolist() for rows in held] == [[3, 4], [], [5]]
    assert held[-1].tolist() == [5]
    assert [rows.tolist() for rows in held[1:]] == [[], [5]]
    assert held.lengths.tolist() == [2, 0, 1]
    with pytest.raises(IndexError):
        held[3]
    assert len(Ragged.of([])) == 0


def test_photos_as_they_are_asked_for() -> None:
    where = np.array([[41.0, 2.0], [np.nan, np.nan]])
    photos = PhotoList(Path("d"), ["a.jpg", "ü b/ñ.jpg"], where=where, headings=np.array([np.nan, 90.0]))
    assert list(photos) == [
        Photo(Path("d/a.jpg"), GeoPoint(41.0, 2.0)),
        Photo(Path("d/ü b/ñ.jpg"), heading=90.0),
    ]
    assert photos[-1] == photos[1]
    assert photos[:1] == [photos[0]]
    assert [photo.path.name for photo in photos.subset(np.array([1, 0]))] == ["ñ.jpg", "a.jpg"]
    for given in (photos, list(photos)):
        assert np.array_equal(positions(given), where, equal_nan=True)
        assert np.array_equal(headings(given), np.array([np.nan, 90.0]), equal_nan=True)
    assert positions([]).shape == (0, 2)


def test_strings() -> None:
    texts = ["", "a", "名前", "\udcff"]
    assert list(Strings(texts)) == texts
    assert len(Strings([])) == 0


def test_a_benchmark_checks_its_groups() -> None:
    photos = PhotoList(Path("d"), ["a.jpg"])
    with pytest.raises(BenchmarkError, match="groups for 2"):
        Benchmark("n", "p", photos, photos, [np.array([0])], groups=("a", "b"))
