"""Tables, whatever they list: CSV with the columns' names in its first line, and Parquet where pyarrow is there.

What CSV is in the wild is decided here for everybody: UTF-8 with or without a mark, commas, quotes around whatever
holds a comma or an end of line, blank lines passed over. Which columns a table needs, and the sentence where it
lacks one, are its reader's own.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from io import StringIO
from pathlib import Path, PurePath
from typing import Any

from salad.errors import needs_extra

Header = Callable[[list[str]], Sequence[str]]
"""Takes the columns' names as a table has them, and gives what to call them; or raises, where one is missing."""

CsvError = csv.Error
"""What is raised in the middle of a text that is no CSV."""

_BEGINS_A_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
_NUMBER = re.compile(r"[+-]?\d+(\.\d*)?(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_ROWS = 1000  # of Parquet in memory


def read_csv(
    path: Path,
    header: Header = list,
    *,
    strict: bool = True,
    errors: str = "strict",
    missing: str | None = "",
) -> Iterator[tuple[int, dict[str, str]]]:
    """The lines of a CSV file, one after another; memory stays small.

    Args:
        path: The file.
        header: Looks at the columns' names; where it is not given, whatever columns there are will do.
        strict: Whether quotes that are never closed are an error, or are read as far as the file goes.
        errors: What becomes of bytes that are not UTF-8, as `open` has it: "surrogateescape" keeps names of files
            that are no text.
        missing: What stands in the columns that a short line does not reach.

    Yields:
        The number of the line that a row ends in, and its fields by the columns' names, as texts. What stands behind
        the last column is a list under None, so that a reader can refuse a line that is too long.

    Raises:
        OSError: If the file cannot be read.
        UnicodeDecodeError: If it is not UTF-8, and `errors` is "strict".
        CsvError: If it is not CSV.
    """
    with path.open(encoding="utf-8-sig", errors=errors, newline="") as file:
        reader = csv.DictReader(file, strict=strict, restval=missing)
        reader.fieldnames = header(list(reader.fieldnames or []))
        for fields in reader:
            yield reader.line_num, fields


def read_parquet(path: Path, header: Header = list) -> Iterator[tuple[int, dict[str, Any]]]:
    """The rows of a Parquet file, one after another; memory stays small.

    Args:
        path: The file.
        header: As `read_csv`, where there is any row at all.

    Yields:
        The number of the row, from 1, and its values by the columns' names.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is no Parquet.
        MissingExtraError: If pyarrow is not installed.
    """
    pyarrow, parquet = _arrow("reading Parquet")
    names: Sequence[str] = ()
    try:
        batches = parquet.ParquetFile(path).iter_batches(batch_size=_ROWS)
        rows = (row for batch in batches for row in batch.to_pylist())
        for number, row in enumerate(rows, start=1):
            names = names or header(list(row))  # every row has the same columns
            yield number, dict(zip(names, row.values(), strict=True))
    except pyarrow.ArrowException as error:
        raise ValueError(f"it is no Parquet ({error})") from error


@contextmanager
def write_table(path: Path, columns: Mapping[str, type]) -> Iterator[Callable[[Iterable[Mapping[str, Any]]], None]]:
    """Begin a table, Parquet where its name ends in `.parquet` and CSV else; what it gives takes rows, some at a time.

    Args:
        path: The file; one that is there is replaced.
        columns: The columns' names, and whether they hold `str` or `float`; None stands for what is not known.

    Raises:
        OSError: If the file cannot be written.
        UnicodeEncodeError: If a text is none, and the table is Parquet; CSV keeps every name of a file.
        MissingExtraError: If it is to be Parquet, and pyarrow is not installed.
    """
    if path.suffix == ".parquet":
        pyarrow, parquet = _arrow("writing Parquet")
        kinds = {str: pyarrow.string(), float: pyarrow.float64()}
        schema = pyarrow.schema([(name, kinds[kind]) for name, kind in columns.items()])
        with parquet.ParquetWriter(path, schema) as table:
            yield lambda rows: table.write_table(pyarrow.Table.from_pylist(list(rows), schema=schema))
    else:
        with path.open("w", encoding="utf-8", errors="surrogateescape", newline="") as file:
            file.write(csv_line(columns))
            yield lambda rows: file.writelines(csv_line(row[name] for name in columns) for row in rows)


def csv_line(values: Iterable[object]) -> str:
    """One line with its end; None leaves its field empty. What the values hold comes back from any reader of CSV.

    Raises:
        TypeError: If `values` cannot be gone through.
    """
    # Older Pythons put quotes around an end of line only where it holds a character of their own line's end.
    line, end = StringIO(newline=""), "\r\n"
    csv.writer(line, lineterminator=end).writerow(values)
    return line.getvalue().removesuffix(end) + "\n"


def without_formulas(values: Iterable[object]) -> Iterator[object]:
    """The same values for a spreadsheet, which takes a text that begins like a formula for one, and runs it.

    Numbers stay bare; a relative path begins with `./` then, and is the same path; any other text begins with an
    apostrophe, as people write it there. A table that comes back to us is not for spreadsheets, and is exact.
    """
    for value in values:
        text, is_path = str(value), isinstance(value, PurePath)
        if text[:1] not in _BEGINS_A_FORMULA or (_NUMBER.fullmatch(text) and not is_path):
            yield value
        else:
            yield f"./{text}" if is_path else f"'{text}"


def _arrow(doing: str) -> tuple[Any, Any]:
    """The package pyarrow, and its part for Parquet."""
    with needs_extra(doing, "parquet"):
        arrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    return arrow, parquet
