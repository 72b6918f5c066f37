"""How far the best match stands from the query, where the positions of both are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64

from salad import geo
from salad.photos import Photo

WITHIN = (5, 10, 25, 50)  # metres


def errors(
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


def medians(
    apart: Float64[np.ndarray, " queries"], weights: Float64[np.ndarray, "draws queries"]
) -> Float64[np.ndarray, " draws"]:
    """The median of each draw, where each query counts so often: the first that half of the weight is not above."""
    order = np.argsort(apart, kind="stable")
    sums = np.cumsum(weights[:, order], axis=1)
    middle = np.argmax(sums >= sums[:, -1:] / 2, axis=1)
    found: Float64[np.ndarray, " draws"] = apart[order][middle]
    return found


def shares(
    apart: Float64[np.ndarray, " queries"], weights: Float64[np.ndarray, "draws queries"]
) -> Float64[np.ndarray, "draws within"]:
    """Percent within each of `WITHIN`, a row a draw."""
    near = np.stack([apart <= metres for metres in WITHIN], axis=1).astype(np.float64)
    found: Float64[np.ndarray, "draws within"] = 100 * (weights @ near) / weights.sum(axis=1, keepdims=True)
    return found
