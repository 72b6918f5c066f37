"""How an index is: what it holds, and whether its descriptors are sound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

import numpy as np
import numpy.typing as npt

_BLOCK = 1 << 22  # numbers looked at in one go

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class IndexInfo:
    """What an index holds.

    Attributes:
        photos: Photos that can be found.
        with_position: Those of them whose position is known.
        model: Name of the model.
        fingerprint: Its fingerprint.
        dim: Numbers in a descriptor.
        bytes: Size of the folder on disk.
        created: When the index was made, UTC.
        box: South, west, north, east of all positions in degrees; west > east where it crosses the date line.
        format_version: The form of the folder.
    """

    photos: int
    with_position: int
    model: str
    fingerprint: str
    dim: int
    bytes: int
    created: datetime
    box: Box | None
    format_version: int

    def as_dict(self) -> dict[str, Any]:
        """These facts as JSON holds them."""
        return {**asdict(self), "created": self.created.isoformat()}


def box(positions: Sequence[tuple[float, float]]) -> Box | None:
    """The smallest box around (latitude, longitude) pairs, across the date line where that is smaller."""
    if not positions:
        return None
    lats, lons = np.asarray(positions, dtype=np.float64).T
    east_of = np.sort(lons)
    gaps = np.diff(east_of, append=east_of[0] + 360)
    widest = int(gaps.argmax()) if gaps.max() > gaps[-1] else len(gaps) - 1
    west, east = east_of[(widest + 1) % len(east_of)], east_of[widest]
    return float(lats.min()), float(west), float(lats.max()), float(east)


def bad_rows(
    descriptors: npt.NDArray[np.float16], alive: npt.NDArray[np.bool_], *, tolerance: float
) -> list[int]:
    """Living rows of `[N, dim]` that are not finite or whose length is further than `tolerance` from 1."""
    step = max(1, _BLOCK // descriptors.shape[1])
    bad: list[int] = []
    for start in range(0, len(descriptors), step):
        wide = descriptors[start : start + step].astype(np.float32)
        off = np.abs(np.linalg.norm(wide, axis=1) - 1)
        wrong = ~(off <= tolerance) & alive[start : start + step]
        bad += [start + int(row) for row in wrong.nonzero()[0]]
    return bad
