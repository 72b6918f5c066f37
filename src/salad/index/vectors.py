"""Descriptors in files: an index's own `descriptors.f16`, and the `.npy` files of other tools.

`descriptors.f16` holds one row a photo, raw little-endian float16, and is only ever appended to. It does not know its
own length: how many rows count is the catalog's word, and bytes behind them are what an interrupted `add` left, which
the next `add` writes over.
"""

from __future__ import annotations

import os
import re
import threading
import weakref
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numkong
import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from salad.errors import StoreError
from salad.files import create_file, open_file, open_in_place
from salad.npy import read_head
from salad.search.base import LONGEST_UNIT, UNIT_TOLERANCE, Block, Mask

Half = npt.NDArray[np.float16]
STORED = np.dtype("<f2")

_BLOCK = 1 << 20  # numbers read, checked or converted in one go: they stay in the processor's cache
_KEEP = 1 << 28  # numbers that may stay in memory between searches: 512 MiB
_WIDEST = 1 << 20  # numbers of a descriptor that somebody else made
_NPY_FLOATS = re.compile(r"[<>=|]?f[248]")
_NPY_KINDS = re.compile(r"[<>=|]?(?:[biuf][1248]|c(?:8|16)|O)")  # those that numpy has a plain name for


class FileRows:
    """Rows of a file, read where and when they are asked for.

    They are read, not mapped: pages of a map count as memory used, and a file cut short under a map kills the
    process. The file stays open, so the rows stay what they are when another process puts a smaller file in
    its place. Any number of threads may read at once.

    Attributes:
        path: The file.
        rows: Rows that should be in it.
        dim: Numbers in a row.
        dtype: float16, or float32, which float64 becomes when it is read.
        longest: No sound row is longer; None where rows may have any length (`salad.search.base.Rows`).
        held: Rows really in the file, fewer than `rows` where it is truncated; only these can be read.
    """

    def __init__(
        self,
        path: Path,
        *,
        rows: int,
        dim: int,
        stored: np.dtype[np.floating] = STORED,
        start: int = 0,
        longest: float | None = LONGEST_UNIT,
        follow: bool = False,
    ) -> None:
        """Open `path`, of which `rows` rows of `dim` numbers, `stored` as this type, count from byte `start` on.

        It may be a link where `follow` is set, as it may where it is not the file of an index.

        Raises:
            StoreError: If the file is missing or may not be read.
        """
        self.path, self.rows, self.dim, self.longest = path, rows, dim, longest
        self.dtype: np.dtype[np.floating] = np.dtype(np.float16 if stored.type is np.float16 else np.float32)
        self._stored, self._start = stored, start
        try:
            self._file = open_file(path, follow=follow)
        except FileNotFoundError as error:
            raise StoreError(f"{path} is missing: restore it, or index the photos again") from error
        except OSError as error:
            raise StoreError(
                f"{path} cannot be read ({error.strerror}): check its permissions, or restore it"
            ) from error
        self._swept = False
        self._kept: tuple[Block, Mask] | None = None  # rows, and which of them are there
        # A search may hold them longer than the index does.
        self._end = weakref.finalize(self, self._file.close)
        self._lock = threading.Lock()  # for systems that cannot read without moving the file's one position
        # Of the file that is open, whatever the path is by now.
        size = os.fstat(self._file.fileno()).st_size - start
        self.held = max(0, min(rows, size // (dim * stored.itemsize)))

    @classmethod
    def of_npy(cls, path: Path) -> FileRows:
        """The rows of a `.npy` file, of any length; nothing in it is ever unpickled.

        Raises:
            StoreError: If the file is missing or cut short, or holds anything but rows of float16, 32 or 64.
        """
        try:
            with open_file(path) as file:
                head = read_head(file, newest=2)
        except OSError as error:
            raise StoreError(f"{path} cannot be read ({error.strerror}): check the name and permissions") from error
        except ValueError as error:
            raise StoreError(f"{path} is no .npy file ({error}): write it with numpy.save") from error
        shape = head.shape
        if len(shape) != 2 or shape[1] < 1 or not _NPY_FLOATS.fullmatch(head.code) or head.by_columns:
            # A kind of objects, which would be pickled, is a kind like any other here.
            kind = str(np.dtype(head.code)) if _NPY_KINDS.fullmatch(head.code) else repr(head.code)
            raise StoreError(
                f"{path} holds {kind} of shape {list(shape)}{' by columns' if head.by_columns else ''}: "
                "descriptors are rows of float16, float32 or float64, one row a photo, in C order"
            )
        if shape[1] > _WIDEST:  # a file of holes may say what it likes, and one such row would fill the memory
            raise StoreError(f"{path} holds rows of {shape[1]:,} numbers: a descriptor has {_WIDEST:,} at most")
        found = cls(
            path, rows=shape[0], dim=shape[1], stored=np.dtype(head.code), start=head.start, longest=None, follow=True
        )
        if found.held < found.rows:
            raise StoreError(f"{path} is cut short (it should hold {found.rows} rows): write it again")
        return found

    def __len__(self) -> int:
        return self.rows

    def read(self, start: int, out: Block) -> int:
        """Fill `out` `[n, dim]`, which must be contiguous and of this type, from row `start` on.

        Returns:
            How many rows were read; fewer than n at the end of what is held.

        Raises:
            StoreError: If the disk does not give them.
        """
        wanted = max(0, min(len(out), self.held - start))
        if not wanted:
            return 0
        stored = out[:wanted] if self._stored == self.dtype else np.empty((wanted, self.dim), self._stored)
        size = self.dim * self._stored.itemsize
        # Bytes, whatever order a foreign file has them in.
        done = self._fill(stored.reshape(-1).view(np.uint8).data, self._start + start * size)
        if stored.dtype != out.dtype:
            with np.errstate(over="ignore"):  # a float64 beyond float32 is infinite there, and told as such
                out[: done // size] = stored[: done // size]
        return done // size

    def _fill(self, raw: memoryview, place: int) -> int:
        """Fill `raw` from byte `place` of the file on; how many bytes there were."""
        done = 0
        try:
            while done < len(raw):
                got = self._read_at(place + done, raw[done:] if done else raw)
                if not got:  # somebody cut the file short after it was opened
                    break
                done += got
        except OSError as error:
            raise StoreError(
                f"{self.path} cannot be read ({error.strerror}): check the disk, and restore the index if it is failing"
            ) from error
        return done

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
            self._kept = (
                np.empty((self.held, self.dim), dtype=self.dtype),
                np.zeros(self.held, dtype=np.bool_),
            )
        self._swept = True

    def block(self, start: int, stop: int, spare: Block) -> Block:
        """The rows from `start` to `stop`, as `salad.search.base.Rows` says.

        Raises:
            StoreError: If the disk does not give them; or some are lost, where none may be damaged.
        """
        if self._kept is not None:
            rows, there = self._kept
            if there[start:stop].all():
                return rows[start:stop]
            # Two threads may read the same rows into the same place: both write the same.
            got = self.read(start, rows[start:stop])
            there[start : start + got] = True
            return rows[start : start + got]
        got = self.read(start, spare[: stop - start])
        if got < stop - start and self.longest is None:
            raise StoreError(f"{self.path} was cut short while it was read: write it again")
        return spare[:got]

    def take(self, rows: Sequence[int] | npt.NDArray[np.integer]) -> Block:
        """These rows, in the order given: `[len(rows), dim]`.

        Raises:
            StoreError: If one of them is not held.
        """
        wanted = np.asarray(rows, dtype=np.int64).reshape(-1)
        kept = self._kept
        if kept is not None and ((wanted >= 0) & (wanted < self.held)).all() and kept[1][wanted].all():
            return kept[0][wanted]
        out = np.empty((len(wanted), self.dim), dtype=self.dtype)
        within = not len(wanted) or (wanted.min() >= 0 and wanted.max() < self.held)
        if not within or not self._gather(wanted, out):
            raise StoreError(
                f"{self.path} is truncated (it holds {self.held} descriptors, {self.rows} were "
                "committed): 'salad verify' names the photos hit"
            )
        return out

    def _gather(self, wanted: npt.NDArray[np.int64], out: Block) -> bool:
        """Read rows from all over the file, those that follow one another at once; False where some are gone."""
        stored = out if self._stored == self.dtype else np.empty(out.shape, self._stored)
        raw, size = stored.reshape(-1).view(np.uint8).data, self.dim * self._stored.itemsize
        ends = (np.flatnonzero(np.diff(wanted) != 1) + 1).tolist()
        lows = [0, *ends] if len(wanted) else []
        firsts = wanted[lows].tolist()  # plain numbers: a search takes hundreds of rows
        for low, high, first in zip(lows, [*ends, len(wanted)], firsts, strict=False):
            part = raw[low * size : high * size]
            if self._fill(part, self._start + first * size) < len(part):
                return False
        if stored is not out:
            with np.errstate(over="ignore"):  # a float64 beyond float32 is infinite there, and told as such
                out[:] = stored
        return True

    def blocks(self, *, numbers: int = _BLOCK) -> Iterator[tuple[int, Block]]:
        """All rows held, about `numbers` numbers at a time.

        Yields:
            The first row of a block, and the block `[n, dim]`; its memory is used again for the next.
        """
        step = max(1, numbers // self.dim)
        spare = np.empty((min(step, self.held), self.dim), dtype=self.dtype)
        for start in range(0, self.held, step):
            got = self.read(start, spare[: self.held - start])
            yield start, spare[:got]

    def close(self) -> None:
        """Let go of the file; nothing can be read afterwards. It also happens when nobody holds the rows."""
        self._end()


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one commit of an index holds, for searching: its rows `[N, dim]`, and which of them are alive `[N]`."""

    generation: int
    rows: FileRows
    alive: Mask


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
    rows = np.empty((count, dim), dtype=STORED)
    step = max(1, _BLOCK // dim)
    for low in range(0, count, step):
        with np.errstate(over="ignore"):  # a float64 beyond float32 is infinite there, and refused
            some = given[low : low + step].astype(np.float32)
        if not (np.abs(lengths(some) - 1) <= UNIT_TOLERANCE).all():
            raise StoreError("descriptors must be finite and of length 1: normalise them, or check the model")
        # Rounding halves is most of the work here, and numpy is ten times as slow at it.
        numkong.astype(some, "float16", out=rows[low : low + step])
    return rows


def lengths(rows: Block) -> npt.NDArray[np.float32]:
    """How long rows `[n, dim]` are: `[n]`; a damaged one may have any length, NaN and infinity too."""
    with np.errstate(all="ignore"):
        wide = rows.astype(np.float32, copy=False)
        found: npt.NDArray[np.float32] = np.sqrt(np.einsum("ij,ij->i", wide, wide))
        return found


def sums(rows: Half) -> list[int]:
    """A checksum (CRC-32) of each row's bytes as they are stored, for `rows` `[N, dim]`."""
    return [zlib.crc32(row) for row in np.ascontiguousarray(rows, dtype=STORED)]


def append(path: Path, rows: Half | npt.NDArray[np.int8], *, at: int) -> None:
    """Write `rows` behind the `at` rows that count, and see them onto the disk.

    Args:
        path: The matrix file, or one of codes.
        rows: `[N, dim]` float16, or `[N, bytes]` of codes.
        at: Rows that are already committed; whatever lies behind them is written over.

    Raises:
        StoreError: If the disk is full or the file cannot be written; what was committed is untouched.
    """
    stored = np.ascontiguousarray(rows, dtype=rows.dtype.newbyteorder("<"))
    start = at * stored.shape[1] * stored.itemsize
    try:
        with open_in_place(path) as file:
            try:
                file.seek(start)
                file.write(stored.data)
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


class NpyWriter:
    """A `.npy` file of rows `[N, dim]` whose N is known only when the last are written; a context manager."""

    def __init__(self, path: Path, *, dim: int, dtype: npt.DTypeLike) -> None:
        """Begin the file at `path`."""
        self.rows = 0
        self._dim, self._dtype = dim, np.dtype(dtype).newbyteorder("<")
        self._file: BinaryIO = create_file(path)
        self._begin()
        self._start = self._file.tell()

    def write(self, rows: npt.NDArray[np.floating]) -> None:
        """Append `rows` `[n, dim]`."""
        self._file.write(np.ascontiguousarray(rows, dtype=self._dtype).tobytes())
        self.rows += len(rows)

    def __enter__(self) -> NpyWriter:
        return self

    def __exit__(self, *_: object) -> None:
        with self._file:
            self._file.seek(0)
            self._begin()
            # numpy pads what stands before the numbers so that their count may grow in its place.
            assert self._file.tell() == self._start
            self._file.flush()
            os.fsync(self._file.fileno())

    def _begin(self) -> None:
        shape = (self.rows, self._dim)
        head = {"descr": npy.dtype_to_descr(self._dtype), "fortran_order": False, "shape": shape}
        npy.write_array_header_1_0(self._file, head)
