"""Fitting a calibration: how sure must a place be, given what spoke for it where the truth was known?

The model is logistic with no negative weight, so it is monotone in everything that speaks for a place. All
judging is out of fold: a query's confidence comes from a fit that saw no query of the same place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salad.errors import BenchmarkError
from salad.geo import GeoPoint, metres_between
from salad.index.index import Match
from salad.localize.voting import RADIUS_M, Candidate, Evidence, candidates, confidence
from salad.network.config import Calibration

# --- Logistic regression without negative weights: the model behind a calibrated confidence ---


Numbers = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

SIGNS = np.array([1.0, 1.0, -1.0, 1.0])
"""Which way each number of `Evidence` counts: all but the spread make a place surer."""
_RIDGE = 1.0  # pulls the weights of standardised evidence towards 0, as one query's loss would


def fit(evidence: Numbers, right: Flags, weight: Numbers) -> tuple[float, Numbers]:
    """Bias and weights, none negative, of the logistic model with the least loss.

    At the optimum of a convex loss under `weights >= 0` some weights are 0 and the others are free; so each
    choice of free ones is fitted by Newton's method, and the best without a negative weight is the optimum.

    Args:
        evidence: `[cases, 4]` in the order of `Evidence`.
        right: `[cases]`
        weight: `[cases]`, above 0; only their ratios count.

    Returns:
        The bias, and the weights `[4]` of top, gap, spread and share; the spread's counts downwards.
    """
    if not right.any() or right.all():
        raise BenchmarkError(
            "every place found is right, or every one wrong: a calibration needs some of both"
        )
    signed = evidence * SIGNS
    middle, scale = signed.mean(axis=0), np.maximum(signed.std(axis=0), 1e-6)
    standard = (signed - middle) / scale
    least, best = np.inf, (0.0, np.zeros(4))
    for free in map(list, chain.from_iterable(combinations(range(4), size) for size in range(5))):
        loss, bias, weights = _newton(standard[:, free], right, weight / weight.mean())
        if loss < least and (weights >= 0).all():
            whole = np.zeros(4)
            whole[free] = weights / scale[free]
            least, best = loss, (bias - float(whole @ middle), whole)
    return best


def _newton(features: Numbers, right: Flags, weight: Numbers) -> tuple[float, float, Numbers]:
    """Loss, bias and weights of an unbounded logistic fit to standardised features, by damped Newton steps."""
    rows = np.column_stack([np.ones(len(right)), features])
    ridge = np.append(1e-6, np.full(features.shape[1], _RIDGE))
    at = np.zeros(rows.shape[1])

    def loss(at: Numbers) -> float:
        z = rows @ at
        return float(weight @ np.logaddexp(0, np.where(right, -z, z)) + ridge @ at**2 / 2)

    for _ in range(50):
        sure = 1 / (1 + np.exp(-(rows @ at)))
        slope = rows.T @ (weight * (sure - right)) + ridge * at
        step = np.linalg.solve((rows.T * (weight * sure * (1 - sure))) @ rows + np.diag(ridge), slope)
        while loss(at - step) > loss(at) and np.abs(step).max() > 1e-9:
            step = step / 2
        at = at - step
        if np.abs(step).max() < 1e-9:
            break
    return loss(at), float(at[0]), at[1:]


SHARPNESSES = (5.0, 10.0, 20.0, 40.0, 80.0)
BINS = 10
FOLDS = 5
HELD = 0.9  # share of answers whose radius holds the truth


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

    Args:
        confidence: in the first place, 0 to 1.
        right: whether that is within `RADIUS_M` of the truth.
        error_m: metres to the truth; infinite where the query is from nowhere near.
        radius_m: what the place says of that.
        weight: what the case counts.
    """

    confidence: Numbers
    right: Flags
    error_m: Numbers
    radius_m: Numbers
    weight: Numbers


class Bin(NamedTuple):
    """Cases of like confidence: how many, their part of all weight, how sure on average, the share right."""

    cases: int
    weight: float
    confidence: float
    right: float


def calibrate(
    cases: Sequence[Case], *, precision: float = 0.95, seed: int = 0, provenance: str = ""
) -> tuple[Calibration, Predictions]:
    """Fit a calibration, and judge it out of fold.

    The sharpness is the one of least loss out of fold; `min_confidence` the lowest at which `precision` of the
    answers out of fold are right; `radius` the factor by which the radius holds the truth in `HELD` of them.

    Raises:
        BenchmarkError: There are too few places, or every answer is right or wrong, so there is nothing to fit.
    """
    apart = _folds([case.place for case in cases], seed)
    tried = {sharpness: _seen(cases, sharpness) for sharpness in SHARPNESSES}
    sure = {sharpness: _out_of_fold(seen, apart) for sharpness, seen in tried.items()}
    best = min(SHARPNESSES, key=lambda sharpness: log_loss(tried[sharpness].judged(sure[sharpness])))
    seen = tried[best]
    limit = threshold(seen.judged(sure[best]), precision)
    bias, weights = fit(seen.evidence, seen.right, seen.weight)
    top, gap, spread, share = (round(float(weight), 4) for weight in weights)
    calibration = Calibration(
        sharpness=best,
        bias=round(bias, 4),
        top=top,
        gap=gap,
        spread=spread,
        share=share,
        radius=round(_holding(seen, sure[best] >= limit), 4),
        min_confidence=round(limit, 4),
        provenance=provenance,
    )
    return calibration, seen.judged(sure[best], calibration.radius)


