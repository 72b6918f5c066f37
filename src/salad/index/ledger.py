"""`photos.sqlite`: which photos an index holds, and how many rows of its matrix count.

One row a photo. SQLite brings what an index needs and we would get wrong: a commit that happens or does not,
one writer at a time, readers that are not disturbed, locks that die with their process. The connection rolls
back by journal, not by write-ahead log, so that a folder nobody can write to can still be searched.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from salad.errors import StoreError
from salad.geo import GeoPoint
from salad.photos import Photo

NAME = "photos.sqlite"

# Paths are bytes on most systems and need not be text; they are stored as the bytes they are (os.fsencode),
# typed as TEXT so that anyone can read the table.
_SCHEMA = """
CREATE TABLE photos (
    row INTEGER PRIMARY KEY,
    path TEXT NOT NULL,
    identity TEXT NOT NULL,
    lat REAL, lon REAL, heading REAL, time TEXT,
    removed INTEGER NOT NULL DEFAULT 0
);
CREATE UNIQUE INDEX live_identity ON photos(identity) WHERE removed = 0;
CREATE INDEX live_path ON photos(path) WHERE removed = 0;
CREATE INDEX dead_row ON photos(row) WHERE removed = 1;
CREATE TABLE committed (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    rows INTEGER NOT NULL, generation INTEGER NOT NULL, matrix TEXT NOT NULL
);
"""
_INSERT = """
INSERT INTO photos (path, lat, lon, heading, time, identity, row) VALUES (CAST(? AS TEXT), ?, ?, ?, ?, ?, ?)
"""
_UPDATE = """
UPDATE photos SET path = CAST(? AS TEXT), lat = COALESCE(?, lat), lon = COALESCE(?, lon),
    heading = COALESCE(?, heading), time = COALESCE(?, time)
WHERE identity = ? AND removed = 0
"""
_REMOVE = """
UPDATE photos SET removed = 1 WHERE removed = 0
AND (path = CAST(:path AS TEXT) OR (path >= CAST(:low AS TEXT) AND path < CAST(:high AS TEXT)))
"""
_PHOTO = "row, path, lat, lon, heading, time"
_FULL_LENGTH = 1000  # photos fetched at once when all are listed


@dataclass(frozen=True, slots=True)
class Committed:
    """What the last commit said: rows that count, how many commits there were, and the matrix file's name."""

    rows: int
    generation: int
    matrix: str


