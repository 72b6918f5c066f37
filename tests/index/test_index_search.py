"""Searching an index: through any searcher, from many threads and processes, whatever lies damaged in its file."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from salad.errors import StoreError
from salad.geo import GeoPoint, metres
from salad.images.photo import Photo
from salad.index.index import Index, Match
from salad.search.base import Hits, Rows
from salad.search.brute_force import BruteForceSearcher
from salad.search.exact import ExactSearcher
from salad.search.filters import Filter

COUNT, DIM = 3000, 64


def unit(seed: int, rows: int) -> np.ndarray:
    drawn = np.random.default_rng(seed).standard_normal((rows, DIM))
    return (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An index with photos along the equator, an hour and 0.001 degrees apart; some of them were removed."""
    folder = tmp_path_factory.mktemp("i") / "city.index"
    with Index.create(folder, dim=DIM, fingerprint="f", model="m") as index:
        photos = [
            Photo(Path(f"/photos/{row}.jpg"), GeoPoint(0, row / 1000), time=datetime(2024, 1, 1 + row % 28))
            for row in range(COUNT)
        ]
        index.add(photos, unit(1, COUNT), identities=[f"{row:032x}" for row in range(COUNT)])
        index.remove([photo.path for photo in photos[::7]])
    return folder


@pytest.fixture
def index(folder: Path) -> Iterator[Index]:
    with Index.open(folder) as index:
        yield index


def numbers(found: list[list[Match]]) -> list[list[tuple[str, float, int]]]:
    return [[(match.photo.path.name, match.score, match.row) for match in best] for best in found]


ASKED: list[dict[str, Any]] = [
    {"descriptors": unit(10 + number, 1 + number % 5), "k": 1 + number % 9, "centred": bool(number % 2)}
    for number in range(16)
] + [{"descriptors": unit(50, 3), "k": 4, "where": Filter(box=(-1, 0.2, 1, 0.9), since=datetime(2024, 1, 9))}]


@pytest.mark.parametrize("asked", ASKED)
def test_any_searcher_may_stand_in_for_the_exact_one(folder: Path, index: Index, asked: dict[str, Any]) -> None:
    with Index.open(folder, searcher=BruteForceSearcher) as plain:
        assert numbers(plain.search(**asked)) == numbers(index.search(**asked))


def test_threads_that_search_at_once_get_the_answers_of_one(index: Index) -> None:
    alone = [numbers(index.search(**asked)) for asked in ASKED]
    with ThreadPoolExecutor(8) as team:
        together = list(team.map(lambda asked: numbers(index.search(**asked)), ASKED * 8))
    assert together == alone * 8


SEARCHING = """
import json, sys
import numpy as np
from salad.index.index import Index
with Index.open(sys.argv[1]) as index:
    sys.stdin.readline()  # so that all begin at once
    for _ in range(5):
        found = index.search(np.load(sys.argv[2]), k=6, centred=True)
    assert "torch" not in sys.modules
    print(json.dumps([[(m.photo.path.name, m.score, m.row) for m in best] for best in found]))
"""


def test_processes_that_search_at_once_get_the_answers_of_one(folder: Path, index: Index, tmp_path: Path) -> None:
    queries = tmp_path / "q.npy"
    np.save(queries, unit(60, 9))
    command = [sys.executable, "-c", SEARCHING, str(folder), str(queries)]
    running = [subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(4)]
    for process in running:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    said = [json.loads(process.communicate(timeout=60)[0]) for process in running]
    alone = numbers(index.search(np.load(queries), k=6, centred=True))
    assert [[[tuple(match) for match in best] for best in found] for found in said] == [alone] * 4


def test_the_mean_is_of_what_is_alive_whatever_a_filter_lets_through(index: Index) -> None:
    every = {match.row: match.score for match in index.search(unit(2, 1), k=COUNT, centred=True)[0]}
    (some,) = index.search(unit(2, 1), k=COUNT, centred=True, where=Filter(box=(-1, 1, 1, 2)))
    assert {match.row: match.score for match in some} == {row: every[row] for row in range(1000, 2001) if row % 7}


class Placed(ExactSearcher):
    """As a database of vectors would: it knows where its rows were taken, and works filters out by itself."""

    takes_filters = True
    given: list[object] = []  # noqa: RUF012  # a test empties it

    def __init__(self, rows: Rows) -> None:
        super().__init__(rows)
        self.lon = np.arange(len(rows)) / 1000

    def search(self, queries: np.ndarray, *, k: int, allowed: Any = None) -> Hits:
        self.given.append(allowed)
        if isinstance(allowed, Filter):
            assert allowed.near is not None
            assert allowed.within_m is not None
            allowed = metres(allowed.near.lat, allowed.near.lon, 0 * self.lon, self.lon) <= allowed.within_m
        return super().search(queries, k=k, allowed=allowed)


def test_a_searcher_that_takes_filters_is_given_them(folder: Path, index: Index) -> None:
    where = Filter(near=GeoPoint(0, 1.5), within_m=3000)
    Placed.given.clear()
    with Index.open(folder, searcher=Placed) as placed:
        (found,) = placed.search(unit(3, 1), k=60, where=where)
        assert numbers([found]) == numbers(index.search(unit(3, 1), k=60, where=where))  # removed ones are out
        placed.search(unit(3, 1))
    assert Placed.given[0] is where
    assert isinstance(Placed.given[1], np.ndarray)


def test_queries_are_checked(index: Index) -> None:
    assert len(index.search(np.ones(DIM), k=2)) == 1
    for wrong in (np.ones(DIM - 1), np.ones((2, DIM + 1)), np.ones((1, 2, DIM))):
        with pytest.raises(StoreError, match=f"index holds descriptors of {DIM} numbers"):
            index.search(wrong)
    for bad in (np.nan, np.inf, 1e300):  # the last is infinite in float32
        with pytest.raises(StoreError, match="NaN or infinity"):
            index.search(np.array([bad, *[0] * (DIM - 1)]))
    with pytest.raises(StoreError, match="k is 0"):
        index.search(np.ones(DIM), k=0)


def test_what_was_swept_twice_stays_in_memory(tmp_path: Path) -> None:
    with Index.create(tmp_path / "i", dim=DIM, fingerprint="f", model="m") as index:
        index.add(
            [Photo(Path(f"/{n}")) for n in range(300)],
            unit(4, 300),
            identities=[f"{n:032x}" for n in range(300)],
        )
        alone = [numbers(index.search(unit(5, 2))) for _ in range(2)]
        (tmp_path / "i" / "descriptors.f16").write_bytes(b"")
        assert [numbers(index.search(unit(5, 2))), *alone] == [alone[0]] * 3
