"""The precision-recall curve and metres, against definitions spelled out with loops."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.datasets.benchmark import Benchmark
from salad.evaluation import metrics
from salad.evaluation.evaluate_benchmark import EvalSettings, judge
from salad.evaluation.metrics import Answers
from salad.evaluation.result import Ranked
from salad.geo import GeoPoint, shifted
from salad.images.photo import Photo

HOME = GeoPoint(48.1, 11.5)
Case = list[tuple[float, bool, bool]]
cases = st.lists(
    st.tuples(st.sampled_from([-math.inf, 0.1, 0.2, 0.5, 0.9]), st.booleans(), st.booleans()),
    min_size=1,
    max_size=12,
)


def points(case: Case) -> list[tuple[float, float, float]]:
    """Threshold, precision and recall, by counting at each score."""
    answerable = sum(can for _, _, can in case)
    found = []
    for threshold in sorted({score for score, _, _ in case if math.isfinite(score)}, reverse=True):
        made = [right and can for score, right, can in case if score >= threshold]
        recall = 100 * sum(made) / answerable if answerable else 0.0
        found.append((threshold, 100 * sum(made) / len(made), recall))
    return found


def answers(case: Case) -> Answers:
    scores, right, answerable = zip(*case, strict=True)
    return Answers(np.array(scores), np.array(right), np.array(answerable))


@given(cases)
def test_the_curve_against_counting(case: Case) -> None:
    due, curve = points(case), answers(case).curve()
    assert curve.thresholds.tolist() == [threshold for threshold, _, _ in due]
    assert curve.precision.tolist() == pytest.approx([precision for _, precision, _ in due])
    assert curve.recall.tolist() == pytest.approx([recall for _, _, recall in due])
    area = before = 0.0
    for _, precision, recall in due:
        area, before = area + (recall - before) * precision / 100, recall
    assert curve.area == pytest.approx(area)
    sure = [(recall, threshold) for threshold, precision, recall in due if precision == 100]
    assert curve.recall_at_full_precision == pytest.approx(max(sure)[0] if sure else 0.0)
    assert curve.surest == (min(threshold for _, threshold in sure) if sure else None)


@given(cases, st.data())
def test_a_query_that_counts_twice_is_there_twice(case: Case, data: st.DataObject) -> None:
    times = data.draw(st.lists(st.integers(0, 3), min_size=len(case), max_size=len(case)))
    repeated = [one for one, count in zip(case, times, strict=True) for _ in range(count)]
    drawn = answers(case).curve(np.array([times], dtype=float))
    if repeated:
        curve = answers(repeated).curve()
        assert drawn.area.tolist() == pytest.approx([float(curve.area)])
        assert drawn.recall_at_full_precision.tolist() == pytest.approx([float(curve.recall_at_full_precision)])


def test_an_unanswerable_query_is_a_chance_to_be_wrong() -> None:
    without = answers([(0.9, True, True), (0.5, True, True)]).curve()
    assert (without.area, without.recall_at_full_precision) == (100, 100)
    sure = answers([(0.9, True, True), (0.5, True, True), (0.7, False, False)]).curve()
    assert sure.recall_at_full_precision == 50
    assert sure.area == pytest.approx(50 + 50 * 2 / 3)
    assert sure.surest == 0.9
    assert answers([(0.9, False, False), (0.5, True, True)]).curve().surest is None


@given(
    st.lists(st.tuples(st.floats(0, 100), st.integers(0, 3)), min_size=1, max_size=9).filter(
        lambda pairs: sum(count for _, count in pairs) > 0
    )
)
def test_medians_and_shares_of_repeated_queries(pairs: list[tuple[float, int]]) -> None:
    far, times = np.array([one for one, _ in pairs]), np.array([[float(count) for _, count in pairs]])
    repeated = sorted(np.repeat(far, times[0].astype(int)).tolist())
    assert metrics.weighted_medians(far, times)[0] == repeated[(len(repeated) - 1) // 2]
    due = [100 * sum(one <= limit for one in repeated) / len(repeated) for limit in metrics.WITHIN_M]
    assert metrics.percent_within(far, times)[0].tolist() == pytest.approx(due)


def placed(name: str, north: float | None) -> Photo:
    return Photo(Path(name), None if north is None else shifted(HOME, north, 0.0))


def test_metres_of_a_result() -> None:
    references = [placed("r0", 0.0), placed("r1", 30.0), placed("r2", None), placed("r3", 500.0)]
    queries = [
        placed("q0", 4.0),
        placed("q1", 50.0),
        placed("q2", 0.0),
        placed("q3", None),
        placed("q4", 0.0),
    ]
    positives = [np.array([0]), np.array([1]), np.array([0]), np.array([0]), np.zeros(0, np.int64)]
    ranked = Ranked(np.array([[0], [1], [2], [0], [3]]))
    drop = judge(Benchmark("b", "radius 25 m", references, queries, positives), ranked, EvalSettings(), model="m")
    far = drop.distances
    assert far is not None
    assert far.known == 2  # q2's match and q3 have no position, q4 no answer
    assert far.median == pytest.approx(12, abs=0.01)
    assert far.within == {5: 50.0, 10: 50.0, 25: 100.0, 50: 100.0}
    assert far.median_interval.low == pytest.approx(4, abs=0.01)
    assert [one.metres is None for one in drop.per_query] == [False, False, True, True, False]
    miss = judge(
        Benchmark("b", "p", references, queries, positives, unanswerable_rule="miss"),
        ranked,
        EvalSettings(),
        model="m",
    )
    assert miss.distances is not None
    assert miss.distances.known == 3
    assert miss.distances.within[50] == pytest.approx(200 / 3)


def test_a_query_without_a_match_is_infinitely_far() -> None:
    references, queries = [placed("r0", 0.0)], [placed("q0", 1.0), placed("q1", 1.0), placed("q2", 1.0)]
    right = [np.array([0])] * 3
    ranked = Ranked(np.array([[0], [-1], [-1]]), np.array([[0.5], [-np.inf], [-np.inf]]))
    result = judge(Benchmark("b", "p", references, queries, right), ranked, EvalSettings(), model="m")
    assert result.distances is not None
    assert math.isinf(result.distances.median)
    assert result.distances.as_dict()["median"] is None
    assert result.distances.within[5] == pytest.approx(100 / 3)
    assert result.precision_recall is not None
    assert result.precision_recall.area == pytest.approx(100 / 3)
    assert result.per_query[1].matches == ()
    nothing = Ranked(np.full((3, 1), -1), np.full((3, 1), -np.inf))
    empty = judge(Benchmark("b", "p", references, queries, right), nothing, EvalSettings(), model="m")
    assert (empty.distances, empty.precision_recall, empty.recall[1]) == (None, None, 0.0)
