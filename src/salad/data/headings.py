"""Which of the photos nearby also look the same way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from salad.data.lazy import Ragged, headings
from salad.errors import BenchmarkError
from salad.geo import turn_between
from salad.photos import Photo


def looking_alike(
    queries: Sequence[Photo], references: Sequence[Photo], positives: Ragged, tolerance: float
) -> Ragged:
    """Keep of each query's positives those that look the same way, within `tolerance` degrees.

    Raises:
        BenchmarkError: A photo has no heading, or the tolerance is not between 0 and 180.
    """
    if not 0 <= tolerance <= 180:
        raise BenchmarkError(f"headings within {tolerance} degrees make no sense: give 0 to 180")
    ours, theirs = headings(queries), headings(references)
    for photos, known in ((queries, ours), (references, theirs)):
        lost = np.flatnonzero(np.isnan(known))
        if lost.size:
            raise BenchmarkError(
                f"{lost.size} of {len(photos)} photos have no heading, the first {photos[int(lost[0])].path}: "
                "give a table with headings, or leave the tolerance of headings away"
            )
    query = np.repeat(np.arange(len(ours)), positives.lengths)
    apart = turn_between(theirs[positives.values], ours[query])
    alike = apart <= tolerance + 1e-9  # with room for rounding
    counts = np.bincount(query[alike], minlength=len(ours))
    return Ragged(positives.values[alike], np.concatenate([[0], np.cumsum(counts)]).astype(np.int64))
