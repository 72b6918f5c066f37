"""How sure must a place be? A calibration fitted to queries whose truth is known, and judged out of fold.

Confidence is logistic regression on the four numbers of `Evidence` (Platt's scaling), with no negative weight, so
that it is monotone in everything that speaks for a place. All judging is out of fold: a query's confidence comes
from a fit that saw no query of the same place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear, minimize
from scipy.special import expit

from salad.errors import BenchmarkError
from salad.geo import GeoPoint, metres_between
from salad.localize.voting import RADIUS_M, Evidence, candidates, confidence
from salad.network.config import Calibration

if TYPE_CHECKING:
    from salad.index.index import Match

Numbers = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

SHARPNESSES = (5.0, 10.0, 20.0, 40.0, 80.0)  # tried for `Calibration.sharpness`: twice as sharp each time
BINS = 10  # steps of confidence in a reliability diagram
FOLDS = 5
RADIUS_COVERAGE = 0.9  # part of the answers whose radius is to hold the truth
SIGNS = np.array([1.0, 1.0, -1.0, 1.0])  # of `Evidence`: all of it but the spread makes a place surer
# Pulls the weights of standardised evidence towards 0 as much as one query's loss would, so that there is an optimum
# where right and wrong are parted perfectly. The bias is pulled by next to nothing: just enough to be unique.
_RIDGE = np.array([1e-6, 1.0, 1.0, 1.0, 1.0])


@dataclass(frozen=True, slots=True)
class Case:
    """A query whose truth is known.

    Attributes:
        place: What it shows; the queries of one place are fitted or judged together, never both.
        matches: What the index said.
        truth: Where it was taken; None where nowhere near the index.
        weight: What it counts. Confidence is only right for one mixture of queries that have an answer and
            queries that have none; weights say which.
    """

    place: str
    matches: Sequence[Match]
    truth: GeoPoint | None
    weight: float = 1.0


class Predictions(NamedTuple):
    """Confidence beside truth, one entry a case.

    Attributes:
        confidence: In the first place, 0 to 1.
        right: Whether that is within `RADIUS_M` of the truth.
        error_m: Metres to the truth; infinite where the query is from nowhere near.
        radius_m: What the place says of that.
        weight: What the case counts.
    """

    confidence: Numbers
    right: Flags
    error_m: Numbers
    radius_m: Numbers
    weight: Numbers


class ReliabilityBin(NamedTuple):
    """Cases of like confidence: how many, their part of all weight, how sure on average, the part that is right."""

    cases: int
    weight: float
    confidence: float
    right: float


def calibrate(
    cases: Sequence[Case], *, precision: float = 0.95, seed: int = 0, provenance: str = ""
) -> tuple[Calibration, Predictions]:
    """Fit a calibration, and judge it out of fold.

    The sharpness is the one of least loss out of fold; `min_confidence` the lowest at which `precision` of the
    answers out of fold are right; `radius` the factor by which the radius holds the truth in `RADIUS_COVERAGE` of
    them.

    Args:
        cases: Queries whose truth is known, of `FOLDS` places at least.
        precision: Part of the answers that is to be right, 0 to 1.
        seed: Of the draw that puts places into folds.
        provenance: What the calibration is to say of itself.

    Raises:
        BenchmarkError: If there are too few places, or every answer is right or wrong, so there is nothing to fit.
    """
    places = sorted({case.place for case in cases})
    if len(places) < FOLDS:
        raise BenchmarkError(f"there are queries of {len(places)} places: give at least {FOLDS}")
    # By place, not by query: photos of one place are so alike that a fit to some would know the others.
    shuffled = np.random.default_rng(seed).permutation(len(places))
    fold_of = dict(zip(places, shuffled % FOLDS, strict=True))
    folds = np.array([fold_of[case.place] for case in cases])

    answers = {sharpness: _Answers.of(cases, sharpness) for sharpness in SHARPNESSES}
    judged = {sharpness: some.predictions(some.out_of_fold(folds)) for sharpness, some in answers.items()}
    sharpness = min(SHARPNESSES, key=lambda each: log_loss(judged[each]))
    best, sure = answers[sharpness], judged[sharpness].confidence
    limit = threshold(judged[sharpness], precision)
    # Judged out of fold, but what ships is fitted to all there is. Four decimals make a file that people can read.
    bias, weights = fit_logistic(best.evidence, best.right, best.weight)
    top, gap, spread, share = (round(float(weight), 4) for weight in weights)
    calibration = Calibration(
        sharpness=sharpness,
        bias=round(bias, 4),
        top=top,
        gap=gap,
        spread=spread,
        share=share,
        radius=round(best.radius_factor(sure >= limit), 4),
        min_confidence=round(limit, 4),
        provenance=provenance,
    )
    return calibration, best.predictions(sure, calibration.radius)


def judge(cases: Sequence[Case], calibration: Calibration) -> Predictions:
    """What a calibration says of cases it was not fitted on.

    Raises:
        BenchmarkError: If a query has no match with a position.
    """
    answers = _Answers.of(cases, calibration.sharpness)
    sure = [confidence(Evidence(*row), calibration) for row in answers.evidence]
    return answers.predictions(np.array(sure), calibration.radius)


def fit_logistic(evidence: Numbers, right: Flags, weight: Numbers) -> tuple[float, Numbers]:
    """Bias and weights, none negative, of the logistic model with the least loss.

    Args:
        evidence: `[cases, 4]` in the order of `Evidence`.
        right: `[cases]`
        weight: `[cases]`, above 0; only their ratios count.

    Returns:
        The bias, and the weights `[4]` of top, gap, spread and vote fraction; the spread's counts downwards.

    Raises:
        BenchmarkError: If all cases are right, or none is.
    """
    if not right.any() or right.all():
        raise BenchmarkError("every place found is right, or every one wrong: a calibration needs some of both")
    signed = evidence * SIGNS
    mean, scale = signed.mean(axis=0), np.maximum(signed.std(axis=0), 1e-6)
    # Standardised, so that the ridge pulls at all of them alike, whatever their units.
    rows = np.column_stack([np.ones(len(right)), (signed - mean) / scale])
    weight = weight / weight.mean()

    def loss(at: Numbers) -> tuple[float, Numbers]:
        z = rows @ at
        slope = rows.T @ (weight * (expit(z) - right)) + _RIDGE * at
        return float(weight @ np.logaddexp(0, np.where(right, -z, z)) + _RIDGE @ at**2 / 2), slope

    # A convex loss in a box has one optimum. Losses are equal in float64 within 1e-7 of it, so a Newton step under the
    # same bounds, which goes by slopes, makes the last digits right: a calibration's fourth decimal is no luck.
    bounds = [(None, None), *[(0, None)] * 4]
    at = minimize(loss, np.zeros(5), jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 0}).x
    sure = expit(rows @ at)
    half = np.linalg.cholesky((rows.T * (weight * sure * (1 - sure))) @ rows + np.diag(_RIDGE)).T
    target = half @ at - np.linalg.solve(half.T, loss(at)[1])
    at = lsq_linear(half, target, ([-np.inf, 0, 0, 0, 0], np.inf), method="bvls", tol=1e-15).x
    weights = at[1:] / scale
    return float(at[0] - weights @ mean), weights


def reliability(predictions: Predictions) -> list[ReliabilityBin | None]:
    """How often what is so sure is right, in `BINS` steps of confidence; None for a step without a case."""
    # A confidence of 1 is in the last.
    step_of = np.minimum((predictions.confidence * BINS).astype(int), BINS - 1)
    bins: list[ReliabilityBin | None] = []
    for step in range(BINS):
        here = step_of == step
        if not here.any():
            bins.append(None)
            continue
        weight = predictions.weight[here]
        sure, right = (
            float(np.average(values[here], weights=weight)) for values in (predictions.confidence, predictions.right)
        )
        bins.append(ReliabilityBin(int(here.sum()), float(weight.sum() / predictions.weight.sum()), sure, right))
    return bins


def calibration_error(predictions: Predictions) -> float:
    """Expected calibration error: how far confidence and the part that is right are apart, on average."""
    return sum(one.weight * abs(one.confidence - one.right) for one in reliability(predictions) if one)


def log_loss(predictions: Predictions) -> float:
    """Mean surprise at the truth, in nats; confidence that is always right has none."""
    given = np.where(predictions.right, predictions.confidence, 1 - predictions.confidence)
    # Sure and wrong would cost infinitely much: at most 28 nats a case.
    return float(-np.average(np.log(np.clip(given, 1e-12, 1)), weights=predictions.weight))


def threshold(predictions: Predictions, precision: float) -> float:
    """The lowest confidence from which on so many are right; the highest there is where none does it."""
    order = np.argsort(-predictions.confidence, kind="stable")
    sure, weight = predictions.confidence[order], predictions.weight[order]
    reached = np.cumsum(weight * predictions.right[order]) / np.cumsum(weight)
    last = np.append(sure[:-1] > sure[1:], True)  # a threshold cannot part equals
    good = np.flatnonzero((reached >= precision) & last)
    return float(sure[good[-1]]) if len(good) else float(sure[0])


class _Answers(NamedTuple):
    """The first place of each case, before anybody says how sure it is."""

    evidence: Numbers
    right: Flags
    error_m: Numbers
    scatter_m: Numbers
    weight: Numbers

    @classmethod
    def of(cls, cases: Sequence[Case], sharpness: float) -> _Answers:
        """What the matches of each case vote for at this sharpness."""
        first = []
        for case in cases:
            place = next(candidates(case.matches, radius_m=RADIUS_M, sharpness=sharpness), None)
            if place is None:
                raise BenchmarkError("a query found no photo with a position: give every photo of the index one")
            first.append(place)
        error = np.array(
            [
                np.inf if case.truth is None else metres_between(case.truth, place.where)
                for case, place in zip(cases, first, strict=True)
            ]
        )
        return cls(
            np.array([place.evidence for place in first]),
            error <= RADIUS_M,
            error,
            np.array([place.scatter_m for place in first]),
            np.array([case.weight for case in cases]),
        )

    def predictions(self, sure: Numbers, radius: float = 1.0) -> Predictions:
        """These places with a confidence for each, their radius so many times their scatter."""
        return Predictions(sure, self.right, self.error_m, radius * self.scatter_m, self.weight)

    def out_of_fold(self, folds: npt.NDArray[np.int64]) -> Numbers:
        """The confidence of each case by a fit to the other folds."""
        sure = np.empty(len(folds))
        for fold in range(FOLDS):
            here = folds == fold
            bias, weights = fit_logistic(self.evidence[~here], self.right[~here], self.weight[~here])
            sure[here] = expit(bias + (self.evidence[here] * SIGNS) @ weights)
        return sure

    def radius_factor(self, answered: Flags) -> float:
        """The least factor by which the radius holds the truth in `RADIUS_COVERAGE` of the answers."""
        off, weight = self.error_m[answered] / self.scatter_m[answered], self.weight[answered]
        order = np.argsort(off)
        # A sum of weights may fall short of what it should be by a rounding: one more answer is not needed for that.
        enough = np.cumsum(weight[order]) >= RADIUS_COVERAGE * weight.sum() * (1 - 1e-9)
        return float(off[order][np.argmax(enough)])
