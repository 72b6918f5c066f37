"""Precision against recall, as the least score that is believed goes from the highest to the lowest.

A query is answered where its best score is at least the threshold, and the answer is right where the best match is.
Precision is the share of right ones among the answers; recall is their share among the queries that have an answer.
A query without a right reference can only be answered wrongly, whatever a protocol says of it in recall@k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64


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
