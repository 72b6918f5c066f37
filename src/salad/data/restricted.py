"""Arrays of integers and texts out of `.npy` and `.npz` files that strangers wrote, and nothing else.

An object array in such a file is a pickle, and a pickle is a program: whoever runs it with pickle's own reader lets the
file call what it likes. `picklesteps` reads its steps without running any. Anything but integers, numbers and texts is
refused by a sentence.
"""

from __future__ import annotations

import re
import sys
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from salad.data.picklesteps import MOST, Plain, Steps, plain_array
from salad.errors import BenchmarkError

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
