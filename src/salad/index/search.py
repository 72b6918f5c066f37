"""Exact search: every query against every descriptor, best first.

The matrix is read through its memory map in blocks, so an index larger than memory works. Each block is
widened to float32 and multiplied; whatever comes within rounding of the best k is kept, and only those few
are scored once more in float64. So equal descriptors have equal scores wherever they stand, and ties are in
order of row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from salad.errors import StoreError
from salad.photos import Photo

if TYPE_CHECKING:
    import torch

Floats = npt.NDArray[np.floating]
Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

_WIDEN = 1 << 19  # numbers widened to float32 at a time: two megabytes, which stay in the processor's cache
_SCORES = 1 << 22  # scores held before the best are picked


@dataclass(frozen=True, slots=True)
class Match:
    """A reference that looks like the query.

    Attributes:
        photo: The reference.
        score: Dot product of the two descriptors, the cosine of their angle: 1 is the same picture.
        row: Row of the index's matrix.
    """

    photo: Photo
    score: float
    row: int


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one commit holds, for searching: descriptors `[N, dim]` and which rows are alive `[N]`."""

    generation: int
    descriptors: npt.NDArray[np.float16]
    alive: Mask


class Searcher(Protocol):
    """The seam that every search engine keeps: `Index` on this machine, others elsewhere."""

    def add(
        self, photos: Sequence[Photo], descriptors: Floats, *, identities: Sequence[str] | None = None
    ) -> int:
        """Take in photos with their descriptors `[N, dim]`; returns how many were new."""
        ...

    def remove(self, paths: Sequence[str | Path]) -> int:
        """Forget the photos at, or below, these paths; returns how many."""
        ...

    def search(self, descriptors: Floats, *, k: int = 5) -> list[list[Match]]:
        """The best k matches of each query, `[Q, dim]` or `[dim]`, best first."""
        ...


def as_queries(descriptors: Floats, dim: int) -> npt.NDArray[np.float32]:
    """Queries as float32 `[Q, dim]`.

    Raises:
        StoreError: If they are not of dimension `dim`, or not all finite.
    """
    queries = np.atleast_2d(np.asarray(descriptors, dtype=np.float32))
    if queries.ndim != 2 or queries.shape[1] != dim:
        raise StoreError(
            f"these descriptors have shape {list(np.shape(descriptors))}, but the index holds descriptors of "
            f"{dim} numbers: describe the query with the index's own model"
        )
    if not np.isfinite(queries).all():
        raise StoreError(
            "a query's descriptor holds NaN or infinity: check the model and the photo it came from"
        )
    return queries


def best_rows(
    matrix: npt.NDArray[np.float16], queries: npt.NDArray[np.float32], *, k: int, allowed: Mask
) -> list[list[tuple[int, float]]]:
    """The k best allowed rows of each query with their scores, best first, ties by row.

    Args:
        matrix: `[N, dim]` float16, memory-mapped or not.
        queries: `[Q, dim]` float32.
        k: How many; fewer come back where fewer are allowed.
        allowed: `[N]`, which rows may come out. Filters belong here: they hold before the ranking.
    """
    if k < 1:
        raise StoreError(f"k is {k}: ask for at least one match")
    if not allowed.any() or not len(queries):
        return [[] for _ in queries]
    query_of, row_of = _candidates(matrix, queries, k, allowed)
    found = []
    for number, query in enumerate(queries):
        rows = row_of[query_of == number]
        scores = _exact_scores(matrix, query, rows)
        order = np.lexsort((rows, -scores))[:k]
        found.append([(int(rows[i]), float(scores[i])) for i in order])
    return found


def _candidates(
    matrix: npt.NDArray[np.float16], queries: npt.NDArray[np.float32], k: int, allowed: Mask
) -> tuple[Rows, Rows]:
    """Pairs (query, row) that hold every true best k, and the few within rounding of them."""
    import torch

    slack = torch.from_numpy(_rounding(queries))
    best = torch.full((len(queries), k), -torch.inf)
    kept: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []
    for start, scores in _scored_blocks(matrix, queries):
        blocked = torch.from_numpy(~allowed[start : start + scores.shape[1]])
        scores.masked_fill_(blocked, -torch.inf)
        ahead = scores.topk(min(k, scores.shape[1])).values
        best = torch.cat([best, ahead], dim=1).topk(k).values
        near = (scores >= (best[:, -1] - slack)[:, None]) & (scores > -torch.inf)
        query_of, column = near.nonzero(as_tuple=True)
        kept.append((query_of, column + start, scores[query_of, column]))
    query_of, row_of, score_of = (torch.cat(parts) for parts in zip(*kept, strict=True))
    still = score_of >= (best[:, -1] - slack)[query_of]
    return query_of[still].numpy(), row_of[still].numpy()


def _scored_blocks(
    matrix: npt.NDArray[np.float16], queries: npt.NDArray[np.float32]
) -> Iterator[tuple[int, torch.Tensor]]:
    """First row and scores `[Q, n]` float32 of one block after another; the caller may write in them."""
    import torch

    rows, dim = matrix.shape
    step = max(1, _WIDEN // dim)
    block = max(step, _SCORES // len(queries) // step * step)
    half = torch.empty(min(step, rows), dim, dtype=torch.float16)
    wide = torch.empty(min(step, rows), dim)
    asked = torch.from_numpy(queries)
    for start in range(0, rows, block):
        scores = torch.empty(len(queries), min(block, rows - start))
        # Lower precision that a caller switched on for its model is not for scores.
        with torch.inference_mode(), torch.autocast("cpu", enabled=False):
            for low in range(0, scores.shape[1], step):
                some = matrix[start + low : start + min(low + step, scores.shape[1])]
                # A copy, for torch will not have read-only memory; but it widens ten times as fast as numpy.
                np.copyto(half.numpy()[: len(some)], some)
                wide[: len(some)].copy_(half[: len(some)])
                scores[:, low : low + len(some)] = asked @ wide[: len(some)].T
        yield start, scores


def _rounding(queries: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """How far a float32 dot product with a row of length 1 may be off, with much to spare: `[Q]`."""
    lengths = np.linalg.norm(queries.astype(np.float64), axis=1)
    off: npt.NDArray[np.float32] = (2.0**-20 * np.sqrt(queries.shape[1]) * lengths).astype(np.float32)
    return off


def _exact_scores(
    matrix: npt.NDArray[np.float16], query: npt.NDArray[np.float32], rows: Rows
) -> npt.NDArray[np.float64]:
    """Dot products in float64, row by row, so that equal rows score equally: `[len(rows)]`."""
    wide = query.astype(np.float64)
    scores = np.empty(len(rows))
    step = max(1, _WIDEN // len(wide))
    for low in range(0, len(rows), step):
        some = rows[low : low + step]
        scores[low : low + step] = (matrix[some].astype(np.float64) * wide).sum(axis=1)
    return scores
