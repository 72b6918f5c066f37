"""Scores without what all rows have in common.

Descriptors of one building, one railway or one camera lean the same way. A reference that leans that way more than the
others is like every query, a hub, and comes out on top too often. So it gives up half of how much it is like the mean
m of all of them, and the query is given back its own half, so that the same picture still scores 1:

    score = q . r - (m . r - m . q) / 2

To first order that ranks as the cosine of centred descriptors does. But only the query is moved, by a vector that
all share, so any `Searcher` finds this too.

Source: Suzuki et al., "Centering Similarity Measures to Reduce Hubs", EMNLP 2013.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from salad.search.base import UNIT_TOLERANCE, DamagedRowError, Hits, Mask, Queries, Rows, Scores, Searcher, as_queries

if TYPE_CHECKING:
    from salad.search.filters import Filter

Mean: TypeAlias = npt.NDArray[np.float64]

SHARE = 0.5  # of the mean: benchmarks/accuracy/centring.py compares others
MOST = 4096  # rows that a mean is taken of: its error is then a hundredth of a descriptor's length
_STEP = 256  # rows or queries widened at once
_NUMBERS = 1 << 22  # numbers in a block where all rows count


class Centred:
    """Finds the best rows by centred scores, through any other searcher.

    Args:
        searcher: Finds the highest dot products.
        mean: `[dim]` of its rows.
    """

    def __init__(self, searcher: Searcher, mean: Mean) -> None:
        self._searcher, self._mean = searcher, mean

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self._searcher.dim

    @property
    def takes_filters(self) -> bool:
        """Whether the other does."""
        return self._searcher.takes_filters

    def __len__(self) -> int:
        return len(self._searcher)

    def search(self, queries: npt.NDArray[np.floating], *, k: int, allowed: Mask | Filter | None = None) -> Hits:
        """The k best rows of each query, as `Searcher.search` says."""
        asked, added = centred(as_queries(queries, self.dim), self._mean)
        hits = self._searcher.search(asked, k=k, allowed=allowed)
        return Hits(hits.rows, hits.scores + added[:, None])


def centred(queries: Queries, mean: Mean) -> tuple[Queries, Scores]:
    """Move queries `[Q, dim]` away from the mean `[dim]` of the rows they are asked of.

    Returns:
        The queries to search by, and what to add to the scores of each: `[Q]`.
    """
    lean = SHARE * mean
    # A step at a time: widened to float64, all queries at once would take three times their memory.
    back = np.zeros(len(queries))
    for low in range(0, len(queries), _STEP):
        back[low : low + _STEP] = queries[low : low + _STEP] @ lean
    return np.subtract(queries, lean, dtype=np.float32), back


def mean_of_some(rows: Rows, alive: Mask, *, most: int = MOST) -> Mean:
    """The mean of rows of length 1 that are alive, as an index takes it: quickly, and whatever is damaged left out.

    Args:
        rows: `[N, dim]`.
        alive: `[N]`, which count.
        most: Where they are more, so many evenly spread ones count.

    Returns:
        `[dim]`; 0 where there is none.

    Raises:
        StoreError: If the disk does not give the rows.
    """
    those = np.flatnonzero(alive)
    if len(those) > most:
        those = those[np.linspace(0, len(those) - 1, most).astype(np.int64)]
    total, count = np.zeros(rows.dim), 0  # in float64: thousands of rows are added up
    for low in range(0, len(those), _STEP):
        wide = rows.take(those[low : low + _STEP]).astype(np.float64)
        sound = np.abs(np.linalg.norm(wide, axis=1) - 1) <= 2 * UNIT_TOLERANCE  # NaN is not
        total += wide[sound].sum(axis=0)
        count += int(sound.sum())
    return total / max(1, count)


def mean_of_all(rows: Rows) -> Mean:
    """The mean of all rows, of whatever length, as an evaluation takes it, of which a figure shall not be a guess.

    Returns:
        `[dim]`; 0 where there is none.

    Raises:
        DamagedRowError: If a row is not finite. It is named here: in a mean, every query would seem so.
    """
    step = max(1, _NUMBERS // rows.dim)
    spare = np.empty((min(step, len(rows)), rows.dim), dtype=rows.dtype)
    total = np.zeros(rows.dim)
    for start in range(0, len(rows), step):
        block = rows.block(start, min(start + step, len(rows)), spare)
        bad = np.flatnonzero(~np.isfinite(block).all(axis=1))
        if bad.size:
            raise DamagedRowError(start + int(bad[0]))
        total += block.sum(axis=0, dtype=np.float64)
    return total / max(1, len(rows))
