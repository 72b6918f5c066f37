"""What an evaluation measures: recall@k, precision against recall, and localisation error, each with how sure it is.

A query without any right reference cannot be answered. Each result says how many there were; they are left
out of recall and localisation error (`drop`, the rule for a user's own folders) or stay in them as misses (`miss`,
the rule of some published protocols), and the protocol says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from salad.evaluation.bootstrap import Interval, SamplingDesign, nested, percentile_interval, proportion_interval
from salad.evaluation.checked import count, interval, real
from salad.tables import whole

if TYPE_CHECKING:
    from salad.evaluation.result import QueryResult

KS = (1, 5, 10, 20)
WITHIN_M = (5, 10, 25, 50)  # metres; 25 is the field's own measure of a right answer


def recall(
    results: Sequence[QueryResult],
    counted: Int64[np.ndarray, " counted"],
    ks: Sequence[int],
    design: SamplingDesign,
) -> tuple[dict[int, float], dict[int, Interval], dict[str, Any]]:
    """Recall@k: the percentage of queries with a right reference among the first k.

    Args:
        results: What became of each query. One with fewer matches than k is taken to name every reference there is.
        counted: Numbers of the queries that a share is taken of, one at least.
        ks: Which k to report.
        design: Which queries hang together.

    Returns:
        Percent by k, in the order asked for; where the truth of each lies 95 times in 100; and how that was found:
        what was drawn again together, how often, and from which seed.
    """
    ranks = np.array([results[number].first_right or math.inf for number in counted.tolist()])
    hits = (ranks[:, None] <= np.array(ks)).astype(np.float64)  # [counted, ks]
    # Where frames of a drive hang together, R@1 says how far: all k are drawn alike, so that they can be nested.
    resampling = design.resampling(counted, hits[:, 0])
    draws = resampling.draws(lambda weights: 100 * (weights @ hits) / weights.sum(axis=1, keepdims=True))
    percent = {k: float(100.0 * hits[:, column].mean()) for column, k in enumerate(ks)}
    intervals = {
        k: proportion_interval(percent[k], draws[:, column], units=resampling.units, counted=len(counted))
        for column, k in enumerate(ks)
    }
    return percent, nested(intervals), resampling.as_dict()


@dataclass(frozen=True, eq=False)
class Curve:
    """Precision against recall, one point for each score that is some query's best, the highest first.

    Attributes:
        thresholds: `[points]` the score from which on answers are believed.
        precision: `[points]` in percent; `[draws, points]` of queries drawn again.
        recall: As many, in percent.
    """

    thresholds: Float64[np.ndarray, " points"]
    precision: Float64[np.ndarray, "*draws points"]
    recall: Float64[np.ndarray, "*draws points"]

    @property
    def area(self) -> Float64[np.ndarray, "*draws"]:
        """The area under the curve in percent, by steps (average precision): nothing is drawn between points."""
        # From no recall at all: the first step counts as well.
        steps = np.diff(self.recall, axis=-1, prepend=0.0)
        return np.asarray((steps * self.precision).sum(axis=-1) / 100)

    @property
    def recall_at_full_precision(self) -> Float64[np.ndarray, "*draws"]:
        """The most recall, in percent, at which no answer is wrong."""
        # Counts are whole numbers, and 100 * n / n is 100 to the last bit.
        return np.asarray(np.where(self.precision == 100, self.recall, 0.0).max(axis=-1, initial=0.0))

    @property
    def surest(self) -> float | None:
        """The lowest threshold at which no answer is wrong; None where the surest answer is. Not for draws."""
        full = np.flatnonzero(self.precision == 100)
        return float(self.thresholds[full[-1]]) if full.size else None


@dataclass(frozen=True, eq=False)
class Answers:
    """What the precision-recall curve is of: `[queries]` each.

    A query is answered where its best score is at least the threshold, and the answer is right where the best match
    is. Precision is the share of right ones among the answers; recall is their share among the queries that have an
    answer. A query without a right reference can only be answered wrongly, whatever a protocol says of it in recall@k.

    Attributes:
        scores: The best score of each query; -infinity where it has no match.
        right: Whether its best match is right.
        answerable: Whether any reference is.
    """

    scores: Float64[np.ndarray, " queries"]
    right: Bool[np.ndarray, " queries"]
    answerable: Bool[np.ndarray, " queries"]

    @classmethod
    def of(cls, results: Sequence[QueryResult]) -> Answers | None:
        """Best scores and whether the best matches are right; None where a query has no scores."""
        scores = [one.scores for one in results]
        best = [-math.inf if not each else each[0] for each in scores]
        if not scores or None in scores:
            return None
        right = np.array([one.hit(1) for one in results])
        return cls(np.array(best), right, np.array([one.positives > 0 for one in results]))

    def curve(self, weights: Float64[np.ndarray, "draws queries"] | None = None) -> Curve:
        """The curve of all of them; a row a draw where `weights` say how often each query counts."""
        order = np.argsort(-self.scores, kind="stable")
        ordered = self.scores[order]
        # The last of each run of equal scores: no threshold parts those. A query without a match is never answered.
        ends = np.append(np.flatnonzero(ordered[1:] != ordered[:-1]), len(order) - 1)
        ends = ends[np.isfinite(ordered[ends])]
        each = np.ones(len(order)) if weights is None else weights
        right = np.cumsum((each * (self.right & self.answerable))[..., order], axis=-1)[..., ends]
        answers = np.cumsum(each[..., order], axis=-1)[..., ends]
        askable = (each * self.answerable).sum(axis=-1, keepdims=True)
        # A draw may hold no query above a threshold, or none that has an answer.
        precision = np.divide(100 * right, answers, out=np.full_like(right, 100.0), where=answers > 0)
        recall = np.divide(100 * right, askable, out=np.zeros_like(right), where=askable > 0)
        return Curve(ordered[ends], precision, recall)


@dataclass(frozen=True, slots=True)
class PrecisionRecall:
    """The curve over the threshold on the best score, in three numbers; all in percent but the threshold.

    Attributes:
        area: Below the curve (average precision).
        area_interval: How sure that is.
        recall_at_full_precision: The most recall with no wrong answer.
        recall_at_full_precision_interval: How sure that is.
        threshold: The least score believed there; None where the surest answer of all is wrong.
    """

    area: float
    area_interval: Interval
    recall_at_full_precision: float
    recall_at_full_precision_interval: Interval
    threshold: float | None

    def as_dict(self) -> dict[str, Any]:
        """The JSON form."""
        return {name: list(part) if isinstance(part, tuple) else part for name, part in asdict(self).items()}

    @classmethod
    def from_dict(cls, read: Mapping[str, Any]) -> PrecisionRecall:
        """What `as_dict` wrote."""
        return cls(
            real(read["area"]),
            interval(read["area_interval"]),
            real(read["recall_at_full_precision"]),
            interval(read["recall_at_full_precision_interval"]),
            None if read["threshold"] is None else real(read["threshold"]),
        )


def precision_recall(results: Sequence[QueryResult], design: SamplingDesign) -> PrecisionRecall | None:
    """The precision-recall curve in short; None where no query has a score.

    Args:
        results: What became of each query.
        design: Which queries hang together.
    """
    answers = Answers.of(results)
    if answers is None or not np.isfinite(answers.scores).any():
        return None
    # All of them, by whatever rule: a query without an answer is a chance to be wrong.
    resampling = design.resampling(np.arange(len(results)), answers.right.astype(np.float64))
    curve = answers.curve()
    curves = [answers.curve(weights) for weights in resampling.weights()]
    return PrecisionRecall(
        float(curve.area),
        percentile_interval(np.concatenate([drawn.area for drawn in curves])),
        float(curve.recall_at_full_precision),
        percentile_interval(np.concatenate([drawn.recall_at_full_precision for drawn in curves])),
        curve.surest,
    )


@dataclass(frozen=True, slots=True)
class Distances:
    """Localisation error: how far best matches stand from their queries.

    Attributes:
        known: How many of the queries that count have a position, as their best matches have.
        median: Of these, in metres; infinite where most of them have no match at all.
        median_interval: How sure that is.
        within: Percent within so many metres.
        within_intervals: How sure each is.
    """

    known: int
    median: float
    median_interval: Interval
    within: dict[int, float]
    within_intervals: dict[int, Interval]

    def as_dict(self) -> dict[str, Any]:
        """The JSON form; what is infinite is null, since JSON has no infinity."""
        median, *ends = (metres if math.isfinite(metres) else None for metres in (self.median, *self.median_interval))
        return {
            "known": self.known,
            "median": median,
            "median_interval": ends,
            "within": {str(metres): percent for metres, percent in self.within.items()},
            "within_intervals": {str(m): list(interval) for m, interval in self.within_intervals.items()},
        }

    @classmethod
    def from_dict(cls, read: Mapping[str, Any]) -> Distances:
        """What `as_dict` wrote."""
        median, low, high = (
            math.inf if metres is None else real(metres) for metres in (read["median"], *read["median_interval"])
        )
        return cls(
            known=count(read["known"], least=1),
            median=median,
            median_interval=Interval(low, high),
            within={whole(metres): real(percent) for metres, percent in read["within"].items()},
            within_intervals={whole(metres): interval(ends) for metres, ends in read["within_intervals"].items()},
        )


def distances(
    results: Sequence[QueryResult],
    counted: Int64[np.ndarray, " counted"],
    design: SamplingDesign,
) -> Distances | None:
    """Localisation error; None where no query and its best match both have a position.

    Args:
        results: What became of each query.
        counted: Numbers of the queries that count.
        design: Which queries hang together.
    """
    metres_of: dict[int, float] = {}
    for number in counted.tolist():
        one = results[number]
        if one.metres is not None:
            metres_of[number] = one.metres
        elif one.where is not None and not one.matches:
            metres_of[number] = math.inf  # it was asked for a place and found none: as wrong as can be
    if all(map(math.isinf, metres_of.values())):
        return None
    far = np.array(list(metres_of.values()))
    # How far frames hang together is asked of right and wrong, since metres may be infinite.
    resampling = design.resampling(np.array(list(metres_of)), (far <= WITHIN_M[-1]).astype(np.float64))
    draws = resampling.draws(
        lambda weights: np.column_stack([weighted_medians(far, weights), percent_within(far, weights)])
    )
    within = percent_within(far, np.ones((1, len(far))))[0]
    return Distances(
        known=len(far),
        median=float(np.median(far)),
        median_interval=percentile_interval(draws[:, 0]),
        within=dict(zip(WITHIN_M, within.tolist(), strict=True)),
        within_intervals={
            limit: proportion_interval(float(percent), drawn, units=resampling.units, counted=len(far))
            for limit, percent, drawn in zip(WITHIN_M, within, draws[:, 1:].T, strict=True)
        },
    )


def weighted_medians(
    far: Float64[np.ndarray, " queries"], weights: Float64[np.ndarray, "draws queries"]
) -> Float64[np.ndarray, " draws"]:
    """The median of each draw, where each query counts so often: the first that half of the weight is not above."""
    # Nothing is interpolated: half way to infinity is no distance.
    order = np.argsort(far, kind="stable")
    sums = np.cumsum(weights[:, order], axis=1)
    return np.asarray(far[order][np.argmax(sums >= sums[:, -1:] / 2, axis=1)])


def percent_within(
    far: Float64[np.ndarray, " queries"], weights: Float64[np.ndarray, "draws queries"]
) -> Float64[np.ndarray, "draws within"]:
    """Percent within each of `WITHIN_M`, a row a draw."""
    near = np.stack([far <= metres for metres in WITHIN_M], axis=1).astype(np.float64)
    return np.asarray(100 * (weights @ near) / weights.sum(axis=1, keepdims=True))
