"""The list of photos of an export: CSV, Parquet or GeoJSON, out and back; what another tool wrote is read as well.

Columns: `path` (seen from the list's folder), and `lat`, `lon`, `heading`, `time`, `identity` and `source` where known;
they may be called and written as in any table of photos (`salad.images.as_written`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from salad.errors import PositionError, StoreError, reason
from salad.geo import compass
from salad.images import as_written
from salad.images.metadata import SOURCES
from salad.images.photo import Photo
from salad.images.photo_table import LONGEST_PATH
from salad.index.geojson import is_text, read_features, write_features
from salad.tables import CsvError, read_csv, read_parquet, shown, write_table

Put = Callable[[Sequence[Photo], Sequence[str]], None]
Record = Mapping[str, Any]

COLUMNS = ("path", "lat", "lon", "heading", "time", "identity", "source")
_DEGREES = ("lat", "lon", "heading")
_IDENTITY = re.compile(r"[0-9a-f]{32}")


@contextmanager
def writer(path: Path) -> Iterator[Put]:
    """Begin a list at `path`, of the form its name ends in; what it gives takes photos and their contents.

    CSV keeps every name, even one that is not UTF-8; Parquet cannot. GeoJSON has the photos as points, with null for
    those without a position.

    Raises:
        MissingExtraError: If it is to be Parquet, and what writes it is not installed.
    """
    kinds = {name: float if name in _DEGREES else str for name in COLUMNS}
    begun = write_features(path, COLUMNS) if path.suffix == ".geojson" else write_table(path, kinds)
    with begun as write:

        def put(photos: Sequence[Photo], identities: Sequence[str]) -> None:
            strange = next((photo.path for photo in photos if not is_text(str(photo.path))), None)
            if strange is not None and path.suffix == ".parquet":
                raise StoreError(
                    f"{os.fsencode(strange)!r} is not UTF-8, and Parquet holds no other names: export as csv"
                )
            pairs = zip(photos, identities, strict=True)
            write(photo.as_dict() | {"identity": identity, "source": photo.source} for photo, identity in pairs)

        yield put


def read(path: Path) -> Iterator[tuple[Photo, str | None]]:
    """The photos of a list, of the form its name ends in, with their contents where it tells them.

    More columns do no harm; memory stays small.

    Raises:
        StoreError: If the list cannot be read, or a line of it makes no sense; it is named.
        MissingExtraError: If it is Parquet, and what reads it is not installed.
    """
    done = 0
    try:
        for record in _records(path):
            yield _photo(record, path.parent)
            done += 1
    except OSError as error:
        raise StoreError(f"{path} cannot be read ({reason(error)}): check the name and permissions") from error
    except (ValueError, PositionError, CsvError) as error:
        raise StoreError(f"{path}, photo {done + 1}: {error}; correct it, or leave it out") from error


def _records(path: Path) -> Iterator[Record]:
    match path.suffix.lower():
        case ".geojson":
            yield from map(_of_feature, read_features(path))
        case ".parquet":
            yield from (record for _, record in read_parquet(path, _header, wanted=COLUMNS))
        case _:
            for _, record in read_csv(path, _header, errors="surrogateescape"):
                if None in record:
                    raise ValueError("it has more fields than the first line (put names with commas in quotes)")
                if any(record.values()):  # spreadsheets end a table by empty rows
                    yield record


def _of_feature(feature: Any) -> Record:
    """A GeoJSON feature as the other forms have it: its properties, and the point of its geometry."""
    match feature:
        case {"properties": dict(known), "geometry": None}:
            return known
        case {"properties": dict(known), "geometry": {"coordinates": [lon, lat, *_]}}:  # a height may follow
            return {**known, "lat": lat, "lon": lon}
    raise ValueError(f"{shown(feature)} is no point with properties")


def _header(names: list[str]) -> list[str]:
    header = as_written.columns(names)
    if header.count("path") != 1:
        told = ", ".join(header[:20]) or "none"
        raise ValueError(f"it needs one column 'path', but has {told[:200]}")
    if twice := [name for name in COLUMNS if header.count(name) > 1]:
        raise ValueError(f"it has two columns {twice[0]!r}, of which nobody knows which is meant")
    return header


def _photo(record: Record, folder: Path) -> tuple[Photo, str | None]:
    path = record.get("path")
    if not isinstance(path, str) or not path or not _can_be_a_name(path):
        raise ValueError(f"{shown(path)} is no file's name")
    where = as_written.position(record.get("lat"), record.get("lon"))
    heading = as_written.degrees(record.get("heading"), "heading")
    turned = heading if heading is None or 0 <= heading <= 360 else compass(heading)
    said_by = record.get("source") if where is not None else None
    source = said_by if said_by in SOURCES else None  # of a later salad, or another tool's column of that name
    photo = Photo(folder / path, where, turned, as_written.time(record.get("time")), source)
    return photo, _identity(record.get("identity"))


def _can_be_a_name(path: str) -> bool:
    """Whether a file could be called so: no NUL, no half of a letter, and not without end."""
    try:
        return "\0" not in path and len(path) <= LONGEST_PATH and bool(os.fsencode(path))
    except UnicodeEncodeError:
        return False


def _identity(value: object) -> str | None:
    """Which photo it is: a content hash, by which the index tells photos from one another ever after."""
    if value is None or value == "":
        return None
    if not isinstance(value, str) or not _IDENTITY.fullmatch(value):
        raise ValueError(
            f"its identity {shown(value)} is no content hash of 32 hexadecimal digits: leave the column out, and "
            "photos go by their content"
        )
    return value
