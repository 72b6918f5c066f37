"""Tables of photos: where each was taken, which way and when, as CSV or Parquet tells it."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from urllib.parse import unquote

from salad.errors import PositionError, reason
from salad.geo import compass, null_island
from salad.images import as_written
from salad.images.metadata import Position
from salad.tables import CsvError, read_csv, read_parquet, shown

_NEEDED, _MORE = ("path", "lat", "lon"), ("heading", "time", "lat_ref", "lon_ref")
_COLUMNS = (*_NEEDED, *_MORE)
LONGEST_PATH = 1 << 15
"""Letters of a path that a table or an index names, the most that any system takes."""
_LONG_NAME = 40  # characters of a column's name that a sentence tells
_URL = re.compile("file:(?://(?:localhost)?(?=/))?", re.IGNORECASE)
_ROOT = re.compile("/*[A-Za-z]:/+|/+")


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
        if None in fields:  # be it empty: `1,5,2,` may be two numbers with decimal commas
            raise ValueError("it has more fields than the header (put names with commas in quotes)")
        known = {name: fields.get(name) for name in _COLUMNS}
        path = str(known["path"] or "").strip() if known["path"] == known["path"] else ""  # pandas: NaN, unlike itself
        if not path or "\0" in path or len(path) > LONGEST_PATH:
            raise ValueError("its path is empty or no file's name")
        refs = {name: known[name] or "" for name in ("lat_ref", "lon_ref")}
        where = as_written.position(known["lat"], known["lon"], **refs)
        heading = as_written.degrees(known["heading"], "heading")
        turned = None if heading is None else compass(heading)
        return cls(line, path, Position(where, turned, as_written.time(known["time"]), "table"))


@dataclass(frozen=True, slots=True)
class PhotoTable:
    """Positions by photo.

    A row means the photo at its path, seen from the table's folder. Where no photo stands there, it means one
    whose path ends in the row's (a bare name is the shortest such end), so that a table may be kept apart
    from its photos, and yet `references/0001.jpg` never speaks for `queries/0001.jpg`. Of the paths of another
    computer, which begin at a root or a drive, the end begins with the last folder that all of them share.
    """

    path: Path
    rows: tuple[Row, ...]
    _by_place: dict[str, Row]
    _by_end: dict[str, Row]

    @classmethod
    def read(cls, path: str | Path) -> PhotoTable:
        """Read a table: CSV in UTF-8 or UTF-16, a header, commas, semicolons or tabs; more columns do no harm.

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
        from_elsewhere: list[tuple[list[str], Row]] = []
        for row in lines:
            plain = _plain(row.path)
            place = _key(path.parent / row.path)
            here = os.path.exists(place)  # noqa: PTH110  # plain strings, for there may be a million
            if not here and plain != row.path:
                by_end[_spelled(os.path.normpath(row.path))] = row
                place = _key(path.parent / plain)
                here = os.path.exists(place)  # noqa: PTH110
            if (first := by_place.setdefault(place, row)) is not row:
                raise PositionError(
                    f"{path}, line {row.line}: {shown(row.path)} has a row already, line {first.line}: keep one"
                )
            # A row whose photo is where it says speaks for that photo only.
            if here:
                continue
            if root := _ROOT.match(plain):
                from_elsewhere.append((plain[root.end() :].split("/"), row))
            else:
                by_end[_spelled(os.path.normpath(plain))] = row
        for end, row in _ends_from_elsewhere(from_elsewhere):
            by_end.setdefault(end, row)
        return cls(path, tuple(lines), by_place, by_end)

    def __len__(self) -> int:
        return len(self.rows)

    def get(self, photo: str | Path) -> Position | None:
        """What the table says of a photo, or None where it has no row."""
        row = self._row(photo)
        return None if row is None else row.position

    def fitted(self, photos: Iterable[str | Path]) -> tuple[PhotoTable, list[str]]:
        """This table for these photos, and what a user should be told of how it fits them.

        A row that fits none of them as it is written means the one that it fits in other letters, small for large,
        where that is only one and no other row fits it so.

        Returns:
            The table; and a sentence if rows fit no photo, with their number and the first, and one if rows say 0,0.
        """
        used: set[int] = set()
        left: list[str] = []  # photos without a row
        for photo in photos:
            row = self._row(photo)
            if row is None:
                left.append(_key(Path(photo)))
            else:
                used.add(row.line)
        places, ends = (_in_small_letters(known, used) for known in (self._by_place, self._by_end))
        meant: dict[int, list[tuple[str, Row]]] = {}
        for key in left if places else ():
            if (row := _found(key.casefold(), places, ends)) is not None:
                meant.setdefault(row.line, []).append((key, row))
        more = dict(found[0] for found in meant.values() if len(found) == 1)
        used |= {row.line for row in more.values()}
        return replace(self, _by_place={**self._by_place, **more}), self._told(used)

    def _told(self, used: set[int]) -> list[str]:
        if not self.rows:
            return [f"{self.path} has no rows but the names of its columns"]
        told = []
        if unused := [row for row in self.rows if row.line not in used]:
            first = unused[0]
            told.append(
                f"{self.path}: of its rows {len(used):,} fit a photo and {len(unused):,} none, the first of them line "
                f"{first.line}, {shown(first.path)} (a path counts from the table's folder, or by how it ends)"
            )
        if zero := [row for row in self.rows if null_island(row.position.where)]:
            rows = "1 row says" if len(zero) == 1 else f"{len(zero):,} rows say"
            told.append(f"{self.path}: {rows} 0,0, which counts as no position; the first is line {zero[0].line}")
        return told

    def check_used(self, photos: Iterable[str | Path]) -> None:
        """Make sure that each row names exactly one of `photos`, for tables that should fit them.

        Raises:
            PositionError: If not; it names the first line that fits none of them or two.
        """
        photos = list(photos)
        fitted, _ = self.fitted(photos)
        taken: dict[int, str | Path] = {}
        for photo in photos:
            row = fitted._row(photo)
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
        return _found(_key(Path(photo)), self._by_place, self._by_end)


