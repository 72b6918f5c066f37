"""Rankings on fixed data against plain float64 numpy: the index's, and the one that judges benchmarks.

Both are exact, best first, equal scores in order of row. They differ in what they take: the index holds rows of
length 1 as float16 and passes over what is damaged; judging takes rows of any length as float32 and refuses what is
not finite. Centred, the index goes by the mean of at most 4,096 rows spread evenly, judging by that of all.
"""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import salad
from pins.where import BenchmarkError, Filter, Held, nearest, salad_says

Floats = npt.NDArray[np.float64]
MANY, DIM, MOST = 5000, 24, 4096
SAME = (3, 700, 2500, 2501, 4999)  # rows that hold one descriptor


def clustered(count: int, seed: int) -> npt.NDArray[np.float32]:
    """Rows of length 1 that lean one way, as descriptors of one town do: centring moves them."""
    rows = np.random.default_rng(seed).standard_normal((count, DIM)) + 1.5 * (np.arange(DIM) < 4)
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def oracle(queries: Floats, rows: Floats, *, k: int, mean: Floats | None = None) -> tuple[Floats, Floats]:
    """Rows and scores `[Q, k]`; centred where a mean is given: q . r - (m . r - m . q) / 2."""
    scores = np.array([(rows * query).sum(axis=1) for query in queries.astype(np.float64)])
    if mean is not None:
        scores -= ((rows @ mean)[None] - (queries.astype(np.float64) @ mean)[:, None]) / 2
        scores[:, list(SAME)] = scores[:, [SAME[0]]]  # a product of matrices rounds equal rows unequally
    order = np.argsort(-scores, axis=1, kind="stable")[:, :k]
    return order, np.take_along_axis(scores, order, axis=1)


@pytest.fixture(scope="module")
def rows() -> npt.NDArray[np.float32]:
    made = clustered(MANY, seed=1)
    made[list(SAME)] = made[SAME[0]]
    return made


