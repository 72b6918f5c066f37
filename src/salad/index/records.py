"""How a photo is written in `photos.sqlite`: the tables, and a photo as a row of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from salad.errors import PositionError
from salad.geo import GeoPoint
from salad.photos import Photo

# Paths are bytes on most systems and need not be text; they are stored as the bytes they are (os.fsencode),
# typed as TEXT so that anyone can read the table.
SCHEMA = """
CREATE TABLE photos (
    row INTEGER PRIMARY KEY,
    path TEXT NOT NULL,
    identity TEXT NOT NULL,
    lat REAL, lon REAL, heading REAL, time TEXT,
    removed INTEGER NOT NULL DEFAULT 0,
    sum INTEGER
);
CREATE UNIQUE INDEX live_identity ON photos(identity) WHERE removed = 0;
CREATE INDEX live_path ON photos(path) WHERE removed = 0;
CREATE INDEX dead_row ON photos(row) WHERE removed = 1;
CREATE TABLE committed (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    rows INTEGER NOT NULL, generation INTEGER NOT NULL, matrix TEXT NOT NULL
);
"""
ADD_SUMS = "ALTER TABLE photos ADD COLUMN sum INTEGER"  # salad 0.1.0 wrote none
INSERT = """
INSERT INTO photos (path, lat, lon, heading, time, identity, row, sum)
VALUES (CAST(? AS TEXT), ?, ?, ?, ?, ?, ?, ?)
"""
UPDATE = """
UPDATE photos SET path = CAST(? AS TEXT), lat = COALESCE(?, lat), lon = COALESCE(?, lon),
    heading = COALESCE(?, heading), time = COALESCE(?, time)
WHERE identity = ? AND removed = 0
"""
REMOVE = """
UPDATE photos SET removed = 1 WHERE removed = 0
AND (path = CAST(:path AS TEXT) OR (path >= CAST(:low AS TEXT) AND path < CAST(:high AS TEXT)))
"""
PHOTO = "row, path, lat, lon, heading, time"  # what `photo` reads

Fields = tuple[bytes, float | None, float | None, float | None, str | None]


def fields(photo: Photo) -> Fields:
    """A photo as `INSERT` and `UPDATE` begin: path, latitude, longitude, heading, time."""
    where = photo.where
    return (
        os.fsencode(photo.path),
        where.lat if where else None,
        where.lon if where else None,
        photo.heading,
        photo.time.isoformat() if photo.time else None,
    )


def photo(row: Sequence[Any]) -> tuple[int, Photo]:
    """The row's number and its photo, from the columns `PHOTO` names.

    What makes no sense there, for the file is damaged, counts as unknown: the photo can still be used.
    """
    number, path, lat, lon, heading, time = row
    name = path if isinstance(path, str) else os.fsdecode(path) if isinstance(path, bytes) else str(path)
    degrees = heading if isinstance(heading, float) else None
    return number, Photo(Path(name), _point(lat, lon), degrees, _moment(time))


def trouble(row: Sequence[Any]) -> str:
    """What of a row makes no sense, if anything: a sentence."""
    _, path, lat, lon, heading, time = row
    read = photo(row)[1]
    wrong = {
        "path": not isinstance(path, str) or "\0" in path,
        "position": (lat, lon) != (None, None) and read.where is None,
        "heading": heading is not None and read.heading is None,
        "time": time is not None and read.time is None,
    }
    named = " and ".join(name for name, bad in wrong.items() if bad)
    return (
        named and f"the {named} of {read.path} in the table is damaged: remove the photo and index it again"
    )


def _point(lat: object, lon: object) -> GeoPoint | None:
    if not isinstance(lat, float) or not isinstance(lon, float):
        return None
    try:
        return GeoPoint(lat, lon)
    except PositionError:
        return None


def _moment(time: object) -> datetime | None:
    if not isinstance(time, str):
        return None
    try:
        return datetime.fromisoformat(time)
    except ValueError:
        return None
