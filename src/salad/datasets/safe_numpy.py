"""Arrays of integers and texts out of `.npy` and `.npz` files that strangers wrote, and nothing else.

An object array in such a file is a pickle, and a pickle is a program: whoever runs it with pickle's own reader lets the
file call what it likes. Here its steps are read without running any. Anything but integers, numbers and texts is
refused by a sentence.
"""

from __future__ import annotations

import math
import os
import pickletools
import re
import sys
import zipfile
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Float64, Int64, Shaped

from salad.errors import BenchmarkError, reason
from salad.files import open_file, read_file
from salad.npy import read_head

MOST = 1 << 27  # numbers of one file, all its arrays together: a gigabyte of rows
_PLAIN = re.compile(r"[<>|=]?(?:[iu][1248]|b1|f[248]|[SU][1-9][0-9]{0,4})")

Plain = Shaped[np.ndarray, "..."]


def plain_array(data: bytes, code: str, shape: tuple[int, ...], fortran: bool, at: str) -> Plain:
    """The array that bytes hold, which may go on behind it; `at` names their file in sentences.

    `code` says what an item is, as numpy writes it: `<i8`, `|S5`. In `fortran` order the first axis runs fastest.

    Raises:
        BenchmarkError: If items are neither numbers nor texts, there are too many, or the bytes end before them.
    """
    # By a pattern and not by np.dtype, which takes structures, sub-arrays, and texts of any length.
    if not _PLAIN.fullmatch(code):
        raise BenchmarkError(f"{at} holds items of the kind {code!r}: only integers, numbers and texts are read")
    kind, count = np.dtype(code), math.prod(shape)
    # Sides that are multiplied by 0 may be anything, and numpy multiplies them before.
    if max(count, math.prod(side for side in shape if side)) > MOST or count * kind.itemsize > len(data):
        raise BenchmarkError(f"{at} ends before its {count} items do, or has too many: fetch it again")
    flat = np.frombuffer(data, dtype=kind, count=count)
    return flat.reshape(shape, order="F" if fortran else "C")


_MARK = object()  # where a row of items begins on the stack


@dataclass(slots=True)
class _Made:
    """What a call would have made: of which function, of which arguments, and what it was told afterwards."""

    of: str
    arguments: tuple[Any, ...]
    state: tuple[Any, ...] | None = None


@dataclass(frozen=True, slots=True)
class _Name:
    """A function or a class that a pickle names; it is compared, never looked up."""

    full: str


_KNOWN = {  # what numpy's own pickles of arrays name, under both names of its inner package
    f"{package}.{name}": name.rpartition(".")[2]
    for package in ("numpy.core", "numpy._core")
    for name in ("multiarray._reconstruct", "multiarray.scalar")
} | {
    "numpy.ndarray": "ndarray",
    "numpy.dtype": "dtype",
    "_codecs.encode": "encode",
    "__builtin__.bytes": "bytes",  # as protocol 2 writes none
}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_VALUES = {  # steps that put a whole number, a text or bytes on the stack
    *("BININT", "BININT1", "BININT2", "INT", "LONG", "LONG1", "LONG4"),
    *("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "UNICODE"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BINSTRING", "SHORT_BINSTRING", "STRING"),
}
_SHORT_TUPLES = ("EMPTY_TUPLE", "TUPLE1", "TUPLE2", "TUPLE3")
_FAULTS = (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError, Warning)


