"""Lines of comma-separated values, whatever the values hold."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from salad.errors import MissingExtraError


class _Back:
    def write(self, line: str) -> str:
        return line


def csv_line(values: Iterable[object]) -> str:
    """One line with its end; None leaves its field empty. What the values hold comes back from any reader of CSV.

    Raises:
        TypeError: `values` cannot be gone through.
    """
    # Older Pythons put quotes around an end of line only where it holds a character of their own line's end.
    end = "\r\n"
    line: str = csv.writer(_Back(), lineterminator=end).writerow(values)
    return line.removesuffix(end) + "\n"


# --- Parquet tables, if pyarrow is there ---


_AT_ONCE = 1000  # rows in memory


def arrow(doing: str) -> tuple[Any, Any]:
    """The Parquet part of pyarrow, behind pyarrow itself.

    Raises:
        MissingExtraError: it is not installed; `doing` says what for.
    """
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError as error:
        raise MissingExtraError(doing, "parquet") from error


def rows(path: Path) -> Iterator[dict[str, Any]]:
    """The rows of a file, one after another, by the names of their columns.

    Raises:
        ValueError: it is no Parquet.
        OSError: it cannot be read.
        MissingExtraError: pyarrow is not installed.
    """
    pyarrow, parquet = arrow("reading Parquet")
    try:
        for batch in parquet.ParquetFile(path).iter_batches(batch_size=_AT_ONCE):
            yield from batch.to_pylist()
    except pyarrow.ArrowException as error:
        raise ValueError(f"it is no Parquet ({error})") from error
