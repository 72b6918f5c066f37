"""Exact search against a plain oracle."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from salad.errors import StoreError
from salad.index import scan, search
from salad.index.search import as_queries, best_rows
from salad.index.vectors import Rows


def _oracle(matrix: np.ndarray, query: np.ndarray, k: int, allowed: np.ndarray) -> list[tuple[int, float]]:
    scores = (matrix.astype(np.float64) * query.astype(np.float64)).sum(axis=1)
    order = [int(row) for row in np.argsort(-scores, kind="stable") if allowed[row]]
    return [(row, float(scores[row])) for row in order[:k]]


def _unit(rng: np.random.Generator, rows: int, dim: int) -> np.ndarray:
    drawn = rng.standard_normal((rows, dim))
    return (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).astype(np.float32)


def _found(matrix: np.ndarray, asked: np.ndarray, *, k: int, allowed: np.ndarray) -> list:
    with TemporaryDirectory() as folder:
        path = Path(folder, "m")
        path.write_bytes(matrix.tobytes())
        rows = Rows(path, rows=len(matrix), dim=matrix.shape[1])
        try:
            return best_rows(rows, asked, k=k, allowed=allowed)
        finally:
            rows.close()


@contextmanager
def _threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@pytest.fixture(params=[False, True], ids=["float32", "bfloat16"])
def coarse(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Search by either arithmetic, whatever the processor has and however few the queries are."""
    monkeypatch.setattr(scan, "_MANY", 1)
    monkeypatch.setattr(scan, "_multiplies_bfloat16", lambda: request.param)
    return bool(request.param)


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(0, 60),
    queries=st.integers(0, 4),
    dim=st.integers(1, 40),
    k=st.integers(1, 80),
    copies=st.booleans(),
)
def test_search_is_the_oracles(
    coarse: bool, seed: int, rows: int, queries: int, dim: int, k: int, copies: bool
) -> None:
    rng = np.random.default_rng(seed)
    matrix = _unit(rng, rows, dim).astype(np.float16)
    if copies and rows:
        matrix = matrix[rng.integers(0, max(1, rows // 3), rows)]  # many equal rows, so many ties
    allowed = rng.random(rows) < 0.8
    asked = _unit(rng, queries, dim)
    asked.setflags(write=False)
    found = _found(matrix, asked, k=k, allowed=allowed)
    assert found == [_oracle(matrix, query, k, allowed) for query in asked]


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize(("widen", "scores"), [(1, 1), (40, 1), (64, 64), (1 << 19, 1 << 22)])
def test_blocks_and_threads_do_not_show(
    coarse: bool, monkeypatch: pytest.MonkeyPatch, widen: int, scores: int, threads: int
) -> None:
    monkeypatch.setattr(scan, "_WIDEN", widen)
    monkeypatch.setattr(scan, "_SCORES", scores)
    monkeypatch.setattr(search, "_QUERIES", 3)
    monkeypatch.setattr(scan, "_PAIRS", 7)
    rng = np.random.default_rng(3)
    matrix = np.repeat(_unit(rng, 70, 16), 3, axis=0).astype(np.float16)
    asked, allowed = _unit(rng, 5, 16), rng.random(210) < 0.5
    allowed[50:150] = False  # whole blocks that need not be read
    with _threads(threads):
        found = _found(matrix, asked, k=11, allowed=allowed)
        assert torch.get_num_threads() == threads
    assert found == [_oracle(matrix, query, 11, allowed) for query in asked]


def test_the_best_coming_last_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan, "_WIDEN", 64)
    rng = np.random.default_rng(11)
    asked = _unit(rng, 2, 8)
    matrix = _unit(rng, 400, 8).astype(np.float16)
    matrix = matrix[np.argsort(matrix.astype(np.float64) @ asked[0], kind="stable")]
    allowed = np.ones(400, bool)
    assert _found(matrix, asked, k=3, allowed=allowed) == [_oracle(matrix, q, 3, allowed) for q in asked]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    hurt=st.lists(
        st.tuples(st.integers(0, 59), st.sampled_from([np.nan, np.inf, -np.inf, 6e4]), st.booleans()),
        max_size=9,
    ),
    lost=st.integers(0, 61),
    k=st.integers(1, 70),
)
def test_damaged_and_lost_rows_are_never_found_and_harm_no_other(
    coarse: bool, seed: int, hurt: list[tuple[int, float, bool]], lost: int, k: int
) -> None:
    rng = np.random.default_rng(seed)
    matrix = _unit(rng, 60, 12).astype(np.float16)
    sound = np.ones(60, bool)
    spoilt = matrix.copy()
    for row, value, whole in hurt:
        spoilt[row, slice(None) if whole else 5] = value
        sound[row] = False
    sound[60 - lost :] = False
    asked = np.concatenate([_unit(rng, 3, 12), -_unit(rng, 1, 12)])
    with TemporaryDirectory() as folder:
        path = Path(folder, "m")
        path.write_bytes(spoilt[: 60 - lost].tobytes())
        rows = Rows(path, rows=60, dim=12)
        found = best_rows(rows, asked, k=k, allowed=np.ones(60, bool))
        rows.close()
    finite = np.isfinite(spoilt.astype(np.float32)).all(axis=1)
    for best, query in zip(found, asked, strict=True):
        # A row that is only too long may come out where it points away, but never ahead of a sound one's score.
        kept = [each for each in best if sound[each[0]]]
        assert kept == _oracle(matrix, query, k, sound)[: len(kept)]
        assert all(finite[row] and score <= 1.03 for row, score in best)
        if finite[: 60 - lost].all() and not hurt:
            assert len(best) == min(k, 60 - lost)


def test_searches_beside_one_another_agree_and_leave_torch_as_it_was() -> None:
    rng = np.random.default_rng(13)
    matrix, asked = _unit(rng, 3000, 256).astype(np.float16), _unit(rng, 4, 256)
    allowed, found = np.ones(3000, bool), []

    def look() -> None:
        found.append((_found(matrix, asked, k=4, allowed=allowed), torch.get_num_threads()))

    with _threads(2):
        threads = [threading.Thread(target=look) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert torch.get_num_threads() == 2
        look()
    expected = [_oracle(matrix, query, 4, allowed) for query in asked]
    assert [each for each, _ in found] == [expected] * 5
    assert found[-1][1] == 2


def test_a_disk_that_fails_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan, "_WIDEN", 64)
    begun = []

    def failing(self: Rows, start: int, out: np.ndarray) -> int:
        begun.append(start)
        raise StoreError("the disk fails")

    monkeypatch.setattr(Rows, "read", failing)
    rng = np.random.default_rng(17)
    with _threads(2), pytest.raises(StoreError, match="the disk fails"):
        _found(_unit(rng, 900, 8).astype(np.float16), _unit(rng, 1, 8), k=1, allowed=np.ones(900, bool))
    assert 1 <= len(begun) <= 2  # one for each thread at most, and no part after that
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("salad-search")]