class _Pickle:
    """A pickle whose steps are read one by one and never run.

    Only the steps that put integers, texts and numpy's arrays of them together are known. The functions that a file
    names are compared with a short list of names, and none is ever looked up. Numpy's reader behind an Unpickler with
    such a list was tried in its place, and crashed in 8 of 10 runs of the fuzz test.
    """

    def __init__(self, data: bytes, at: str) -> None:
        self._data, self._at = data, at
        self._stack: list[Any] = []
        self._memo: dict[int, Any] = {}
        self._encoded = 0
        self._arrays: dict[int, Any] = {}
        self._lists: set[int] = set()

    def items(self, shape: tuple[int, ...]) -> list[Any]:
        """The items of the object array that the pickle holds: ints, texts, arrays and lists of ints."""
        try:
            items = [self._plain(item) for item in _list_of(_state(self._top())[4])]
        except _FAULTS as error:
            raise BenchmarkError(
                f"{self._at} is damaged, or holds more than arrays of integers and texts ({error}); nothing of it was "
                "run: fetch it again from where the data set comes from"
            ) from error
        if len(items) != math.prod(shape):
            raise BenchmarkError(f"{self._at} says it holds {shape} items, but has {len(items)}: fetch it again")
        return items

    def _top(self) -> Any:
        """What is on the stack after the last step."""
        for opcode, argument, _ in pickletools.genops(BytesIO(self._data)):
            if opcode.name == "STOP":
                return self._stack.pop()
            self._step(opcode.name, argument)
        raise ValueError("it has no end")

    def _step(self, name: str, argument: Any) -> None:
        stack = self._stack
        match name:
            case _ if name in _VALUES:
                stack.append(argument)
            case _ if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
            case _ if name in _SHORT_TUPLES:
                begin = len(stack) - _SHORT_TUPLES.index(name)
                stack[begin:] = [tuple(stack[begin:])]
            case "PROTO" | "FRAME":
                pass
            case "PUT" | "BINPUT" | "LONG_BINPUT" | "MEMOIZE":
                self._memo[len(self._memo) if argument is None else argument] = stack[-1]
            case "GET" | "BINGET" | "LONG_BINGET":
                stack.append(self._memo[argument])
            case "MARK":
                stack.append(_MARK)
            case "EMPTY_LIST":
                stack.append([])
            case "LIST":
                stack.append(self._since_mark())
            case "TUPLE":
                stack.append(tuple(self._since_mark()))
            case "APPEND":
                item = stack.pop()
                _list_of(stack[-1]).append(item)
            case "APPENDS":
                items = self._since_mark()
                _list_of(stack[-1]).extend(items)
            case "GLOBAL":
                stack.append(_named(argument.replace(" ", ".", 1)))
            case "STACK_GLOBAL":
                inner = stack.pop()
                stack.append(_named(f"{stack.pop()}.{inner}"))
            case "REDUCE":
                arguments, function = stack.pop(), stack.pop()
                stack.append(self._called(function, arguments))
            case "BUILD":
                state, made = stack.pop(), stack[-1]
                if not isinstance(made, _Made) or not isinstance(state, tuple):
                    raise TypeError("it changes what is no array")
                made.state = state
            case _:
                raise ValueError(f"it uses the step {name}")

    def _since_mark(self) -> list[Any]:
        place = next((row for row in range(len(self._stack) - 1, -1, -1) if self._stack[row] is _MARK), None)
        if place is None:
            raise ValueError("its steps do not fit together")
        items = self._stack[place + 1 :]
        del self._stack[place:]
        return items

    def _called(self, function: Any, arguments: Any) -> Any:
        """What a call would have made; of bytes, these themselves."""
        if not isinstance(function, _Name) or not isinstance(arguments, tuple):
            raise TypeError("it calls what is no function")
        if function.full == "bytes":
            return b""
        if function.full != "encode":
            return _Made(function.full, arguments)
        text, coding = arguments  # how protocol 2 writes bytes
        if coding != "latin1":
            raise ValueError(f"it codes bytes as {coding!r}")
        return self._bytes(text)

    def _bytes(self, text: str) -> bytes:
        self._encoded += len(text)
        if self._encoded > len(self._data):  # each text stands in the file once
            raise ValueError("it repeats itself to fill the memory")
        return text.encode("latin-1")

    def _plain(self, item: Any) -> Any:
        """An item as numpy would have it; an array that many items share is made once."""
        if not isinstance(item, _Made):
            if type(item) in (int, str) or (isinstance(item, list) and self._whole(item)):
                return item
            raise TypeError(f"an item is of the kind {type(item).__name__}")
        # Without this a small file could name one large array a million times, and fill the memory with its copies.
        if id(item) not in self._arrays:
            if item.of == "scalar":
                kind, raw = item.arguments
                self._arrays[id(item)] = plain_array(raw, _code(kind), (), False, self._at)[()]
            else:
                self._arrays[id(item)] = self._inner(item)
        return self._arrays[id(item)]

    def _whole(self, items: list[Any]) -> bool:
        """Whether a list holds whole numbers alone; looked through once, however often the file names it."""
        if id(items) not in self._lists and all(type(part) is int for part in items):
            self._lists.add(id(items))
        return id(items) in self._lists

    def _inner(self, item: _Made) -> Any:
        _, shape, kind, fortran, raw = _state(item)
        if isinstance(raw, str):  # as Python 2 wrote bytes
            raw = self._bytes(raw)
        if isinstance(raw, list) and self._whole(raw):
            return raw
        if not isinstance(raw, bytes) or not all(type(side) is int and side >= 0 for side in shape):
            raise TypeError("an array has no shape or no bytes")
        return plain_array(raw, _code(kind), shape, bool(fortran), self._at)