def _found(key: str, by_place: Mapping[str, Row], by_end: Mapping[str, Row]) -> Row | None:
    """The row of a photo, by its place or the longest end of it."""
    if (row := by_place.get(key)) is not None:
        return row
    at = key.find(os.sep)
    while at >= 0:
        if (row := by_end.get(key[at + 1 :])) is not None:
            return row
        at = key.find(os.sep, at + 1)
    return None


def _in_small_letters(known: Mapping[str, Row], used: set[int]) -> dict[str, Row]:
    """The same in small letters, without rows that are used, and without those that only their letters tell apart."""
    rows: dict[str, list[Row]] = {}
    for key, row in known.items():
        rows.setdefault(key.casefold(), []).append(row)
    return {key: same[0] for key, same in rows.items() if len(same) == 1 and same[0].line not in used}


def _plain(path: str) -> str:
    """A path with slashes, of one that Windows or a URL writes."""
    url = _URL.match(path)
    return (unquote(path[url.end() :]) if url else path).replace("\\", "/")


def _ends_from_elsewhere(paths: list[tuple[list[str], Row]]) -> Iterator[tuple[str, Row]]:
    """By which ends paths of another computer are known: the last folder that all share, and what comes behind it."""
    if not paths:
        return
    folders = [parts[:-1] for parts, _ in paths]
    shared = len(os.path.commonprefix(folders))  # noqa: RUF071  # of lists, it compares what they hold
    for parts, row in paths:
        yield _spelled(os.path.normpath("/".join(parts[max(shared - 1, 0) :]))), row


def _key(path: Path) -> str:
    return _spelled(os.path.abspath(path))  # noqa: PTH100  # resolve() would follow links, a photo keeps its own name


def _spelled(path: str) -> str:
    """One spelling for accented names: some file systems take letters and accents apart."""
    return unicodedata.normalize("NFC", path)


def read_rows(path: Path) -> list[Row]:
    """The rows of a table of positions, CSV or Parquet, in order; empty ones are passed over.

    Raises:
        MissingExtraError: If it is Parquet, and pyarrow is not installed.
        PositionError: If the file or a column is missing, or a row makes no sense (named by its line).
    """
    read = partial(read_parquet, wanted=_COLUMNS) if path.suffix.lower() == ".parquet" else read_csv
    rows: list[Row] = []
    try:
        for line, fields in read(path, partial(_header, path)):
            try:
                if None in fields or any(fields.values()):  # spreadsheets end a table by empty rows
                    rows.append(Row.of(line, fields))
            except (ValueError, PositionError) as error:
                raise PositionError(f"{path}, line {line}: {error}; correct the row or leave it out") from error
    except OSError as error:
        raise PositionError(
            f"the table {path} cannot be read ({reason(error)}): check the name and who may read it"
        ) from error
    except UnicodeDecodeError as error:
        raise PositionError(
            f"the table {path} is not UTF-8 text: save it as CSV in UTF-8 ('CSV UTF-8' in Excel)"
        ) from error
    except CsvError as error:
        raise PositionError(f"the table {path} is not CSV ({error}): save it as CSV with commas") from error
    except ValueError as error:
        raise PositionError(f"the table {path} cannot be read: {error}; save it as Parquet or CSV") from error
    return rows


def _header(path: Path, names: list[str]) -> list[str]:
    header = as_written.columns(names)
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