def judge(cases: Sequence[Case], calibration: Calibration) -> Predictions:
    """What a calibration says of cases it was not fitted on."""
    seen = _seen(cases, calibration.sharpness)
    sure = [confidence(Evidence(*one), calibration) for one in seen.evidence]
    return seen.judged(np.array(sure), calibration.radius)


def reliability(judged: Predictions) -> list[Bin | None]:
    """How often what is so sure is right, in `BINS` steps of confidence; None for a step without a case."""
    step = np.minimum((judged.confidence * BINS).astype(int), BINS - 1)
    return [_bin(judged, step == number) for number in range(BINS)]


def _bin(judged: Predictions, here: Flags) -> Bin | None:
    if not here.any():
        return None
    weight = judged.weight[here]
    sure, right = (np.average(values[here], weights=weight) for values in (judged.confidence, judged.right))
    return Bin(int(here.sum()), float(weight.sum() / judged.weight.sum()), float(sure), float(right))


def calibration_error(judged: Predictions) -> float:
    """Expected calibration error: how far confidence and share of right ones are apart, on average."""
    return sum(one.weight * abs(one.confidence - one.right) for one in reliability(judged) if one)


def log_loss(judged: Predictions) -> float:
    """Mean surprise at the truth, in nats; confidence that is always right has none."""
    given = np.where(judged.right, judged.confidence, 1 - judged.confidence)
    return float(-np.average(np.log(np.clip(given, 1e-12, 1)), weights=judged.weight))


def threshold(judged: Predictions, precision: float) -> float:
    """The lowest confidence from which on that share is right; the highest there is where none does it."""
    order = np.argsort(-judged.confidence, kind="stable")
    sure, weight = judged.confidence[order], judged.weight[order]
    reached = np.cumsum(weight * judged.right[order]) / np.cumsum(weight)
    last = np.append(sure[:-1] > sure[1:], True)  # a threshold cannot part equals
    good = np.flatnonzero((reached >= precision) & last)
    return float(sure[good[-1]]) if len(good) else float(sure[0])


def _holding(seen: _Seen, answered: Flags) -> float:
    """The factor by which the radius holds the truth in `HELD` of the answers."""
    off, weight = seen.error_m[answered] / seen.scatter_m[answered], seen.weight[answered]
    order = np.argsort(off)
    enough = np.cumsum(weight[order]) >= HELD * weight.sum() * (1 - 1e-9)
    return float(off[order][np.argmax(enough)])


class _Seen(NamedTuple):
    """What the first place of each case is like."""

    evidence: Numbers
    right: Flags
    error_m: Numbers
    scatter_m: Numbers
    weight: Numbers

    def judged(self, sure: Numbers, radius: float = 1.0) -> Predictions:
        return Predictions(sure, self.right, self.error_m, radius * self.scatter_m, self.weight)


def _seen(cases: Sequence[Case], sharpness: float) -> _Seen:
    found = [next(candidates(case.matches, radius_m=RADIUS_M, sharpness=sharpness), None) for case in cases]
    first = [one for one in found if one is not None]
    if len(first) < len(cases):
        raise BenchmarkError("a query found no photo with a position: give every photo of the index one")
    error = np.array([_error(case, one) for case, one in zip(cases, first, strict=True)])
    return _Seen(
        np.array([one.evidence for one in first]),
        error <= RADIUS_M,
        error,
        np.array([one.scatter_m for one in first]),
        np.array([case.weight for case in cases]),
    )


def _error(case: Case, one: Candidate) -> float:
    return np.inf if case.truth is None else metres_between(case.truth, one.where)


def _folds(places: Sequence[str], seed: int) -> npt.NDArray[np.int64]:
    """The fold of each case, `[cases]`; those of one place are in one."""
    names = sorted(set(places))
    if len(names) < FOLDS:
        raise BenchmarkError(f"there are queries of {len(names)} places: give at least {FOLDS}")
    drawn = dict(zip(names, np.random.default_rng(seed).permutation(len(names)) % FOLDS, strict=True))
    return np.array([drawn[place] for place in places])


def _out_of_fold(seen: _Seen, apart: npt.NDArray[np.int64]) -> Numbers:
    """The confidence of each case by a fit to the other folds."""
    sure = np.empty(len(apart))
    for fold in range(FOLDS):
        here = apart == fold
        bias, weights = fit(seen.evidence[~here], seen.right[~here], seen.weight[~here])
        sure[here] = 1 / (1 + np.exp(-(bias + (seen.evidence[here] * SIGNS) @ weights)))
    return sure
