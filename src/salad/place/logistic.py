"""Logistic regression without negative weights: the model behind a calibrated confidence."""

from __future__ import annotations

from itertools import chain, combinations

import numpy as np
import numpy.typing as npt

from salad.errors import BenchmarkError

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
