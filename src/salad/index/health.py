"""How an index is: what it holds, and whether its descriptors are sound."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salad.geo import metres
from salad.index import layout, matrix, records
from salad.index.header import Header
from salad.index.ledger import UNKNOWN, Ledger
from salad.index.matrix import Half, Rows

_ROUNDING = 1e-3
_BLOCK = 1 << 22  # numbers looked at in one go

Box = tuple[float, float, float, float]
Mask = npt.NDArray[np.bool_]
Numbers = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class IndexInfo:
    """What an index holds.

    Attributes:
        photos: Photos that can be found.
        with_position: Those of them whose position is known.
        with_heading: Those of them whose heading is known.
        with_time: Those of them of which it is known when they were taken.
        removed: Removed photos whose room `compact` would give back.
        model: Name of the model.
        fingerprint: Its fingerprint.
        dim: Numbers in a descriptor.
        bytes: Size of the folder on disk.
        bytes_of_descriptors: How much of that are descriptors.
        created: When the index was made, UTC.
        box: South, west, north, east of all positions in degrees; west > east where it crosses the date line.
        span_km: How far that box reaches from south to north and, along its middle, from west to east.
        earliest: When the first of the photos was taken, by the clock where it was; ISO 8601.
        latest: When the last of them was.
        format_version: The form of the folder.
    """

    photos: int
    with_position: int
    with_heading: int
    with_time: int
    removed: int
    model: str
    fingerprint: str
    dim: int
    bytes: int
    bytes_of_descriptors: int
    created: datetime
    box: Box | None
    span_km: tuple[float, float] | None
    earliest: str | None
    latest: str | None
    format_version: int

    def as_dict(self) -> dict[str, Any]:
        """These facts as JSON holds them."""
        return {**asdict(self), "created": self.created.isoformat()}


def survey(folder: Path, header: Header, table: Ledger) -> IndexInfo:
    """What the index in `folder` holds, in numbers."""
    with table.reading():
        last, facts, positions = table.committed(), table.facts(), table.positions()
    around = box(positions)
    return IndexInfo(
        photos=facts.photos,
        with_position=len(positions),
        with_heading=facts.with_heading,
        with_time=facts.with_time,
        removed=last.rows - facts.photos,
        model=header.model,
        fingerprint=header.fingerprint,
        dim=header.dim,
        bytes=layout.size(folder),
        bytes_of_descriptors=last.rows * header.dim * matrix.STORED.itemsize,
        created=header.created,
        box=around,
        span_km=span_km(around) if around else None,
        earliest=facts.earliest,
        latest=facts.latest,
        format_version=header.format_version,
    )


def box(positions: npt.ArrayLike) -> Box | None:
    """The smallest box around (latitude, longitude) pairs `[N, 2]`, across the date line where that is smaller."""
    given = np.asarray(positions, dtype=np.float64)
    if not given.size:
        return None
    lats, lons = given.T
    east_of = np.sort(lons)
    gaps = np.diff(east_of, append=east_of[0] + 360)
    widest = int(gaps.argmax()) if gaps.max() > gaps[-1] else len(gaps) - 1
    west, east = east_of[(widest + 1) % len(east_of)], east_of[widest]
    return float(lats.min()), float(west), float(lats.max()), float(east)


def span_km(around: Box) -> tuple[float, float]:
    """Kilometres from south to north, and from west to east along the middle of a box."""
    south, west, north, east = around
    middle, width = (south + north) / 2, (east - west) % 360
    # Wider than half the globe, the great circle would be the short way round: go by its half.
    across = 2 * float(metres(middle, 0.0, middle, width / 2))
    return round(float(metres(south, 0.0, north, 0.0)) / 1000, 3), round(across / 1000, 3)


def complaints(table: Ledger) -> list[str]:
    """What is wrong with the table of photos, a sentence each; empty means sound."""
    with table.reading():
        table.committed()
        said = [text for (text,) in table.select("PRAGMA integrity_check") if text != "ok"]
        ((rows,),) = table.select("SELECT rows FROM committed")
        ((count, top),) = table.select("SELECT COUNT(*), COALESCE(MAX(row), -1) FROM photos")
        if (count, top) != (rows, rows - 1):
            said.append(f"it lists {count} photos up to row {top}, but {rows} rows were committed")
        said = [f"{table.path} is damaged ({text}): restore it, or index the photos again" for text in said]
        return [*said, *filter(None, map(records.trouble, _rows(table)))]


def _rows(table: Ledger) -> Iterator[tuple[Any, ...]]:
    """Every live photo as it is written, whatever number its row has."""
    row = -(1 << 63)
    sql = f"SELECT {records.PHOTO} FROM photos WHERE removed = 0 AND row > ? ORDER BY row LIMIT 1000"
    while page := table.select(sql, (row,)):
        yield from page
        row = page[-1][0]


def sound(rows: Half, sums: Numbers) -> Mask:
    """Which rows of `[n, dim]` are what was written, by the checksums noted in `sums`.

    Where none was noted (`UNKNOWN`) it goes by the length, which must be 1; rounding to float16 moves it a bit.
    """
    with np.errstate(all="ignore"):  # damage may be any number, NaN and infinity too
        wide = rows.astype(np.float32)
        lengths = np.sqrt(np.einsum("ij,ij->i", wide, wide))
    now = np.array(matrix.sums(rows), dtype=np.int64)
    plausible = np.abs(lengths - 1) <= matrix.UNIT_TOLERANCE + _ROUNDING
    good: Mask = (sums == now) | ((sums == UNKNOWN) & plausible)
    return good


def checked(rows: Rows, alive: Mask, sums: Numbers) -> Iterator[tuple[int, Half, Mask]]:
    """Every row held, in blocks, and whether it is alive and sound.

    Args:
        rows: The matrix.
        alive: `[rows]`, which of them count.
        sums: `[rows]`, their checksums.

    Yields:
        The first row of a block, the block `[n, dim]`, whose memory is used again, and its mask `[n]`.
    """
    for start, block in rows.blocks(numbers=_BLOCK):
        here = slice(start, start + len(block))
        yield start, block, alive[here] & sound(block, sums[here])


def damaged(rows: Rows, alive: Mask, sums: Numbers) -> list[int]:
    """Living rows that are not sound; those that the file does not even hold are not among them."""
    bad: list[int] = []
    for start, _, good in checked(rows, alive, sums):
        bad += (start + (alive[start : start + len(good)] & ~good).nonzero()[0]).tolist()
    return bad
