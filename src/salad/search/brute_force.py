"""Brute force: all scores at once, in float64, sorted.

What the tests hold every other searcher to, and a pattern for writing one. It takes memory for every score.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from salad.search.base import DamagedRowError, Hits, Mask, Numbers, Rows, as_mask, as_queries, check_k

if TYPE_CHECKING:
    from salad.search.filters import Filter


class BruteForceSearcher:
    """Finds the rows with the highest dot products.

    Args:
        rows: What is searched.

    Raises:
        DamagedRowError: If a row may have any length and has none.
    """

    def __init__(self, rows: Rows) -> None:
        self._longest = rows.longest
        self._rows = rows.take(np.arange(len(rows))).astype(np.float64)
        bad = np.flatnonzero(~np.isfinite(self._rows).all(axis=1))
        if rows.longest is None and bad.size:
            raise DamagedRowError(int(bad[0]))

    takes_filters = False

    @property
    def dim(self) -> int:
        """Numbers in a row."""
        return int(self._rows.shape[1])

    def __len__(self) -> int:
        return len(self._rows)

    def search(self, queries: npt.NDArray[np.floating], *, k: int, allowed: Mask | Filter | None = None) -> Hits:
        """The k best rows of each query, as `Searcher.search` says."""
        check_k(k)
        asked, mask = as_queries(queries, self.dim).astype(np.float64), as_mask(allowed, len(self))
        hits = Hits.none(len(asked), min(k, len(self)))
        for number, query in enumerate(asked):
            with np.errstate(invalid="ignore"):  # infinity times 0, in a damaged row
                scores = (self._rows * query).sum(axis=1)
            # What is too long to be sound is damaged; it shows where it scores more than a sound row can.
            most = np.inf if self._longest is None else self._longest * float(np.linalg.norm(query))
            sound = np.isfinite(scores) & (np.abs(scores) <= most)
            those = np.flatnonzero(sound if mask is None else sound & mask)
            best: Numbers = those[np.argsort(-scores[those], kind="stable")][:k]
            hits.rows[number, : len(best)] = best
            hits.scores[number, : len(best)] = scores[best]
        return hits
