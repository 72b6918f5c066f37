"""What a search keeps while it sweeps: enough rows for each query to be sure that the true best are among them.

Scores of a sweep are rounded. So a row is kept as long as rounding might hide that it is among the best k.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from salad.index.vectors import UNIT_TOLERANCE

Queries: TypeAlias = npt.NDArray[np.float32]
Scores: TypeAlias = npt.NDArray[np.float32]
Numbers: TypeAlias = npt.NDArray[np.int64]
Mask: TypeAlias = npt.NDArray[np.bool_]

# bfloat16 rounds to within 2^-9. Query, row and score are each rounded once, and of two scores that are compared
# one may come out too high and the other too low; the rest is to spare.
_COARSE = 1.05 * 2 * 3 * 2.0**-9


class Candidates:
    """Pairs (query, row) with their scores, at least the best k of each query among the rows seen so far.

    They are in order of query, and of score from the best on.

    Attributes:
        query_of: `[P]`.
        row_of: `[P]`.
        score_of: `[P]`.
    """

    def __init__(self, queries: Queries, *, k: int, coarse: bool) -> None:
        """Begin with none.

        Args:
            queries: `[Q, dim]`.
            k: How many are wanted for each query.
            coarse: Whether scores come of bfloat16 rather than float32.
        """
        lengths = np.linalg.norm(queries.astype(np.float64), axis=1)
        off = _COARSE if coarse else 2.0**-20 * np.sqrt(queries.shape[1])
        self._k, self._slack = k, (off * lengths).astype(np.float32)
        # No sound row scores above this, and comparing with it also shows NaN and infinity.
        self._most = ((1 + 2 * UNIT_TOLERANCE + off) * lengths).astype(np.float32)
        self._least = np.full(len(queries), -np.inf, dtype=np.float32)
        self.query_of = self.row_of = np.zeros(0, dtype=np.int64)
        self.score_of = np.zeros(0, dtype=np.float32)

    def offer(self, start: int, scores: Scores, allowed: Mask) -> None:
        """Take from `scores` `[Q, n]`, of the rows from `start` on, those that may be among the best.

        Rows that are not `allowed` `[n]`, score -infinity, or are damaged and show it, are passed over.
        """
        near = (scores >= self._least[:, None]) & (scores <= self._most[:, None]) & (scores > -np.inf)
        if not allowed.all():
            near &= allowed
        count = np.count_nonzero(near)
        if count > 4 * self._k * len(scores) and self._k < scores.shape[1]:
            self._raise_least(np.where(near, scores, -np.inf))
            near &= scores >= self._least[:, None]
        query_of, column = np.divmod(np.flatnonzero(near), scores.shape[1])
        if len(query_of):
            self._keep(query_of, column + start, scores[query_of, column])

    def merge(self, other: Candidates) -> None:
        """Take over what another found among other rows."""
        self._keep(other.query_of, other.row_of, other.score_of)

    def pairs(self, numbers: Numbers) -> tuple[Numbers, Numbers]:
        """Query and row of these pairs: `[len(numbers)]` each."""
        return self.query_of[numbers], self.row_of[numbers]

    def leaders(self) -> Numbers:
        """Which of the pairs are the k best of their query by these scores: their numbers."""
        first, _ = bounds(self.query_of, len(self._least))
        return np.flatnonzero(np.arange(len(self.query_of)) - first[self.query_of] < self._k)

    def rivals(self, leaders: Numbers, exact: npt.NDArray[np.float64]) -> Numbers:
        """Which other pairs may be among the k best, now that the leaders' exact scores are known: their numbers."""
        kth = np.full(len(self._least), np.inf)
        np.minimum.at(kth, self.query_of[leaders], exact)
        near = self.score_of >= (kth - self._slack / 2)[self.query_of]
        near[leaders] = False
        return np.flatnonzero(near)

    def _raise_least(self, scores: Scores) -> None:
        kth = -np.partition(-scores, self._k - 1, axis=1)[:, self._k - 1]
        self._least = np.maximum(self._least, kth - self._slack)

    def _keep(self, query_of: Numbers, row_of: Numbers, score_of: Scores) -> None:
        """Add candidates, and let go of those that k others of their query leave behind for sure."""
        query_of = np.concatenate([self.query_of, query_of])
        row_of = np.concatenate([self.row_of, row_of])
        score_of = np.concatenate([self.score_of, score_of])
        order = np.lexsort((-score_of, query_of))
        query_of, row_of, score_of = query_of[order], row_of[order], score_of[order]
        first, behind = bounds(query_of, len(self._least))
        full = behind - first >= self._k
        kth = score_of[first[full] + self._k - 1]
        self._least[full] = np.maximum(self._least[full], kth - self._slack[full])
        still = score_of >= self._least[query_of]
        self.query_of, self.row_of, self.score_of = query_of[still], row_of[still], score_of[still]


def bounds(query_of: Numbers, queries: int) -> tuple[Numbers, Numbers]:
    """Where each query begins in sorted `query_of`, and where it ends: `[queries]` each."""
    every = np.arange(queries)
    return np.searchsorted(query_of, every, "left"), np.searchsorted(query_of, every, "right")
