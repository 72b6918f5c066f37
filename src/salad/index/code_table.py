"""What `photos.sqlite` says of codes: how they are coded, which files hold them, and how far each of them counts.

The tables are made when an index is first compressed. They are part of the same commits as the photos, so a file of
codes never counts for more than what was seen onto the disk before. A salad that knows no codes leaves them as they
are: what it adds has no code yet, and where it compacts, the codes are of a matrix that is no more, and pass for none.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from salad.errors import StoreError
from salad.index.catalog import Catalog
from salad.search.compressed import Coding, block_rows

SCHEMA = (
    "CREATE TABLE IF NOT EXISTS code_plan (id INTEGER PRIMARY KEY CHECK (id = 1), bytes INTEGER NOT NULL)",
    "CREATE TABLE IF NOT EXISTS codings (id INTEGER PRIMARY KEY, bytes INTEGER NOT NULL, seen INTEGER NOT NULL, "
    "step REAL NOT NULL, middle BLOB NOT NULL, axes BLOB NOT NULL, sum INTEGER NOT NULL)",
    "CREATE TABLE IF NOT EXISTS codes (file TEXT PRIMARY KEY, coding INTEGER NOT NULL, matrix TEXT NOT NULL, "
    "rows INTEGER NOT NULL, sums BLOB NOT NULL)",
)
CODE_FILE = re.compile(r"codes-\d+\.i8")

_MOST_BYTES = 1 << 20  # of a code; it has no more than a descriptor has numbers
_SUMS, _MIDDLE, _AXES = np.dtype("<u4"), np.dtype("<f4"), np.dtype("<f2")


@dataclass(frozen=True, slots=True)
class CodeSet:
    """A file of codes, as the last commit has it.

    Attributes:
        file: Its name.
        coding: Number of how they are coded.
        size: Bytes of a code.
        seen: Photos that could be found when the coding was fitted.
        matrix: Name of the file of descriptors that these are codes of.
        rows: How many rows, the first ones, have codes.
        sums: Checksums (CRC-32) of its blocks.
    """

    file: str
    coding: int
    size: int
    seen: int
    matrix: str
    rows: int
    sums: tuple[int, ...]


class CodeTable:
    """The tables of codes; whatever reads or writes them runs inside a look or a change of the catalog."""

    def __init__(self, catalog: Catalog) -> None:
        self.catalog = catalog
        self.folder = catalog.path.parent

    def sets(self, *, matrix: str | None = None) -> list[CodeSet]:
        """The files of codes, of one file of descriptors where it is named, those of most rows first."""
        if not self._is_there():
            return []
        found = self.catalog.select(
            "SELECT file, coding, bytes, seen, matrix, rows, sums FROM codes JOIN codings ON codings.id = coding "
            "ORDER BY rows DESC, file"
        )
        return [
            CodeSet(file, coding, size, seen, of, rows, tuple(np.frombuffer(sums, _SUMS).tolist()))
            for file, coding, size, seen, of, rows, sums in found
            # No other file is ours to read or delete.
            if CODE_FILE.fullmatch(str(file)) and _makes_sense(size, seen, rows, sums) and matrix in (None, of)
        ]

    def coding(self, of: CodeSet, *, dim: int) -> Coding:
        """How a file's rows are coded.

        Raises:
            StoreError: If that is damaged.
        """
        found = self.catalog.select("SELECT step, middle, axes, sum FROM codings WHERE id = ?", (of.coding,))
        for step, middle, axes, noted in found:
            whole = isinstance(step, float) and isinstance(middle, bytes) and isinstance(axes, bytes)
            whole = whole and len(middle) == of.size * _MIDDLE.itemsize and len(axes) == of.size * dim * _AXES.itemsize
            if whole and noted == _sum(step, middle, axes) and np.isfinite(step):
                along = np.frombuffer(axes, _AXES).reshape(of.size, dim)
                return Coding(along.astype(np.float16), np.frombuffer(middle, _MIDDLE).astype(np.float32), step)
        raise StoreError(f"how {self.folder / of.file} is coded is damaged: {way_out(self.folder)}")

    def plan(self) -> int | None:
        """Bytes of a code that were asked for; 0 for no codes, None where nobody has said."""
        found = self.catalog.select("SELECT bytes FROM code_plan") if self._is_there() else []
        sizes = [size for (size,) in found if isinstance(size, int) and 0 <= size <= _MOST_BYTES]
        return sizes[0] if sizes else None

    def set_plan(self, size: int) -> None:
        """Note how many bytes of a code are asked for; 0 for no codes."""
        for statement in SCHEMA:
            self.catalog.change(statement)
        self.catalog.change("INSERT OR REPLACE INTO code_plan VALUES (1, ?)", (size,))

    def begin(self, file: str, coding: Coding, *, seen: int, matrix: str) -> None:
        """Note a file of codes of which none counts yet."""
        middle, axes = coding.middle.astype(_MIDDLE).tobytes(), coding.axes.astype(_AXES).tobytes()
        number = self.catalog.change(
            "INSERT INTO codings (bytes, seen, step, middle, axes, sum) VALUES (?, ?, ?, ?, ?, ?)",
            (coding.size, seen, coding.step, middle, axes, _sum(coding.step, middle, axes)),
        )
        self.catalog.change("INSERT INTO codes VALUES (?, ?, ?, 0, ?)", (file, number, matrix, b""))

    def put(self, file: str, *, coding: int, matrix: str, rows: int, sums: tuple[int, ...]) -> None:
        """Note how far a file of codes counts, and its blocks' checksums."""
        blob = np.array(sums, _SUMS).tobytes()
        self.catalog.change("INSERT OR REPLACE INTO codes VALUES (?, ?, ?, ?, ?)", (file, coding, matrix, rows, blob))

    def keep_only(self, files: set[str]) -> None:
        """Forget all files of codes but these, and how no file is coded any more."""
        for each in self.sets():
            if each.file not in files:
                self.catalog.change("DELETE FROM codes WHERE file = ?", (each.file,))
        self.catalog.change("DELETE FROM codings WHERE id NOT IN (SELECT coding FROM codes)")

    def _is_there(self) -> bool:
        return bool(self.catalog.select("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'codes'"))


def _makes_sense(size: Any, seen: Any, rows: Any, sums: Any) -> bool:
    """Whether codes can be of that size and number: a damaged number must not have us ask for so much memory."""
    if not all(isinstance(number, int) and number >= 0 for number in (size, seen, rows)) or not isinstance(sums, bytes):
        return False
    return bool(0 < size <= _MOST_BYTES) and len(sums) == -(-rows // block_rows(size)) * _SUMS.itemsize


def _sum(step: float, middle: bytes, axes: bytes) -> int:
    return zlib.crc32(axes, zlib.crc32(middle, zlib.crc32(np.float64(step).tobytes())))


def way_out(folder: object) -> str:
    """What to do where codes are not what they should be."""
    return f"searches are exact there until 'salad compress {folder}' has made them anew"
