"""What an evaluation found: figures with how sure they are, and what became of each query."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float64

from salad.data.benchmark import Unanswerable
from salad.evaluation.curves import Answers
from salad.evaluation.intervals import Interval
from salad.evaluation.leaks import Leak

Degrees: TypeAlias = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of one query.

    Attributes:
        query: its photo, by its path below the folder of queries.
        positives: how many references are right for it.
        first_right: the rank of the first right one among `matches`, from 1; None where there is none among them.
        matches: rows of the references found, best first.
        scores: their scores, where somebody told them.
        right: the row of a right reference: the first found, or the first there is; None where none is right.
        metres: from the query to its best match; None where a position is not known, or nothing was found.
        where: latitude and longitude of the query, where known.
        group: the drive, place or panorama it belongs to, where known.
    """

    query: str
    positives: int
    first_right: int | None
    matches: tuple[int, ...]
    scores: tuple[float, ...] | None = None
    right: int | None = None
    metres: float | None = None
    where: Degrees | None = None
    group: str | None = None

    def hit(self, k: int) -> bool:
        """Whether a right reference is among the first k."""
        return self.first_right is not None and self.first_right <= k


@dataclass(frozen=True, slots=True)
class Reference:
    """A reference that a verdict names: its path below the folder of references, and where it is, if known."""

    name: str
    where: Degrees | None = None


@dataclass(frozen=True, slots=True)
class PrecisionRecall:
    """The curve over the threshold on the best score, in three numbers; all in percent but the threshold.

    Attributes:
        area: below the curve (average precision).
        recall_at_full_precision: the most recall with no wrong answer.
        threshold: the least score believed there; None where the surest answer of all is wrong.
        area_interval: how sure `area` is.
        full_interval: how sure `recall_at_full_precision` is.
    """

    area: float
    recall_at_full_precision: float
    threshold: float | None
    area_interval: Interval
    full_interval: Interval

    def as_dict(self) -> dict[str, Any]:
        """The JSON form."""
        return {
            "area": self.area,
            "area_interval": self.area_interval.as_list(),
            "recall_at_full_precision": self.recall_at_full_precision,
            "recall_at_full_precision_interval": self.full_interval.as_list(),
            "threshold": self.threshold,
        }


@dataclass(frozen=True, slots=True)
class Distances:
    """How far best matches stand from their queries.

    Attributes:
        known: how many of the queries that count have a position, as their best matches have.
        median: of these, in metres; infinite where most of them have no match at all.
        median_interval: how sure that is.
        within: percent within so many metres.
        within_intervals: how sure each is.
    """

    known: int
    median: float
    median_interval: Interval
    within: dict[int, float]
    within_intervals: dict[int, Interval]

    def as_dict(self) -> dict[str, Any]:
        """The JSON form; what is infinite is null."""
        return {
            "known": self.known,
            "median": _finite(self.median),
            "median_interval": [_finite(end) for end in self.median_interval.as_list()],
            "within": {str(metres): share for metres, share in self.within.items()},
            "within_intervals": {str(m): interval.as_list() for m, interval in self.within_intervals.items()},
        }


@dataclass(frozen=True)
class Result:
    """What an evaluation found.

    Attributes:
        benchmark: The set's name.
        protocol: The rule that said what was right; never show a figure without it.
        queries: How many queries there were, the unanswerable ones included.
        references: How many references there were.
        unanswerable: How many queries had no right reference.
        recall: Recall in percent for each k.
        model: The model's name.
        seconds: Time for describing both sides and ranking.
        notes: Sentences a reader of the figures should see.
        fingerprint: The model's; empty where descriptors or rankings came from outside.
        unanswerable_rule: Whether unanswerable queries were left out of shares or counted as misses.
        intervals: Where the truth of each recall lies 95 times in 100.
        drawn: What was drawn again together for that: `by`, `units`, `length`, `level`, `times`, `seed`.
        precision_recall: The curve in short; None where nobody told scores.
        distances: Metres; None where positions are not known.
        leaks: Photos that are in both sides; None where nobody looked.
        verdicts: What became of each query, in the benchmark's order.
        known: The references that verdicts name, by row.
        folders: The folders of references and of queries that names are below.
        digests: Of the references' names and of what is right, to tell whether two results are of one set.
    """

    benchmark: str
    protocol: str
    queries: int
    references: int
    unanswerable: int
    recall: dict[int, float]
    model: str
    seconds: float
    notes: tuple[str, ...] = ()
    fingerprint: str = ""
    unanswerable_rule: Unanswerable = "drop"
    intervals: dict[int, Interval] = field(default_factory=dict)
    drawn: Mapping[str, Any] = field(default_factory=dict)
    precision_recall: PrecisionRecall | None = None
    distances: Distances | None = None
    leaks: tuple[Leak, ...] | None = None
    verdicts: tuple[Verdict, ...] = ()
    known: Mapping[int, Reference] = field(default_factory=dict)
    folders: tuple[str, str] = ("", "")
    digests: tuple[str, str] = ("", "")

    def as_dict(self) -> dict[str, Any]:
        """Give the JSON form that `salad evaluate --format json` prints: every figure, but no single query."""
        curve, distances = self.precision_recall, self.distances
        return {
            "protocol": self.protocol,
            "queries": self.queries,
            "references": self.references,
            "unanswerable": self.unanswerable,
            "recall": {str(k): percent for k, percent in self.recall.items()},
            "model": self.model,
            "seconds": self.seconds,
            "benchmark": self.benchmark,
            "unanswerable_rule": self.unanswerable_rule,
            "fingerprint": self.fingerprint,
            "intervals": {str(k): interval.as_list() for k, interval in self.intervals.items()},
            "drawn": dict(self.drawn),
            "precision_recall": None if curve is None else curve.as_dict(),
            "metres": None if distances is None else distances.as_dict(),
            "leaks": None if self.leaks is None else [leak.as_dict() for leak in self.leaks],
            "notes": list(self.notes),
        }

    def counts(self, one: Verdict) -> bool:
        """Whether shares are of this query too, by the protocol's rule."""
        return one.positives > 0 or self.unanswerable_rule == "miss"

    def answers(self) -> Answers | None:
        """What the precision-recall curve is of; None where nobody told scores."""
        return answers(self.verdicts)


def answers(verdicts: tuple[Verdict, ...]) -> Answers | None:
    """Best scores and whether the best matches are right; None where a verdict has no scores."""
    scores = [one.scores for one in verdicts]
    if not scores or any(told is None for told in scores):
        return None
    best: Float64[np.ndarray, " queries"] = np.array([told[0] if told else -math.inf for told in scores])
    right: Bool[np.ndarray, " queries"] = np.array([one.hit(1) for one in verdicts])
    return Answers(best, right, np.array([one.positives > 0 for one in verdicts]))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
