"""Photos: finding them, what is known of each, which is which; their pixels are in `salad.images.decode`."""

from __future__ import annotations

import hashlib
import os
import sys
import unicodedata
from collections.abc import Iterable, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import IO, Any, TextIO

from salad.errors import PhotoError, PositionError
from salad.geo import GeoPoint
from salad.images.decode import existing, naming
from salad.images.metadata import Position, parse_at_name, read_exif
from salad.tables import CsvError, read_csv, read_parquet

_NEEDED = ("path", "lat", "lon")
_LONG_NAME = 40  # characters of a column's name that a sentence tells
SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".webp", ".tif", ".tiff", ".bmp", ".gif"}
    | {".ppm", ".pgm", ".pnm", ".jp2", ".avif", ".heic", ".heif"}
)
"""What a photo's name ends in, in small letters; a folder's other files are not photos."""


@dataclass(frozen=True, slots=True)
class Photo:
    """A photo and what is known of it.

    Attributes:
        path: Its file.
        where: Where it was taken.
        heading: Which way the camera looked, in degrees clockwise from north, 0 to 360.
        time: When it was taken; local time where it carries no time zone.
    """

    path: Path
    where: GeoPoint | None = None
    heading: float | None = None
    time: datetime | None = None

    def as_dict(self) -> dict[str, Any]:
        """This photo as JSON and tables hold it: path, lat, lon, heading, time; None for what is unknown."""
        return {
            "path": str(self.path),
            "lat": self.where.lat if self.where else None,
            "lon": self.where.lon if self.where else None,
            "heading": self.heading,
            "time": self.time.isoformat() if self.time else None,
        }


# --- finding -------------------------------------------------------------------------------


def find_photos(sources: Iterable[str | Path], stdin: TextIO | None = None) -> list[Path]:
    """The photos that files, folders and lists name, each once.

    Folders are walked in order of names, through links but never in circles; what is hidden and what does not
    end in one of `SUFFIXES` is left out. A file given by name is taken whatever it ends in. `-` stands for a
    list on `stdin` (the process's own where not given), one file or folder a line.

    Raises:
        PhotoError: If a source is missing, a folder cannot be read or holds no photo, or nothing is named.
    """
    found: dict[Path, None] = {}
    for source in sources:
        if source == "":  # an unset variable in a script, which must not mean the folder it runs in
            raise PhotoError("one of the photos named is an empty text: check the script that names it")
        named = listed(stdin or sys.stdin) if str(source) == "-" else [Path(source)]
        for path in named:
            inside = os.path.isdir(path)  # noqa: PTH112  # Path.is_dir fails over a name too long
            found.update(dict.fromkeys(photos_in(path) if inside else [existing(path)]))
    if not found:
        raise PhotoError("no photos are named: give files, folders, or - with a list on standard input")
    return list(found)


def listed(stdin: TextIO) -> list[Path]:
    """The paths a list names, one a line; blank lines are left out.

    Raises:
        PhotoError: If the list is not text.
    """
    try:
        lines = [line.removeprefix("\ufeff").rstrip("\r\n") for line in stdin]
    except UnicodeDecodeError as error:
        raise PhotoError("the list on standard input is not text: write one path a line, in UTF-8") from error
    return [Path(line) for line in lines if line.strip()]


def photos_in(folder: Path) -> list[Path]:
    """The photos in a folder and those in it, sorted by path.

    Raises:
        PhotoError: If a folder cannot be read, or there is no photo.
    """
    photos: list[Path] = []
    seen: set[str] = set()

    def refuse(error: OSError) -> None:
        raise PhotoError(
            f"the folder {error.filename} cannot be read ({error.strerror}): leave it out"
        ) from error

    for here, folders, files in os.walk(folder, onerror=refuse, followlinks=True):
        real = os.path.realpath(here)  # a folder may be reached by several links, also from within itself
        fresh = real not in seen
        seen.add(real)
        folders[:] = sorted(name for name in folders if fresh and not name.startswith("."))
        if fresh:
            # Names as plain texts: a Path for each of a million files would take longer than the walk.
            named = [name for name in files if not name.startswith(".")]
            photos += [Path(here, name) for name in named if name[name.rfind(".") :].lower() in SUFFIXES]
    if not photos:
        raise PhotoError(
            f"the folder {folder} holds no photos: none of its files ends in .jpg, .png or the like"
        )
    return sorted(photos)


