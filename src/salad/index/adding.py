"""Taking photos in: descriptors behind all others first, then one commit that says they count."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from salad.errors import StoreError
from salad.index import matrix
from salad.index.ledger import Committed, Ledger
from salad.index.matrix import Half
from salad.photos import Photo


def add(folder: Path, table: Ledger, photos: Sequence[Photo], contents: Sequence[str], rows: Half) -> int:
    """Add photos to the index in `folder`; how many were new.

    Args:
        folder: The index.
        table: Its photos.
        photos: With absolute paths.
        contents: Their contents.
        rows: `[N, dim]`, their descriptors as they are stored.

    Raises:
        StoreError: If another program is writing, the disk is full, or descriptors of the index are lost;
            nothing was added.
    """
    with table.writing():
        last = table.committed()
        known, first = table.known(contents), dict[str, int]()
        for number, content in enumerate(contents):
            if content not in known:
                first.setdefault(content, number)
        fresh = list(first.values())
        if fresh:
            chosen = rows if len(fresh) == len(rows) else rows[fresh]
            _check_whole(folder, table, last, chosen.shape[1])
            matrix.append(folder / last.matrix, chosen, at=last.rows)
            new, names = [photos[n] for n in fresh], [contents[n] for n in fresh]
            table.insert(new, names, matrix.sums(chosen), row=last.rows)
        again = [number for number, content in enumerate(contents) if first.get(content) != number]
        table.update([photos[n] for n in again], [contents[n] for n in again])
        table.retire([photo.path for photo in photos], contents, below=last.rows)
        table.commit_rows(last.rows + len(fresh))
    return len(fresh)


def _check_whole(folder: Path, table: Ledger, last: Committed, dim: int) -> None:
    """Refuse to write behind descriptors that are lost: the gap would be filled, and pass for theirs.

    Raises:
        StoreError: If the file of descriptors is shorter than the photos that can be found need it.
    """
    rows = matrix.Rows(folder / last.matrix, rows=last.rows, dim=dim)
    lost = table.count(start=rows.held) if rows.held < last.rows else 0
    rows.close()
    if lost:
        raise StoreError(
            f"{rows.path} is truncated and lacks the descriptors of {lost} photos, so nothing was added: restore "
            f"it, or run 'salad compact {folder}', which lets go of those photos and names them, and index them "
            "again"
        )
