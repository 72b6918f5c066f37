"""Scores without what all photos of an index have in common."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.evaluation.evaluate_benchmark import rank
from salad.images.photo import Photo
from salad.index.index import Index
from salad.index.vectors import FileRows
from salad.search import hubness
from salad.search.base import ArrayRows, DamagedRowError
from salad.search.hubness import mean_of_all, mean_of_some

Make = Callable[[np.ndarray], Index]


def leaning(seed: int, rows: int, dim: int = 16, *, lean: float = 2.0) -> np.ndarray:
    """Descriptors that all lean one way, as those of one building do; rounded as an index keeps them."""
    rng = np.random.default_rng(seed)
    drawn = rng.standard_normal((rows, dim))
    drawn[:, 0] += lean
    return np.float32(np.float16(drawn / np.linalg.norm(drawn, axis=1, keepdims=True)))


def oracle(queries: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The score as docs/method.md writes it, `[Q, N]`."""
    q, r = queries.astype(np.float64), rows.astype(np.float64)
    mean = r.mean(axis=0)
    return q @ r.T - (r @ mean - (q @ mean)[:, None]) / 2


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Make]:
    opened: list[Index] = []

    def make(rows: np.ndarray) -> Index:
        folder = tmp_path / f"i{len(opened)}"
        opened.append(Index.create(folder, dim=rows.shape[1], fingerprint="f", model="m"))
        add(opened[-1], rows)
        return opened[-1]

    yield make
    for index in opened:
        index.close()


def add(index: Index, rows: np.ndarray, *, first: int = 0) -> None:
    names = [str(number) for number in range(first, first + len(rows))]
    index.add([Photo(Path("/photos", name)) for name in names], rows, identities=names)


@pytest.mark.parametrize("count", [7, hubness._STEP, 2 * hubness._STEP + 9])
def test_it_is_the_formula(made: Make, count: int) -> None:
    rows, queries = leaning(0, 40), leaning(1, count)
    due = oracle(queries, rows)
    for number, matches in enumerate(made(rows).search(queries, k=40, centred=True)):
        assert [match.row for match in matches] == np.argsort(-due[number]).tolist()
        assert [match.score for match in matches] == pytest.approx(np.sort(due[number])[::-1], abs=1e-6)


def test_what_is_like_everything_no_longer_comes_first(made: Make) -> None:
    own, hub = np.float64([0.6, 0.8, 0]), np.float64([1, 0, 0])  # all lean along the first axis, the hub most
    others = [np.float64([0.8, 0, 0.6]), np.float64([0.8, 0, -0.6])]
    index = made(np.array([own, hub, *others], dtype=np.float32))
    query = np.float32([0.92, 0.39, 0])  # shows what `own` shows, from where the common part is large
    assert index.search(query, k=1)[0][0].row == 1
    assert index.search(query, k=1, centred=True)[0][0].row == 0


@given(st.integers(0, 10**6), st.integers(1, 12), st.floats(0, 5))
@settings(max_examples=50)
def test_the_same_picture_scores_one(seed: int, rows: int, lean: float) -> None:
    held = leaning(seed, rows, lean=lean)
    moved, added = hubness.centred(held, held.astype(np.float64).mean(axis=0))
    lengths = (held.astype(np.float64) ** 2).sum(axis=1)
    assert (moved.astype(np.float64) * held).sum(axis=1) + added == pytest.approx(lengths, abs=1e-6)


def test_an_evaluation_ranks_as_an_index_does(made: Make) -> None:
    rows, queries = leaning(2, 60), leaning(3, 9)
    ranked = rank(ArrayRows(queries), ArrayRows(rows), k=5, centred=True)
    assert ranked.scores is not None
    found = made(rows).search(queries, k=5, centred=True)
    assert ranked.rows.tolist() == [[match.row for match in matches] for matches in found]
    assert ranked.scores == pytest.approx(np.array([[m.score for m in matches] for matches in found]))
    plain = rank(ArrayRows(queries), ArrayRows(rows), k=5)
    assert ranked.rows.tolist() != plain.rows.tolist()


def test_the_mean_follows_what_is_added_and_removed(made: Make) -> None:
    rows, query = leaning(4, 30), leaning(5, 1)
    index = made(rows[:10])
    for held, change in (
        (rows[:10], lambda: None),
        (rows, lambda: add(index, rows[10:], first=10)),
        (rows[1:], lambda: index.remove(["/photos/0"])),
        (rows[1:], index.compact),
    ):
        change()
        (matches,) = index.search(query, k=30, centred=True)
        assert [match.score for match in matches] == pytest.approx(np.sort(oracle(query, held)[0])[::-1], abs=1e-6)


def test_an_empty_index_has_no_mean_and_no_match(made: Make) -> None:
    assert made(leaning(0, 0)).search(leaning(1, 2), centred=True) == [[], []]


class TestMean:
    def over(self, folder: Path, rows: np.ndarray, alive: np.ndarray) -> np.ndarray:
        path = folder / "m"
        path.write_bytes(np.asarray(rows, dtype="<f2").tobytes())
        held = FileRows(path, rows=len(rows), dim=rows.shape[1])
        try:
            return mean_of_some(held, alive)
        finally:
            held.close()

    def test_neither_the_removed_nor_the_damaged_count(self, tmp_path: Path) -> None:
        rows, alive = leaning(6, 300), np.ones(300, dtype=np.bool_)
        alive[[0, 7]] = False
        due = rows[alive][1:-2].astype(np.float64).mean(axis=0)
        rows[1], rows[298], rows[299] = np.nan, np.inf, 3.0
        assert self.over(tmp_path, rows, alive) == pytest.approx(due)

    def test_of_many_it_takes_some_evenly_spread(self) -> None:
        rows, alive = leaning(7, 9), np.ones(9, dtype=np.bool_)
        alive[[1, 2]] = False  # of rows 0, 3, 4, ..., 8 the first, the middle and the last
        found = mean_of_some(ArrayRows(np.float16(rows)), alive, most=3)
        assert found == pytest.approx(rows[[0, 5, 8]].mean(axis=0))


class TestMeanOfAll:
    @pytest.mark.parametrize("numbers", [1, 50, 1 << 22])
    @pytest.mark.parametrize("kind", [np.float16, np.float32])
    def test_all_count_of_whatever_length(self, numbers: int, kind: type, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(hubness, "_NUMBERS", numbers)
        rows = (leaning(8, 5000) * np.linspace(1, 40, 5000)[:, None]).astype(kind)
        assert mean_of_all(ArrayRows(rows)) == pytest.approx(rows.astype(np.float64).mean(axis=0), abs=1e-9)

    def test_no_rows_have_no_mean(self) -> None:
        assert mean_of_all(ArrayRows(np.zeros((0, 3)))).tolist() == [0, 0, 0]

    def test_a_damaged_row_is_named(self) -> None:
        rows = leaning(9, 40)
        rows[31, 2] = np.nan
        with pytest.raises(DamagedRowError, match="row 31 "):
            mean_of_all(ArrayRows(rows))
