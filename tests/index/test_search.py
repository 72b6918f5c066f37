"""Exact search against a plain oracle."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.errors import StoreError
from salad.index import search
from salad.index.search import as_queries, best_rows


def _oracle(matrix: np.ndarray, query: np.ndarray, k: int, allowed: np.ndarray) -> list[tuple[int, float]]:
    scores = (matrix.astype(np.float64) * query.astype(np.float64)).sum(axis=1)
    order = [int(row) for row in np.argsort(-scores, kind="stable") if allowed[row]]
    return [(row, float(scores[row])) for row in order[:k]]


def _unit(rng: np.random.Generator, rows: int, dim: int) -> np.ndarray:
    drawn = rng.standard_normal((rows, dim))
    return (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).astype(np.float32)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(0, 60),
    queries=st.integers(0, 4),
    dim=st.integers(1, 40),
    k=st.integers(1, 80),
    copies=st.booleans(),
)
def test_search_is_the_oracles(seed: int, rows: int, queries: int, dim: int, k: int, copies: bool) -> None:
    rng = np.random.default_rng(seed)
    matrix = _unit(rng, rows, dim).astype(np.float16)
    if copies and rows:
        matrix = matrix[rng.integers(0, max(1, rows // 3), rows)]  # many equal rows, so many ties
    allowed = rng.random(rows) < 0.8
    asked = _unit(rng, queries, dim)
    found = best_rows(matrix, asked, k=k, allowed=allowed)
    assert found == [_oracle(matrix, query, k, allowed) for query in asked]


@pytest.mark.parametrize(("widen", "scores"), [(1, 1), (40, 1), (64, 64), (1 << 19, 1 << 22)])
def test_blocks_do_not_show(monkeypatch: pytest.MonkeyPatch, widen: int, scores: int) -> None:
    monkeypatch.setattr(search, "_WIDEN", widen)
    monkeypatch.setattr(search, "_SCORES", scores)
    rng = np.random.default_rng(3)
    matrix = np.repeat(_unit(rng, 70, 16), 3, axis=0).astype(np.float16)
    asked, allowed = _unit(rng, 5, 16), rng.random(210) < 0.5
    found = best_rows(matrix, asked, k=11, allowed=allowed)
    assert found == [_oracle(matrix, query, 11, allowed) for query in asked]


def test_equal_rows_come_out_in_order_of_row_wherever_they_stand() -> None:
    rng = np.random.default_rng(5)
    twin = _unit(rng, 1, 2176)
    matrix = np.concatenate([_unit(rng, 300, 2176), twin, _unit(rng, 511, 2176), twin]).astype(np.float16)
    (found,) = best_rows(matrix, twin, k=2, allowed=np.ones(len(matrix), bool))
    assert [row for row, _ in found] == [300, 812]
    assert found[0][1] == found[1][1]


def test_a_callers_lower_precision_is_not_for_scores() -> None:
    rng = np.random.default_rng(7)
    matrix, asked = _unit(rng, 500, 64).astype(np.float16), _unit(rng, 3, 64)
    allowed = np.ones(500, bool)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = best_rows(matrix, asked, k=9, allowed=allowed)
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
        best_rows(np.ones((1, 4), np.float16), np.ones((1, 4), np.float32), k=0, allowed=np.ones(1, bool))
