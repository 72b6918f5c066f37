"""Exact ranking in blocks over both sides, so that millions of references take little memory.

A block of references is multiplied with a block of queries in float32. Whatever comes within rounding of a query's
best k is scored once more in float64 while the block is at hand. So equal descriptors have equal scores wherever
they stand, the size of the blocks changes nothing, and ties are in order of row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64

from salad.errors import BenchmarkError
from salad.index import centring

Vectors: TypeAlias = Float[np.ndarray, "rows dim"]
Numbers: TypeAlias = Int64[np.ndarray, " pairs"]
Scores: TypeAlias = Float64[np.ndarray, " pairs"]

_NUMBERS = 1 << 22  # numbers of references in a block: 16 MiB of float32
_QUERIES = 512  # queries multiplied with a block at once
_PAIRS = 1 << 20  # numbers scored once more at a time: 8 MiB of float64
_ROUNDING = (
    2.0**-20
)  # a float32 product is off by less, times the square root of its length and both sides' lengths


class Rows(Protocol):
    """Descriptors that come block by block, in memory or from files; `salad.index.npy.Matrix` is one too."""

    @property
    def rows(self) -> int:
        """How many there are."""
        ...

    @property
    def dim(self) -> int:
        """Numbers in each."""
        ...

    def blocks(self, *, numbers: int) -> Iterator[Vectors]:
        """All of them in order, about so many numbers at a time."""
        ...


@dataclass(frozen=True, eq=False)
class Held:
    """Descriptors `[rows, dim]` that are in memory already."""

    descriptors: Vectors

    @property
    def rows(self) -> int:
        """How many there are."""
        return len(self.descriptors)

    @property
    def dim(self) -> int:
        """Numbers in each."""
        return int(self.descriptors.shape[1])

    def blocks(self, *, numbers: int) -> Iterator[Vectors]:
        """All of them in order, about so many numbers at a time."""
        step = max(1, numbers // self.dim)
        for start in range(0, self.rows, step):
            yield self.descriptors[start : start + step]


@dataclass(frozen=True, eq=False)
class Ranked:
    """What was found for each query, best first.

    Attributes:
        rows: `[queries, k]` rows of references; -1 where there is no more.
        scores: `[queries, k]` their scores; None where nobody told them.
    """

    rows: Int64[np.ndarray, "queries k"]
    scores: Float64[np.ndarray, "queries k"] | None = None


def rank(
    queries: Float32[np.ndarray, "queries dim"], references: Float32[np.ndarray, "references dim"], *, k: int
) -> Int64[np.ndarray, "queries k"]:
    """Rank references by their dot product with each query, exactly.

    Args:
        queries: `[queries, dim]` descriptors.
        references: `[references, dim]` descriptors.
        k: How many to keep.

    Returns:
        `[queries, min(k, references)]` rows of references, best first; equal scores in the order of their rows, so
        that the same descriptors give the same figure everywhere.

    Raises:
        BenchmarkError: The two sides do not fit, or hold numbers that are not finite.
    """
    return nearest(Held(queries), Held(references), k=k).rows


def nearest(
    queries: Rows,
    references: Rows,
    *,
    k: int,
    centred: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Ranked:
    """Find the references with the highest dot products with each query, exactly, with their scores.

    Queries are held in memory as float32; references pass by in blocks, once, or twice where `centred`.

    Args:
        queries: `[queries, dim]` descriptors.
        references: `[references, dim]` descriptors.
        k: How many to keep; no more than there are references come back.
        centred: Whether scores leave out what all references have in common, as `salad.index.centring` says.
        progress: Told how many references have passed by, and of how many.

    Raises:
        BenchmarkError: The two sides do not fit, or hold numbers that are not finite.
    """
    if queries.dim != references.dim:
        raise BenchmarkError(
            f"queries have {queries.dim} numbers each and references {references.dim}: describe both with one model"
        )
    asked, added = _whole(queries), np.zeros(queries.rows)
    if centred:
        asked, added = centring.centred(asked, _mean(references))
    best = _Best(asked, k=min(k, references.rows))
    done = 0
    for block in references.blocks(numbers=_NUMBERS):
        best.offer(done, np.ascontiguousarray(block, dtype=np.float32))
        done += len(block)
        if progress is not None:
            progress(done, references.rows)
    return Ranked(best.rows, best.scores + added[:, None])


class _Best:
    """The k best references of each query among those seen so far."""

    def __init__(self, queries: Float32[np.ndarray, "queries dim"], *, k: int) -> None:
        self._queries, self._k = queries, k
        self._off = _ROUNDING * np.sqrt(queries.shape[1]) * _lengths(queries, "query")
        self.rows = np.full((len(queries), k), -1, dtype=np.int64)
        self.scores = np.full((len(queries), k), -np.inf)

    def offer(self, start: int, block: Float32[np.ndarray, "block dim"]) -> None:
        """Take what is among the best of a block, whose first row is `start`."""
        longest = float(_lengths(block, "reference", start).max())
        for low in range(0, len(self._queries), _QUERIES):
            near = self._near(slice(low, low + _QUERIES), block, longest)
            query_of, column = np.divmod(np.flatnonzero(near), len(block))
            self._keep(query_of + low, column + start, self._exact(query_of + low, block, column))

    def _near(
        self, those: slice, block: Float32[np.ndarray, "block dim"], longest: float
    ) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
        """Which of a block may be among a query's k best, by rounded scores: `[queries, block]`."""
        scores = self._queries[those] @ block.T
        off = self._off[those] * longest
        near = scores >= _below(self.scores[those, -1] - off)[:, None]
        k, count = self._k, scores.shape[1]
        if count > k and np.count_nonzero(near) > 4 * k * len(scores):
            kth = np.partition(scores, count - k, axis=1)[:, count - k]  # rounded itself, hence twice
            near &= scores >= _below(kth - 2 * off)[:, None]
        found: np.ndarray[tuple[int, int], np.dtype[np.bool_]] = near
        return found

    def _exact(self, query_of: Numbers, block: Float32[np.ndarray, "block dim"], column: Numbers) -> Scores:
        """Dot products of pairs, each by itself in float64."""
        scores = np.empty(len(query_of))
        step = max(1, _PAIRS // block.shape[1])
        for low in range(0, len(scores), step):
            wide = block[column[low : low + step]].astype(np.float64)
            wide *= self._queries[query_of[low : low + step]]
            scores[low : low + step] = wide.sum(axis=1)
        return scores

    def _keep(self, query_of: Numbers, row_of: Numbers, score_of: Scores) -> None:
        """Merge new pairs with the best so far of the queries they touch."""
        touched = np.unique(query_of)
        queries = np.concatenate([np.repeat(touched, self._k), query_of])
        rows = np.concatenate([self.rows[touched].ravel(), row_of])
        scores = np.concatenate([self.scores[touched].ravel(), score_of])
        order = np.lexsort((rows, -scores, queries))
        first = np.searchsorted(queries[order], touched)
        kept = order[first[:, None] + np.arange(self._k)]  # each has k at least: those it had
        self.rows[touched], self.scores[touched] = rows[kept], scores[kept]


def _below(limits: Float64[np.ndarray, " queries"]) -> Float32[np.ndarray, " queries"]:
    """Limits as float32, rounded down."""
    return np.nextafter(limits.astype(np.float32), np.float32(-np.inf))


def _whole(rows: Rows) -> Float32[np.ndarray, "rows dim"]:
    """All descriptors at once, float32."""
    if isinstance(rows, Held):
        return np.ascontiguousarray(rows.descriptors, dtype=np.float32)
    whole = np.empty((rows.rows, rows.dim), dtype=np.float32)
    done = 0
    for block in rows.blocks(numbers=_NUMBERS):
        whole[done : done + len(block)] = block
        done += len(block)
    return whole


def _mean(rows: Rows) -> Float64[np.ndarray, " dim"]:
    total, done = np.zeros(rows.dim), 0
    for block in rows.blocks(numbers=_NUMBERS):
        _lengths(
            block, "reference", done
        )  # what is not finite is named here: in a mean, every query would seem so
        total += block.sum(axis=0, dtype=np.float64)
        done += len(block)
    return total / max(1, done)


def _lengths(
    rows: Float32[np.ndarray, "rows dim"], role: str, start: int = 0
) -> Float32[np.ndarray, " rows"]:
    """The length of each descriptor; a number that is not finite, or too large to square, shows in it."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    bad = np.flatnonzero(~np.isfinite(lengths))
    if bad.size:
        raise BenchmarkError(
            f"the descriptor of {role} {start + int(bad[0])} (from 0) holds NaN, infinity or numbers too large to "
            "multiply: check the model and the photo it came from"
        )
    return np.asarray(lengths, dtype=np.float32)
