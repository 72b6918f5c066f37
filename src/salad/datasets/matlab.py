"""Just enough of MATLAB's file format, version 5, to read the structure that a benchmark's ground truth comes in.

Structures, cells, texts and real numbers are read, packed or not, of either byte order; whatever bytes a file holds,
it is read or refused by a sentence. SciPy's `loadmat` was tried in its place. Of 2,000 files with one byte changed 30
killed the process (SciPy 1.17.1 looks for a number's kind in a table without asking whether it is in it), and so did
cells 10,000 deep. What would keep such files from it has to go through every element, which is most of a reader.

Source: MathWorks, "MAT-File Format", level 5.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salad.errors import BenchmarkError
from salad.files import read_file

Value = dict[str, Any] | list[Any] | str | NDArray[np.float64]

# An element's kind says how its content is coded: numbers, or letters.
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_LETTERS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _PACKED = 14, 15
# A matrix's class says what its elements are; numbers of any width are classes of their own.
_CELL, _STRUCT, _TEXT, _NUMBER = 1, 2, 4, range(6, 16)
_LONGEST = 1 << 28  # bytes of a file
_MOST = 1 << 28  # bytes that all of it may unpack to: a small file may say it holds terabytes
_DEEPEST = 8  # a file of cells in cells would else end in the interpreter's recursion limit
_ELEMENTS = 1 << 23  # of all kinds: an empty one takes eight bytes in a file, and a hundred in memory
_COUNT = 1 << 27  # numbers of all matrices: a gigabyte
_FAULTS = (struct.error, zlib.error, ValueError, IndexError, KeyError, TypeError, OverflowError)


def read_struct(path: Path, name: str) -> dict[str, Value]:
    """Read a structure out of a `.mat` file.

    Args:
        path: The file.
        name: The variable.

    Returns:
        Its fields in their order: structures as dicts, cells as lists, texts, numbers as float64 of their shape;
        None for a field of a kind not read here.

    Raises:
        BenchmarkError: If the file cannot be read, is damaged or of another version, or has no such structure.
    """
    try:
        for found, value in _Reader(read_file(path, most=_LONGEST)).variables():
            if found == name and isinstance(value, dict):
                return value
    except OSError as error:
        raise BenchmarkError(f"{path} cannot be read ({error.strerror}): check the name and its rights") from error
    except _FAULTS as error:
        raise BenchmarkError(
            f"{path} is no whole MATLAB file of version 5 ({error}): fetch it again, or save it with -v6 or -v7"
        ) from error
    raise BenchmarkError(f"{path} holds no structure called {name}: take the file that the data set comes with")


class _Reader:
    """A file's bytes, taken apart; what it unpacks to and how many elements it has is counted over all of it."""

    def __init__(self, data: bytes) -> None:
        order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
        if order is None:
            raise ValueError("its first 128 bytes do not say how it is written")
        self._data, self._order = memoryview(data)[128:], order
        self._unpacked = self._elements = self._count = 0

    def variables(self) -> Iterator[tuple[str, Value | None]]:
        """Names and values of a file's variables; None for what is of a kind not read here."""
        for kind, content in self._all_in(self._data):
            if kind == _PACKED:
                unpacked = zlib.decompressobj().decompress(content, _MOST - self._unpacked)
                self._unpacked += len(unpacked)
                if self._unpacked >= _MOST:
                    raise ValueError("it unpacks to more than any ground truth does")
                for inner, matrix in self._all_in(memoryview(unpacked)):
                    if inner == _MATRIX:
                        yield self._matrix(matrix, 0)
            elif kind == _MATRIX:
                yield self._matrix(content, 0)

    def _all_in(self, data: memoryview) -> Iterator[tuple[int, memoryview]]:
        """The elements that stand one after the other in bytes: each one's kind and content."""
        place = 0
        while place + 8 <= len(data):
            self._elements += 1
            if self._elements > _ELEMENTS:
                raise ValueError("it has more parts than any ground truth does")
            kind, size = struct.unpack_from(f"{self._order}II", data, place)
            if kind >> 16:  # a short one, content and all in eight bytes
                kind, size, begin, end = kind & 0xFFFF, kind >> 16, place + 4, place + 8
            else:  # padded to eight bytes, but for packed ones
                begin = place + 8
                end = begin + size + (0 if kind == _PACKED else -size % 8)
            if begin + size > len(data):
                raise ValueError("it ends in the middle")
            yield kind, data[begin : begin + size]
            place = end

    def _matrix(self, data: memoryview, depth: int) -> tuple[str, Value | None]:
        """A matrix's name and value; None for a value of a kind not read here."""
        if depth > _DEEPEST:
            raise ValueError("its cells are in cells without end")
        elements = self._all_in(data)
        nothing = (9, memoryview(b""))
        (_, flags), (_, sides), (_, coded_name) = (next(elements, nothing) for _ in range(3))
        if not flags:  # nothing at all, which is how an empty cell is written
            return "", np.zeros((0, 0))
        name, kind = str(coded_name, "latin-1"), struct.unpack_from(f"{self._order}I", flags)[0] & 0xFF
        if kind == _CELL:
            return name, [self._matrix(content, depth + 1)[1] for _, content in elements]
        coded, content = next(elements, nothing)
        if kind == _STRUCT:  # how many bytes a field's name takes, all names, then a matrix for each field
            width, (_, names) = int(self._numbers(5, content)[0]), next(elements, nothing)
            if width < 1:
                raise ValueError("a structure's fields have no names")
            if len(names) // width > _ELEMENTS:
                raise ValueError("it has more parts than any ground truth does")
            starts = range(0, len(names), width)
            fields = [str(names[at : at + width], "latin-1").split("\0")[0] for at in starts]
            values = [self._matrix(field, depth + 1)[1] for _, field in elements]
            return name, dict(zip(fields, values, strict=False))
        if kind == _TEXT:
            wide = {"<": "-le", ">": "-be"}[self._order] if _LETTERS[coded] in ("utf-16", "utf-32") else ""
            return name, str(content, _LETTERS[coded] + wide)
        if kind in _NUMBER:
            shape = self._numbers(5, sides).astype(int)
            return name, self._numbers(coded, content).reshape(shape, order="F")
        return name, None

    def _numbers(self, coded: int, content: memoryview) -> NDArray[np.float64]:
        kind = np.dtype(self._order + _NUMBERS[coded])
        self._count += len(content) // kind.itemsize
        if self._count > _COUNT:
            raise ValueError("it holds more numbers than any ground truth does")
        with np.errstate(all="ignore"):  # a signalling NaN in a damaged file
            return np.frombuffer(content, dtype=kind).astype(np.float64)
