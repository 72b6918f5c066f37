"""Scores without what all photos of an index have in common.

Descriptors of one building, one railway or one camera lean the same way. A reference that leans that way more than the
others is like every query, a hub, and comes out on top too often. So it gives up half of how much it is like the mean
m of all of them, and the query is given back its own half, so that the same picture still scores 1:

    score = q . r - (m . r - m . q) / 2

To first order that ranks as the cosine of centred descriptors does. But only the query is moved, by a vector that
all share, so whatever finds the largest dot product finds this too.

Source: Suzuki et al., "Centering Similarity Measures to Reduce Hubs", EMNLP 2013.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from salad.index.candidates import Mask, Queries
from salad.index.vectors import UNIT_TOLERANCE, Rows

Mean: TypeAlias = npt.NDArray[np.float64]

SHARE = 0.5  # of the mean: benchmarks/centring.py compares others
MOST = 4096  # photos that a mean is taken of: its error is then a hundredth of a descriptor's length
_STEP = 256  # rows or queries widened at once


def centred(queries: Queries, mean: Mean) -> tuple[Queries, npt.NDArray[np.float64]]:
    """Move queries `[Q, dim]` away from the mean `[dim]` of the references they are asked of.

    Returns:
        The queries to search by, and what to add to the scores of each: `[Q]`.
    """
    lean = SHARE * mean
    back = np.zeros(len(queries))
    for low in range(0, len(queries), _STEP):
        back[low : low + _STEP] = queries[low : low + _STEP] @ lean
    return np.subtract(queries, lean, dtype=np.float32), back


def mean_of(rows: Rows, alive: Mask) -> Mean:
    """The mean of the rows that are alive: of `MOST` evenly spread ones where they are more, 0 where there is none.

    A row that is no descriptor, as damage can make it, does not count.

    Raises:
        StoreError: the disk does not give the rows.
    """
    those = np.flatnonzero(alive)
    if len(those) > MOST:
        those = those[np.linspace(0, len(those) - 1, MOST).astype(np.int64)]
    total, count = np.zeros(rows.dim), 0
    for low in range(0, len(those), _STEP):
        wide = rows.take(those[low : low + _STEP]).astype(np.float64)
        sound = np.abs(np.linalg.norm(wide, axis=1) - 1) <= 2 * UNIT_TOLERANCE  # NaN is not
        total += wide[sound].sum(axis=0)
        count += int(sound.sum())
    return total / max(1, count)
