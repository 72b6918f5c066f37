"""What a search hands out is what was written: the few rows that come out on top are checked by their sums.

A flipped bit can make a descriptor like another photo's, and nothing in its numbers shows it. To check every
row at every search would cost more than the search; to check those that are found costs next to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from salad.index import vectors
from salad.index.catalog import UNKNOWN, Ledger
from salad.index.vectors import Snapshot
from salad.search.base import Mask

_STEP = 1024  # rows checked in one go


class ChecksumVerifier:
    """The rows of one snapshot that were checked so far; each is checked once."""

    def __init__(self, seen: Snapshot) -> None:
        self._seen = seen
        self._checked = np.zeros(len(seen.alive), dtype=np.bool_)
        self._damaged = np.zeros(len(seen.alive), dtype=np.bool_)

    def alive(self) -> Mask:
        """Rows that are alive and not known to be damaged: `[N]`."""
        return self._seen.alive & ~self._damaged if self._damaged.any() else self._seen.alive

    def passes(self, table: Ledger, rows: Iterable[int]) -> bool:
        """Whether these rows are what was written; those that are not will not be alive from now on.

        It belongs in a look in which the rows have the numbers they have in the snapshot.
        """
        found = np.fromiter(rows, dtype=np.int64)
        found = np.sort(found[~self._checked[found]])
        passed = True
        for low in range(0, len(found), _STEP):
            some = found[low : low + _STEP]
            noted = table.sums_at(some)
            wrong = (noted != UNKNOWN) & (noted != vectors.sums(self._seen.rows.take(some)))
            self._checked[some] = True
            self._damaged[some[wrong]] = True
            passed = passed and not wrong.any()
        return passed