def _named(full: str) -> _Name:
    if full not in _KNOWN:
        raise ValueError(f"it names {full[:60]}")
    return _Name(_KNOWN[full])


def _list_of(item: Any) -> list[Any]:
    if not isinstance(item, list):
        raise TypeError("a list is missing")
    return item


def _state(made: Any) -> tuple[Any, ...]:
    """What an array was told: version, shape, kind, order, content."""
    if not isinstance(made, _Made) or made.of != "_reconstruct" or made.state is None or len(made.state) != 5:
        raise TypeError("it is no array")
    return made.state


def _code(kind: Any) -> str:
    """How an array's items are coded, such as `<i8`."""
    if not isinstance(kind, _Made) or kind.of != "dtype" or kind.state is None:
        raise TypeError("an array does not say what its items are")
    order, code = kind.state[1], kind.arguments[0]
    if isinstance(code, bytes):
        code = code.decode("ascii")
    return f"{order.decode('ascii') if isinstance(order, bytes) else order}{code}"


_MOST_BYTES = 1 << 30  # of a file, and of all arrays in an .npz, which may say that it unpacks to terabytes
_MOST_OF_A_LIST = 1 << 20  # bytes of a list of what an .npz holds
_END_OF_ZIP, _END_OF_LARGE_ZIP = b"PK\5\6", b"PK\6\7"
_ZIP_FAULTS = (
    *(OSError, zipfile.BadZipFile, zlib.error, EOFError),
    *(NotImplementedError, ValueError, RuntimeError),  # an unknown packing, an odd name, a password
)


@dataclass(frozen=True, slots=True)
class Arrays:
    """What a file holds: a plain array, or the items of an object array, each an int, a text or an array.

    `at` names the file in sentences.
    """

    value: Plain | list[Any]
    at: str

    def texts(self) -> list[str]:
        """A list of texts.

        Raises:
            BenchmarkError: If it is something else.
        """
        if isinstance(self.value, np.ndarray) and self.value.dtype.kind == "U":
            letters = self.value.ravel().view(self.value.dtype.byteorder + "u4")
            if letters.size and letters.max() > sys.maxunicode:  # which numpy would hand to Python, and crash
                raise BenchmarkError(f"{self.at} holds letters that do not exist: fetch it again")
        items = self.value if isinstance(self.value, list) else self.value.ravel().tolist()
        told = [item.decode("utf-8", "replace") if isinstance(item, bytes) else item for item in items]
        if not all(isinstance(item, str) for item in told):
            raise BenchmarkError(f"{self.at} should hold names of photos and holds something else: fetch it again")
        try:
            "".join(told).encode("utf-8", "surrogateescape")
        except UnicodeEncodeError as error:
            raise BenchmarkError(
                f"{self.at} holds letters that do not exist ({error.reason}): fetch it again"
            ) from error
        return told

    def numbers(self) -> Float64[np.ndarray, ...]:
        """Plain numbers of any shape.

        Raises:
            BenchmarkError: If it is something else.
        """
        if isinstance(self.value, list) or self.value.dtype.kind not in "iuf":
            raise BenchmarkError(f"{self.at} should hold numbers and holds something else: fetch it again")
        with np.errstate(all="ignore"):  # a signalling NaN in a damaged file
            return self.value.astype(np.float64)

    def rows(self) -> list[Int64[np.ndarray, " n"]]:
        """Row numbers for each query: one number, a line of a table, or an array of any length.

        Raises:
            BenchmarkError: If it is something else.
        """
        found: list[Int64[np.ndarray, " n"]] = []
        rows = 0
        for item in self.value:
            array = np.asarray(item) if isinstance(item, int | np.generic | np.ndarray) else None
            if isinstance(item, list) and all(type(part) is int and abs(part) < 1 << 62 for part in item):
                array = np.array(item, dtype=np.int64)
            # an empty list was saved as no real numbers
            if array is None or not (array.dtype.kind in "iu" or (array.dtype.kind == "f" and array.size == 0)):
                raise BenchmarkError(
                    f"{self.at} should hold rows of references for each query and holds something else"
                )
            rows += array.size  # before the array is copied: a file may name one of them a million times
            if rows > MOST:
                raise BenchmarkError(f"{self.at} holds more than {MOST} numbers, which no ground truth does")
            found.append(array.ravel().astype(np.int64))
        return found


