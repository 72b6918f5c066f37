"""The head of a `.npy` file: what its numbers are, how many, and where they begin.

The head is a line of Python, which numpy's own reader evaluates: nested a thousand deep it ends in the interpreter's
limits, and what it says of its shape may be anything. Here it is taken apart by the one form that it is written in,
and nothing is evaluated or allocated.

Source: NumPy Enhancement Proposal 1, "A simple file format for NumPy arrays".
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import BinaryIO

_MAGIC = b"\x93NUMPY"
_LONGEST = 10_000  # bytes of a head, as numpy has it; one of a million dimensions is none
_FIELD = re.compile(
    r"(['\"])(?P<name>descr|fortran_order|shape)\1:"
    r"(?:(['\"])(?P<code>[^'\"]{1,20})\3|(?P<flag>True|False)"
    r"|\((?P<sides>(?:[0-9]{1,18}L?,){0,31}(?:[0-9]{1,18}L?)?)\))"
    r"(?:,|(?=\}$))"
)


@dataclass(frozen=True, slots=True)
class NpyHead:
    """What a `.npy` file says of itself.

    Attributes:
        code: What an item is, as numpy writes it: `<f4`, `|O`; it need not be a kind that there is.
        by_columns: Whether the first axis runs fastest.
        shape: As it is said; what follows may be shorter.
        start: Bytes before the first item.
    """

    code: str
    by_columns: bool
    shape: tuple[int, ...]
    start: int

    @property
    def count(self) -> int:
        """How many items there should be."""
        return math.prod(self.shape)


def read_head(file: BinaryIO, *, newest: int = 3) -> NpyHead:
    """Read the head of a `.npy` file, from where the file stands.

    Args:
        file: The file, at its beginning.
        newest: Version of the format that is read at most: 3 differs from 2 in names of columns alone.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it has no such head; the message says what of it.
    """
    first = file.read(8)
    if len(first) < 8 or not first.startswith(_MAGIC):
        raise ValueError("its first bytes are another format's")
    version = first[6]
    if not 1 <= version <= newest:
        raise ValueError(f"version {version}.{first[7]}")
    wide = 2 if version == 1 else 4
    said = file.read(wide)
    length = int.from_bytes(said, "little")
    text = file.read(min(length, _LONGEST)) if len(said) == wide else b""
    if len(text) < max(length, 1):
        raise ValueError("its head is cut short")
    code, by_columns, sides = _fields(text.decode("latin-1"))
    shape = tuple(int(side.rstrip("L")) for side in sides.split(",") if side)
    return NpyHead(code, by_columns, shape, len(first) + wide + length)


def _fields(text: str) -> tuple[str, bool, str]:
    """What the head says of `descr`, `fortran_order` and `shape`, in whatever order."""
    plain = "".join(text.split())
    found: dict[str, re.Match[str]] = {}
    place = 1
    while (field := _FIELD.match(plain, place)) and field["name"] not in found:
        found[field["name"]] = field
        place = field.end()
    if plain[:1] == "{" and plain[place:] == "}" and len(found) == 3:
        code, flag, sides = found["descr"]["code"], found["fortran_order"]["flag"], found["shape"]["sides"]
        # One number in brackets is a number to Python and no shape.
        if code is not None and flag is not None and sides is not None and ("," in sides or not sides):
            return code, flag == "True", sides
    raise ValueError("its head does not say of what kind and shape its numbers are")