# --- what is known -------------------------------------------------------------------------


def read_photo(path: Path, table: PhotoTable | None = None, *, file: IO[bytes] | None = None) -> Photo:
    """A photo with its position, heading and time, each from the first that has it: table, `@` name, EXIF.

    Pixels are not decoded: a photo that cannot be opened has no EXIF here, and `decode` says what is wrong.

    Args:
        path: The file.
        table: What is known from elsewhere.
        file: The same file where it is open already, or held in memory.

    Raises:
        PhotoError: If there is no such file.
    """
    path = existing(Path(path))
    own = (parse_at_name(path.name) or Position()).completed(read_exif(path, file=file))
    return placed(Photo(path, own.where, own.heading, own.time), table)


def placed(photo: Photo, table: PhotoTable | None) -> Photo:
    """The photo with what a table says of it, which comes before what it says itself."""
    listed = table.get(photo.path) if table else None
    if listed is None:
        return photo
    known = listed.completed(Position(photo.where, photo.heading, photo.time))
    return Photo(photo.path, known.where, known.heading, known.time)


def content_hash(path: Path, *, file: IO[bytes] | None = None) -> str:
    """Which photo this is, whatever its name: 32 hexadecimal digits of BLAKE2b over the file's bytes.

    Args:
        path: The file.
        file: The same file where it is open already, or held in memory.

    Raises:
        PhotoError: If the file cannot be read.
    """
    path = existing(Path(path))
    with naming(path), path.open("rb") if file is None else nullcontext(file) as source:
        source.seek(0)
        return hashlib.file_digest(source, lambda: hashlib.blake2b(digest_size=16)).hexdigest()  # type: ignore[arg-type]  # typeshed asks for more than it uses


# --- positions of photos from a table ------------------------------------------------------


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
        known = {name: "" if value is None or value != value else value for name, value in fields.items()}
        times = {name: value.isoformat() for name, value in known.items() if isinstance(value, datetime)}
        texts = {name: times.get(name) or str(value).strip() for name, value in known.items()}
        path, heading, time = (texts.get(column, "") for column in ("path", "heading", "time"))
        if not path or "\0" in path:
            raise ValueError("its path is empty or no file's name")
        where = GeoPoint(_degrees(texts["lat"], "lat"), _degrees(texts["lon"], "lon"))
        turned = _degrees(heading, "heading") % 360 if heading else None
        try:
            return cls(line, path, Position(where, turned, datetime.fromisoformat(time) if time else None))
        except ValueError:
            raise ValueError(f"its time {time!r} is not written as 2024-05-31T14:00:00") from None


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
    read = read_parquet if path.suffix.lower() == ".parquet" else read_csv
    rows: list[Row] = []
    try:
        for line, fields in read(path, partial(_header, path)):
            try:
                rows.append(Row.of(line, fields))
            except (ValueError, PositionError) as error:
                raise PositionError(
                    f"{path}, line {line}: {error}; correct the row or leave it out"
                ) from error
    except OSError as error:
        raise PositionError(
            f"the table {path} cannot be read ({error.strerror or error}): check the name and who may read it"
        ) from error
    except UnicodeDecodeError as error:
        raise PositionError(
            f"the table {path} is not UTF-8 text ({error.reason}): save it as CSV in UTF-8"
        ) from error
    except CsvError as error:
        raise PositionError(f"the table {path} is not CSV ({error}): save it as CSV with commas") from error
    except ValueError as error:
        raise PositionError(f"the table {path} cannot be read: {error}; save it as Parquet or CSV") from error
    return rows


def _header(path: Path, names: list[str]) -> list[str]:
    header = [name.strip().lower() for name in names]
    for needed in _NEEDED:
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
        number = float(text)
        if abs(number) <= 1e6:  # neither nan nor infinite, nor so large that a turn is lost in rounding
            return number
    raise ValueError(f"its {column} {text!r} is not a number of degrees")
