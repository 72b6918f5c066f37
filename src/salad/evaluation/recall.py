"""Recall@k: the share of queries with a right reference among the first k.

A query without any right reference cannot be answered. Each result says how many there were; they are left
out of the share (`drop`, the rule for a user's own folders) or stay in it as misses (`miss`, the rule of some
published protocols), and the protocol says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from salad.data.benchmark import Benchmark
from salad.errors import BenchmarkError, ModelError, PhotoError
from salad.photos import Photo

if TYPE_CHECKING:
    from salad.model.describer import Describes

KS = (1, 5, 10, 20)
Unanswerable = Literal["drop", "miss"]
_BLOCK_SCORES = 1 << 24  # scores held at once while ranking: 64 MiB of float32


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

    def as_dict(self) -> dict[str, Any]:
        """Give the JSON form that `salad evaluate --format json` prints."""
        return {
            "protocol": self.protocol,
            "queries": self.queries,
            "references": self.references,
            "unanswerable": self.unanswerable,
            "recall": {str(k): percent for k, percent in self.recall.items()},
            "model": self.model,
            "seconds": self.seconds,
        }


def recall_at(
    ranked: NDArray[np.integer[Any]] | Sequence[Sequence[int]],
    positives: Sequence[NDArray[np.int64]],
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
    if not ks or min(ks) < 1:
        raise BenchmarkError(f"recall at {list(ks)} makes no sense: give whole numbers from 1")
    pairs = [
        (np.asarray(rows), right)
        for rows, right in zip(ranked, positives, strict=True)
        if right.size or unanswerable == "miss"
    ]
    if not pairs:
        raise BenchmarkError(
            f"none of {len(positives)} queries has a right reference, so there is no recall to give: "
            "check the ground truth, the tolerance or the radius"
        )
    first_hits = np.array([_first_hit(rows, right) for rows, right in pairs])
    return {k: float(100.0 * np.mean(first_hits < k)) for k in ks}


def _first_hit(rows: NDArray[np.integer[Any]], right: NDArray[np.int64]) -> float:
    """Give the place of the first right row in a ranking, from 0; infinite where there is none."""
    hits = np.isin(rows, right)
    return float(np.argmax(hits)) if hits.any() else float("inf")


def rank(
    queries: NDArray[np.float32],
    references: NDArray[np.float32],
    *,
    k: int,
) -> NDArray[np.int64]:
    """Rank references by their dot product with each query, exactly.

    Args:
        queries: `[Q, dim]` descriptors.
        references: `[R, dim]` descriptors.
        k: How many to keep.

    Returns:
        `[Q, min(k, R)]` rows of references, best first; equal scores in the order of their rows, so that the
        same descriptors give the same figure everywhere.
    """
    k = min(k, len(references))
    ranked = np.empty((len(queries), k), dtype=np.int64)
    block = max(1, _BLOCK_SCORES // len(references))
    for start in range(0, len(queries), block):
        scores = queries[start : start + block] @ references.T
        for row, line in enumerate(scores, start):
            ranked[row] = _best(line, k)
    return ranked


def _best(scores: NDArray[np.float32], k: int) -> NDArray[np.int64]:
    """Give the rows of the k highest scores, best first, ties by row."""
    least = np.partition(scores, len(scores) - k)[len(scores) - k]
    candidates = np.flatnonzero(scores >= least)  # all that tie with the k-th, so that the first rows win
    return candidates[np.argsort(-scores[candidates], kind="stable")[:k]]


def evaluate(
    benchmark: Benchmark,
    model: Describes,
    *,
    ks: Sequence[int] = KS,
    batch_size: int = 16,
    unanswerable: Unanswerable = "drop",
    progress: Callable[[int, int], None] | None = None,
) -> Result:
    """Describe both sides of a benchmark, rank, and give the recall.

    Args:
        benchmark: The set and its ground truth.
        model: What turns photos into descriptors.
        ks: Which k to report; a k beyond the number of references asks whether any is right.
        batch_size: Photos described at once.
        unanswerable: Whether queries without positives are left out (`drop`) or count as misses (`miss`).
        progress: Told how many photos are described, and of how many.

    Raises:
        BenchmarkError: A photo cannot be read (a figure with holes is no figure), or no query has an answer.
        ModelError: The model gives descriptors of another shape than it says, or numbers that are not finite.
    """
    # Ranking nothing refuses a senseless k or an unanswerable set now, not after an hour of describing.
    recall_at([[]] * len(benchmark.queries), benchmark.positives, ks, unanswerable=unanswerable)
    began = time.perf_counter()
    photos = (*benchmark.references, *benchmark.queries)
    descriptors = _describe(photos, model, batch_size=batch_size, progress=progress)
    references, queries = np.split(descriptors, [len(benchmark.references)])
    ranked = rank(queries, references, k=max(ks))
    rule = ", unanswerable queries count as misses" if unanswerable == "miss" else ""
    return Result(
        benchmark=benchmark.name,
        protocol=benchmark.protocol + rule,
        queries=len(benchmark.queries),
        references=len(benchmark.references),
        unanswerable=benchmark.unanswerable,
        recall=recall_at(ranked, benchmark.positives, ks, unanswerable=unanswerable),
        model=model.name,
        seconds=time.perf_counter() - began,
        notes=benchmark.notes,
    )


def _describe(
    photos: Sequence[Photo],
    model: Describes,
    *,
    batch_size: int,
    progress: Callable[[int, int], None] | None,
) -> NDArray[np.float32]:
    """Describe every photo, float32 [N, dim]."""
    descriptors = np.empty((len(photos), model.dim), dtype=np.float32)
    for start in range(0, len(photos), batch_size):
        batch = [photo.path for photo in photos[start : start + batch_size]]
        try:
            described = model.describe(batch, batch_size=batch_size)
        except PhotoError as error:
            raise BenchmarkError(
                f"a figure with holes is no figure, and a photo cannot be read: {error}; "
                "mend it, or take it out of the set"
            ) from error
        if described.shape != (len(batch), model.dim) or not np.isfinite(described).all():
            raise ModelError(
                f"model '{model.name}' gave {described.shape} numbers for {len(batch)} photos "
                f"from {batch[0]} on, where {(len(batch), model.dim)} finite ones were due: use other weights"
            )
        descriptors[start : start + len(batch)] = described
        if progress is not None:
            progress(start + len(batch), len(photos))
    return descriptors