def read_npy(path: Path) -> Arrays:
    """Read an `.npy` file.

    Raises:
        BenchmarkError: If it cannot be read, is damaged, or holds anything but integers, numbers and texts.
    """
    try:
        data = read_file(path, most=_MOST_BYTES)
    except OSError as error:
        raise BenchmarkError(f"{path} cannot be read ({error.strerror}): check the name and its rights") from error
    return parse_npy(data, str(path))


def read_npz(path: Path) -> dict[str, Arrays]:
    """Read an `.npz` file: its arrays by name.

    Raises:
        BenchmarkError: As `read_npy`.
    """
    try:
        with open_file(path) as file:
            _check_zip(file)
            with zipfile.ZipFile(file) as archive:
                found = [info for info in archive.infolist() if info.filename.endswith(".npy")]
                if any(info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for info in found):
                    raise ValueError("it is packed in a way that numpy never packs")
                if sum(info.file_size for info in found) > _MOST_BYTES:
                    raise BenchmarkError(f"{path} unpacks to more than any ground truth does: fetch it again")
                members = {info.filename: archive.read(info) for info in found}
    except _ZIP_FAULTS as error:
        raise BenchmarkError(f"{path} is not a whole .npz file ({reason(error)}): fetch it again") from error
    return {name.removesuffix(".npy"): parse_npy(data, f"{name} in {path}") for name, data in members.items()}


def _check_zip(file: BinaryIO) -> None:
    """Refuse a list of contents that would fill the memory: Python's reader takes it as long as the file says.

    Raises:
        ValueError: If it is longer than that of a few arrays.
    """
    length = file.seek(0, os.SEEK_END)
    file.seek(max(0, length - (1 << 16) - 42))
    tail = file.read()
    at = tail.rfind(_END_OF_ZIP)
    large = tail[max(0, at - 20) : at].startswith(_END_OF_LARGE_ZIP)
    if large or int.from_bytes(tail[at + 12 : at + 16], "little") > _MOST_OF_A_LIST:
        raise ValueError("it lists more than a few arrays")
    file.seek(0)


def parse_npy(data: bytes, at: str) -> Arrays:
    """Read the bytes of an `.npy` file; `at` names it in sentences.

    Raises:
        BenchmarkError: As `read_npy`.
    """
    try:
        head = read_head(BytesIO(data))
    except ValueError as error:
        raise BenchmarkError(
            f"{at} is not a whole .npy file of plain items: fetch it again, or save it with numpy"
        ) from error
    content = data[head.start :]
    if head.code.endswith(("O", "O8", "O4")):
        return Arrays(_Pickle(content, at).items(head.shape), at)
    return Arrays(plain_array(content, head.code, head.shape, head.by_columns, at), at)
