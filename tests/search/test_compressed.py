"""Codes, and searching by them: what is found has exact scores, and nearly nothing is missed."""

from __future__ import annotations

import numpy as np
import pytest

from salad.search import compressed
from salad.search.base import LONGEST_UNIT, ArrayRows, Hits
from salad.search.brute_force import BruteForceSearcher
from salad.search.compressed import ArrayCodes, Coding, CompressedSearcher
from salad.search.exact import ExactSearcher
from salad.search.hubness import Centred
from salad.search.principal import principal

DIM = 96


def places(seed: int, count: int, *, dim: int = DIM, places: int = 40) -> np.ndarray:
    """Rows of length 1 around the middles of places, which lie along few directions as those of real photos do."""
    rng = np.random.default_rng(7)
    wide = 0.9 ** np.arange(dim)
    middles = rng.standard_normal((places, dim)) * wide
    drawn = np.random.default_rng(seed)
    rows = middles[drawn.integers(places, size=count)] + 0.5 * wide * drawn.standard_normal((count, dim)) + 0.05
    rows += 0.02 * drawn.standard_normal((count, dim))
    return np.float32(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def half(rows: np.ndarray) -> ArrayRows:
    return ArrayRows(rows.astype(np.float16), longest=LONGEST_UNIT)


def recall(found: Hits, due: Hits) -> float:
    return float(np.mean([np.isin(one, other).mean() for one, other in zip(due.rows, found.rows, strict=True)]))


@pytest.mark.parametrize(("size", "least"), [(8, 0.9), (32, 0.999)])
@pytest.mark.parametrize("centred", [False, True])
def test_nearly_all_of_the_best_rows_are_found_and_their_scores_are_exact(
    size: int, least: float, centred: bool
) -> None:
    rows, queries = half(places(0, 6000)), places(1, 60)
    mean = rows.take(np.arange(6000)).astype(np.float64).mean(axis=0)
    coded, exact = CompressedSearcher.of(rows, size=size, candidates=200), ExactSearcher(rows)
    one, other = (Centred(each, mean) if centred else each for each in (coded, exact))
    found, due = one.search(queries, k=10), other.search(queries, k=10)
    assert recall(found, due) >= least
    assert recall(found, due) < 1 or size > 8  # else the codes were not asked
    every = BruteForceSearcher(rows).search(
        queries if not centred else np.subtract(queries, 0.5 * mean, dtype=np.float32), k=6000
    )
    added = (queries @ (0.5 * mean))[:, None] if centred else 0.0
    for query in range(60):
        exactly = dict(zip(every.rows[query].tolist(), every.scores[query].tolist(), strict=True))
        of_row = [exactly[row] for row in found.rows[query].tolist()]
        assert found.scores[query] == pytest.approx(np.array(of_row) + (added[query] if centred else 0), abs=1e-12)


def test_more_candidates_and_more_bytes_find_no_less() -> None:
    rows, queries = half(places(0, 6000)), places(1, 60)
    due = ExactSearcher(rows).search(queries, k=10)

    def reached(size: int, candidates: int) -> float:
        return recall(CompressedSearcher.of(rows, size=size, candidates=candidates).search(queries, k=10), due)

    assert reached(8, 200) <= reached(8, 1000)
    assert reached(8, 200) <= reached(16, 200) <= reached(64, 200)


@pytest.mark.parametrize("let_through", [0.6, 0.2, 0.02, 0.0])
def test_a_filter_holds_before_the_ranking(let_through: float) -> None:
    rows, queries = half(places(0, 6000)), places(1, 20)
    allowed = np.random.default_rng(3).random(6000) < let_through
    found = CompressedSearcher.of(rows, size=32).search(queries, k=5, allowed=allowed)
    due = ExactSearcher(rows).search(queries, k=5, allowed=allowed)
    assert allowed[found.rows[found.rows >= 0]].all()
    assert recall(found, due) >= 0.99
    if let_through < 0.1:  # so few that their codes are not asked
        assert np.array_equal(found.rows, due.rows)


def test_damaged_rows_are_never_found() -> None:
    whole = places(0, 5000).astype(np.float16)
    whole[5], whole[17], whole[40, 3] = np.nan, 100 * whole[17], np.inf
    rows, queries = ArrayRows(whole, longest=LONGEST_UNIT), places(0, 60)
    found = CompressedSearcher.of(rows, size=48).search(queries, k=10)
    assert not np.isin([5, 17, 40], found.rows).any()
    assert recall(found, BruteForceSearcher(rows).search(queries, k=10)) >= 0.99


class Holes(ArrayCodes):
    """Codes of only some rows, of which some blocks are damaged."""

    held, bad = 4500, (1, 3)

    def __len__(self) -> int:
        return self.held

    def block(self, number: int, spare: np.ndarray) -> np.ndarray | None:
        return None if number in self.bad else super().block(number, spare)


def test_rows_without_codes_are_searched_exactly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compressed, "BLOCK", 32 * 500)
    rows, queries = half(places(0, 6000)), places(1, 20)
    allowed = np.random.default_rng(3).random(6000) < 0.9
    searcher = CompressedSearcher(rows, Holes(Coding.fitted(rows, size=32), rows), candidates=300)
    for mask in (None, allowed):
        found, due = (
            searcher.search(queries, k=10, allowed=mask),
            ExactSearcher(rows).search(queries, k=10, allowed=mask),
        )
        assert recall(found, due) >= 0.99
        bare = np.r_[500:1000, 1500:2000, 4500:6000]  # all of those that belong there
        assert [np.intersect1d(row, bare).tolist() for row in found.rows] == [
            np.intersect1d(row, bare).tolist() for row in due.rows
        ]


