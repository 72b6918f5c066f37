"""Recall, ranking and evaluation, against definitions spelled out with loops."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from salad.datasets.benchmark import Benchmark
from salad.datasets.compact_lists import PhotoList
from salad.errors import BenchmarkError, ModelError
from salad.evaluation.evaluate_benchmark import CENTRED, EvalSettings, evaluate, judge, rank, with_leaks
from salad.evaluation.result import Ranked
from salad.images.photo import Photo
from salad.models.fake import FakeDescriber
from salad.network.config import Calibration
from salad.search import exact
from salad.search.base import ArrayRows, Hits
from salad.search.brute_force import BruteForceSearcher

KS = (1, 2, 3, 5, 8)
# A busy machine is no failure: no test here depends on time.
unhurried = settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow])


@st.composite
def rankings(draw: st.DrawFn) -> tuple[np.ndarray, list[np.ndarray]]:
    """Rankings of all references, with right rows, of which some query has at least one."""
    references, queries = draw(st.integers(1, 8)), draw(st.integers(1, 6))
    ranked = np.array([draw(st.permutations(range(references))) for _ in range(queries)], dtype=np.int64)
    right = [draw(st.sets(st.integers(0, references - 1))) for _ in range(queries)]
    right[0] |= {0}
    return ranked, [np.array(sorted(rows), dtype=np.int64) for rows in right]


def by_hand(ranked: np.ndarray, positives: list[np.ndarray], k: int, *, drop: bool) -> float:
    pairs = [(set(row[:k].tolist()), set(right.tolist())) for row, right in zip(ranked, positives, strict=True)]
    counted = [bool(first & right) for first, right in pairs if right or not drop]
    return 100 * sum(counted) / len(counted)


def recall(
    ranked: np.ndarray, positives: list[np.ndarray], ks: Sequence[int] = KS, rule: Any = "drop"
) -> dict[int, float]:
    """Recall as a result has it, of photos that nobody opens."""
    references = 1 + max([0, *ranked.ravel().tolist(), *(row for right in positives for row in right)])
    sides = (
        [Photo(Path(f"{side}{n}.jpg")) for n in range(count)]
        for side, count in (("r", references), ("q", len(positives)))
    )
    benchmark, settings_ = Benchmark("b", "p", *sides, positives), EvalSettings(ks, rule, times=2)
    settings_.check(benchmark)
    result = judge(benchmark, Ranked(ranked), settings_, model="m")
    assert result.unanswerable == sum(not len(right) for right in positives)
    return result.recall


class TestRecall:
    @unhurried
    @given(rankings())
    def test_against_the_definition(self, case: tuple[np.ndarray, list[np.ndarray]]) -> None:
        for rule in ("drop", "miss"):
            for k, percent in recall(*case, rule=rule).items():
                assert percent == pytest.approx(by_hand(*case, k, drop=rule == "drop"))

    @unhurried
    @given(rankings())
    def test_grows_with_k_and_ends_at_all(self, case: tuple[np.ndarray, list[np.ndarray]]) -> None:
        percents = list(recall(*case).values())
        assert percents == sorted(percents)
        assert percents[-1] == 100  # 8 is all the references there are

    @unhurried
    @given(rankings())
    def test_a_perfect_ranking_is_100(self, case: tuple[np.ndarray, list[np.ndarray]]) -> None:
        ranked, positives = case
        pairs = zip(ranked, positives, strict=True)
        perfect = [[*right, *(row for row in rows if row not in right)] for rows, right in pairs]
        assert recall(np.array(perfect), positives) == dict.fromkeys(KS, 100.0)

    @unhurried
    @given(rankings(), st.data())
    def test_the_order_of_references_does_not_matter(
        self, case: tuple[np.ndarray, list[np.ndarray]], data: st.DataObject
    ) -> None:
        ranked, positives = case
        moved = np.array(data.draw(st.permutations(range(ranked.shape[1]))))
        again = recall(moved[ranked], [np.sort(moved[right]) for right in positives])
        assert again == recall(*case)

    def test_padding_is_never_right(self) -> None:
        assert recall(np.array([[-1, -1]]), [np.array([1])], [1, 2]) == {1: 0.0, 2: 0.0}

    def test_refusals(self) -> None:
        ranked, right, nothing = np.array([[0]]), [np.array([0])], [np.array([], dtype=np.int64)]
        with pytest.raises(BenchmarkError, match="1 rankings but 2 queries"):
            recall(ranked, right * 2)
        for ks in ([0, 1], []):
            with pytest.raises(BenchmarkError, match="whole numbers from 1"):
                recall(ranked, right, ks)
        with pytest.raises(BenchmarkError, match="none of 1 queries has a right reference"):
            recall(ranked, nothing)
        assert recall(ranked, nothing, [1], "miss") == {1: 0.0}  # all unanswerable may all be misses


small = st.integers(-3, 3)  # few values, so that scores tie often, and float32 sums them exactly


class TestRank:
    @unhurried
    @given(
        queries=st.lists(st.tuples(small, small), min_size=1, max_size=5),
        references=st.lists(st.tuples(small, small), min_size=1, max_size=9),
        k=st.integers(1, 12),
    )
    def test_against_a_sort_of_everything(
        self, queries: list[tuple[int, int]], references: list[tuple[int, int]], k: int
    ) -> None:
        held = (ArrayRows(np.array(side, np.float32)) for side in (queries, references))
        found = rank(*held, k=k).rows
        for query, rows in zip(queries, found, strict=True):
            scores = [query[0] * x + query[1] * y for x, y in references]
            assert rows.tolist() == sorted(range(len(references)), key=lambda row: (-scores[row], row))[:k]
        assert found.dtype == np.int64

    def test_what_ties_but_for_rounding_is_put_in_order_of_row(self) -> None:
        rng = np.random.default_rng(0)
        one = rng.standard_normal((3, 700)).astype(np.float32)
        references = np.concatenate([one] * 40)  # every third row is the same
        found = rank(ArrayRows(one), ArrayRows(references), k=50)
        assert found.scores is not None
        for number, (rows, scores) in enumerate(zip(found.rows, found.scores, strict=True)):
            assert rows[:40].tolist() == list(range(number, 120, 3))
            assert len(set(scores[:40].tolist())) == 1
            assert scores[0] == pytest.approx(float(one[number].astype(float) @ one[number]), rel=1e-12)

    def test_another_searcher_finds_what_it_finds(self) -> None:
        class First(BruteForceSearcher):
            def search(self, queries: np.ndarray, *, k: int, allowed: Any = None) -> Hits:
                return super().search(queries, k=k, allowed=np.arange(len(self)) < 2)

        rng = np.random.default_rng(1)
        queries, references = (ArrayRows(rng.standard_normal((9, 4))) for _ in range(2))
        for centred in (False, True):
            found = rank(queries, references, k=3, centred=centred, searcher=First)
            assert np.sort(found.rows, axis=1).tolist() == [[-1, 0, 1]] * 9

    def test_refusals(self) -> None:
        ones = np.ones((2, 3), np.float32)
        sound = ArrayRows(ones)
        with pytest.raises(BenchmarkError, match="3 numbers each and references 2"):
            rank(sound, ArrayRows(ones[:, :2]), k=1)
        for wrong in (np.nan, np.inf, 1e30):
            bad = ones.copy()
            bad[1, 0] = wrong
            with pytest.raises(BenchmarkError, match=r"query 1 .*NaN"):
                rank(ArrayRows(bad), sound, k=1)
            with pytest.raises(BenchmarkError, match=r"reference 1 .*NaN"):
                rank(sound, ArrayRows(bad), k=1)
            with pytest.raises(BenchmarkError, match=r"reference 1 .*NaN"):
                rank(sound, ArrayRows(bad), k=1, centred=True)


@st.composite
def whole_cases(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, list[list[int]]]:
    """Descriptors of few values, so that many tie and some are the same, and what is right, often nothing."""
    dim = draw(st.integers(1, 3))
    rows = st.lists(st.lists(st.integers(-2, 2), min_size=dim, max_size=dim), min_size=1, max_size=12)
    queries, references = np.array(draw(rows)), np.array(draw(rows))
    right = [sorted(draw(st.sets(st.integers(0, len(references) - 1), max_size=3))) for _ in queries]
    return queries, references, right


def plain_recall(
    queries: np.ndarray, references: np.ndarray, right: list[list[int]], k: int, *, drop: bool
) -> float | None:
    """Recall@k with loops and sorts, and nothing of ours."""
    won = asked = 0
    for query, rows in zip(queries.tolist(), right, strict=True):
        if drop and not rows:
            continue
        scores = [sum(a * b for a, b in zip(query, one, strict=True)) for one in references.tolist()]
        first = sorted(range(len(scores)), key=lambda row: (-scores[row], row))[:k]
        asked, won = asked + 1, won + any(row in rows for row in first)
    return 100 * won / asked if asked else None


class TestAgainstAnIndependentComputation:
    @settings(max_examples=500, deadline=None)
    @given(whole_cases(), st.sampled_from(["drop", "miss"]), st.sampled_from([1, 5, 1 << 20]))
    def test_recall_on_random_data_with_ties_duplicates_and_empty_positives(
        self, case: tuple[np.ndarray, np.ndarray, list[list[int]]], rule: Any, block: int
    ) -> None:
        queries, references, right = case
        positives = [np.array(rows, dtype=np.int64) for rows in right]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(exact, "_BLOCK", block)
            patch.setattr(exact, "_BATCH", block)
            ranked = rank(ArrayRows(queries), ArrayRows(references), k=max(KS)).rows
        due = {k: plain_recall(queries, references, right, k, drop=rule == "drop") for k in KS}
        if due[1] is None:
            with pytest.raises(BenchmarkError, match="has a right reference"):
                recall(ranked, positives, rule=rule)
            return
        assert recall(ranked, positives, rule=rule) == pytest.approx(due)


@pytest.fixture
def drive(tmp_path: Path) -> Benchmark:
    """Six places photographed twice, the second time a little lighter; the last query shows none of them."""
    rng = np.random.default_rng(0)
    references, queries = [], []
    for number in range(6):
        pixels = rng.integers(0, 200, (4, 4, 3), dtype=np.uint8)
        for side, gain in ((references, 0), (queries, 30)):
            path = tmp_path / f"{'rq'[side is queries]}{number}.png"
            Image.fromarray(pixels + np.uint8(gain)).resize((40, 40)).save(path)
            side.append(Photo(path))
    positives = [np.array([number]) for number in range(5)] + [np.array([], dtype=np.int64)]
    return Benchmark("drive", "frames ±0", tuple(references), tuple(queries), tuple(positives), ("a note",))


class Broken(FakeDescriber):
    """Says one dimension and gives another, or numbers that are none."""

    def describe(self, photos: Any, *, batch_size: int = 16) -> Any:
        described = super().describe(photos, batch_size=batch_size)
        return described[:, 1:] if self.name == "short" else described * np.nan


class TestEvaluate:
    def test_the_whole_road(self, drive: Benchmark) -> None:
        seen: list[tuple[int, int]] = []
        result = evaluate(
            drive,
            FakeDescriber(),
            ks=(1, 5, 99),
            batch_size=5,
            progress=lambda done, total: seen.append((done, total)),
        )
        assert result.recall == {1: 100.0, 5: 100.0, 99: 100.0}
        assert seen == [(5, 12), (6, 12), (11, 12), (12, 12)]
        assert (result.benchmark, result.notes) == ("drive", ("a note",))

    def test_json(self, drive: Benchmark) -> None:
        shown = json.loads(json.dumps(evaluate(drive, FakeDescriber()).as_dict(), allow_nan=False))
        assert shown["seconds"] >= 0
        old = ("protocol", "queries", "references", "unanswerable", "recall", "model")
        assert {name: shown[name] for name in old} == {
            "protocol": "frames ±0",
            "queries": 6,
            "references": 6,
            "unanswerable": 1,
            "recall": {"1": 100.0, "5": 100.0, "10": 100.0, "20": 100.0},
            "model": "fake",
        }
        assert shown["drawn"] == {
            "by": "block",
            "units": 5,
            "length": 1,
            "level": 0.95,
            "times": 2000,
            "seed": 0,
        }
        low, high = shown["intervals"]["1"]
        assert 30 < low < 50  # five of five
        assert high == 100
        assert shown["precision_recall"]["area"] <= 100
        assert (shown["metres"], shown["leaks"], shown["benchmark"]) == (None, None, "drive")
        assert shown["fingerprint"] == FakeDescriber().fingerprint

    def test_misses_are_named_in_the_protocol(self, drive: Benchmark) -> None:
        result = evaluate(drive, FakeDescriber(), ks=(1,), unanswerable="miss")
        assert result.recall[1] == pytest.approx(500 / 6)
        assert result.protocol == "frames ±0, unanswerable queries count as misses"

    def test_a_rule_that_the_protocol_brings_is_part_of_its_name(self, drive: Benchmark) -> None:
        published = replace(drive, protocol="msls-val-11k", unanswerable_rule="miss")
        result = evaluate(published, FakeDescriber(), ks=(1,))
        assert (result.protocol, result.unanswerable_rule) == ("msls-val-11k", "miss")
        assert result.recall[1] == pytest.approx(500 / 6)
        told = evaluate(published, FakeDescriber(), ks=(1,), unanswerable="drop")
        assert (told.protocol, told.recall[1]) == ("msls-val-11k, unanswerable queries left out", 100.0)

    def test_a_model_is_judged_as_it_is_used(self, drive: Benchmark) -> None:
        class Centred(FakeDescriber):
            calibration = Calibration(centred=True)

        photos = [[photo.path for photo in side] for side in (drive.queries, drive.references)]
        held = [ArrayRows(FakeDescriber().describe(side)) for side in photos]
        for model, plain, name, centred, notes in (
            (Centred(), False, "fake", True, ("a note", CENTRED)),
            (Centred(), True, "fake, plain", False, ("a note",)),
            (FakeDescriber(), False, "fake", False, ("a note",)),
            (FakeDescriber(), True, "fake", False, ("a note",)),
        ):
            result = evaluate(drive, model, ks=(1, 3), plain=plain)
            due = rank(*held, k=3, centred=centred)
            assert [one.matches for one in result.per_query] == [tuple(rows) for rows in due.rows.tolist()]
            assert due.scores is not None
            assert np.array([one.scores for one in result.per_query]) == pytest.approx(due.scores)
            assert (result.model, result.notes) == (name, notes)

    def test_verdicts_say_what_became_of_each_query(self, drive: Benchmark) -> None:
        result = evaluate(drive, FakeDescriber(), ks=(1, 3))
        assert [one.query for one in result.per_query] == [f"q{number}.png" for number in range(6)]
        for number, one in enumerate(result.per_query[:5]):
            assert (one.first_right, one.right, one.positives) == (1, number, 1)
            assert one.matches[0] == number
            assert one.scores is not None
            assert len(one.matches) == len(one.scores) == 3
            assert list(one.scores) == sorted(one.scores, reverse=True)
            assert result.known[number].name == f"r{number}.png"
        last = result.per_query[5]
        assert (last.first_right, last.right, last.positives, last.hit(99)) == (None, None, 0, False)
        assert {row for one in result.per_query for row in one.matches} <= result.known.keys()

    def test_as_many_rankings_as_queries(self, drive: Benchmark) -> None:
        with pytest.raises(BenchmarkError, match="1 rankings but 6 queries"):
            judge(drive, Ranked(np.array([[0]])), EvalSettings(), model="m")

    def test_batches_do_not_matter(self, drive: Benchmark) -> None:
        recalls = [evaluate(drive, FakeDescriber(dim=2), batch_size=size).recall for size in (1, 7, 64)]
        assert recalls[0] == recalls[1] == recalls[2]

    def test_a_photo_that_cannot_be_read(self, drive: Benchmark) -> None:
        drive.queries[3].path.write_bytes(b"not an image")
        with pytest.raises(BenchmarkError, match=r"no figure.*q3\.png"):
            evaluate(drive, FakeDescriber())

    @pytest.mark.parametrize("name", ["short", "nan"])
    def test_a_broken_model(self, drive: Benchmark, name: str) -> None:
        with pytest.raises(ModelError, match=f"'{name}' gave"):
            evaluate(drive, Broken(name=name))

    def test_refused_before_anything_is_described(self, drive: Benchmark) -> None:
        nothing = tuple(np.array([], dtype=np.int64) for _ in drive.queries)
        hopeless = Benchmark("x", "p", drive.references, drive.queries, nothing)
        for case, ks in ((hopeless, (1,)), (drive, (0,))):
            with pytest.raises(BenchmarkError):
                evaluate(case, FakeDescriber(), ks=ks, progress=lambda *_: pytest.fail("it began"))

    def test_a_photo_on_both_sides_is_told(self, drive: Benchmark) -> None:
        result = evaluate(drive, FakeDescriber(), ks=(1, 3))
        assert with_leaks(result, drive).leaks == ()
        shutil.copy(drive.references[4].path, drive.queries[2].path)
        (leak,) = with_leaks(evaluate(drive, FakeDescriber(), ks=(1, 3)), drive).leaks or ()
        assert (leak.query, leak.reference, leak.kind) == (2, 4, "file")

    def test_a_set_is_told_from_another_by_its_names_and_what_is_right(self, drive: Benchmark) -> None:
        one = evaluate(drive, FakeDescriber(), ks=(1,))
        listed = PhotoList(drive.references[0].path.parent, [photo.path.name for photo in drive.references])
        assert evaluate(replace(drive, references=listed), FakeDescriber(), ks=(1,)).digests == one.digests
        other = replace(drive, positives=[*drive.positives[:5], np.array([0])])
        names, right = evaluate(other, FakeDescriber(), ks=(1,)).digests
        assert names == one.digests[0]
        assert right != one.digests[1]
