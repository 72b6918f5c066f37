"""Arrays of integers and texts out of `.npy` and `.npz` files that strangers wrote, and nothing else.

An object array in such a file is a pickle, and a pickle is a program: whoever runs it with pickle's own reader lets the
file call what it likes. `picklesteps` reads its steps without running any. Anything but integers, numbers and texts is
refused by a sentence.
"""

from __future__ import annotations

import math
import pickletools
import re
import sys
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, Shaped

from salad.errors import BenchmarkError

# --- The steps of a pickle, read one by one and never run: for arrays of integers and texts in files of strangers ---
#
# Only the steps that put integers, texts and numpy's arrays of them together are known. The functions that a file names
# are compared with a short list of names, and none is ever looked up.


MOST = 1 << 27  # numbers of one file, all its arrays together: a gigabyte of rows
_PLAIN = re.compile(r"[<>|=]?(?:[iu][1248]|b1|f[248]|[SU][1-9][0-9]{0,4})")

Plain = Shaped[np.ndarray, "..."]


def plain_array(data: bytes, code: str, shape: tuple[int, ...], fortran: bool, at: str) -> Plain:
    """The array that bytes hold; `at` names their file in sentences.

    Args:
        data: the bytes, which may go on behind the array.
        code: what an item is, as numpy writes it: `<i8`, `|S5`.
        shape: how many items along each axis.
        fortran: whether the first axis runs fastest.
        at: the file.

    Raises:
        BenchmarkError: items are neither numbers nor texts, there are too many, or the bytes end before them.
    """
    if not _PLAIN.fullmatch(code):
        raise BenchmarkError(
            f"{at} holds items of the kind {code!r}: only integers, numbers and texts are read"
        )
    kind, count = np.dtype(code), math.prod(shape)
    if count > MOST or count * kind.itemsize > len(data):
        raise BenchmarkError(f"{at} ends before its {count} items do, or has too many: fetch it again")
    flat = np.frombuffer(data, dtype=kind, count=count)
    return flat.reshape(shape, order="F" if fortran else "C")


