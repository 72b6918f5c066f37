"""Descriptors in a `.npy` file, numpy's own: written and read in blocks, never whole in memory, never pickled."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from salad.errors import StoreError

_BLOCK = 1 << 20  # numbers read in one go
_TYPES = (np.float16, np.float32, np.float64)


class Writer:
    """A matrix `[N, dim]` whose N is known only when the last rows are written; a context manager."""

    def __init__(self, path: Path, *, dim: int, dtype: npt.DTypeLike) -> None:
        """Begin the file at `path`."""
        self.rows = 0
        self._dim, self._dtype = dim, np.dtype(dtype).newbyteorder("<")
        self._file: BinaryIO = path.open("wb")
        self._begin()
        self._start = self._file.tell()

    def write(self, rows: npt.NDArray[np.floating]) -> None:
        """Append `rows` `[n, dim]`."""
        self._file.write(np.ascontiguousarray(rows, dtype=self._dtype).tobytes())
        self.rows += len(rows)

    def __enter__(self) -> Writer:
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
        told = {"descr": npy.dtype_to_descr(self._dtype), "fortran_order": False, "shape": shape}
        npy.write_array_header_1_0(self._file, told)


@dataclass(frozen=True, slots=True)
class Matrix:
    """A matrix in a file.

    Attributes:
        path: The file.
        rows: How many rows.
        dim: Numbers in a row.
    """

    path: Path
    rows: int
    dim: int
    _dtype: np.dtype[np.floating]
    _start: int

    @classmethod
    def open(cls, path: Path) -> Matrix:
        """Look at the matrix in `path`.

        Raises:
            StoreError: If the file is missing or cut short, or holds anything but rows of float16, 32 or 64.
        """
        try:
            with path.open("rb") as file:
                shape, by_columns, dtype = _head(file)
                start, size = file.tell(), os.fstat(file.fileno()).st_size
        except OSError as error:
            raise StoreError(
                f"{path} cannot be read ({error.strerror}): check the name and permissions"
            ) from error
        except (ValueError, EOFError) as error:
            raise StoreError(f"{path} is no .npy file ({error}): write it with numpy.save") from error
        if len(shape) != 2 or shape[1] < 1 or dtype.type not in _TYPES or by_columns:
            raise StoreError(
                f"{path} holds {dtype} of shape {list(shape)}{' by columns' if by_columns else ''}: "
                "descriptors are rows of float16, float32 or float64, one row a photo, in C order"
            )
        matrix = cls(path, shape[0], shape[1], dtype, start)
        if size < start + matrix.rows * matrix.dim * dtype.itemsize:
            raise StoreError(f"{path} is cut short (it should hold {matrix.rows} rows): write it again")
        return matrix

    def blocks(self, *, numbers: int = _BLOCK) -> Iterator[npt.NDArray[np.floating]]:
        """All rows in order, about `numbers` numbers `[n, dim]` at a time."""
        step = max(1, numbers // self.dim)
        with self.path.open("rb") as file:
            file.seek(self._start)
            for low in range(0, self.rows, step):
                count = min(step, self.rows - low) * self.dim
                yield np.fromfile(file, dtype=self._dtype, count=count).reshape(-1, self.dim)


def _head(file: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype[np.floating]]:
    """Shape, whether it is by columns, and type; objects, which would be pickled, are a type like any other."""
    version = npy.read_magic(file)
    if version == (1, 0):
        return npy.read_array_header_1_0(file)
    if version == (2, 0):
        return npy.read_array_header_2_0(file)
    raise ValueError(f"version {version[0]}.{version[1]}")
