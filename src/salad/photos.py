"""Photos: finding them, what is known of each, which is which; their pixels are in `salad.pixels`."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TextIO

from salad.errors import PhotoError
from salad.geo import GeoPoint
from salad.geotags import Position, at_name, parse_at_name
from salad.phototable import PhotoTable
from salad.pixels import MAX_PIXELS, existing, naming, open_rgb, read_exif, save_jpeg, squeeze

__all__ = [
    "MAX_PIXELS",
    "SUFFIXES",
    "Photo",
    "PhotoTable",
    "Position",
    "at_name",
    "find_photos",
    "identity",
    "open_rgb",
    "parse_at_name",
    "placed",
    "read_photo",
    "save_jpeg",
    "squeeze",
]

SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".webp", ".tif", ".tiff", ".bmp", ".gif"}
    | {".ppm", ".pgm", ".pnm", ".jp2", ".avif", ".heic", ".heif"}
)
"""What a photo's name ends in, in small letters; a folder's other files are not photos."""


@dataclass(frozen=True, slots=True)
class Photo:
    """A photo and what is known of it.

    Attributes:
        path: its file.
        where: where it was taken.
        heading: which way the camera looked, in degrees clockwise from north, 0 to 360.
        time: when it was taken; local time where it carries no time zone.
    """

    path: Path
    where: GeoPoint | None = None
    heading: float | None = None
    time: datetime | None = None


# --- finding -------------------------------------------------------------------------------


def find_photos(sources: Iterable[str | Path], stdin: TextIO | None = None) -> list[Path]:
    """The photos that files, folders and lists name, each once.

    Folders are walked in order of names, through links but never in circles; what is hidden and what does not
    end in one of `SUFFIXES` is left out. A file given by name is taken whatever it ends in. `-` stands for a
    list on `stdin` (the process's own where not given), one file or folder a line.

    Raises:
        PhotoError: where a source is missing, a folder cannot be read or holds no photo, or nothing is named.
    """
    found: dict[Path, None] = {}
    for source in sources:
        if source == "":  # an unset variable in a script, which must not mean the folder it runs in
            raise PhotoError("one of the photos named is an empty text: check the script that names it")
        named = listed(stdin or sys.stdin) if str(source) == "-" else [Path(source)]
        for path in named:
            inside = os.path.isdir(path)  # noqa: PTH112  # Path.is_dir fails over a name too long
            found.update(dict.fromkeys(_photos_in(path) if inside else [existing(path)]))
    if not found:
        raise PhotoError("no photos are named: give files, folders, or - with a list on standard input")
    return list(found)


def listed(stdin: TextIO) -> list[Path]:
    """The paths a list names, one a line; blank lines are left out.

    Raises:
        PhotoError: where the list is not text.
    """
    try:
        lines = [line.removeprefix("\ufeff").rstrip("\r\n") for line in stdin]
    except UnicodeDecodeError as error:
        raise PhotoError("the list on standard input is not text: write one path a line, in UTF-8") from error
    return [Path(line) for line in lines if line.strip()]


def _photos_in(folder: Path) -> list[Path]:
    photos: list[Path] = []
    seen: set[str] = set()

    def refuse(error: OSError) -> None:
        raise PhotoError(
            f"the folder {error.filename} cannot be read ({error.strerror}): leave it out"
        ) from error

    for here, folders, files in os.walk(folder, onerror=refuse, followlinks=True):
        real = os.path.realpath(here)
        fresh = real not in seen
        seen.add(real)
        folders[:] = sorted(name for name in folders if fresh and not name.startswith("."))
        if fresh:
            photos += [Path(here, name) for name in files if _looks_like_photo(name)]
    if not photos:
        raise PhotoError(
            f"the folder {folder} holds no photos: none of its files ends in .jpg, .png or the like"
        )
    return sorted(photos)


def _looks_like_photo(name: str) -> bool:
    return not name.startswith(".") and os.path.splitext(name)[1].lower() in SUFFIXES  # noqa: PTH122  # a Path for each file is slow


# --- what is known -------------------------------------------------------------------------


def read_photo(path: Path, table: PhotoTable | None = None) -> Photo:
    """A photo with its position, heading and time, each from the first that has it: table, `@` name, EXIF.

    Pixels are not decoded: a photo that cannot be opened has no EXIF here, and `open_rgb` says what is wrong.

    Raises:
        PhotoError: where there is no such file.
    """
    path = existing(Path(path))
    told = (parse_at_name(path.name) or Position()).completed(read_exif(path))
    return placed(Photo(path, told.where, told.heading, told.time), table)


def placed(photo: Photo, table: PhotoTable | None) -> Photo:
    """The photo with what a table says of it, which comes before what it says itself."""
    told = table.get(photo.path) if table else None
    if told is None:
        return photo
    told = told.completed(Position(photo.where, photo.heading, photo.time))
    return Photo(photo.path, told.where, told.heading, told.time)


def identity(path: Path) -> str:
    """Which photo this is, whatever its name: 32 hexadecimal digits of BLAKE2b over the file's bytes.

    Raises:
        PhotoError: where the file cannot be read.
    """
    path = existing(Path(path))
    with naming(path), path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
