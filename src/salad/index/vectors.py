"""`descriptors.f16`: one row a photo, raw little-endian float16, only ever appended to.

The file does not know its own length. How many rows count is the ledger's word (see `ledger.py`); bytes
behind them are what an interrupted `add` left, and the next `add` writes over them.
"""

from __future__ import annotations

import os
import threading
import weakref
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salad.errors import StoreError

Half = npt.NDArray[np.float16]
STORED = np.dtype("<f2")
UNIT_TOLERANCE = 0.01  # a length further from 1 is no rounding: the descriptor was not normalised

_BLOCK = 1 << 20  # numbers read, checked or converted in one go: they stay in the processor's cache
_KEEP = 1 << 28  # numbers that may stay in memory between searches: 512 MiB


class Rows:
    """The rows one commit's matrix file holds, read where and when they are asked for.

    They are read, not mapped: pages of a map count as memory used, and a file cut short under a map kills the
    process. The file stays open, so the rows stay what they are when another process puts a smaller file in
    its place. Any number of threads may read at once.

    Attributes:
        path: The matrix file.
        rows: Rows that were committed.
        dim: Numbers in a row.
        held: Rows really in the file, fewer than `rows` where it is truncated; only these can be read.
    """

    def __init__(self, path: Path, *, rows: int, dim: int) -> None:
        """Open `path`, of which `rows` rows of `dim` numbers count.

        Raises:
            StoreError: If the file is missing or may not be read.
        """
        self.path, self.rows, self.dim = path, rows, dim
        try:
            self._file = path.open("rb", buffering=0)
        except FileNotFoundError as error:
            raise StoreError(f"{path} is missing: restore it, or index the photos again") from error
        except OSError as error:
            raise StoreError(f"{path} cannot be read ({error.strerror}): check its permissions") from error
        self._swept = False
        self._kept: tuple[Half, npt.NDArray[np.bool_]] | None = None  # rows, and which of them are there
        self._end = weakref.finalize(self, self._file.close)
        self._lock = threading.Lock()  # for systems that cannot read without moving the file's one position
        size = os.fstat(self._file.fileno()).st_size
        self.held = min(rows, size // (dim * STORED.itemsize))

    def read(self, start: int, out: Half) -> int:
        """Fill `out` `[n, dim]`, which must be contiguous, from row `start` on.

        Returns:
            How many rows were read; fewer than n at the end of what is held.

        Raises:
            StoreError: If the disk does not give them.
        """
        wanted = max(0, min(len(out), self.held - start))
        size = self.dim * STORED.itemsize
        raw = out[:wanted].data.cast("B") if wanted else memoryview(b"")
        done = 0
        try:
            while done < len(raw):
                got = self._read_at(start * size + done, raw[done:])
                if not got:  # somebody cut the file short after it was opened
                    break
                done += got
        except OSError as error:
            raise StoreError(
                f"{self.path} cannot be read ({error.strerror}): check the disk, and restore the index if "
                "it is failing"
            ) from error
        return done // size

    def _read_at(self, place: int, raw: memoryview) -> int:
        if hasattr(os, "preadv"):
            return os.preadv(self._file.fileno(), [raw], place)
        with self._lock:
            self._file.seek(place)
            return self._file.readinto(raw) or 0

    def keep(self) -> None:
        """Say that all rows are about to be swept: what fits stays in memory from the second sweep on.

        The system has it in its own memory too, but handing it over takes as long as multiplying it.
        """
        if self._swept and self._kept is None and self.held * self.dim <= _KEEP:
            self._kept = np.empty((self.held, self.dim), dtype=STORED), np.zeros(self.held, dtype=np.bool_)
        self._swept = True

    def block(self, start: int, stop: int, spare: Half) -> Half:
        """The rows from `start` to `stop`, not to be written to; fewer at the end of what is held.

        Args:
            start: The first row.
            stop: The row behind the last.
            spare: Memory `[n, dim]` for rows that are not kept, n >= stop - start; used where need be.

        Raises:
            StoreError: If the disk does not give them.
        """
        if self._kept is None:
            return spare[: self.read(start, spare[: stop - start])]
        rows, there = self._kept
        if not there[start:stop].all():
            got = self.read(start, rows[start:stop])
            there[start : start + got] = True
            return rows[start : start + got]
        return rows[start:stop]

    def take(self, rows: Sequence[int] | npt.NDArray[np.integer]) -> Half:
        """These rows, in the order given: `[len(rows), dim]`.

        Raises:
            StoreError: If one of them is not held.
        """
        wanted = np.asarray(rows, dtype=np.int64).reshape(-1)
        kept = self._kept
        if kept is not None and ((wanted >= 0) & (wanted < self.held)).all() and kept[1][wanted].all():
            return kept[0][wanted]
        out = np.empty((len(wanted), self.dim), dtype=STORED)
        ends = np.flatnonzero(np.diff(wanted) != 1) + 1  # rows that follow one another are read at once
        for low, high in zip([0, *ends], [*ends, len(wanted)], strict=True):
            if low < high and (wanted[low] < 0 or self.read(int(wanted[low]), out[low:high]) < high - low):
                raise StoreError(
                    f"{self.path} is truncated (it holds {self.held} descriptors, {self.rows} were "
                    "committed): 'salad verify' names the photos hit"
                )
        return out

    def blocks(self, *, numbers: int = _BLOCK) -> Iterator[tuple[int, Half]]:
        """All rows held, about `numbers` numbers at a time.

        Yields:
            The first row of a block, and the block `[n, dim]`; its memory is used again for the next.
        """
        step = max(1, numbers // self.dim)
        block = np.empty((min(step, self.held), self.dim), dtype=STORED)
        for start in range(0, self.held, step):
            yield start, block[: self.read(start, block)]

    def close(self) -> None:
        """Let go of the file; nothing can be read afterwards. It also happens when nobody holds the rows."""
        self._end()


def storable(descriptors: npt.NDArray[np.floating], count: int, dim: int) -> Half:
    """Descriptors of `count` photos as they are stored: `[count, dim]` float16.

    Raises:
        StoreError: If their shape is another, or a row is not finite and of length 1.
    """
    given = np.asarray(descriptors)
    if given.shape != (count, dim):
        raise StoreError(
            f"{count} photos need descriptors of shape {[count, dim]}, but these have {list(given.shape)}: "
            "describe them with the index's own model"
        )
    import torch

    rows = np.empty((count, dim), dtype=STORED)
    step = max(1, _BLOCK // dim)
    for low in range(0, count, step):
        some = given[low : low + step].astype(np.float32)
        lengths = np.sqrt(np.einsum("ij,ij->i", some, some))
        if not (np.abs(lengths - 1) <= UNIT_TOLERANCE).all():
            raise StoreError("descriptors must be finite and of length 1: normalise them, or check the model")
        # Rounding halves is most of the work here, and torch does it 30 times as fast as numpy.
        torch.from_numpy(rows[low : low + step]).copy_(torch.from_numpy(some))
    return rows


def sums(rows: Half) -> list[int]:
    """A checksum (CRC-32) of each row's bytes as they are stored, for `rows` `[N, dim]`."""
    return [zlib.crc32(row) for row in np.ascontiguousarray(rows, dtype=STORED)]


def append(path: Path, rows: Half, *, at: int) -> None:
    """Write `rows` behind the `at` rows that count, and see them onto the disk.

    Args:
        path: The matrix file.
        rows: `[N, dim]` float16.
        at: Rows that are already committed; whatever lies behind them is written over.

    Raises:
        StoreError: If the disk is full or the file cannot be written; what was committed is untouched.
    """
    start = at * rows.shape[1] * STORED.itemsize
    try:
        with path.open("r+b") as file:
            try:
                file.seek(start)
                file.write(np.ascontiguousarray(rows, dtype=STORED).data)
                file.flush()
                os.fsync(file.fileno())
            except OSError:
                with suppress(OSError):
                    file.truncate(start)  # give the space back: on a full disk others need it
                raise
    except OSError as error:
        raise StoreError(
            f"{path} cannot be written ({error.strerror}): nothing was added; make room, or check permissions"
        ) from error
