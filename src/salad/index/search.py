"""Exact search: every query against every descriptor, best first.

The matrix is read in blocks, so an index larger than memory works. `scan.py` multiplies them quickly and keeps
whatever comes within rounding of the best k; only those few are scored once more in float64. So equal
descriptors have equal scores wherever they stand, and ties are in order of row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from salad.errors import StoreError
from salad.images.photo import Photo
from salad.index.candidates import Mask, Queries, bounds
from salad.index.scan import best_pairs
from salad.index.vectors import Rows

if TYPE_CHECKING:
    from salad.index.filters import Filter

Floats = npt.NDArray[np.floating]
Found = list[tuple[int, float]]

_QUERIES = 512  # queries answered in one sweep; more would only need more memory


@dataclass(frozen=True, slots=True)
class Match:
    """A reference that looks like the query.

    Attributes:
        photo: The reference.
        score: Dot product of the two descriptors, the cosine of their angle; centred, if that was asked for, on all
            photos of the index. 1 is the same picture.
        row: Row of the index's matrix.
    """

    photo: Photo
    score: float
    row: int


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one commit holds, for searching: its rows `[N, dim]`, and which of them are alive `[N]`."""

    generation: int
    rows: Rows
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

    def search(
        self, descriptors: Floats, *, k: int = 5, where: Filter | None = None, centred: bool = False
    ) -> list[list[Match]]:
        """The best k matches of each query, `[Q, dim]` or `[dim]`, best first, among those `where` allows.

        Where `centred`, scores are those of `centring.py`.
        """
        ...


def as_queries(descriptors: Floats, dim: int) -> Queries:
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


def best_rows(rows: Rows, queries: Queries, *, k: int, allowed: Mask) -> list[Found]:
    """The k best allowed rows of each query with their scores, best first, ties by row.

    A row that holds NaN or infinity, or is longer than a descriptor can be, is damaged: it is never found.

    Args:
        rows: `[N, dim]`.
        queries: `[Q, dim]` float32.
        k: How many; fewer come back where fewer are allowed.
        allowed: `[N]`, which rows may come out. Filters belong here: they hold before the ranking.

    Raises:
        StoreError: If k is below 1, or the disk does not give the rows.
    """
    if k < 1:
        raise StoreError(f"k is {k}: ask for at least one match")
    if not allowed[: rows.held].any():
        return [[] for _ in queries]
    found: list[Found] = []
    for low in range(0, len(queries), _QUERIES):
        found += _best_rows(rows, queries[low : low + _QUERIES], k, allowed)
    return found


def _best_rows(rows: Rows, queries: Queries, k: int, allowed: Mask) -> list[Found]:
    query_of, row_of, score_of = best_pairs(rows, queries, k=k, allowed=allowed)
    order = np.lexsort((row_of, -score_of, query_of))
    found = list(zip(row_of[order].tolist(), score_of[order].tolist(), strict=True))
    first, behind = bounds(query_of[order], len(queries))
    return [found[low : min(high, low + k)] for low, high in zip(first, behind, strict=True)]
