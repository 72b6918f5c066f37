"""Reading an index from one end to the other while others may write to it: its photos, descriptors, health.

A look must not last, for nobody can commit during it; so a long walk takes many. Additions and removals do not
disturb it, since they leave every row its number. A compaction numbers the rows anew, and names another
matrix file: that is how it is noticed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from salad.errors import StoreError
from salad.index import health
from salad.index.ledger import Ledger
from salad.index.matrix import Half
from salad.index.search import Snapshot
from salad.photos import Photo

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
    for start, block, good in health.checked(seen.rows, seen.alive, sums):
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
    return health.complaints(table)


def _matrix_trouble(table: Ledger, look: Looks) -> list[str]:
    named = None
    while named is None:  # again, where a compaction came between
        with table.reading():
            seen, sums = look(), table.sums()
            lost = table.live_rows(start=seen.rows.held).tolist()
        bad = health.damaged(seen.rows, seen.alive, sums)
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
