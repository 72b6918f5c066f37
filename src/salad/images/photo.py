"""Photos: finding them, what is known of each, which is which; their pixels are in `salad.images.decode`."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TextIO

from salad.errors import PhotoError
from salad.geo import GeoPoint
from salad.images.at_names import parse_at_name
from salad.images.decode import existing, in_memory, naming
from salad.images.exif import read_exif
from salad.images.metadata import NOTHING_SAID, SOURCES, Position, settled
from salad.tables import bounded_lines

if TYPE_CHECKING:
    from salad.images.photo_table import PhotoTable

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
        source: Who says where, one of `salad.images.metadata.SOURCES`; None where nobody does, or it is not known who.
        remark: Why it has no position, or what of it was not understood: half a sentence, which may be empty.
    """

    path: Path
    where: GeoPoint | None = None
    heading: float | None = None
    time: datetime | None = None
    source: str | None = field(default=None, compare=False)
    remark: str = field(default="", compare=False)

    @classmethod
    def of(cls, path: Path, known: Position) -> Photo:
        """A photo of which that is known."""
        return cls(path, known.where, known.heading, known.time, known.source, known.remark)

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
        lines = [line.removeprefix("\ufeff").rstrip("\r\n") for line in bounded_lines(stdin)]
    except ValueError as error:  # not UTF-8, or a line without end
        raise PhotoError("the list on standard input is not text: write one path a line, in UTF-8") from error
    return [Path(line) for line in lines if line.strip()]


def photos_in(folder: Path) -> list[Path]:
    """The photos in a folder and those in it, sorted by path.

    Raises:
        PhotoError: If a folder cannot be read, or there is no photo.
    """
    photos: list[Path] = []
    seen: set[tuple[int, int]] = set()
    waiting = [os.fspath(folder)]  # as os.walk goes, which on Python 3.11 calls itself for each folder further down
    while waiting:
        here = waiting.pop()
        folders = []
        try:
            known = os.stat(here)  # noqa: PTH116  # plain texts, as below
            if (known.st_dev, known.st_ino) in seen:  # reached by several links, perhaps from within itself
                continue
            seen.add((known.st_dev, known.st_ino))
            with os.scandir(here) as entries:
                for entry in entries:
                    name = entry.name
                    if name.startswith("."):
                        continue
                    if _is_folder(entry):
                        folders.append(name)
                    # Names as plain texts: a Path for each of a million files would take longer than the walk.
                    elif name[name.rfind(".") :].lower() in SUFFIXES:
                        photos.append(Path(here, name))
        except OSError as error:
            raise PhotoError(f"the folder {here} cannot be read ({error.strerror}): leave it out") from error
        waiting += [os.path.join(here, name) for name in sorted(folders, reverse=True)]  # noqa: PTH118
    if not photos:
        raise PhotoError(f"the folder {folder} holds no photos: none of its files ends in .jpg, .png or the like")
    return sorted(photos)


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # a link to itself
        return False


# --- what is known -------------------------------------------------------------------------


def read_photo(path: Path, table: PhotoTable | None = None, *, file: IO[bytes] | None = None) -> Photo:
    """A photo with its position, heading and time, each from the first of `salad.images.metadata.SOURCES` that has it.

    Pixels are not decoded: a photo that cannot be opened has no EXIF here, and `decode` says what is wrong.

    Args:
        path: The file.
        table: What is known from elsewhere.
        file: The same file where it is held in memory already.

    Raises:
        PhotoError: If there is no such file.
    """
    path = Path(path) if file is not None else existing(Path(path))
    known = settled([parse_at_name(path.name) or Position(), read_exif(path, file=file)])
    if known.where is None and not known.remark:
        known = replace(known, remark=NOTHING_SAID)
    return placed(Photo.of(path, known), table)


def placed(photo: Photo, table: PhotoTable | None) -> Photo:
    """The photo with what a table says of it, which comes before what it says itself."""
    listed = table.get(photo.path) if table else None
    if listed is None:
        return photo
    own = Position(photo.where, photo.heading, photo.time, photo.source or SOURCES[-1], photo.remark)
    known = settled([replace(listed, source="table"), own])
    return Photo.of(photo.path, known)


def content_hash(path: Path, *, file: IO[bytes] | None = None) -> str:
    """Which photo this is, whatever its name: 32 hexadecimal digits of BLAKE2b over the file's bytes.

    Args:
        path: The file.
        file: The same file where it is held in memory already.

    Raises:
        PhotoError: If the file cannot be read.
    """
    path = Path(path)
    source = in_memory(path) if file is None else file
    with naming(path):
        source.seek(0)
        return hashlib.file_digest(source, lambda: hashlib.blake2b(digest_size=16)).hexdigest()  # type: ignore[arg-type]  # typeshed asks for more than it uses