@pytest.fixture(scope="module")
def queries(rows: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Few enough and many: engines may take another road from some number on; one asks for the rows that tie."""
    return np.concatenate([rows[SAME[0] : SAME[0] + 1], clustered(39, seed=2)])


@pytest.fixture(scope="module")
def index(rows: npt.NDArray[np.float32], tmp_path_factory: pytest.TempPathFactory) -> salad.Index:
    known = [
        salad.Photo(
            Path(f"/photos/{row:04}.jpg"),
            salad.GeoPoint(row / 1000, 0.5),
            time=datetime(2024, 1, 1) + timedelta(hours=row),
        )
        for row in range(MANY)
    ]
    made = salad.Index.create(tmp_path_factory.mktemp("many") / "i", dim=DIM, fingerprint="f", model="m")
    made.add(known, rows, identities=[f"{row:032x}" for row in range(MANY)])
    return made


def matches(
    index: salad.Index, queries: Floats, *, k: int, where: Filter | None = None, centred: bool = False
) -> tuple[Floats, Floats]:
    found = index.search(queries, k=k, where=where, centred=centred)
    return tuple(np.array([[getattr(one, name) for one in best] for best in found]) for name in ("row", "score"))


def same(found: tuple[Floats, Floats], wanted: tuple[Floats, Floats], *, within: float = 1e-9) -> None:
    np.testing.assert_array_equal(found[0], wanted[0])
    np.testing.assert_allclose(found[1], wanted[1], rtol=0, atol=within)


@pytest.mark.parametrize("k", [1, 5, 100])
@pytest.mark.parametrize("count", [1, 7, 40])
class TestIndex:
    def test_plain(self, index: salad.Index, rows: Floats, queries: Floats, k: int, count: int) -> None:
        stored = rows.astype(np.float16).astype(np.float64)
        found = matches(index, queries[:count], k=k)
        same(found, oracle(queries[:count], stored, k=k))
        assert found[0][0][: min(k, 5)].tolist() == list(SAME)[:k]

    def test_centred(self, index: salad.Index, rows: Floats, queries: Floats, k: int, count: int) -> None:
        """By the mean of 4,096 rows spread evenly, though there are more."""
        stored = rows.astype(np.float16).astype(np.float64)
        some = stored[np.linspace(0, MANY - 1, MOST).astype(np.int64)]
        found = matches(index, queries[:count], k=k, centred=True)
        same(found, oracle(queries[:count], stored, k=k, mean=some.mean(axis=0)), within=2e-7)
        of_all = oracle(queries, stored, k=1, mean=stored.mean(axis=0))
        of_some = oracle(queries, stored, k=1, mean=some.mean(axis=0))
        assert np.abs(of_some[1] - of_all[1]).max() > 1e-6  # so the two means can be told apart here

    def test_filtered(self, index: salad.Index, rows: Floats, queries: Floats, k: int, count: int) -> None:
        """A filter holds before the ranking: the best k of those it lets through."""
        stored = rows.astype(np.float16).astype(np.float64)
        where = Filter(box=(0.0, -1.0, 2.5005, 1.0), since=datetime(2024, 1, 1) + timedelta(hours=100))
        found = matches(index, queries[:count], k=k, where=where)
        low = 100
        order, scores = oracle(queries[:count], stored[low:2501], k=k)
        same(found, (order + low, scores))


def test_a_filter_moves_no_mean(index: salad.Index, queries: Floats) -> None:
    every = {one.row: one.score for one in index.search(queries[5], k=MANY, centred=True)[0]}
    where = Filter(box=(1.0, -1.0, 1.5, 1.0))
    (few,) = index.search(queries[5], k=MANY, where=where, centred=True)
    assert {one.row: one.score for one in few} == {row: every[row] for row in range(1000, 1501)}


def test_more_is_asked_for_than_there_is(index: salad.Index, queries: Floats) -> None:
    assert [len(best) for best in index.search(queries[:2], k=MANY + 1)] == [MANY, MANY]
    few = Filter(box=(0.0, -1.0, 0.0025, 1.0))
    assert [[one.row for one in best] for best in index.search(queries[0], k=9, where=few)] == [
        np.argsort(-_scores(index, queries[0], 3), kind="stable").tolist()
    ]
    assert index.search(np.zeros((0, DIM)), k=3) == []


def _scores(index: salad.Index, query: Floats, count: int) -> Floats:
    found = {one.row: one.score for one in index.search(query, k=MANY)[0]}
    return np.array([found[row] for row in range(count)])


def test_an_empty_index_answers_with_nothing(tmp_path: Path) -> None:
    with salad.Index.create(tmp_path / "i", dim=DIM, fingerprint="f", model="m") as index:
        for centred in (False, True):
            assert index.search(np.ones((2, DIM)), k=3, centred=centred) == [[], []]


class TestJudging:
    """Evaluation's own ranking: `nearest` over descriptors in memory."""

    @pytest.mark.parametrize("k", [1, 20, MANY + 5])
    @pytest.mark.parametrize("centred", [False, True])
    @pytest.mark.parametrize("length", [1.0, 37.5])
    def test_any_length(self, rows: Floats, queries: Floats, k: int, centred: bool, length: float) -> None:
        lengths = np.linspace(1.0, length, MANY, dtype=np.float32)[:, None]
        lengths[list(SAME)] = length
        held = (rows * lengths).astype(np.float32)
        mean = held.astype(np.float64).mean(axis=0) if centred else None  # of all, however many
        found = nearest(Held(queries), Held(held), k=k, centred=centred)
        assert found.scores is not None
        order, scores = oracle(queries, held.astype(np.float64), k=k, mean=mean)
        first = slice(None, 100)  # of thousands of scores two may differ by less than a float32 query is rounded
        within = 2e-7 * length if centred else 1e-9
        same((found.rows[:, first], found.scores[:, first]), (order[:, first], scores[:, first]), within=within)
        assert found.rows.shape == (40, min(k, MANY))
        assert (np.sort(found.rows, axis=1)[:, :1] >= 0).all()

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("centred", [False, True])
    def test_what_is_not_finite_is_an_error(self, rows: Floats, queries: Floats, bad: float, centred: bool) -> None:
        broken = rows.copy()
        broken[4321, 7] = bad
        with pytest.raises(BenchmarkError, match="reference 4321"):
            nearest(Held(queries), Held(broken), k=3, centred=centred)
        with pytest.raises(BenchmarkError, match="query 4321" if not centred else "query"):
            nearest(Held(broken), Held(queries), k=3, centred=centred)

    def test_sides_of_two_dimensions_are_an_error(self, rows: Floats, queries: Floats) -> None:
        with pytest.raises(BenchmarkError):
            nearest(Held(queries), Held(rows[:, :-1]), k=3)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize("length", [1.0, 5.0])
def test_descriptors_from_outside(tmp_path: Path, dtype: type, length: float) -> None:
    """`salad evaluate --descriptors`: `.npy` files, ranked as they stand, by dot product."""
    references, queries = clustered(300, seed=3), clustered(9, seed=4)
    references *= np.linspace(1.0, length, 300, dtype=np.float32)[:, None]
    references[250] = references[20]
    for side, made in (("references", references), ("queries", queries)):
        (tmp_path / side).mkdir()
        for number in range(len(made)):
            (tmp_path / side / f"{number:04}.jpg").touch()
        np.save(tmp_path / f"{side}.npy", made.astype(dtype))
    folders = ("--references", tmp_path / "references", "--queries", tmp_path / "queries")
    files = (tmp_path / "references.npy", tmp_path / "queries.npy")
    saved = tmp_path / "result.json"
    ran = salad_says("evaluate", *folders, "--frames", "2", "--descriptors", *files, "--save", saved)
    assert ran.code == 0, ran.err
    held = [made.astype(dtype).astype(np.float64) for made in (queries, references)]
    order, scores = oracle(held[0], held[1], k=20)
    verdicts = json.loads(saved.read_text(encoding="utf-8"))["verdicts"]
    wide = [[one[name] for one in verdicts] for name in ("matches", "scores")]
    same((np.array(wide[0]), np.array(wide[1])), (order, scores), within=1e-6)
    references[7, 1] = np.nan
    np.save(files[0], references)
    broken = salad_says("evaluate", *folders, "--frames", "2", "--descriptors", *files)
    assert (broken.code, "row 7" in broken.err) == (2, True)
