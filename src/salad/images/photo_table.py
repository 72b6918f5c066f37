"""Tables of photos: where each was taken, which way and when, as CSV or Parquet tells it."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path

from salad.errors import PositionError, reason
from salad.geo import GeoPoint
from salad.images.metadata import Position
from salad.tables import CsvError, number, read_csv, read_parquet, shown

_NEEDED, _MORE = ("path", "lat", "lon"), ("heading", "time")
_COLUMNS = (*_NEEDED, *_MORE)
LONGEST_PATH = 1 << 15
"""Letters of a path that a table or an index names, the most that any system takes."""
_LONG_NAME = 40  # characters of a column's name that a sentence tells


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table (one row of Parquet): its number in the file, the path as written, what it says."""

    line: int
    path: str
    position: Position

    @classmethod
    def of(cls, line: int, fields: Mapping[str, object]) -> Row:
        """A row from its fields.

        Raises:
            ValueError: If it makes no sense; the message says what of it.
            PositionError: If its position is none on earth.
        """
        if None in fields:
            raise ValueError("it has more fields than the header (put names with commas in quotes)")
        # As CSV would hold them. What is not known is None or, by pandas, NaN, which does not equal itself.
        columns = {name: fields[name] for name in _COLUMNS if name in fields}
        known = {name: "" if value is None or value != value else value for name, value in columns.items()}
        times = {name: value.isoformat() for name, value in known.items() if isinstance(value, datetime)}
        texts = {name: times.get(name) or str(value).strip() for name, value in known.items()}
        path, heading, time = (texts.get(column, "") for column in ("path", "heading", "time"))
        if not path or "\0" in path or len(path) > LONGEST_PATH:
            raise ValueError("its path is empty or no file's name")
        where = GeoPoint(_degrees(texts["lat"], "lat"), _degrees(texts["lon"], "lon"))
        turned = _degrees(heading, "heading") % 360 if heading else None
        try:
            return cls(line, path, Position(where, turned, datetime.fromisoformat(time) if time else None))
        except ValueError:
            raise ValueError(f"its time {shown(time)} is not written as 2024-05-31T14:00:00") from None


@dataclass(frozen=True, slots=True)
class PhotoTable:
    """Positions by photo.

    A row means the photo at its path, seen from the table's folder. Where no photo stands there, it means one
    whose path ends in the row's (a bare name is the shortest such end), so that a table may be kept apart
    from its photos, and yet `references/0001.jpg` never speaks for `queries/0001.jpg`.
    """

    path: Path
    rows: tuple[Row, ...]
    _by_place: dict[str, Row]
    _by_end: dict[str, Row]

    @classmethod
    def read(cls, path: str | Path) -> PhotoTable:
        """Read a CSV table: UTF-8 (with or without a mark), commas, a header; more columns do no harm.

        A name that ends in `.parquet` is read as Parquet, with the same columns; times may be timestamps.

        Raises:
            MissingExtraError: If it is Parquet, and pyarrow is not installed.
            PositionError: If the file or a column is missing, a row makes no sense (named by its line), or a photo
                has two rows.
        """
        path = Path(path)
        lines = read_rows(path)
        by_place: dict[str, Row] = {}
        by_end: dict[str, Row] = {}
        for row in lines:
            place = _key(path.parent / row.path)
            if (first := by_place.setdefault(place, row)) is not row:
                raise PositionError(
                    f"{path}, line {row.line}: {row.path!r} has a row already, line {first.line}: keep one"
                )
            # A row whose photo is where it says speaks for that photo only.
            if not os.path.isabs(row.path) and not os.path.exists(place):  # noqa: PTH110, PTH117  # plain strings
                by_end[_spelled(os.path.normpath(row.path))] = row
        return cls(path, tuple(lines), by_place, by_end)

    def __len__(self) -> int:
        return len(self.rows)

    def get(self, photo: str | Path) -> Position | None:
        """What the table says of a photo, or None where it has no row."""
        row = self._row(photo)
        return None if row is None else row.position

    def check_used(self, photos: Iterable[str | Path]) -> None:
        """Make sure that each row names exactly one of `photos`, for tables that should fit them.

        Raises:
            PositionError: If not; it names the first line that fits none of them or two.
        """
        taken: dict[int, str | Path] = {}
        for photo in photos:
            row = self._row(photo)
            if row is None:
                continue
            other = taken.setdefault(row.line, photo)
            if _key(Path(other)) != _key(Path(photo)):
                raise PositionError(
                    f"{self.path}, line {row.line}: {row.path!r} fits two photos, {other} and {photo}: "
                    f"write enough of the path to tell them apart"
                )
        for row in self.rows:
            if row.line not in taken:
                raise PositionError(
                    f"{self.path}, line {row.line}: no photo fits {row.path!r}: correct the row or drop it"
                )

    def _row(self, photo: str | Path) -> Row | None:
        key = _key(Path(photo))
        if (row := self._by_place.get(key)) is not None:
            return row
        parts = Path(key).parts[1:]
        ends = (str(Path(*parts[start:])) for start in range(len(parts)))
        return next((self._by_end[end] for end in ends if end in self._by_end), None)


def _key(path: Path) -> str:
    return _spelled(os.path.abspath(path))  # noqa: PTH100  # resolve() would follow links, a photo keeps its own name


def _spelled(path: str) -> str:
    """One spelling for accented names: some file systems take letters and accents apart."""
    return unicodedata.normalize("NFC", path)


def read_rows(path: Path) -> list[Row]:
    """The rows of a table of positions, CSV or Parquet, in order.

    Raises:
        MissingExtraError: If it is Parquet, and pyarrow is not installed.
        PositionError: If the file or a column is missing, or a row makes no sense (named by its line).
    """
    read = partial(read_parquet, wanted=_COLUMNS) if path.suffix.lower() == ".parquet" else read_csv
    rows: list[Row] = []
    try:
        for line, fields in read(path, partial(_header, path)):
            try:
                rows.append(Row.of(line, fields))
            except (ValueError, PositionError) as error:
                raise PositionError(f"{path}, line {line}: {error}; correct the row or leave it out") from error
    except OSError as error:
        raise PositionError(
            f"the table {path} cannot be read ({reason(error)}): check the name and who may read it"
        ) from error
    except UnicodeDecodeError as error:
        raise PositionError(f"the table {path} is not UTF-8 text ({error.reason}): save it as CSV in UTF-8") from error
    except CsvError as error:
        raise PositionError(f"the table {path} is not CSV ({error}): save it as CSV with commas") from error
    except ValueError as error:
        raise PositionError(f"the table {path} cannot be read: {error}; save it as Parquet or CSV") from error
    return rows


def _header(path: Path, names: list[str]) -> list[str]:
    header = [name.strip().lower() for name in names]
    for needed in (*_NEEDED, *(name for name in _MORE if name in header)):
        if header.count(needed) != 1:
            # As they fit into a sentence: a table that is none may hold anything there.
            short = [name if len(name) <= _LONG_NAME else name[:_LONG_NAME] + "..." for name in header]
            found = ", ".join(name if name.isprintable() else repr(name) for name in short) or "none"
            raise PositionError(
                f"the table {path} needs one column {needed!r}, but its columns are {found}: "
                f"write path,lat,lon[,heading,time] in the first line, with commas"
            )
    return header


def _degrees(text: str, column: str) -> float:
    with suppress(ValueError):
        found = number(text)
        if abs(found) <= 1e6:  # not so large that a turn is lost in rounding
            return found
    raise ValueError(f"its {column} {shown(text)} is not a number of degrees")
