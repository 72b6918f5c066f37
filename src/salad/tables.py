"""Tables, whatever they list: CSV with the columns' names in its first line, and Parquet where pyarrow is there.

What CSV is in the wild is decided here for everybody: UTF-8 with or without a mark, or UTF-16, as spreadsheets write
it; commas, semicolons or tabs, as the first line has them; quotes around whatever holds one of them or an end of line;
blank lines passed over; and so is what a number is. Which columns a table needs, and the sentence where it lacks one,
are its reader's own. A table may be anybody's: it is read from a file and from nothing else, and no line or value of
it is longer than one can be.
"""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any, BinaryIO, TextIO

from salad.errors import needs_extra, reason
from salad.files import open_file

Header = Callable[[list[str]], Sequence[str]]
"""Takes the columns' names as a table has them, and gives what to call them; or raises, where one is missing."""

CsvError = csv.Error
"""What is raised in the middle of a text that is no CSV."""

LONGEST_LINE = 1 << 20
"""Letters of a line of text that are read; the photos right for a query, or found for it, may be thousands."""
LONGEST_TEXT = 1 << 16
"""Letters of a value of a table; a path has at most half as many on any system."""

_DELIMITERS = ",;\t"
_SEPARATOR = re.compile(r'"?sep=([,;\t])"?\s*', re.IGNORECASE)  # a first line by which Excel is told what parts fields
_QUOTED = re.compile(r'"[^"]*"?')
_MARKS = {
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16, whose mark it begins with
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_NO_CSV = {
    b"PK\3\4": "it is a spreadsheet of Excel, LibreOffice or Numbers, or another packed file",
    b"\xd0\xcf\x11\xe0": "it is a spreadsheet of an old Excel",
    b"PAR1": "it is Parquet, and its name must end in .parquet",
    b"SQLite format 3\0": "it is a database",
    b"<": "it is XML, such as GPX, KML or a web page",
    b"{": "it is JSON, such as GeoJSON",
    b"[": "it is JSON",
}
"""How files begin that are taken for tables, and are none."""

_BEGINS_A_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
_ROWS = 1000  # of Parquet in memory
_MOST_OF_A_COLUMN = 1 << 29  # bytes of a Parquet file's group of rows, by its own word
_NUMBER = re.compile(r"[+-]?(?:[0-9]{1,40}(?:\.[0-9]{0,40})?|\.[0-9]{1,40})(?:[eE][+-]?[0-9]{1,3})?")


def number(text: str) -> float:
    """A number as people and programs write it: `48.1`, `-7`, `1e-05`; blanks around it do no harm.

    Python takes more for a number than any table means by one: `1_0`, the digits of other scripts, `nan`.

    Raises:
        ValueError: If it is none, or too large for any.
    """
    plain = text.strip(" \t")
    found = float(plain) if _NUMBER.fullmatch(plain) else math.nan
    if not math.isfinite(found):
        raise ValueError(f"{shown(text)} is no number")
    return found


def whole(text: str) -> int:
    """A whole number: `7`, `-12`; blanks around it do no harm.

    Raises:
        ValueError: If it is none, or has more digits than any number of a table.
    """
    if not re.fullmatch(r"[+-]?[0-9]{1,18}", plain := text.strip(" \t")):
        raise ValueError(f"{shown(text)} is no whole number")
    return int(plain)


def shown(value: object, *, most: int = 60) -> str:
    """A value as a sentence tells it: in quotes, what cannot be seen escaped, and no longer than one reads."""
    # Cut before it is quoted: a value may fill the memory once, and need not do so twice.
    said = repr(value[:most] if isinstance(value, str | bytes) else value)
    cut = isinstance(value, str | bytes) and len(value) > most
    return f"{said[: most + 2]}{'...' if cut or len(said) > most + 2 else ''}"


def read_lines(path: Path, *, errors: str = "strict", longest: int = LONGEST_LINE) -> Iterator[str]:
    """The lines of a text, one after another, with their ends as they are; memory stays small.

    Args:
        path: The file, in UTF-8 with or without a mark, or in UTF-16 or UTF-32 with one.
        errors: What becomes of bytes that are not UTF-8, as `open` has it.
        longest: Letters that a line may have.

    Raises:
        OSError: If the file cannot be read, or is none.
        UnicodeDecodeError: If it is not UTF-8, and `errors` is "strict".
        ValueError: If a line is longer.
    """
    with open_file(path) as raw:
        head = raw.peek(4)
        encoding = next((name for mark, name in _MARKS.items() if head.startswith(mark)), "utf-8-sig")
        with io.TextIOWrapper(raw, encoding=encoding, errors=errors, newline="") as file:
            yield from bounded_lines(file, longest=longest)


def bounded_lines(file: TextIO, *, longest: int = LONGEST_LINE) -> Iterator[str]:
    """The lines of an open text, such as a list on standard input.

    Raises:
        ValueError: If a line is longer.
    """
    line_number = 0
    while line := file.readline(longest + 1):
        line_number += 1
        if len(line) > longest:
            raise ValueError(f"line {line_number} has over {longest:,} letters")
        yield line


def read_csv(
    path: Path,
    header: Header = list,
    *,
    strict: bool = True,
    errors: str = "strict",
    missing: str | None = "",
) -> Iterator[tuple[int, dict[str, str]]]:
    """The lines of a CSV file, one after another; memory stays small.

    Fields are parted by commas, semicolons or tabs: by what a first line `sep=;` says, which is no line of the table,
    or by what stands most often between the columns' names.

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
        CsvError: If it is not CSV; the message says what it is instead, where that shows.
    """
    with open_file(path) as file:
        head = file.peek(16).removeprefix(codecs.BOM_UTF8).lstrip()
    if instead := next((told for beginning, told in _NO_CSV.items() if head.startswith(beginning)), None):
        raise CsvError(instead)
    lines = _lines_of_csv(path, errors)
    first = next(lines, "")
    told = _SEPARATOR.fullmatch(first)
    if told is None:
        lines = itertools.chain([first], lines)
    delimiter = told[1] if told else max(_DELIMITERS, key=_QUOTED.sub("", first).count)  # of equals the comma
    reader = csv.DictReader(lines, strict=strict, restval=missing, delimiter=delimiter)
    reader.fieldnames = header(list(reader.fieldnames or []))
    for fields in reader:
        yield reader.line_num + (told is not None), fields


def _lines_of_csv(path: Path, errors: str) -> Iterator[str]:
    try:
        yield from read_lines(path, errors=errors)
    except UnicodeDecodeError:
        raise
    except ValueError as error:
        raise CsvError(str(error)) from error


def read_parquet(
    path: Path, header: Header = list, *, wanted: Collection[str] | None = None
) -> Iterator[tuple[int, dict[str, Any]]]:
    """The rows of a Parquet file, one after another; memory stays small.

    Args:
        path: The file.
        header: As `read_csv`, where there is any row at all.
        wanted: Columns that are read, as `header` calls them; all where not given.

    Yields:
        The number of the row, from 1, and its values by the columns' names.

    Raises:
        OSError: If the file cannot be read, or is none.
        ValueError: If it is no Parquet, or unpacks to what no table holds.
        MissingExtraError: If pyarrow is not installed.
    """
    pyarrow, parquet = _arrow("reading Parquet")
    with open_file(path) as file:
        _check_metadata(file)
        try:
            table = parquet.ParquetFile(file)
            if not table.metadata.num_rows:
                return
            names = dict(zip(table.schema_arrow.names, header(table.schema_arrow.names), strict=True))
            columns = [column for column, name in names.items() if wanted is None or name in wanted]
            texts = _checked_columns(pyarrow, table, columns, length=os.fstat(file.fileno()).st_size)
            # Each text once, and how long it is known before it stands in a thousand rows.
            table = parquet.ParquetFile(file, read_dictionary=texts)
            done = itertools.count(1)
            for batch in table.iter_batches(batch_size=_ROWS, columns=columns):
                called = [names[column] for column in batch.schema.names]
                for row in zip(*_plain(batch), strict=True):
                    yield next(done), dict(zip(called, row, strict=True))
        except OSError as error:
            if error.errno is not None:
                raise
            raise ValueError(
                f"it is no Parquet ({reason(error)})"
            ) from error  # pyarrow's own word for bytes it cannot read
        except (pyarrow.ArrowException, OverflowError) as error:
            raise ValueError(f"it is no Parquet ({error})") from error


_LOOK = """
import sys
from pyarrow import ArrowException, parquet
try:
    metadata = parquet.ParquetFile(sys.stdin.buffer).metadata
except (ArrowException, OSError):
    sys.exit()  # said better where it is read
for group in range(metadata.num_row_groups):
    for column in range(metadata.num_columns):
        metadata.row_group(group).column(column)
"""


def _check_metadata(file: BinaryIO) -> None:
    """Whether a process survives it to look at what Parquet says of its columns, which is tried in another one.

    Arrow ends the process over some that are damaged ("terminate called after throwing an instance of
    'parquet::ParquetException'"), where nothing can be caught. Where no process can be started nothing is tried.

    Raises:
        ValueError: If it does not, or not within a minute.
    """
    try:
        tried = subprocess.run(
            [sys.executable, "-P", "-c", _LOOK], stdin=file, capture_output=True, timeout=60, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError("what it says of its columns takes a minute to read") from error
    except (OSError, ValueError):
        return
    finally:
        file.seek(0)
    if tried.returncode < 0:
        raise ValueError("what it says of its columns is damaged")


def _checked_columns(pyarrow: Any, table: Any, columns: Sequence[str], *, length: int) -> list[str]:
    """Those columns that hold texts, none of them, nor any other, more than a table of photos can.

    A few bytes of Parquet can stand for terabytes: one value repeated, or packed zeros.
    """
    rows = table.metadata.num_rows
    if rows > length:  # each names another photo
        raise ValueError(f"it says it holds {rows:,} rows in {length:,} bytes")
    for group in range(table.metadata.num_row_groups):
        for place in range(table.metadata.num_columns):
            if table.metadata.row_group(group).column(place).total_uncompressed_size > _MOST_OF_A_COLUMN:
                raise ValueError("a column of it unpacks to more than any table holds")
    schema, texts = table.schema_arrow, list[str]()
    for column in columns:
        kind = schema.field(schema.get_field_index(column)).type
        wide = pyarrow.types.is_fixed_size_binary(kind) and kind.byte_width > LONGEST_TEXT
        if pyarrow.types.is_nested(kind) or wide:
            raise ValueError(f"its column {shown(column)} holds {shown(str(kind))}, neither texts nor numbers")
        if any(test(kind) for test in (pyarrow.types.is_string, pyarrow.types.is_large_string)):
            texts.append(column)
    return texts


def _plain(batch: Any) -> list[list[Any]]:
    """The values of each column, texts not longer than one may be."""
    longest_of = import_module("pyarrow.compute")
    columns = []
    for column in batch.columns:
        if hasattr(column, "dictionary"):
            longest = longest_of.max(longest_of.binary_length(column.dictionary)).as_py() or 0
            if longest > LONGEST_TEXT:
                raise ValueError(f"it holds a text of {longest:,} bytes")
            column = column.dictionary_decode()
        columns.append(column.to_pylist())
    return columns


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
    line, end = io.StringIO(newline=""), "\r\n"
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
