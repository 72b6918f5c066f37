"""Recall@k: the share of queries with a right reference among the first k.

A query without any right reference cannot be answered. Each result says how many there were; they are left
out of the share (`drop`, the rule for a user's own folders) or stay in it as misses (`miss`, the rule of some
published protocols), and the protocol says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.typing import NDArray

from salad import geo
from salad.datasets.benchmark import Unanswerable
from salad.errors import BenchmarkError
from salad.images.photo import Photo

KS = (1, 5, 10, 20)


def recall_at(
    ranked: NDArray[np.integer[Any]] | Sequence[Sequence[int]],
    positives: Sequence[Int64[np.ndarray, " n"]],
    ks: Sequence[int] = KS,
    *,
    unanswerable: Unanswerable = "drop",
) -> dict[int, float]:
    """Compute recall@k in percent.

    Args:
        ranked: `[Q, K]` rows of references for each query, best first. A ranking shorter than k is taken to
            hold every reference there is; -1, which some search engines pad with, is never right.
        positives: The right rows of each query; empty where it cannot be answered.
        ks: Which k to report.
        unanswerable: `drop` leaves queries without positives out of the share, `miss` counts them as misses.

    Returns:
        Percent for each k, in the order asked for.

    Raises:
        BenchmarkError: The lengths differ, a k is below 1, or no query is left to count.
    """
    if len(ranked) != len(positives):
        raise BenchmarkError(
            f"{len(ranked)} rankings but positives for {len(positives)} queries: give one of each"
        )
    check_countable(positives, ks, unanswerable=unanswerable)
    hits = first_hits(ranked, positives)
    if unanswerable == "drop":
        hits = hits[[number for number, right in enumerate(positives) if right.size]]
    return {k: float(100.0 * np.mean(hits < k)) for k in ks}


def check_countable(
    positives: Sequence[Int64[np.ndarray, " n"]], ks: Sequence[int], *, unanswerable: Unanswerable
) -> None:
    """Make sure that there will be a recall to give.

    Raises:
        BenchmarkError: A k is below 1, or no query is left to count.
    """
    if not ks or min(ks) < 1:
        raise BenchmarkError(f"recall at {list(ks)} makes no sense: give whole numbers from 1")
    if len(positives) and (unanswerable == "miss" or any(right.size for right in positives)):
        return
    raise BenchmarkError(
        f"none of {len(positives)} queries has a right reference, so there is no recall to give: "
        "check the ground truth, the tolerance or the radius"
    )


def first_hits(
    ranked: NDArray[np.integer[Any]] | Sequence[Sequence[int]], positives: Sequence[Int64[np.ndarray, " n"]]
) -> Float64[np.ndarray, " queries"]:
    """The place of the first right row in each ranking, from 0; infinite where there is none."""
    places = np.full(len(ranked), np.inf)
    for number, (rows, right) in enumerate(zip(ranked, positives, strict=True)):
        hits = np.isin(np.asarray(rows), right)
        if hits.any():
            places[number] = np.argmax(hits)
    return places


# --- Precision against recall, as the least score that is believed goes from the highest to the lowest ---
#
# A query is answered where its best score is at least the threshold, and the answer is right where the best match is.
# Precision is the share of right ones among the answers; recall is their share among the queries that have an answer.
# A query without a right reference can only be answered wrongly, whatever a protocol says of it in recall@k.


@dataclass(frozen=True, eq=False)
class Curve:
    """One point for each score that is some query's best, the highest first.

    Attributes:
        thresholds: `[points]` the score from which on answers are believed.
        precision: `[points]` in percent.
        recall: `[points]` in percent.
    """

    thresholds: Float64[np.ndarray, " points"]
    precision: Float64[np.ndarray, " points"]
    recall: Float64[np.ndarray, " points"]

    @property
    def area(self) -> float:
        """The area under the curve in percent, by steps (average precision): nothing is drawn between points."""
        return float(_area(self.precision[None], self.recall[None])[0])

    @property
    def recall_at_full_precision(self) -> float:
        """The most recall, in percent, at which no answer is wrong."""
        return float(_full(self.precision[None], self.recall[None])[0])

    @property
    def surest(self) -> float | None:
        """The lowest threshold at which no answer is wrong; None where the surest answer is."""
        full = np.flatnonzero(self.precision == 100)
        return float(self.thresholds[full[-1]]) if full.size else None


@dataclass(frozen=True, eq=False)
class Answers:
    """What the curve is of: `[queries]` each.

    Attributes:
        scores: the best score of each query; -infinity where it has no match.
        right: whether its best match is right.
        answerable: whether any reference is.
    """

    scores: Float64[np.ndarray, " queries"]
    right: Bool[np.ndarray, " queries"]
    answerable: Bool[np.ndarray, " queries"]

    def curve(self) -> Curve:
        """The curve of all of them."""
        precision, recall = self._points(np.ones((1, len(self.scores))))
        order, ends = self._order()
        return Curve(self.scores[order][ends], precision[0], recall[0])

    def area_and_full(self, weights: Float64[np.ndarray, "draws queries"]) -> Float64[np.ndarray, "draws 2"]:
        """Area and recall at full precision, in percent, where each query counts so often: a row a draw."""
        points = self._points(weights)
        return np.stack([_area(*points), _full(*points)], axis=1)

    def _order(self) -> tuple[np.ndarray, np.ndarray]:
        """Queries from the highest score on, and the last of each run of equal ones: no threshold parts those."""
        order = np.argsort(-self.scores, kind="stable")
        ordered = self.scores[order]
        ends = np.append(np.flatnonzero(ordered[1:] != ordered[:-1]), len(order) - 1)
        return order, ends[np.isfinite(ordered[ends])]

    def _points(self, weights: Float64[np.ndarray, "draws queries"]) -> tuple[np.ndarray, np.ndarray]:
        order, ends = self._order()
        right = np.cumsum((weights * (self.right & self.answerable))[:, order], axis=1)[:, ends]
        made = np.cumsum(weights[:, order], axis=1)[:, ends]
        all_ = (weights * self.answerable).sum(axis=1, keepdims=True)
        precision = np.divide(100 * right, made, out=np.full_like(right, 100.0), where=made > 0)
        recall = np.divide(100 * right, all_, out=np.zeros_like(right), where=all_ > 0)
        return precision, recall


def _area(precision: np.ndarray, recall: np.ndarray) -> Float64[np.ndarray, " draws"]:
    area: Float64[np.ndarray, " draws"] = (np.diff(recall, axis=1, prepend=0.0) * precision).sum(axis=1) / 100
    return area


def _full(precision: np.ndarray, recall: np.ndarray) -> Float64[np.ndarray, " draws"]:
    sure: Float64[np.ndarray, " draws"] = np.where(precision == 100, recall, 0.0).max(axis=1, initial=0.0)
    return sure


# --- How far the best match stands from the query, where the positions of both are known ---


WITHIN_M = (5, 10, 25, 50)  # metres


def distance_errors(
    queries: Sequence[Photo], references: Sequence[Photo], best: Int64[np.ndarray, " queries"]
) -> Float64[np.ndarray, " queries"]:
    """Metres from each query to its best match; NaN where a position is not known, infinite where there is no match.

    Args:
        queries: the photos asked about.
        references: the photos that `best` are rows of.
        best: the row of each query's best match; -1 where there is none.
    """
    apart = np.full(len(queries), np.nan)
    for number, row in enumerate(best.tolist()):
        here = queries[number].where
        if here is None:
            continue
        if row < 0:
            apart[number] = np.inf
        elif (there := references[row].where) is not None:
            apart[number] = geo.metres_between(here, there)
    return apart


def distance_medians(
    apart: Float64[np.ndarray, " queries"], weights: Float64[np.ndarray, "draws queries"]
) -> Float64[np.ndarray, " draws"]:
    """The median of each draw, where each query counts so often: the first that half of the weight is not above."""
    order = np.argsort(apart, kind="stable")
    sums = np.cumsum(weights[:, order], axis=1)
    middle = np.argmax(sums >= sums[:, -1:] / 2, axis=1)
    found: Float64[np.ndarray, " draws"] = apart[order][middle]
    return found


def shares_within(
    apart: Float64[np.ndarray, " queries"], weights: Float64[np.ndarray, "draws queries"]
) -> Float64[np.ndarray, "draws within"]:
    """Percent within each of `WITHIN`, a row a draw."""
    near = np.stack([apart <= metres for metres in WITHIN_M], axis=1).astype(np.float64)
    found: Float64[np.ndarray, "draws within"] = 100 * (weights @ near) / weights.sum(axis=1, keepdims=True)
    return found
