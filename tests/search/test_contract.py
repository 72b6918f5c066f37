"""What every searcher promises, whatever engine it is: one more is held to it by one more line in `SEARCHERS`."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np
import pytest

from salad.errors import SearchError
from salad.geo import GeoPoint
from salad.index.vectors import FileRows
from salad.search.base import LONGEST_UNIT, ArrayRows, Hits, Searcher
from salad.search.brute_force import BruteForceSearcher
from salad.search.compressed import CompressedSearcher
from salad.search.exact import ExactSearcher
from salad.search.filters import Filter

Make = Callable[[np.ndarray], Searcher]


def _half(rows: np.ndarray) -> ArrayRows:
    return ArrayRows(np.float16(rows), longest=LONGEST_UNIT)


def _single(rows: np.ndarray) -> ArrayRows:
    return ArrayRows(np.float32(np.float16(rows)), longest=LONGEST_UNIT)


def _of_any_length(rows: np.ndarray) -> ArrayRows:
    return ArrayRows(np.float32(np.float16(rows)))


def _in_a_file(rows: np.ndarray) -> FileRows:
    with NamedTemporaryFile() as file:
        path = Path(file.name)
        path.write_bytes(np.float16(rows).tobytes())
        return FileRows(path, rows=len(rows), dim=rows.shape[1])  # which keeps the file open


def _of_another_tool(rows: np.ndarray) -> FileRows:
    with NamedTemporaryFile(suffix=".npy") as file:
        np.save(file, np.float64(np.float16(rows)))
        file.flush()
        return FileRows.of_npy(Path(file.name))


SEARCHERS: dict[str, Make] = {
    "brute force": lambda rows: BruteForceSearcher(_half(rows)),
    "exact, float16": lambda rows: ExactSearcher(_half(rows)),
    "exact, float32": lambda rows: ExactSearcher(_single(rows)),
    "exact, any length": lambda rows: ExactSearcher(_of_any_length(rows)),
    "exact, a file of float16": lambda rows: ExactSearcher(_in_a_file(rows)),
    "exact, a file of float64": lambda rows: ExactSearcher(_of_another_tool(rows)),
    "exact, in threads": lambda rows: ExactSearcher(_half(rows), threads=3),
    # As many bytes as there are numbers: such codes lose next to nothing, and so must the searcher.
    "compressed": lambda rows: CompressedSearcher.of(_half(rows), candidates=40),
    "compressed, float32": lambda rows: CompressedSearcher.of(_single(rows), candidates=40),
    "compressed, any length": lambda rows: CompressedSearcher.of(_of_any_length(rows), candidates=40),
    "compressed, a file of float16": lambda rows: CompressedSearcher.of(_in_a_file(rows), candidates=40),
}


@pytest.fixture(params=SEARCHERS.values(), ids=list(SEARCHERS))
def make(request: pytest.FixtureRequest) -> Make:
    """Rows `[N, dim]` of length 1 -> a searcher of them as float16 keeps them."""
    found: Make = request.param
    return found


def unit(seed: int, rows: int, dim: int) -> np.ndarray:
    """Descriptors of length 1, `[rows, dim]`."""
    drawn = np.random.default_rng(seed).standard_normal((rows, dim))
    return np.float32(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def due(rows: np.ndarray, queries: np.ndarray, k: int, allowed: np.ndarray | None = None) -> Hits:
    """What is to be found, from the definition."""
    scores = np.float64(np.float16(rows)) @ np.float64(queries).T
    hits = Hits(np.full((len(queries), min(k, len(rows))), -1), np.full((len(queries), min(k, len(rows))), -np.inf))
    for number, of_query in enumerate(scores.T):
        order = [row for row in np.argsort(-of_query, kind="stable") if allowed is None or allowed[row]][:k]
        hits.rows[number, : len(order)], hits.scores[number, : len(order)] = order, of_query[order]
    return hits


def same(found: Hits, expected: Hits) -> bool:
    """Whether the same rows were found, with the same scores but for what the order of a float64 sum makes."""
    close = np.allclose(found.scores, expected.scores, rtol=0, atol=1e-12)
    return close and np.array_equal(found.rows, expected.rows)


def test_it_finds_the_best_rows(make: Make) -> None:
    rows, queries = unit(0, 700, 24), unit(1, 9, 24)
    searcher = make(rows)
    assert (searcher.dim, len(searcher)) == (24, 700)
    found = searcher.search(queries, k=6)
    assert (found.rows.dtype, found.scores.dtype) == (np.int64, np.float64)
    assert same(found, due(rows, queries, 6))


def test_equal_rows_score_equally_and_come_in_order_of_row(make: Make) -> None:
    rows, queries = unit(2, 40, 16)[np.random.default_rng(3).integers(0, 12, 400)], unit(4, 5, 16)
    found = make(rows).search(queries, k=90)
    for row, score in zip(found.rows, found.scores, strict=True):
        alike = np.flatnonzero(np.diff(score) == 0)
        assert len(alike) > 10
        assert (np.diff(row)[alike] > 0).all()
        assert (np.diff(score) <= 0).all()
        for number in {*row.tolist()}:  # each as often as it is there, but for the last, which k may cut
            twins = np.flatnonzero((rows == rows[number]).all(axis=1))
            taken = np.isin(twins, row)
            assert taken.all() or (number == row[-1] or (rows[number] == rows[row[-1]]).all())
            assert (np.diff(taken.astype(int)) <= 0).all()


@pytest.mark.parametrize("let_through", [0.5, 0.01, 0.0])
def test_a_mask_holds_before_the_ranking(make: Make, let_through: float) -> None:
    rows, queries = unit(5, 600, 16), unit(6, 4, 16)
    allowed = np.random.default_rng(7).random(600) < let_through
    allowed[100:300] = False
    found = make(rows).search(queries, k=8, allowed=allowed)
    assert same(found, due(rows, queries, 8, allowed))


def test_what_is_no_mask_of_its_rows_is_told(make: Make) -> None:
    searcher = make(unit(5, 60, 16))
    with pytest.raises(SearchError, match=r"60 rows are searched.*shape \[59\]"):
        searcher.search(unit(6, 1, 16), k=1, allowed=np.ones(59, dtype=np.bool_))
    with pytest.raises(SearchError, match=r"60 rows are searched.*this is int64 of shape \[60\]"):
        searcher.search(unit(6, 1, 16), k=1, allowed=np.arange(60))
    if not searcher.takes_filters:
        with pytest.raises(SearchError, match=r"60 rows are searched.*a filter"):
            searcher.search(unit(6, 1, 16), k=1, allowed=Filter(near=GeoPoint(0, 0), within_m=5))


def test_fewer_rows_than_asked_for_are_all_there_are(make: Make) -> None:
    rows, queries = unit(8, 7, 16), unit(9, 2, 16)
    found = make(rows).search(queries, k=10**9)
    assert found.rows.shape == found.scores.shape == (2, 7)
    assert same(found, due(rows, queries, 7))


def test_without_rows_or_queries_nothing_is_found(make: Make) -> None:
    assert make(unit(0, 0, 16)).search(unit(1, 3, 16), k=5).rows.shape == (3, 0)
    none = make(unit(0, 9, 16)).search(unit(1, 0, 16), k=5)
    assert none.rows.shape == none.scores.shape == (0, 5)


@pytest.mark.parametrize("k", [0, -1])
def test_no_match_cannot_be_asked_for(make: Make, k: int) -> None:
    with pytest.raises(SearchError, match=f"k is {k}"):
        make(unit(0, 9, 16)).search(unit(1, 1, 16), k=k)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_query_that_is_not_finite_is_named(make: Make, bad: float) -> None:
    queries = unit(1, 3, 16)
    queries[2, 5] = bad
    with pytest.raises(SearchError, match=r"query 2 \(from 0\) holds NaN or infinity"):
        make(unit(0, 9, 16)).search(queries, k=1)


def test_a_query_beyond_float32_is_named(make: Make) -> None:
    with pytest.raises(SearchError, match=r"query 0 \(from 0\) holds NaN or infinity"):
        make(unit(0, 9, 16)).search(np.full((1, 16), 1e300), k=1)


@pytest.mark.parametrize("shape", [(1, 15), (1, 17), (16,), (1, 2, 16)])
def test_a_query_of_another_dimension_is_told(make: Make, shape: tuple[int, ...]) -> None:
    with pytest.raises(SearchError, match="rows of 16 numbers"):
        make(unit(0, 9, 16)).search(np.ones(shape, np.float32), k=1)


@pytest.mark.parametrize("length", [0.0, 1e-30, 50.0, 1e30])
def test_queries_may_have_any_length(make: Make, length: float) -> None:
    rows, queries = unit(10, 50, 16), unit(11, 3, 16) * np.float32(length)
    found, expected = make(rows).search(queries, k=4), due(rows, queries, 4)
    assert found.rows.tolist() == expected.rows.tolist()
    assert found.scores == pytest.approx(expected.scores, rel=1e-12, abs=0)


@pytest.mark.parametrize("kind", [np.float16, np.float64])
def test_queries_may_be_of_any_type(make: Make, kind: type) -> None:
    rows, queries = unit(12, 50, 16), np.float16(unit(13, 3, 16)).astype(kind)
    assert same(make(rows).search(queries, k=4), due(rows, queries, 4))


def test_it_leaves_what_it_is_given_as_it_was(make: Make) -> None:
    rows, queries, allowed = unit(14, 80, 16), unit(15, 3, 16), np.ones(80, dtype=np.bool_)
    for given in (rows, queries, allowed):
        given.setflags(write=False)
    assert same(make(rows).search(queries, k=4, allowed=allowed), due(rows, queries, 4))


def test_threads_that_ask_at_once_get_the_answers_of_one(make: Make) -> None:
    rows = unit(16, 3000, 64)
    searcher, asked = make(rows), [unit(100 + number, 1 + number % 4, 64) for number in range(24)]
    alone = [searcher.search(queries, k=5) for queries in asked]
    with ThreadPoolExecutor(8) as team:
        together = list(team.map(lambda queries: searcher.search(queries, k=5), asked * 3))
    for one, other in zip(alone * 3, together, strict=True):
        assert np.array_equal(one.rows, other.rows)
        assert np.array_equal(one.scores, other.scores)
