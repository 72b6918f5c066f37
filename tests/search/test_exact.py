"""The exact search against the plainest, to the last bit."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NoReturn

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from salad.errors import MissingExtraError, StoreError
from salad.search import exact
from salad.search.base import LONGEST_UNIT, ArrayRows, DamagedRowError, Hits, Rows
from salad.search.brute_force import BruteForceSearcher
from salad.search.exact import ExactSearcher


def unit(rng: np.random.Generator, rows: int, dim: int) -> np.ndarray:
    drawn = rng.standard_normal((rows, dim))
    return (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).astype(np.float32)


def same(found: Hits, expected: Hits) -> bool:
    return np.array_equal(found.rows, expected.rows) and np.array_equal(found.scores, expected.scores)


def agree(rows: Rows, queries: np.ndarray, *, k: int, allowed: np.ndarray | None = None, threads: int = 1) -> None:
    found = ExactSearcher(rows, threads=threads).search(queries, k=k, allowed=allowed)
    assert same(found, BruteForceSearcher(rows).search(queries, k=k, allowed=allowed))


@pytest.fixture(params=["float16", "bfloat16"])
def kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Search by either arithmetic, whatever the processor has and however few rows and queries are."""
    monkeypatch.setattr(exact, "_MANY_ROWS", 0)
    monkeypatch.setattr(exact, "_MANY_QUERIES", 0)
    monkeypatch.setattr(exact, "_FEW", 100)
    monkeypatch.setattr(exact.numkong, "get_capabilities", lambda: {"genoa": request.param == "bfloat16"})
    return str(request.param)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks, batches and the rest so small that little data needs many, and several threads."""
    for name, size in {
        "_BLOCK": 64,
        "_BATCH": 3,
        "_TOGETHER": 100,
        "_PAIRS": 40,
        "_WORK": 1,
        "_CANDIDATES": 20,
    }.items():
        monkeypatch.setattr(exact, name, size)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(0, 60),
    queries=st.integers(0, 5),
    dim=st.integers(1, 70),
    k=st.integers(1, 80),
    copies=st.booleans(),
    kind=st.sampled_from([np.float16, np.float32]),
    longest=st.sampled_from([LONGEST_UNIT, None]),
)
def test_it_is_the_plainest(
    kernel: str,
    seed: int,
    rows: int,
    queries: int,
    dim: int,
    k: int,
    copies: bool,
    kind: type,
    longest: float | None,
) -> None:
    rng = np.random.default_rng(seed)
    matrix = unit(rng, rows, dim).astype(kind)
    if copies and rows:
        matrix = matrix[rng.integers(0, max(1, rows // 3), rows)]  # many equal rows, so many ties
    agree(ArrayRows(matrix, longest=longest), unit(rng, queries, dim), k=k, allowed=rng.random(rows) < 0.8)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    dim=st.integers(1, 70),
    k=st.integers(1, 12),
    rows_at=st.floats(-30, 15),
    rows_apart=st.floats(0, 6),
    queries_at=st.floats(-30, 30),
)
def test_rows_and_queries_may_have_any_length(
    kernel: str, seed: int, dim: int, k: int, rows_at: float, rows_apart: float, queries_at: float
) -> None:
    rng = np.random.default_rng(seed)
    lengths = 10.0 ** (rows_at - rows_apart * rng.random((50, 1)))
    rows = (unit(rng, 50, dim) * lengths).astype(np.float32)
    agree(ArrayRows(rows), (unit(rng, 4, dim) * 10.0**queries_at).astype(np.float32), k=k)


@settings(max_examples=300)
@given(
    seed=st.integers(0, 2**32 - 1),
    dim=st.integers(1, 3000),
    kind=st.sampled_from([np.float16, np.float32]),
    spread=st.floats(0, 9),
    signs=st.sampled_from(["one", "both", "cancel"]),
    kernel=st.sampled_from([exact._HALF, exact._COARSE]),
)
def test_no_score_is_off_by_more_than_the_bound(
    seed: int, dim: int, kind: type, spread: float, signs: str, kernel: exact._Kernel
) -> None:
    """Of numbers large and small, all of one sign, so that every rounding goes one way, or such that all cancel."""
    rng = np.random.default_rng(seed)
    rows, queries = (
        10 ** (-spread * rng.random((count, dim))) * (1 if signs == "one" else rng.choice([-1, 1], (count, dim)))
        for count in (6, 5)
    )
    if signs == "cancel":  # the other half of a row undoes what the first half adds
        queries[:, dim // 2 : dim // 2 * 2] = queries[:, : dim // 2]
        rows[:, dim // 2 : dim // 2 * 2] = -rows[:, : dim // 2] * (1 + rng.random((6, dim // 2)) * 2.0**-9)
    held = ArrayRows(rows.astype(kind))
    asked = queries.astype(np.float32)
    candidates = exact._Candidates(held, asked, k=6)
    exact._Batch(asked, candidates, kernel).offer(exact._Reader(held, 6, None, kernel).read(0, 6))
    ((query, row, low, high),) = candidates._new
    assert len(row) == 30
    scores = (held.take(row).astype(np.float64) * asked[query]).sum(axis=1)
    assert (low <= scores).all()
    assert (scores <= high).all()


def alike(rng: np.random.Generator, kind: type) -> np.ndarray:
    """Rows whose scores lie closer together than float16 can tell, each 30 times."""
    near = unit(rng, 40, 512) * np.float32(1e-3) + unit(rng, 1, 512)
    return (near / np.linalg.norm(near, axis=1, keepdims=True)).astype(kind).repeat(30, axis=0)


@pytest.mark.parametrize("kind", [np.float16, np.float32])
@pytest.mark.parametrize("k", [1, 5, 31, 40])
def test_scores_that_rounding_hides_are_told_apart(kernel: str, k: int, kind: type) -> None:
    rng = np.random.default_rng(23)
    matrix = alike(rng, kind)
    asked = matrix[[3, 700, 900]].astype(np.float32) + unit(rng, 3, 512) * np.float32(1e-4)
    agree(ArrayRows(matrix), asked, k=k, allowed=rng.random(1200) < 0.7)


@pytest.mark.parametrize("kind", [np.float16, np.float32])
@pytest.mark.parametrize("threads", [1, 3])
def test_blocks_batches_and_threads_do_not_show(kernel: str, small: None, threads: int, kind: type) -> None:
    rng = np.random.default_rng(3)
    matrix = np.repeat(unit(rng, 70, 16), 3, axis=0).astype(kind)
    allowed = rng.random(210) < 0.5
    allowed[50:150] = False
    agree(ArrayRows(matrix), unit(rng, 17, 16), k=11, allowed=allowed, threads=threads)


def test_the_best_coming_last_are_found(small: None) -> None:
    rng = np.random.default_rng(11)
    asked, matrix = unit(rng, 2, 8), unit(rng, 400, 8).astype(np.float16)
    matrix = matrix[np.argsort(matrix.astype(np.float64) @ asked[0], kind="stable")]
    agree(ArrayRows(matrix), asked, k=3)


def test_rows_that_are_all_one_take_no_memory_for_each() -> None:
    rows = ArrayRows(np.ones((3000, 4), np.float16))
    asked = np.ones((2, 4), np.float32)
    candidates = exact._Candidates(rows, asked, k=2)
    batch, reader = exact._Batch(asked, candidates, exact._HALF), exact._Reader(rows, 10, None, exact._HALF)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exact, "_CANDIDATES", 100)
        for start in range(0, 3000, 10):
            batch.offer(reader.read(start, start + 10))
            assert len(candidates._pairs.row) <= 100
    assert candidates.hits().rows.tolist() == [[0, 1], [0, 1]]


def test_a_query_of_nothing_finds_the_first_rows() -> None:
    matrix = unit(np.random.default_rng(31), 50, 8).astype(np.float16)
    found = ExactSearcher(ArrayRows(matrix, longest=LONGEST_UNIT)).search(np.zeros((1, 8)), k=3)
    assert (found.rows.tolist(), found.scores.tolist()) == ([[0, 1, 2]], [[0, 0, 0]])


def test_equal_rows_come_out_in_order_of_row_wherever_they_stand() -> None:
    rng = np.random.default_rng(5)
    twin = unit(rng, 1, 2176)
    matrix = np.concatenate([unit(rng, 300, 2176), twin, unit(rng, 3000, 2176), twin]).astype(np.float16)
    found = ExactSearcher(ArrayRows(matrix, longest=LONGEST_UNIT), threads=2).search(twin, k=2)
    assert found.rows.tolist() == [[300, 3301]]
    assert found.scores[0, 0] == found.scores[0, 1]


# --- damage ---------------------------------------------------------------------------------


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    hurt=st.lists(
        st.tuples(st.integers(0, 59), st.sampled_from([np.nan, np.inf, -np.inf, 6e4]), st.booleans()),
        max_size=9,
    ),
    k=st.integers(1, 70),
    kind=st.sampled_from([np.float16, np.float32]),
)
def test_damaged_rows_are_never_ahead_and_harm_no_other(
    kernel: str, seed: int, hurt: list[tuple[int, float, bool]], k: int, kind: type
) -> None:
    rng = np.random.default_rng(seed)
    matrix, sound = unit(rng, 60, 12).astype(kind), np.ones(60, bool)
    spoilt = matrix.copy()
    for row, value, whole in hurt:
        spoilt[row, slice(None) if whole else 5] = value
        sound[row] = False
    asked = np.concatenate([unit(rng, 3, 12), -unit(rng, 1, 12)])
    found = ExactSearcher(ArrayRows(spoilt, longest=LONGEST_UNIT)).search(asked, k=k)
    expected = BruteForceSearcher(ArrayRows(matrix, longest=LONGEST_UNIT)).search(asked, k=k, allowed=sound)
    for rows, scores, best in zip(found.rows, found.scores, expected.rows, strict=True):
        # A row that is only too long may come out where it points away, but never ahead of a sound one's score.
        kept = rows[(rows >= 0) & sound[rows]]
        assert kept.tolist() == best[: len(kept)].tolist()
        assert (scores <= 1.03).all()
        assert np.isfinite(spoilt[rows[rows >= 0]]).all()


@pytest.mark.parametrize("kind", [np.float16, np.float32])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 3e38])
def test_a_damaged_row_is_named_where_rows_may_have_any_length(bad: float, kind: type) -> None:
    matrix = unit(np.random.default_rng(1), 9, 4)
    with np.errstate(over="ignore"):  # 3e38 is infinite as float16
        matrix = matrix.astype(kind)
        matrix[7, 2] = bad
    with pytest.raises(DamagedRowError, match=r"row 7 \(from 0\) holds NaN, infinity or numbers too large") as told:
        ExactSearcher(ArrayRows(matrix)).search(np.ones((1, 4)), k=1)
    assert told.value.row == 7


class Lost(ArrayRows):
    """Rows of which those from 30 on are lost, as those of a file cut short are."""

    def block(self, start: int, stop: int, spare: np.ndarray) -> np.ndarray:
        return super().block(start, min(stop, 30), spare)


def test_rows_that_are_lost_are_not_found(small: None) -> None:
    rng = np.random.default_rng(2)
    rows, asked = Lost(unit(rng, 60, 8).astype(np.float16), longest=LONGEST_UNIT), unit(rng, 5, 8)
    found = ExactSearcher(rows, threads=2).search(asked, k=60)
    assert same(found, BruteForceSearcher(rows).search(asked, k=60, allowed=np.arange(60) < 30))


# --- threads --------------------------------------------------------------------------------


class Failing(ArrayRows):
    """Rows that cannot be read."""

    def __init__(self, error: BaseException) -> None:
        super().__init__(unit(np.random.default_rng(17), 900, 8).astype(np.float16), longest=LONGEST_UNIT)
        self.error, self.begun = error, list[int]()

    def block(self, start: int, stop: int, spare: np.ndarray) -> np.ndarray:
        self.begun.append(start)
        raise self.error


@pytest.mark.parametrize("error", [StoreError("the disk fails"), KeyboardInterrupt("the disk fails")])
def test_whatever_ends_one_thread_ends_the_search(small: None, error: BaseException) -> None:
    rows = Failing(error)
    with pytest.raises(type(error), match="the disk fails"):
        ExactSearcher(rows, threads=2).search(np.ones((1, 8)), k=1)
    assert 1 <= len(rows.begun) <= 2  # one for each thread at most, and no block after that
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("salad-search")]


def test_an_interrupt_of_the_caller_ends_the_search(small: None, monkeypatch: pytest.MonkeyPatch) -> None:
    class Slow(Failing):
        def block(self, start: int, stop: int, spare: np.ndarray) -> np.ndarray:
            self.begun.append(start)
            first.set()
            interrupted.wait(10)
            return self._rows[start:stop]

    first, interrupted = threading.Event(), threading.Event()
    rows = Slow(StoreError(""))

    class Interrupted(ThreadPoolExecutor):
        def map(self, work: Callable[..., Any], *_: object, **__: object) -> NoReturn:
            self.submit(work, 0)
            first.wait(10)
            threading.Timer(0.05, interrupted.set).start()
            raise KeyboardInterrupt  # Ctrl-C while the threads sweep

    offered = list[object]()
    monkeypatch.setattr(exact, "ThreadPoolExecutor", Interrupted)
    monkeypatch.setattr(exact._Batch, "offer", lambda _, block: offered.append(block))
    with pytest.raises(KeyboardInterrupt):
        ExactSearcher(rows, threads=2).search(np.ones((7, 8)), k=1)
    assert len(rows.begun) == 1
    assert offered == []  # the block that was being read is not multiplied any more


def test_threads_that_cannot_start_leave_none_waiting(small: None, monkeypatch: pytest.MonkeyPatch) -> None:
    class Waiting(Failing):
        def block(self, start: int, stop: int, spare: np.ndarray) -> np.ndarray:
            refused.wait(10)  # or the first thread would have done it all before a second is needed
            return self._rows[start:stop]

    start, started, refused = threading.Thread.start, list[threading.Thread](), threading.Event()

    def once(self: threading.Thread) -> None:
        if self.name.startswith("salad-search"):
            if started:
                refused.set()
                raise RuntimeError("can't start new thread")
            started.append(self)
        start(self)

    monkeypatch.setattr(threading.Thread, "start", once)
    with pytest.raises(RuntimeError, match="start new thread"):
        ExactSearcher(Waiting(StoreError("")), threads=2).search(np.ones((1, 8)), k=1)
    assert not started[0].is_alive()


def test_blocks_without_an_allowed_row_are_not_read(small: None) -> None:
    class Watched(ArrayRows):
        def block(self, start: int, stop: int, spare: np.ndarray) -> np.ndarray:
            read.update(range(start, stop))
            return super().block(start, stop, spare)

    read, allowed = set[int](), np.zeros(200, bool)
    allowed[[3, 150]] = True
    rows = Watched(unit(np.random.default_rng(20), 200, 16).astype(np.float16), longest=LONGEST_UNIT)
    found = ExactSearcher(rows, threads=1).search(np.ones((1, 16)), k=5, allowed=allowed)
    assert sorted(found.rows[0].tolist()) == [-1, -1, -1, 3, 150]
    assert len(read) < 20


@pytest.mark.parametrize("has", [{}, {"genoa": False}, {"genoa": True}, {"neonbfdot": True}])
def test_many_queries_of_many_rows_are_rounded_more_where_that_is_quicker(
    has: dict[str, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    kernels = list[str]()
    reader = exact._Reader

    def watched(*given: Any) -> object:
        kernels.append(given[-1].name)
        return reader(*given)

    monkeypatch.setattr(exact, "_Reader", watched)
    monkeypatch.setattr(exact.numkong, "get_capabilities", lambda: has)
    rng = np.random.default_rng(41)
    rows = ArrayRows(unit(rng, 17000, 8).astype(np.float16))
    for queries, k in ((16, 32), (15, 32), (16, 33)):
        agree(rows, unit(rng, queries, 8), k=k)
    assert kernels == ["bfloat16" if any(has.values()) else "float16", "float16", "float16"]


@pytest.mark.parametrize("first", [1e18, 1e-30])
def test_blocks_may_lie_further_apart_than_float32_reaches(first: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a block of long rows reaches is infinite at the scale of a block of short ones."""
    monkeypatch.setattr(exact, "_BLOCK", 50 * 8)
    drawn = np.random.default_rng(0).standard_normal((100, 8))
    lengths = np.repeat([first, 1e-12 / first], 50)
    agree(ArrayRows(np.float32(drawn * lengths[:, None])), np.float32(drawn[:3]), k=7)


def test_rows_beyond_float32_are_damaged() -> None:
    rows = np.ones((5, 3))
    rows[3] = 1e300
    with pytest.raises(DamagedRowError, match="row 3"):
        ExactSearcher(ArrayRows(rows)).search(np.ones((1, 3)), k=1)


@pytest.mark.parametrize("error", [DamagedRowError(3), MissingExtraError("reading HEIC", "heic")])
def test_errors_come_whole_from_another_process(error: Exception) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), getattr(again, "row", 0)) == (type(error), str(error), getattr(error, "row", 0))