def test_threads_that_cannot_start_leave_none_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan, "_WIDEN", 64)
    start, started = threading.Thread.start, []

    def once(self: threading.Thread) -> None:
        if self.name.startswith("salad-search"):
            if started:
                raise RuntimeError("can't start new thread")
            started.append(self)
        start(self)

    monkeypatch.setattr(threading.Thread, "start", once)
    rng = np.random.default_rng(19)
    with _threads(2), pytest.raises(RuntimeError, match="start new thread"):
        _found(_unit(rng, 900, 8).astype(np.float16), _unit(rng, 1, 8), k=1, allowed=np.ones(900, bool))
    assert not started[0].is_alive()


def _alike(rng: np.random.Generator) -> np.ndarray:
    """Rows whose scores lie closer together than bfloat16 can tell, each 30 times."""
    near = _unit(rng, 40, 512) * 0.05 + _unit(rng, 1, 512)
    return (near / np.linalg.norm(near, axis=1, keepdims=True)).astype(np.float16).repeat(30, axis=0)


@pytest.mark.parametrize("k", [1, 5, 31, 40])
def test_scores_that_rounding_hides_are_told_apart(coarse: bool, k: int) -> None:
    rng = np.random.default_rng(23)
    matrix = _alike(rng)
    asked, allowed = matrix[[3, 700, 900]].astype(np.float32), rng.random(1200) < 0.7
    asked[1] *= 50  # a query need not be of length 1
    found = _found(matrix, asked, k=k, allowed=allowed)
    assert found == [_oracle(matrix, query, k, allowed) for query in asked]


