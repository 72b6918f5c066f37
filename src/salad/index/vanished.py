"""Photos whose files are gone: deleted, or on a disk that is not there today.

The two look alike from here. What tells them apart is how much is gone at once: who deletes photos seldom takes all of
them, and seldom leaves an empty folder standing, while the place where a disk is put into the tree stays, with nothing
in it.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from salad.index.index_folder import is_gone, resolved


def disk_may_be_away(gone: Sequence[Path], held: Mapping[Path, int]) -> list[str]:
    """Half a sentence for each folder that looks as if its disk were not there.

    Args:
        gone: Photos whose files are gone.
        held: Of each folder that was named, how many photos the index held below it before anything was added.
    """
    doubts = {}
    for folder, count in held.items():
        (home,) = resolved([folder])
        if count and count == sum(path.is_relative_to(home) for path in gone):
            doubts[home] = f"all {count:,} photos that the index holds of {folder} are gone"
    parents = Counter(path.parent for path in gone)
    emptied = Counter[Path]()
    for parent, count in parents.items():
        left = next((each for each in (parent, *parent.parents) if not is_gone(each)), parent)
        if _is_empty(left):
            emptied[left] += count
    for folder, count in emptied.items():
        doubts.setdefault(folder, f"{folder} is empty, and {count:,} photos of it are gone")
    return list(doubts.values())


def _is_empty(folder: Path) -> bool:
    try:
        with os.scandir(folder) as entries:
            return next(entries, None) is None
    except OSError:
        return False
