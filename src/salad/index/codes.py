"""Files of codes beside the matrix: read, checked, and kept up to date by whatever changes the index.

`codes-7.i8` holds the codes of the matrix's first rows, one behind the other, and nothing else. It grows as the matrix
does: codes are written and seen onto the disk first, then a commit says that they count, and the checksums of its
blocks (`code_table`). So a kill leaves bytes that nobody counts. What is read is held to those checksums, once; a
block that is damaged or lost has no codes, and its rows are searched exactly.
"""

from __future__ import annotations

import os
import threading
import weakref
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from salad.errors import StoreError
from salad.files import open_file
from salad.index import index_folder
from salad.index.catalog import Catalog
from salad.index.code_table import CODE_FILE, CodeSet, CodeTable, way_out
from salad.index.vectors import Half, append
from salad.search.base import Numbers
from salad.search.compressed import Bytes, Coding, block_rows

_KEEP = 1 << 29  # bytes of codes that stay in memory between searches


class CodeFile:
    """The codes of one commit, as `salad.search.compressed.Codes` has them.

    The first sweep passes over the file and keeps nothing, so that a process that asks once stays small; from the
    second on all blocks stay in memory.

    Args:
        folder: The index.
        codes: What the commit says of the file.
        coding: How it is coded.
        before: The same file as an earlier commit had it: what was read of it need not be read again.

    Attributes:
        noticed: A sentence for each thing that is wrong with it.

    Raises:
        StoreError: If the file is missing or may not be read.
    """

    def __init__(self, folder: Path, codes: CodeSet, coding: Coding, *, before: CodeFile | None = None) -> None:
        self.path, self.codes, self.coding = folder / codes.file, codes, coding
        self.noticed: list[str] = []
        self._sweeps = 0
        self._good: dict[int, int] = {}  # blocks found sound, with their checksums
        self._bad: set[int] = set()
        self._kept: dict[int, Bytes] = {}
        try:
            self._file = open_file(self.path, follow=False)
        except OSError as error:
            raise StoreError(f"{self.path} cannot be read ({error.strerror}): {way_out(folder)}") from error
        weakref.finalize(self, self._file.close)
        self._lock = threading.Lock()
        if before is not None and before.path == self.path:
            # Blocks that have not grown since.
            same = {number for number, noted in before._good.items() if codes.sums[number : number + 1] == (noted,)}
            self._sweeps = before._sweeps
            self._good = {number: codes.sums[number] for number in same}
            self._kept = {number: block for number, block in before._kept.items() if number in same}
        held = os.fstat(self._file.fileno()).st_size // codes.size
        if held < codes.rows:
            self.noticed.append(f"{self.path} is cut short (it holds {held} codes of {codes.rows}): {way_out(folder)}")

    def __len__(self) -> int:
        return self.codes.rows

    @property
    def blocks(self) -> int:
        """How many blocks there are; the last may be shorter."""
        return -(-len(self) // block_rows(self.codes.size))

    def keep(self) -> None:
        """Say that all blocks are about to be asked for: from the second time on they stay in memory, if they fit."""
        self._sweeps += 1

    def block(self, number: int, spare: Bytes) -> Bytes | None:
        """The codes of a block of rows; None where they are not what was written."""
        if number in self._kept:
            return self._kept[number]
        if number in self._bad:
            return None
        step = block_rows(self.codes.size)
        count = min(step, len(self) - number * step)
        stays = self._sweeps > 1 and len(self) * self.codes.size <= _KEEP
        out = np.empty((count, self.codes.size), np.int8) if stays else spare[:count]
        if not self._read(number * step * self.codes.size, out.reshape(-1).view(np.uint8).data) or (
            number not in self._good and zlib.crc32(out.data) != self.codes.sums[number]
        ):
            self._bad.add(number)
            self.noticed.append(f"block {number} of {self.path} is damaged: {way_out(self.path.parent)}")
            return None
        self._good[number] = self.codes.sums[number]
        if stays:
            self._kept[number] = out
        return out

    def _read(self, place: int, raw: memoryview) -> bool:
        """Fill `raw` from byte `place` on; False where there is not so much, or the disk does not give it."""
        done = 0
        with suppress(OSError):
            while done < len(raw):
                if hasattr(os, "preadv"):
                    got = os.preadv(self._file.fileno(), [raw[done:]], place + done)
                else:  # such systems cannot read without moving the file's one position
                    with self._lock:
                        self._file.seek(place + done)
                        got = self._file.readinto(raw[done:]) or 0
                if not got:
                    return False
                done += got
        return done == len(raw)

    def sound(self) -> int:
        """How many rows, the first ones, have codes that are what was written."""
        step, spare = block_rows(self.codes.size), self._spare()
        for number in range(self.blocks):
            if self.block(number, spare) is None:
                return number * step
        return len(self)

    def all(self) -> Iterator[tuple[int, Bytes | None]]:
        """Every block behind its first row; its memory is used again for the next."""
        step, spare = block_rows(self.codes.size), self._spare()
        for number in range(self.blocks):
            yield number * step, self.block(number, spare)

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def _spare(self) -> Bytes:
        return np.empty((min(block_rows(self.codes.size), len(self)), self.codes.size), np.int8)


def newest(
    table: CodeTable, *, matrix: str, dim: int, before: CodeFile | None = None
) -> tuple[CodeFile | None, list[str]]:
    """The codes of most rows that can be used; and a sentence for each file that cannot."""
    said: list[str] = []
    for each in table.sets():
        if each.matrix != matrix:  # an older salad compacted the index, and knew nothing of codes
            gone = f"{table.folder / each.file} holds codes of {each.matrix}, which is no more"
            said.append(f"{gone}: {way_out(table.folder)}")
            continue
        try:
            known = before is not None and (before.codes.file, before.codes.coding) == (each.file, each.coding)
            coding = before.coding if before is not None and known else table.coding(each, dim=dim)
            return CodeFile(table.folder, each, coding, before=before), said
        except StoreError as error:
            said.append(str(error))
    return None, said


def extend(catalog: Catalog, rows: Half, *, matrix: str, at: int) -> None:
    """Inside of an addition: codes for rows `[N, dim]` behind the `at` rows that count, where all of those have codes.

    Raises:
        StoreError: If the disk is full; nothing was added.
    """
    table = CodeTable(catalog)
    for each in table.sets(matrix=matrix):
        if each.rows != at:  # rows without codes come first, and `compress` comes to them
            continue
        try:
            coding = table.coding(each, dim=rows.shape[1])
        except StoreError:  # damaged: no more codes of that kind
            continue
        if (table.folder / each.file).exists():
            write(table, each, coding.encode(rows))


def write(table: CodeTable, codes: CodeSet, more: Bytes) -> None:
    """Write codes behind those that count, see them onto the disk, and note that they will count."""
    append(table.folder / codes.file, more, at=codes.rows)
    sums, at, step = list(codes.sums), codes.rows, block_rows(codes.size)
    while len(more):
        room = step - at % step
        before = sums.pop() if at % step else 0
        sums.append(zlib.crc32(more[:room].data, before))
        at, more = at + len(more[:room]), more[room:]
    table.put(codes.file, coding=codes.coding, matrix=codes.matrix, rows=at, sums=tuple(sums))


def carry(catalog: Catalog, kept: Numbers, *, old: str, new: str, generation: int, dim: int) -> None:
    """Inside of a compaction: the codes of the rows that stay, in a file of their own.

    Args:
        catalog: The photos.
        kept: Rows that stay, ascending.
        old: Name of the file of descriptors that they were rows of.
        new: Name of that which they will be rows of.
        generation: Of the commit that is to come.
        dim: Numbers in a descriptor.

    Raises:
        StoreError: If the disk has no room.
    """
    table = CodeTable(catalog)
    codes, _ = newest(table, matrix=old, dim=dim)
    if codes is None:
        return
    name = begun(table.folder, generation)
    made = CodeSet(name, codes.codes.coding, codes.codes.size, codes.codes.seen, new, 0, ())
    table.put(name, coding=made.coding, matrix=new, rows=0, sums=())
    for start, block in codes.all():
        if block is None:  # codes count from the first row on, without a gap
            break
        these = kept[(kept >= start) & (kept < start + len(block))] - start
        write(table, made, block[these])
        (made,) = (each for each in table.sets() if each.file == name)
    table.keep_only({name})
    codes.close()


def begun(folder: Path, generation: int) -> str:
    """Make an empty file of codes, and see its name onto the disk; the name."""
    try:
        with index_folder.new_file(folder, "codes-{}.i8", generation) as file:
            index_folder.settle(folder)
            return Path(file.name).name
    except OSError as error:
        raise StoreError(
            f"no codes can be written in {folder} ({error.strerror}): make room, or check permissions"
        ) from error


def sweep(catalog: Catalog) -> None:
    """Delete files of codes that nobody names; inside of a change, or another might just be making one."""
    table = CodeTable(catalog)
    named = {each.file for each in table.sets()}
    for file in table.folder.iterdir():
        if CODE_FILE.fullmatch(file.name) and file.name not in named:
            with suppress(OSError):  # somebody holds it open, where that matters
                file.unlink()