@pytest.mark.parametrize("precision", ["medium", "high"])
def test_float32_told_to_be_quick_finds_the_same(precision: str) -> None:
    rng = np.random.default_rng(29)
    matrix = _alike(rng)
    asked, allowed = matrix[[3, 700, 900]].astype(np.float32), rng.random(1200) < 0.7
    torch.set_float32_matmul_precision(precision)
    try:
        found = _found(matrix, asked, k=40, allowed=allowed)
    finally:
        torch.set_float32_matmul_precision("highest")
    assert found == [_oracle(matrix, query, 40, allowed) for query in asked]


def test_a_query_of_nothing_finds_the_first_rows(coarse: bool) -> None:
    matrix = _unit(np.random.default_rng(31), 50, 8).astype(np.float16)
    (found,) = _found(matrix, np.zeros((1, 8), np.float32), k=3, allowed=np.ones(50, bool))
    assert found == [(0, 0.0), (1, 0.0), (2, 0.0)]


def test_what_was_swept_twice_stays_in_memory(tmp_path: Path) -> None:
    rng = np.random.default_rng(37)
    matrix, asked = _unit(rng, 300, 16).astype(np.float16), _unit(rng, 2, 16)
    path, allowed = tmp_path / "m", np.ones(300, bool)
    path.write_bytes(matrix.tobytes())
    rows = Rows(path, rows=300, dim=16)
    expected = [_oracle(matrix, query, 5, allowed) for query in asked]
    for _ in range(2):
        assert best_rows(rows, asked, k=5, allowed=allowed) == expected
    path.write_bytes(b"")
    assert best_rows(rows, asked, k=5, allowed=allowed) == expected


def test_equal_rows_come_out_in_order_of_row_wherever_they_stand() -> None:
    rng = np.random.default_rng(5)
    twin = _unit(rng, 1, 2176)
    matrix = np.concatenate([_unit(rng, 300, 2176), twin, _unit(rng, 511, 2176), twin]).astype(np.float16)
    (found,) = _found(matrix, twin, k=2, allowed=np.ones(len(matrix), bool))
    assert [row for row, _ in found] == [300, 812]
    assert found[0][1] == found[1][1]


def test_a_callers_lower_precision_is_not_for_scores() -> None:
    rng = np.random.default_rng(7)
    matrix, asked = _unit(rng, 500, 64).astype(np.float16), _unit(rng, 3, 64)
    allowed = np.ones(500, bool)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = _found(matrix, asked, k=9, allowed=allowed)
    assert found == [_oracle(matrix, query, 9, allowed) for query in asked]


def test_queries_are_checked() -> None:
    assert as_queries(np.ones(4), 4).shape == (1, 4)
    assert as_queries(np.ones((3, 4), np.float16), 4).dtype == np.float32
    for wrong in (np.ones(3), np.ones((2, 5)), np.ones((1, 2, 4))):
        with pytest.raises(StoreError, match="index holds descriptors of 4 numbers"):
            as_queries(wrong, 4)
    for bad in (np.nan, np.inf):
        with pytest.raises(StoreError, match="NaN or infinity"):
            as_queries(np.array([1, bad, 0, 0]), 4)
    with pytest.raises(StoreError, match="k is 0"):
        _found(np.ones((1, 4), np.float16), np.ones((1, 4), np.float32), k=0, allowed=np.ones(1, bool))
