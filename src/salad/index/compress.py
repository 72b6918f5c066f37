"""Making codes for an index that has none, or none that serve: fitted, then written stage by stage.

Rows never change, so they are read and coded while others search and write; only to write down a stage is the index
locked. Killed or interrupted, it goes on behind the last stage. Until all rows have the new codes the old ones stay.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from salad.errors import StoreError
from salad.index import codes
from salad.index.catalog import Catalog
from salad.index.code_table import CodeSet, CodeTable
from salad.index.codes import CodeFile
from salad.index.vectors import Half, Snapshot
from salad.search.compressed import Coding, block_rows

USUAL = 256
"""Bytes of a code where nobody says."""
AUTOMATIC = 1 << 28
"""Numbers in an index's descriptors from which on it gets codes by itself: 31,775 photos of 8,448 numbers.

Up to there the descriptors stay in memory between searches, 512 MiB; beyond, every exact search reads them anew."""
OUTGROWN = 2
"""A coding serves until an index holds so many times the photos that it held when the coding was fitted.

By then half of it was never seen by the fit. And since an index must double, all the fitting that ever is done takes no
more than twice the time of the last one."""

_TRIES = 10  # compactions may come between, each of which is one for nothing
_STAGE = 16384  # rows coded before they are written down
_STEP = 1 << 24  # numbers of descriptors in memory at once

Progress = Callable[[int, int], None]
Look = Callable[[], Snapshot]


@dataclass(frozen=True, slots=True)
class Compressed:
    """What a compression came to.

    Attributes:
        size: Bytes of a code; none but those of one size are left.
        rows: Rows that have codes.
        fitted: Whether the rows' directions were sought anew.
        written: Codes that were written.
    """

    size: int
    rows: int
    fitted: bool
    written: int


def compress(
    catalog: Catalog, look: Look, *, dim: int, size: int | None = None, progress: Progress | None = None
) -> Compressed:
    """See to it that all rows have codes of `size` bytes, or of as many as before; take away all others.

    Args:
        catalog: The photos.
        look: Gives the latest commit.
        dim: Numbers in a descriptor.
        size: Bytes of a code.
        progress: Called with (rows that have codes, rows).

    Raises:
        StoreError: If another program is writing, the disk is full, or the file of descriptors is cut short. What was
            written so far is gone on with next time.
    """
    table = CodeTable(catalog)
    with catalog.writing():
        size = size or table.plan() or USUAL
        table.set_plan(size)
        _cut_back(table, catalog.committed().matrix, dim)
        _commit(catalog)
    fitted, written = 0, 0
    while True:
        with catalog.reading():
            seen = look()
            fit = _serving(table, seen, min(size, dim))
            # In the same look: another may take these codes away at any time.
            coding = None if fit is None else table.coding(fit, dim=dim)
        rows = seen.rows
        if rows.held < rows.rows:
            raise StoreError(
                f"{rows.path} is truncated (it holds {rows.held} descriptors, {rows.rows} were committed), so no codes "
                f"were made: restore it, or run 'salad compact {table.folder}'"
            )
        if fit is None or coding is None:
            if fitted == _TRIES:
                raise StoreError(f"{catalog.path} does not keep what is written of codes: restore it")
            _begin(catalog, table, seen, size)
            fitted += 1
            continue
        if progress is not None:
            progress(fit.rows, rows.rows)
        if fit.rows < rows.rows:
            written += _go_on(catalog, table, seen, fit, coding)
        elif _finish(catalog, table, fit):
            return Compressed(fit.size, fit.rows, fitted > 0, written)


def is_due(catalog: Catalog, look: Look, *, dim: int) -> bool:
    """Whether codes should be made, or made anew, as far as that shows without reading them."""
    table = CodeTable(catalog)
    with catalog.reading():
        plan, seen = table.plan(), look()
        if plan is None and seen.rows.rows * dim < AUTOMATIC:
            return False
        fit = _serving(table, seen, min(plan or USUAL, dim))
        if plan == 0 or seen.rows.held < seen.rows.rows:  # what is cut short has other troubles
            return False
    return fit is None or fit.rows < seen.rows.rows


def take_away(catalog: Catalog) -> None:
    """Take all codes away, and make no more until they are asked for."""
    table = CodeTable(catalog)
    with catalog.writing():
        table.set_plan(0)
        table.keep_only(set())
        _commit(catalog)
    with catalog.writing():
        codes.sweep(catalog)


def _serving(table: CodeTable, seen: Snapshot, size: int) -> CodeSet | None:
    """The file of most rows that is of the right size, of this matrix, not outgrown, and where it should be."""
    photos = int(np.count_nonzero(seen.alive))
    for each in table.sets(matrix=seen.rows.path.name):
        whole = False
        with suppress(OSError):  # its length is looked at here, its content when it is read
            whole = (table.folder / each.file).stat().st_size >= each.rows * each.size
        if each.size == size and whole and photos < OUTGROWN * max(1, each.seen):
            return each
    return None


def _cut_back(table: CodeTable, matrix: str, dim: int) -> None:
    """Forget codes that cannot be used, and in others what stands behind the first block that is damaged."""
    usable = set()
    for each in table.sets(matrix=matrix):
        try:
            file = CodeFile(table.folder, each, table.coding(each, dim=dim))
        except StoreError:
            continue
        usable.add(each.file)
        sound = file.sound()
        file.close()
        if sound < each.rows:
            sums = each.sums[: sound // block_rows(each.size)]
            table.put(each.file, coding=each.coding, matrix=matrix, rows=sound, sums=sums)
    table.keep_only(usable)
    codes.sweep(table.catalog)


def _begin(catalog: Catalog, table: CodeTable, seen: Snapshot, size: int) -> None:
    """Fit a coding, and begin a file of codes."""
    those = np.flatnonzero(seen.alive)
    coding = Coding.fitted(seen.rows, size=size, those=those)
    with catalog.writing():
        last = catalog.committed()
        if last.matrix == seen.rows.path.name:  # else a compaction came between: once more
            name = codes.begun(table.folder, last.generation + 1)
            table.begin(name, coding, seen=len(those), matrix=last.matrix)
            _commit(catalog)


def _go_on(catalog: Catalog, table: CodeTable, seen: Snapshot, fit: CodeSet, coding: Coding) -> int:
    """Code the next rows and write them down; how many."""
    start, stop = fit.rows, min(fit.rows + _STAGE, seen.rows.rows)
    step = max(1, _STEP // seen.rows.dim)
    spare: Half = np.empty((min(step, stop - start), seen.rows.dim), np.float16)
    parts = [coding.encode(seen.rows.block(low, min(low + step, stop), spare)) for low in range(start, stop, step)]
    with catalog.writing():
        if fit not in table.sets(matrix=catalog.committed().matrix):  # another does the same, or a compaction came
            return 0
        codes.write(table, fit, np.concatenate(parts))
        _commit(catalog)
    return stop - start


def _finish(catalog: Catalog, table: CodeTable, fit: CodeSet) -> bool:
    """Take all other codes away, if all rows have these by now."""
    with catalog.writing():
        last = catalog.committed()
        if fit not in table.sets(matrix=last.matrix) or fit.rows < last.rows:
            return False
        if len(table.sets()) > 1:
            table.keep_only({fit.file})
            _commit(catalog)
    with catalog.writing():
        codes.sweep(catalog)
    return True


def _commit(catalog: Catalog) -> None:
    """As many rows as before; but others are to see that something changed."""
    catalog.commit_rows(catalog.committed().rows)