class _Mark:
    """Where a row of items begins on the stack."""


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
_WHOLE = {"BININT", "BININT1", "BININT2", "INT", "LONG", "LONG1", "LONG4"}
_TEXTS = {"BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "UNICODE"}
_BYTES = {"BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BINSTRING", "SHORT_BINSTRING", "STRING"}
_VALUES = frozenset(_WHOLE | _TEXTS | _BYTES)
_FAULTS = (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError, Warning)


class Steps:
    """The steps of one pickle."""

    def __init__(self, data: bytes, at: str) -> None:
        self._data, self._at = data, at
        self._stack: list[Any] = []
        self._memo: dict[int, Any] = {}
        self._encoded = 0
        self._arrays: dict[int, Any] = {}

    def items(self, shape: tuple[int, ...]) -> list[Any]:
        """The items of the object array that the pickle holds: ints, texts, arrays and lists of ints."""
        try:
            top = self._walked()
            items = [self._plain(item) for item in _list_of(_state(top)[4])]
        except _FAULTS as error:
            raise BenchmarkError(
                f"{self._at} is damaged, or holds more than arrays of integers and texts ({error}); nothing of it was "
                "run: fetch it again from where the data set comes from"
            ) from error
        if len(items) != math.prod(shape):
            raise BenchmarkError(
                f"{self._at} says it holds {shape} items, but has {len(items)}: fetch it again"
            )
        return items

    def _walked(self) -> Any:
        for opcode, argument, _ in pickletools.genops(BytesIO(self._data)):
            if opcode.name == "STOP":
                return self._stack.pop()
            self._step(opcode.name, argument)
        raise ValueError("it has no end")

    def _step(self, name: str, argument: Any) -> None:
        if name in ("PROTO", "FRAME"):
            return
        if name in _VALUES:
            self._stack.append(argument)
        elif name in _CONSTANTS:
            self._stack.append(_CONSTANTS[name])
        elif name in _STEPS:
            _STEPS[name](self, argument)
        else:
            raise ValueError(f"it uses the step {name}")

    # Each of these is one step; they share a shape so that a table can hold them.

    def _mark(self, _: Any) -> None:
        self._stack.append(_Mark)

    def _since_mark(self) -> list[Any]:
        place = next((row for row in range(len(self._stack) - 1, -1, -1) if self._stack[row] is _Mark), None)
        if place is None:
            raise ValueError("its steps do not fit together")
        items = self._stack[place + 1 :]
        del self._stack[place:]
        return items

    def _empty_list(self, _: Any) -> None:
        self._stack.append([])

    def _list(self, _: Any) -> None:
        self._stack.append(self._since_mark())

    def _tuple(self, _: Any) -> None:
        self._stack.append(tuple(self._since_mark()))

    def _short_tuple(self, length: int) -> None:
        items = tuple(self._stack[len(self._stack) - length :])
        del self._stack[len(self._stack) - length :]
        self._stack.append(items)

    def _append(self, _: Any) -> None:
        item = self._stack.pop()
        _list_of(self._stack[-1]).append(item)

    def _appends(self, _: Any) -> None:
        items = self._since_mark()
        _list_of(self._stack[-1]).extend(items)

    def _put(self, place: Any) -> None:
        self._memo[len(self._memo) if place is None else place] = self._stack[-1]

    def _get(self, place: Any) -> None:
        self._stack.append(self._memo[place])

    def _global(self, argument: Any) -> None:
        self._named(".".join(argument.split(" ", 1)))

    def _stack_global(self, _: Any) -> None:
        name = self._stack.pop()
        self._named(f"{self._stack.pop()}.{name}")

    def _named(self, full: str) -> None:
        if full not in _KNOWN:
            raise ValueError(f"it names {full[:60]}")
        self._stack.append(_Name(_KNOWN[full]))

    def _reduce(self, _: Any) -> None:
        arguments, function = self._stack.pop(), self._stack.pop()
        if not isinstance(function, _Name) or not isinstance(arguments, tuple):
            raise TypeError("it calls what is no function")
        if function.full == "encode":
            self._stack.append(self._coded(*arguments))
        else:
            self._stack.append(b"" if function.full == "bytes" else _Made(function.full, arguments))

    def _coded(self, text: str, coding: str) -> bytes:
        if coding != "latin1":
            raise ValueError(f"it codes bytes as {coding!r}")
        self._encoded += len(text)
        if self._encoded > len(self._data):  # each text is told once
            raise ValueError("it repeats itself to fill the memory")
        return text.encode("latin-1")

    def _build(self, _: Any) -> None:
        state = self._stack.pop()
        made = self._stack[-1]
        if not isinstance(made, _Made) or not isinstance(state, tuple):
            raise TypeError("it changes what is no array")
        made.state = state

    # What the steps made, as numpy would have it.

    def _plain(self, item: Any) -> Any:
        if not isinstance(item, _Made):
            if type(item) in (int, str) or (
                isinstance(item, list) and all(type(part) is int for part in item)
            ):
                return item
            raise TypeError(f"an item is of the kind {type(item).__name__}")
        if id(item) not in self._arrays:
            self._arrays[id(item)] = self._scalar(item) if item.of == "scalar" else self._inner(item)
        return self._arrays[id(item)]

    def _scalar(self, item: _Made) -> Any:
        kind, raw = item.arguments
        return plain_array(raw, _code(kind), (), False, self._at)[()]

    def _inner(self, item: _Made) -> Any:
        _, shape, kind, fortran, raw = _state(item)
        if isinstance(raw, str):  # as Python 2 wrote bytes
            raw = raw.encode("latin-1")
        if isinstance(raw, list) and all(type(part) is int for part in raw):
            return list(raw)
        if not isinstance(raw, bytes) or not all(type(side) is int and side >= 0 for side in shape):
            raise TypeError("an array has no shape or no bytes")
        return plain_array(raw, _code(kind), shape, bool(fortran), self._at)


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


def _short(length: int) -> Callable[[Steps, Any], None]:
    return lambda steps, _: steps._short_tuple(length)


_STEPS: dict[str, Callable[[Steps, Any], None]] = {
    "MARK": Steps._mark,
    "EMPTY_LIST": Steps._empty_list,
    "LIST": Steps._list,
    "TUPLE": Steps._tuple,
    **{name: _short(length) for length, name in enumerate(("EMPTY_TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"))},
    "APPEND": Steps._append,
    "APPENDS": Steps._appends,
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"), Steps._put),
    **dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), Steps._get),
    "GLOBAL": Steps._global,
    "STACK_GLOBAL": Steps._stack_global,
    "REDUCE": Steps._reduce,
    "BUILD": Steps._build,
}


_MAGIC = b"\x93NUMPY"
_HEADER = re.compile(
    r"\{'descr': *'([^']{1,20})', *'fortran_order': *(True|False), *"
    r"'shape': *\(((?:[0-9]{1,18}L?, *){0,8}(?:[0-9]{1,18}L?)?)\),? *\}\s*"
)
_MOST_BYTES = 1 << 31  # of one array in an .npz

Value = Plain | list[Any]