def test_neither_threads_nor_blocks_nor_batches_show(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, queries = half(places(0, 6000)), places(1, 30)
    codes = ArrayCodes(Coding.fitted(rows, size=16), rows)
    plain = CompressedSearcher(rows, codes, candidates=100, threads=1).search(queries, k=10)
    monkeypatch.setattr(compressed, "BLOCK", 16 * 170)
    monkeypatch.setattr(compressed, "_WORK", 1)
    monkeypatch.setattr(compressed, "_BATCH", 7)
    other = CompressedSearcher(rows, codes, candidates=100, threads=4).search(queries, k=10)
    assert np.array_equal(plain.rows, other.rows)
    assert np.array_equal(plain.scores, other.scores)


def test_a_code_is_off_by_half_a_step() -> None:
    rows = places(0, 3000)
    coding = Coding.fitted(half(rows), size=32, seed=4)
    along = rows.astype(np.float16).astype(np.float32) @ coding.axes.astype(np.float32).T - coding.middle
    within = np.abs(along) < 127 * coding.step
    assert within.mean() > 0.999
    assert np.abs(coding.encode(rows.astype(np.float16)) * coding.step - along)[within].max() < 0.5001 * coding.step


def test_a_seed_gives_the_same_coding_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compressed, "SAMPLE", 500)
    rows = half(places(0, 3000))
    one, same, another = (Coding.fitted(rows, size=8, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(one.axes, same.axes)
    assert not np.array_equal(one.axes, another.axes)


def test_the_directions_are_those_in_which_rows_differ_most() -> None:
    rows = places(0, 3000)
    found = principal(ArrayRows(rows), np.arange(3000), count=12)
    apart = (rows - rows.mean(axis=0)).astype(np.float64)
    assert found.mean == pytest.approx(rows.mean(axis=0), abs=1e-6)
    assert found.axes @ found.axes.T == pytest.approx(np.eye(12), abs=1e-5)
    spread = np.linalg.svd(apart, compute_uv=False)[:12] / np.sqrt(3000)
    assert found.spread == pytest.approx(spread, rel=1e-3)
    assert np.std(apart @ found.axes.T, axis=0) == pytest.approx(found.spread, rel=1e-4)


def test_damaged_rows_turn_no_direction() -> None:
    rows = places(0, 800).astype(np.float16)
    worse = rows.copy()
    worse[3], worse[300], worse[799] = np.nan, 50 * rows[1], np.inf
    sound = np.setdiff1d(np.arange(800), [3, 300, 799])
    one = principal(ArrayRows(worse, longest=LONGEST_UNIT), np.arange(800), count=5)
    other = principal(ArrayRows(rows, longest=LONGEST_UNIT), sound, count=5)
    assert one.axes == pytest.approx(other.axes, abs=1e-4)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_next_to_no_rows_can_be_coded(count: int) -> None:
    rows = half(places(0, count))
    assert len(ArrayCodes(Coding.fitted(rows, size=16), rows)) == count
