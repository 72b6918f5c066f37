"""Reading an index from one end to the other while others may write to it.

A look must not last, for nobody can commit during it; so a long reading takes many. Additions and removals do not
disturb it, since they leave every row its number. A compaction numbers the rows anew, and names another file of
descriptors: that is how it is noticed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from salad.errors import StoreError
from salad.images.photo import Photo
from salad.index.catalog import Catalog
from salad.index.facts import Known
from salad.index.vectors import Half, Snapshot
from salad.index.verify import checked

_KEPT = 1000  # rows listed last, any of which finds the place again behind a compaction


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


def listed(catalog: Catalog) -> Iterator[tuple[Photo, str]]:
    """Every photo with its content, in order of row; memory stays small.

    Raises:
        StoreError: If the index is compacted meanwhile so that there is no telling where to go on.
    """
    last: list[tuple[int, str]] = []
    vectors = ""
    while True:
        with catalog.reading():
            now = catalog.committed().matrix
            if last and now != vectors:
                rows = catalog.rows_of([content for _, content in last])
                # A compaction moves photos down only: one that is higher was removed and added again.
                last = sorted((rows[each], each) for row, each in last if rows.get(each, row + 1) <= row)
                if not last:
                    raise _compacted(catalog)
            vectors = now
            page = catalog.after(last[-1][0] if last else -1)
        if not page:
            return
        last = [*last, *((known.row, known.identity) for known in page)][-_KEPT:]
        yield from ((known.photo, known.identity) for known in page)


def pages(catalog: Catalog, look: Callable[[], Snapshot]) -> Iterator[Page]:
    """What one commit holds, some photos at a time, in order of row.

    Args:
        catalog: The photos.
        look: Gives the latest commit.

    Raises:
        StoreError: If the index is compacted meanwhile.
    """
    with catalog.reading():  # rows and checksums of one commit
        seen, sums = look(), catalog.sums()
        lost = catalog.live_rows(start=seen.rows.held).tolist()

    def still(rows: list[int]) -> dict[int, Known]:
        found = catalog.photos_at(rows, vectors=seen.rows.path.name)
        if found is None:
            raise _compacted(catalog)
        return dict(sorted(found.items()))

    for start, block, good in checked(seen.rows, seen.alive, sums):
        alive = seen.alive[start : start + len(block)]
        # Photos removed since the look are told too: a page is what that commit held.
        held = still((start + alive.nonzero()[0]).tolist())
        rows = [row for row in held if good[row - start]]
        yield Page(
            [held[row].photo for row in rows],
            [held[row].identity for row in rows],
            block[[row - start for row in rows]],
            [held[row].photo.path for row in held if not good[row - start]],
        )
    if lost:
        yield Page([], [], seen.rows.take([]), [known.photo.path for known in still(lost).values()])


def _compacted(catalog: Catalog) -> StoreError:
    return StoreError(f"{catalog.path.parent} was compacted while it was read: try again")