class Ledger:
    """The table of photos. Every method but the two that open a transaction runs inside one."""

    def __init__(self, path: Path, *, wait: float) -> None:
        """Open `path`; `wait` is how many seconds to wait for another writer."""
        self.path = path
        self._lock = threading.RLock()  # one connection, shared by threads, one transaction at a time
        with self._told():
            self._db = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode=rw",
                uri=True,
                timeout=wait,
                isolation_level=None,
                check_same_thread=False,
            )
            self._db.execute("PRAGMA synchronous = FULL")
        self._db.text_factory = os.fsdecode

    @staticmethod
    def create(path: Path, *, matrix: str) -> None:
        """Make an empty table at `path` for the matrix file named `matrix`."""
        db = sqlite3.connect(path)
        try:
            db.executescript(_SCHEMA)
            db.execute("INSERT INTO committed VALUES (1, 0, 0, ?)", (matrix,))
            db.commit()
        finally:
            db.close()

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            self._db.close()

    @contextmanager
    def reading(self) -> Iterator[None]:
        """One consistent look: everything read inside belongs to the same commit."""
        with self._lock, self._told():
            self._db.execute("BEGIN")
            try:
                yield
            finally:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")

    @contextmanager
    def writing(self) -> Iterator[None]:
        """One change, whole or not at all; the lock is taken at once, so two writers never both begin."""
        with self._lock, self._told():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def committed(self) -> Committed:
        """What the last commit said."""
        row = self._db.execute("SELECT rows, generation, matrix FROM committed").fetchone()
        if row is None:
            raise StoreError(
                f"{self.path} is damaged (no commit in it): restore it, or index the photos again"
            )
        return Committed(*row)

    def commit_rows(self, rows: int) -> None:
        """Say that from this commit on `rows` rows of the matrix count."""
        self._db.execute("UPDATE committed SET rows = ?, generation = generation + 1", (rows,))

    def dead_rows(self) -> list[int]:
        """Rows whose photo was removed, ascending."""
        return [row for (row,) in self._db.execute("SELECT row FROM photos WHERE removed = 1 ORDER BY row")]

    def find(self, identities: Iterable[str]) -> dict[str, Photo]:
        """The live photos with these contents, by content."""
        found = self._db.execute(
            f"SELECT {_PHOTO}, identity FROM photos "
            "WHERE removed = 0 AND identity IN (SELECT value FROM json_each(?))",
            (json.dumps(list(identities)),),
        )
        return {identity: _photo(fields)[1] for *fields, identity in found}

    def at_rows(self, rows: Iterable[int]) -> dict[int, Photo]:
        """The photos of these rows, removed ones too: a search may have begun before a removal."""
        found = self._db.execute(
            f"SELECT {_PHOTO} FROM photos WHERE row IN (SELECT value FROM json_each(?))",
            (json.dumps([int(row) for row in rows]),),
        )
        return dict(_photo(fields) for fields in found)

    def after(self, row: int) -> list[tuple[int, Photo]]:
        """The next live photos behind `row`, at most a thousand, by row."""
        found = self._db.execute(
            f"SELECT {_PHOTO} FROM photos WHERE removed = 0 AND row > ? ORDER BY row LIMIT {_FULL_LENGTH}",
            (row,),
        )
        return [_photo(fields) for fields in found]

    def positions(self) -> list[tuple[float, float]]:
        """Latitude and longitude of every live photo that has them."""
        return self._db.execute(
            "SELECT lat, lon FROM photos WHERE removed = 0 AND lat IS NOT NULL"
        ).fetchall()

    def insert(self, photos: Sequence[Photo], identities: Sequence[str], *, row: int) -> None:
        """Write new photos, the first of them for matrix row `row`."""
        fields = zip(photos, identities, strict=True)
        self._db.executemany(_INSERT, [(*_fields(p), i, row + n) for n, (p, i) in enumerate(fields)])

    def update(self, photos: Sequence[Photo], identities: Sequence[str]) -> None:
        """Give known contents their path and what is newly known of them; the unknown takes nothing away."""
        self._db.executemany(_UPDATE, [(*_fields(p), i) for p, i in zip(photos, identities, strict=True)])

    def retire(self, paths: Iterable[Path], identities: Iterable[str]) -> None:
        """Remove live photos at `paths` whose content is none of `identities`: their file was replaced."""
        current = set(identities)
        for path in paths:
            found = self._db.execute(
                "SELECT row, identity FROM photos WHERE removed = 0 AND path = CAST(? AS TEXT)",
                (os.fsencode(path),),
            ).fetchall()
            stale = [(row,) for row, identity in found if identity not in current]
            self._db.executemany("UPDATE photos SET removed = 1 WHERE row = ?", stale)

    def remove(self, path: Path) -> int:
        """Remove the photo at `path`, or all those below it; how many."""
        below = os.fsencode(path).rstrip(os.sep.encode())
        bounds = {
            "path": os.fsencode(path),
            "low": below + os.sep.encode(),
            "high": below + chr(ord(os.sep) + 1).encode(),
        }
        return self._db.execute(_REMOVE, bounds).rowcount

    def complaints(self) -> list[str]:
        """What is wrong with the table; empty means sound."""
        rows = self.committed().rows
        said = [text for (text,) in self._db.execute("PRAGMA integrity_check") if text != "ok"]
        count, top = self._db.execute("SELECT COUNT(*), COALESCE(MAX(row), -1) FROM photos").fetchone()
        if (count, top) != (rows, rows - 1):
            said.append(f"it lists {count} photos up to row {top}, but {rows} rows were committed")
        return [f"{self.path} is damaged: {text}" for text in said]

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn SQLite's errors into a sentence."""
        try:
            yield
        except sqlite3.Error as error:
            raise StoreError(_sentence(self.path, error)) from error


def _fields(photo: Photo) -> tuple[bytes, float | None, float | None, float | None, str | None]:
    where = photo.where
    return (
        os.fsencode(photo.path),
        where.lat if where else None,
        where.lon if where else None,
        photo.heading,
        photo.time.isoformat() if photo.time else None,
    )


def _photo(fields: Sequence[object]) -> tuple[int, Photo]:
    row, path, lat, lon, heading, time = fields
    assert isinstance(row, int)
    assert isinstance(path, str)
    where = GeoPoint(lat, lon) if isinstance(lat, float) and isinstance(lon, float) else None
    when = datetime.fromisoformat(time) if isinstance(time, str) else None
    return row, Photo(Path(path), where, heading if isinstance(heading, float) else None, when)


def _sentence(path: Path, error: sqlite3.Error) -> str:
    kind = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the low byte is the kind, the rest its detail
    if kind in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return f"{path.parent} is being written by another program: wait until it is done and try again"
    if kind in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM):
        return f"{path} cannot be opened for this ({error}): check that you may write to its folder"
    if kind in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
        return f"{path} cannot be written ({error}): nothing was changed; make room on the disk and try again"
    return f"{path} is damaged ({error}): restore it, or index the photos again"