@dataclass(frozen=True, slots=True)
class Arrays:
    """What a file holds: a plain array, or the items of an object array, each an int, a text or an array.

    Attributes:
        value: the array or the items.
        at: which file, for sentences.
    """

    value: Value
    at: str

    def texts(self) -> list[str]:
        """A list of texts.

        Raises:
            BenchmarkError: it is something else.
        """
        items = self.value if isinstance(self.value, list) else _tolist(self.value.ravel(), self.at)
        told = [item.decode("utf-8", "replace") if isinstance(item, bytes) else item for item in items]
        if not all(isinstance(item, str) for item in told):
            raise BenchmarkError(
                f"{self.at} should hold names of photos and holds something else: fetch it again"
            )
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
            BenchmarkError: it is something else.
        """
        if isinstance(self.value, list) or self.value.dtype.kind not in "iuf":
            raise BenchmarkError(f"{self.at} should hold numbers and holds something else: fetch it again")
        with np.errstate(all="ignore"):  # a signalling NaN in a damaged file
            return self.value.astype(np.float64)

    def rows(self) -> list[Int64[np.ndarray, " n"]]:
        """Row numbers for each query: one number, a line of a table, or an array of any length.

        Raises:
            BenchmarkError: it is something else.
        """
        found = [_integers(item, self.at) for item in self.value]
        if sum(map(len, found)) > MOST:
            raise BenchmarkError(f"{self.at} holds more than {MOST} numbers, which no ground truth does")
        return found


def _integers(item: Any, at: str) -> Int64[np.ndarray, " n"]:
    array = np.asarray(item) if isinstance(item, int | np.generic | np.ndarray) else None
    if isinstance(item, list) and all(type(part) is int and abs(part) < 1 << 62 for part in item):
        array = np.array(item, dtype=np.int64)
    # an empty list was saved as no real numbers
    if array is None or not (array.dtype.kind in "iu" or (array.dtype.kind == "f" and array.size == 0)):
        raise BenchmarkError(f"{at} should hold rows of references for each query and holds something else")
    return array.ravel().astype(np.int64)


def read_npy(path: Path) -> Arrays:
    """Read an `.npy` file.

    Raises:
        BenchmarkError: it cannot be read, is damaged, or holds anything but integers, numbers and texts.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BenchmarkError(
            f"{path} cannot be read ({error.strerror}): check the name and its rights"
        ) from error
    return parse_npy(data, str(path))


def read_npz(path: Path) -> dict[str, Arrays]:
    """Read an `.npz` file: its arrays by name.

    Raises:
        BenchmarkError: as `read_npy`.
    """
    faults = (
        OSError,
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        ValueError,
        RuntimeError,
    )
    try:
        with zipfile.ZipFile(path) as archive:
            found = [info for info in archive.infolist() if info.filename.endswith(".npy")]
            if any(info.file_size > _MOST_BYTES for info in found):
                raise BenchmarkError(f"{path} unpacks to more than any ground truth does: fetch it again")
            members = {info.filename: archive.read(info) for info in found}
    except faults as error:
        raise BenchmarkError(f"{path} is not a whole .npz file ({error}): fetch it again") from error
    return {name.removesuffix(".npy"): parse_npy(data, f"{name} in {path}") for name, data in members.items()}


def parse_npy(data: bytes, at: str) -> Arrays:
    """Read the bytes of an `.npy` file; `at` names it in sentences.

    Raises:
        BenchmarkError: as `read_npy`.
    """
    start, code, fortran, shape = _header(data, at)
    if code.endswith(("O", "O8", "O4")):
        return Arrays(Steps(data[start:], at).items(shape), at)
    return Arrays(plain_array(data[start:], code, shape, fortran, at), at)


def _header(data: bytes, at: str) -> tuple[int, str, bool, tuple[int, ...]]:
    """Where an array's bytes begin, how its items are coded, in which order, and its shape."""
    wide = 4 if data[6:7] in (b"\x02", b"\x03") else 2
    size = int.from_bytes(data[8 : 8 + wide], "little")
    told = _HEADER.fullmatch(data[8 + wide : 8 + wide + min(size, 10_000)].decode("latin-1"))
    if not data.startswith(_MAGIC) or told is None:
        raise BenchmarkError(
            f"{at} is not a whole .npy file of plain items: fetch it again, or save it with numpy"
        )
    shape = tuple(int(side.strip(" L")) for side in told[3].split(",") if side.strip(" L"))
    return 8 + wide + size, told[1], told[2] == "True", shape


def _tolist(array: Plain, at: str) -> list[Any]:
    if array.dtype.kind == "U":
        letters = array.view(array.dtype.byteorder + "u4")
        if letters.size and letters.max() > sys.maxunicode:  # of which numpy would make a crash
            raise BenchmarkError(f"{at} holds letters that do not exist: fetch it again")
    items: list[Any] = array.tolist()
    return items
