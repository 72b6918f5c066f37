"""Recall@k: the share of queries with a right reference among the first k.

A query without any right reference cannot be answered. Each result says how many there were; they are left
out of the share (`drop`, the rule for a user's own folders) or stay in it as misses (`miss`, the rule of some
published protocols), and the protocol says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray

from salad.data.benchmark import Unanswerable
from salad.errors import BenchmarkError

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
