"""Giving back the room of removed photos: a new matrix beside the old one, switched to by one commit.

The new file holds the living, sound rows in their order. It is seen onto the disk before SQLite commits its
name and the new numbers of the rows; then the old file goes. Killed before the commit the index is what it
was, killed after it what it became, and the file that nobody names is swept away by the next compaction.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salad.errors import StoreError
from salad.index import codes, index_folder, verify
from salad.index.catalog import Catalog, Committed
from salad.index.facts import UNKNOWN
from salad.index.vectors import FileRows, sums
from salad.search.base import Mask, Numbers

Dropping = Callable[[list[Path]], None]

_OURS = re.compile(r"descriptors(-\d+)?\.f16|\.[0-9a-f]{32}\.part")  # the second is of an index.json
_NAMED = 5  # damaged photos named in a sentence; `verify` names all


@dataclass(frozen=True, slots=True)
class Compacted:
    """What a compaction did.

    Attributes:
        kept: Photos the index holds now.
        freed: Bytes given back to the disk.
        damaged: Photos whose descriptors were damaged or lost, which are no longer in the index: index them
            again.
    """

    kept: int
    freed: int
    damaged: list[Path]


def compact(folder: Path, catalog: Catalog, *, dim: int, dropping: Dropping | None = None) -> Compacted:
    """Rewrite the index in `folder` without its removed rows and, where that is allowed, its damaged ones.

    Args:
        folder: The index.
        catalog: Its photos.
        dim: Numbers in a descriptor.
        dropping: Called with the photos that are damaged, before anything is written, if there are any; and then they
            are dropped. Where it is not given, they have nothing compacted.

    Raises:
        StoreError: If photos are damaged and may not be dropped, another program is writing, or the disk has no room
            for the new file; nothing changed.
    """
    before = index_folder.size(folder)
    try:
        with catalog.writing():
            last = catalog.committed()
            _sweep(folder, keep=last.matrix)
            kept, damaged = _rewrite(folder, catalog, last, dim, dropping)  # the commit comes when this block ends
    finally:
        # Under the lock again: a compaction that has begun since is writing a file nobody names yet.
        with suppress(StoreError), catalog.writing():
            _sweep(folder, keep=catalog.committed().matrix)
            codes.sweep(catalog)
    with suppress(StoreError):  # no room, or somebody reads: the next one will do it
        catalog.shrink()
    return Compacted(kept, max(0, before - index_folder.size(folder)), damaged)


def _rewrite(
    folder: Path, catalog: Catalog, last: Committed, dim: int, dropping: Dropping | None
) -> tuple[int, list[Path]]:
    """Inside of a change: how many rows stay, and the photos whose descriptors were not worth keeping."""
    old = FileRows(folder / last.matrix, rows=last.rows, dim=dim)
    try:
        live, noted = catalog.live_rows(), catalog.sums()
        kept, damaged = _worth_keeping(catalog, old, live, noted)
        if damaged and dropping is None:
            raise _refusal(folder, damaged)
        if len(kept) == last.rows and (noted != UNKNOWN).all():
            return len(kept), []  # nothing to be gained
        if damaged and dropping is not None:
            dropping(damaged)
        new, checksums = _write(folder, old, kept, noted[kept], last.generation + 1)
    finally:
        old.close()  # or Windows would not let it be deleted
    catalog.renumber(kept, checksums)
    codes.carry(catalog, kept, old=last.matrix, new=new, generation=last.generation + 1, dim=dim)
    catalog.commit_rows(len(kept), matrix=new)
    return len(kept), damaged


def _worth_keeping(catalog: Catalog, rows: FileRows, live: Numbers, noted: Numbers) -> tuple[Numbers, list[Path]]:
    """Rows that are alive and sound, ascending; and the photos that would be lost though nobody removed them."""
    alive: Mask = np.zeros(rows.rows, dtype=np.bool_)
    alive[live] = True
    good = [start + mask.nonzero()[0] for start, _, mask in verify.checked(rows, alive, noted)]
    kept = np.concatenate([np.zeros(0, dtype=np.int64), *good])
    damaged = [known.photo.path for known in catalog.at_rows(np.setdiff1d(live, kept).tolist()).values()]
    # A photo may be marked as removed by a damaged byte: one that was removed has no checksum any more.
    others = catalog.at_rows(np.flatnonzero(~alive).tolist()).values()
    return kept, damaged + [known.photo.path for known in others if known.trouble]


def _write(folder: Path, old: FileRows, kept: Numbers, noted: Numbers, number: int) -> tuple[str, Numbers]:
    """Write the rows that stay into a file of their own; its name, and their checksums.

    Those that were noted stay what they are, for they have just been found right: should the disk give other bytes now,
    that shows. Only where none was noted it is made.
    """
    checksums, done = noted.copy(), 0
    try:
        with index_folder.new_file(folder, "descriptors-{}.f16", number) as file:
            for start, block in old.blocks():
                chosen = block[kept[(kept >= start) & (kept < start + len(block))] - start]
                file.write(chosen.data)
                anew = np.flatnonzero(checksums[done : done + len(chosen)] == UNKNOWN)
                checksums[done + anew] = sums(chosen[anew])
                done += len(chosen)
            if done < len(kept):
                raise StoreError(f"{old.path} was cut short while it was read: nothing was changed; restore it")
            file.flush()
            os.fsync(file.fileno())
            index_folder.settle(folder)  # its name too, before a commit says it
    except OSError as error:
        raise StoreError(
            f"new descriptors in {folder} cannot be written ({error.strerror}): nothing was changed; this needs "
            "room for those that stay beside the old ones"
        ) from error
    return Path(file.name).name, checksums


def _refusal(folder: Path, damaged: list[Path]) -> StoreError:
    named = ", ".join(map(str, damaged[:_NAMED])) + (", ..." if len(damaged) > _NAMED else "")
    return StoreError(
        f"{len(damaged)} photos of {folder} are damaged ({named}), so nothing was changed: restore the file, or run "
        "'salad compact' with --drop-damaged, which lets go of them, and index them again"
    )


def _sweep(folder: Path, *, keep: str) -> None:
    """Delete files that nobody names: of the last compaction, or of a process that was killed."""
    for file in folder.iterdir():
        if file.name != keep and _OURS.fullmatch(file.name):
            with suppress(OSError):  # somebody holds it open, where that matters: the next sweep will do it
                file.unlink()
