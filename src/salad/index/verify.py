"""How an index is: what it holds, and whether its descriptors are sound."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salad.errors import StoreError
from salad.geo import metres
from salad.images.photo import Photo
from salad.index import catalog, index_folder, vectors
from salad.index.catalog import UNKNOWN, Ledger
from salad.index.index_folder import Header
from salad.index.vectors import FileRows, Half, Snapshot
from salad.search.base import UNIT_TOLERANCE, Mask, Numbers

_ROUNDING = 1e-3
_BLOCK = 1 << 22  # numbers looked at in one go

Box = tuple[float, float, float, float]


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
        bytes=index_folder.size(folder),
        bytes_of_descriptors=last.rows * header.dim * vectors.STORED.itemsize,
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
        return [*said, *filter(None, map(catalog.row_trouble, _rows(table)))]


def _rows(table: Ledger) -> Iterator[tuple[Any, ...]]:
    """Every live photo as it is written, whatever number its row has."""
    row = -(1 << 63)
    sql = f"SELECT {catalog.PHOTO} FROM photos WHERE removed = 0 AND row > ? ORDER BY row LIMIT 1000"
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
    now = np.array(vectors.sums(rows), dtype=np.int64)
    plausible = np.abs(lengths - 1) <= UNIT_TOLERANCE + _ROUNDING
    good: Mask = (sums == now) | ((sums == UNKNOWN) & plausible)
    return good


def checked(rows: FileRows, alive: Mask, sums: Numbers) -> Iterator[tuple[int, Half, Mask]]:
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


def damaged(rows: FileRows, alive: Mask, sums: Numbers) -> list[int]:
    """Living rows that are not sound; those that the file does not even hold are not among them."""
    bad: list[int] = []
    for start, _, good in checked(rows, alive, sums):
        bad += (start + (alive[start : start + len(good)] & ~good).nonzero()[0]).tolist()
    return bad


# --- Reading an index from one end to the other while others may write to it: its photos, descriptors, health ---
#
# A look must not last, for nobody can commit during it; so a long walk takes many. Additions and removals do not
# disturb it, since they leave every row its number. A compaction numbers the rows anew, and names another
# matrix file: that is how it is noticed.


_KEPT = 1000  # rows told last, any of which finds the place again behind a compaction

Looks = Callable[[], Snapshot]


@dataclass(frozen=True, slots=True)
class Page:
    """Some photos of an index.

    Attributes:
        photos: The photos.
        identities: Their contents.
        descriptors: `[len(photos), dim]`.
        damaged: Photos that belong here, but whose descriptors are damaged or lost.
    """

    photos: list[Photo]
    identities: list[str]
    descriptors: Half
    damaged: list[Path]


def listed(table: Ledger) -> Iterator[tuple[Photo, str]]:
    """Every photo with its content, in order of row; memory stays small.

    Raises:
        StoreError: If the index is compacted meanwhile so that there is no telling where to go on.
    """
    told: list[tuple[int, str]] = []
    matrix = ""
    while True:
        with table.reading():
            now = table.committed().matrix
            if now != matrix:
                told, matrix = _where_now(table, told), now
            page = table.after(told[-1][0] if told else -1)
        if not page:
            return
        told = [*told, *((row, identity) for row, _, identity in page)][-_KEPT:]
        yield from ((photo, identity) for _, photo, identity in page)


def at_rows(table: Ledger, seen: Snapshot, rows: Iterable[int]) -> dict[int, tuple[Photo, str]] | None:
    """Photos and contents of a snapshot's rows; None where the rows have other numbers by now."""
    with table.reading():
        if table.committed().matrix != seen.rows.path.name:
            return None
        return table.at_rows(rows)


def pages(table: Ledger, look: Looks) -> Iterator[Page]:
    """What one commit holds, some photos at a time, in order of row.

    Raises:
        StoreError: If the index is compacted meanwhile.
    """
    with table.reading():
        seen, sums = look(), table.sums()
        lost = table.live_rows(start=seen.rows.held).tolist()
    for start, block, good in checked(seen.rows, seen.alive, sums):
        alive = seen.alive[start : start + len(block)]
        held = _still(table, seen, (start + alive.nonzero()[0]).tolist())
        rows = [row for row in held if good[row - start]]
        yield Page(
            [held[row][0] for row in rows],
            [held[row][1] for row in rows],
            block[[row - start for row in rows]],
            [held[row][0].path for row in held if not good[row - start]],
        )
    if lost:
        gone = [photo.path for photo, _ in _still(table, seen, lost).values()]
        yield Page([], [], seen.rows.take([]), gone)


def verify(table: Ledger, look: Looks) -> list[str]:
    """Read everything and say what is wrong, a sentence each; empty means sound."""
    said: list[str] = []
    for part in (_table_trouble, _matrix_trouble):
        try:
            said += part(table, look)
        except StoreError as error:  # so damaged that it cannot be read: that is what we were asked for
            said.append(str(error))
    return list(dict.fromkeys(said))


def _table_trouble(table: Ledger, _: Looks) -> list[str]:
    return complaints(table)


def _matrix_trouble(table: Ledger, look: Looks) -> list[str]:
    named = None
    while named is None:  # again, where a compaction came between
        with table.reading():
            seen, sums = look(), table.sums()
            lost = table.live_rows(start=seen.rows.held).tolist()
        bad = damaged(seen.rows, seen.alive, sums)
        named = at_rows(table, seen, [*bad, *lost])
    said = []
    if lost:
        said.append(
            f"{seen.rows.path} is truncated: it holds {seen.rows.held} descriptors, {seen.rows.rows} were "
            "committed; restore it, or let go of the photos whose descriptors it lost and index them again"
        )
    return said + [
        f"{photo.path} has {'lost its' if row >= seen.rows.held else 'a damaged'} descriptor: remove it and "
        "index it again"
        for row, (photo, _) in named.items()
    ]


def _still(table: Ledger, seen: Snapshot, rows: list[int]) -> dict[int, tuple[Photo, str]]:
    held = at_rows(table, seen, rows)
    if held is None:
        raise _compacted(table)
    return dict(sorted(held.items()))


def _where_now(table: Ledger, told: Sequence[tuple[int, str]]) -> list[tuple[int, str]]:
    """Of rows and contents before a compaction those still there, at the rows they have after it."""
    now = table.rows_of([identity for _, identity in told])
    # A compaction moves photos down only: one that is higher was removed and added again.
    still = sorted((now[identity], identity) for row, identity in told if now.get(identity, row + 1) <= row)
    if told and not still:
        raise _compacted(table)
    return still


def _compacted(table: Ledger) -> StoreError:
    return StoreError(f"{table.path.parent} was compacted while it was read: try again")
