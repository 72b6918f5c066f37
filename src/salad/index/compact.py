"""Giving back the room of removed photos: a new matrix beside the old one, switched to by one commit.

The new file holds the living, sound rows in their order. It is seen onto the disk before SQLite commits its
name and the new numbers of the rows; then the old file goes. Killed before the commit the index is what it
was, killed after it what it became, and the file that nobody names is swept away by the next compaction.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salad.errors import StoreError
from salad.index import codes, index_folder, verify
from salad.index.catalog import UNKNOWN, Catalog, Committed
from salad.index.vectors import FileRows, sums

_OURS = re.compile(r"descriptors(-\d+)?\.f16")


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


def compact(folder: Path, catalog: Catalog, *, dim: int) -> Compacted:
    """Rewrite the index in `folder` without its removed and damaged rows.

    Raises:
        StoreError: If another program is writing, or the disk has no room for the new file; nothing changed.
    """
    before = index_folder.size(folder)
    try:
        with catalog.writing():
            last = catalog.committed()
            _sweep(folder, keep=last.matrix)
            kept, damaged = _rewrite(folder, catalog, last, dim)  # the commit comes when this block ends
    finally:
        # Under the lock again: a compaction that has begun since is writing a file nobody names yet.
        with suppress(StoreError), catalog.writing():
            _sweep(folder, keep=catalog.committed().matrix)
            codes.sweep(catalog)
    with suppress(StoreError):  # no room, or somebody reads: the next one will do it
        catalog.shrink()
    return Compacted(kept, max(0, before - index_folder.size(folder)), damaged)


def _rewrite(folder: Path, catalog: Catalog, last: Committed, dim: int) -> tuple[int, list[Path]]:
    """Inside of a change: how many rows stay, and the photos whose descriptors were not worth keeping."""
    old = FileRows(folder / last.matrix, rows=last.rows, dim=dim)
    alive = np.zeros(last.rows, dtype=np.bool_)
    live, noted = catalog.live_rows(), catalog.sums()
    alive[live[live < last.rows]] = True  # a damaged table may list photos behind those that count
    full = len(live) == alive.sum() == old.held == last.rows
    if full and (noted != UNKNOWN).all() and not verify.damaged(old, alive, noted):
        return len(live), []  # nothing to be gained
    path = folder / f"descriptors-{last.generation + 1}.f16"
    rows, checksums = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    try:
        with path.open("wb") as file:
            for start, block, good in verify.checked(old, alive, noted):
                chosen = block[good]
                file.write(chosen.data)
                rows.append(start + good.nonzero()[0])
                checksums.append(np.array(sums(chosen), dtype=np.int64))
            file.flush()
            os.fsync(file.fileno())
        index_folder.settle(path.parent)  # its name too, before a commit says it
    except OSError as error:
        raise StoreError(
            f"{path} cannot be written ({error.strerror}): nothing was changed; a compaction needs room for "
            "the descriptors that stay beside the old ones"
        ) from error
    old.close()  # or Windows would not let it be deleted
    kept = np.concatenate(rows)
    damaged = [photo.path for photo, _ in catalog.at_rows(np.setdiff1d(live, kept)).values()]
    catalog.renumber(kept, np.concatenate(checksums))
    codes.carry(catalog, kept, old=last.matrix, new=path.name, generation=last.generation + 1, dim=dim)
    catalog.commit_rows(len(kept), matrix=path.name)
    return len(kept), damaged


def _sweep(folder: Path, *, keep: str) -> None:
    """Delete matrix files nobody names: of the last compaction, or of one that was killed."""
    for file in folder.iterdir():
        if file.name != keep and _OURS.fullmatch(file.name):
            with suppress(OSError):  # somebody holds it open, where that matters: the next sweep will do it
                file.unlink()
