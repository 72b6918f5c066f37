"""`photos.sqlite`: which photos an index holds, and how many rows of its matrix count.

One row a photo. SQLite brings what an index needs and we would get wrong: a commit that happens or does not,
one writer at a time, readers that are not disturbed, locks that die with their process. The connection rolls
back by journal, not by write-ahead log, so that a folder nobody can write to can still be searched.
"""

from __future__ import annotations

import json
import os
import re
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salad.errors import PositionError, StoreError
from salad.geo import GeoPoint
from salad.images.photo import Photo

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
# CAST in this and all statements below: the paths are bound as bytes, which no encoding can refuse.
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
PHOTO = "row, path, lat, lon, heading, time"  # what `photo_of_row` reads
CATALOG_FILE = "photos.sqlite"
UNKNOWN = -1  # in place of a checksum that was never written

_MATRIX = re.compile(r"[^/\\:\0]+\.f16")
_PAGE = 1000  # photos fetched, or paths asked for, at once
_CACHE_KB = 64 << 10  # the tree of contents of a million photos is touched everywhere by an addition


def row_of_photo(photo: Photo) -> tuple[Any, ...]:
    """A photo as `INSERT` and `UPDATE` begin: path, latitude, longitude, heading, time."""
    path, *known = photo.as_dict().values()
    return os.fsencode(path), *known


def photo_of_row(row: Sequence[Any]) -> tuple[int, Photo]:
    """The row's number and its photo, from the columns `PHOTO` names.

    What makes no sense there, for the file is damaged, counts as unknown: the photo can still be used.
    """
    number, path, lat, lon, heading, time = row
    name = path if isinstance(path, str) else os.fsdecode(path) if isinstance(path, bytes) else str(path)
    where = taken = None
    if isinstance(lat, float) and isinstance(lon, float):
        with suppress(PositionError):
            where = GeoPoint(lat, lon)
    if isinstance(time, str):
        with suppress(ValueError):
            taken = datetime.fromisoformat(time)
    return number, Photo(Path(name), where, heading if isinstance(heading, float) else None, taken)


def row_trouble(row: Sequence[Any]) -> str:
    """What of a row makes no sense, if anything: a sentence."""
    _, path, lat, lon, heading, time = row
    read = photo_of_row(row)[1]
    wrong = {
        "path": not isinstance(path, str) or "\0" in path,
        "position": (lat, lon) != (None, None) and read.where is None,
        "heading": heading is not None and read.heading is None,
        "time": time is not None and read.time is None,
    }
    named = " and ".join(name for name, bad in wrong.items() if bad)
    return named and f"the {named} of {read.path} in the table is damaged: remove the photo and index it again"


class Database:
    """A connection that threads share, one transaction at a time."""

    def __init__(self, path: Path, *, wait: float) -> None:
        """Open `path`, which must exist; `wait` is how many seconds to wait for another writer."""
        self.path = path
        self._lock = threading.RLock()
        with self._explaining():
            self._db = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode=rw",
                uri=True,
                timeout=wait,
                isolation_level=None,  # Python's module begins no transactions of its own
                check_same_thread=False,  # the lock sees to that
            )
            self._db.execute("PRAGMA synchronous = FULL")  # a commit that returned survives a power cut
            self._db.execute(f"PRAGMA cache_size = -{_CACHE_KB}")
        self._db.text_factory = os.fsdecode  # a path need not be UTF-8, and comes back as it was

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            self._db.close()

    @contextmanager
    def reading(self) -> Iterator[None]:
        """One consistent look: everything read inside belongs to the same commit, and nobody commits meanwhile.

        Inside another look, or a change, it is part of that.
        """
        with self._lock, self._explaining():
            if self._db.in_transaction:
                yield
                return
            try:  # around BEGIN too: an interrupt may come right behind it
                self._db.execute("BEGIN")
                yield
            finally:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")

    @contextmanager
    def writing(self) -> Iterator[None]:
        """One change, whole or not at all; the lock is taken at once, so two writers never both begin."""
        with self._lock, self._explaining():
            if self._db.in_transaction:  # what an interrupt cut short: nothing else comes before a change
                self._db.execute("ROLLBACK")
            try:
                self._db.execute("BEGIN IMMEDIATE")
                yield
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def select(self, sql: str, parameters: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """What a query finds; part of the look or change it is asked in, else a look of its own."""
        with self.reading():
            return self._db.execute(sql, parameters).fetchall()

    def change(self, sql: str, parameters: Sequence[Any] = ()) -> int:
        """Run a statement of a change that somebody else began; the number of the row it inserted last."""
        return self._db.execute(sql, parameters).lastrowid or 0

    def shrink(self) -> None:
        """Give the room of deleted rows back to the disk; outside of a change."""
        with self._lock, self._explaining():
            self._db.execute("VACUUM")

    @contextmanager
    def _explaining(self) -> Iterator[None]:
        """Turn SQLite's errors into a sentence."""
        try:
            yield
        # Of a damaged file SQLite quotes what it read there, and Python fails to read that as text.
        except (sqlite3.Error, UnicodeDecodeError) as error:
            kind = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the low byte; the rest is its detail
            if kind in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                text = f"{self.path.parent} is being written by another program: wait until it is done and try again"
            elif kind in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM):
                text = f"{self.path} cannot be opened for this ({error}): check that you may write to its folder"
            elif kind in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
                text = (
                    f"{self.path} cannot be written ({error}): nothing was changed; make room on the disk and try again"
                )
            else:
                text = f"{self.path} is damaged ({error}): restore it, or index the photos again"
            raise StoreError(text) from error


@dataclass(frozen=True, slots=True)
class Committed:
    """What the last commit said: rows that count, how many commits there were, and the matrix file's name."""

    rows: int
    generation: int
    matrix: str


class Catalog(Database):
    """The table of photos. Whatever reads or writes it runs inside `reading` or `writing`."""

    @staticmethod
    def create(path: Path, *, matrix: str) -> None:
        """Make an empty table at `path` for the matrix file named `matrix`."""
        db = sqlite3.connect(path)  # which makes the file; `Database` opens what is there
        try:
            db.executescript(SCHEMA)
            db.execute("INSERT INTO committed VALUES (1, 0, 0, ?)", (matrix,))
            db.commit()
        finally:
            db.close()

    def committed(self) -> Committed:
        """What the last commit said.

        Raises:
            StoreError: If there is none, or it makes no sense.
        """
        row = self._db.execute("SELECT rows, generation, matrix FROM committed").fetchone()
        if row is None:
            raise StoreError(f"{self.path} is damaged (no commit in it): restore it, or index the photos again")
        rows, generation, matrix = row
        counts = isinstance(rows, int) and isinstance(generation, int) and rows >= 0
        # A name with a folder in it, or of another file, would have us write where we must not.
        if not counts or not isinstance(matrix, str) or not _MATRIX.fullmatch(matrix):
            raise StoreError(f"{self.path} is damaged (its commit says {row}): restore it, or index the photos again")
        # No photo, no row: a damaged number, as large as it may be, must not have us ask for so much memory.
        (listed,) = self._db.execute("SELECT COALESCE(MAX(row), -1) + 1 FROM photos").fetchone()
        return Committed(min(rows, listed), generation, matrix)

    def commit_rows(self, rows: int, *, matrix: str | None = None) -> None:
        """Say that from this commit on `rows` rows count, of the matrix file named `matrix` if it is another."""
        self._db.execute(
            "UPDATE committed SET rows = ?, generation = generation + 1, matrix = COALESCE(?, matrix)",
            (rows, matrix),
        )

    def dead_rows(self) -> npt.NDArray[np.int64]:
        """Rows that count and whose photo was removed, ascending."""
        rows = self.committed().rows
        found = self._db.execute(
            "SELECT row FROM photos WHERE removed = 1 AND row BETWEEN 0 AND ? ORDER BY row", (rows - 1,)
        )
        return np.fromiter((row for (row,) in found), dtype=np.int64)

    def live_rows(self, *, start: int = 0) -> npt.NDArray[np.int64]:
        """Rows from `start` on whose photo can be found, ascending."""
        found = self._db.execute("SELECT row FROM photos WHERE removed = 0 AND row >= ? ORDER BY row", (start,))
        return np.fromiter((row for (row,) in found), dtype=np.int64)

    def count(self, *, start: int = 0) -> int:
        """How many photos can be found, from row `start` on."""
        found = self._db.execute("SELECT COUNT(*) FROM photos WHERE removed = 0 AND row >= ?", (start,))
        return int(found.fetchone()[0])

    def sums(self) -> npt.NDArray[np.int64]:
        """The checksum of each row that counts, `UNKNOWN` where none was written: `[rows]`."""
        rows = self.committed().rows
        return self._sums(np.arange(rows), "row BETWEEN 0 AND ?", rows - 1)

    def sums_at(self, rows: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """The checksums of `rows`, which ascend, `UNKNOWN` where none was written: `[len(rows)]`."""
        return self._sums(rows, "row IN (SELECT value FROM json_each(?))", json.dumps(rows.tolist()))

    def rows_of(self, identities: Iterable[str]) -> dict[str, int]:
        """The rows of the live photos with these contents, by content."""
        return dict(
            self._db.execute(
                "SELECT identity, row FROM photos WHERE removed = 0 AND identity IN (SELECT value FROM json_each(?))",
                (json.dumps(list(identities)),),
            ).fetchall()
        )

    def positions(self) -> npt.NDArray[np.float64]:
        """Latitude and longitude of every live photo that has them: `[N, 2]`."""
        found = self._db.execute(
            "SELECT CAST(lat AS REAL), CAST(lon AS REAL) FROM photos "
            "WHERE removed = 0 AND lat IS NOT NULL AND lon IS NOT NULL"
        )
        pairs = np.fromiter(found, dtype=[("lat", np.float64), ("lon", np.float64)])
        return pairs.view(np.float64).reshape(-1, 2)

    def find(self, identities: Iterable[str]) -> dict[str, Photo]:
        """The live photos with these contents, by content."""
        found = self._db.execute(
            f"SELECT {PHOTO}, identity FROM photos WHERE removed = 0 AND identity IN (SELECT value FROM json_each(?))",
            (json.dumps(list(identities)),),
        )
        return {identity: photo_of_row(fields)[1] for *fields, identity in found}

    def at_rows(self, rows: Iterable[int]) -> dict[int, tuple[Photo, str]]:
        """Photo and content of these rows, removed ones too: a search may have begun before a removal."""
        found = self._db.execute(
            f"SELECT {PHOTO}, identity FROM photos WHERE row IN (SELECT value FROM json_each(?))",
            (json.dumps([int(row) for row in rows]),),
        )
        return {fields[0]: (photo_of_row(fields)[1], identity) for *fields, identity in found}

    def photos_at(self, rows: Iterable[int], *, vectors: str) -> dict[int, tuple[Photo, str]] | None:
        """The same of rows of the file of descriptors named `vectors`; None where a compaction came since."""
        with self.reading():
            return self.at_rows(rows) if self.committed().matrix == vectors else None

    def at_paths(self, paths: Iterable[Path], *, below: int | None = None) -> list[tuple[int, Path, str]]:
        """Row, path and content of the live photos at these paths, of those before row `below` where given."""
        wanted = list(map(os.fsencode, paths))  # bytes, which json_each could not take: hence marks, in parts
        found: list[tuple[int, str, str]] = []
        for low in range(0, len(wanted), _PAGE):
            some = wanted[low : low + _PAGE]
            marks = ",".join(["CAST(? AS TEXT)"] * len(some))
            found += self._db.execute(
                f"SELECT row, path, identity FROM photos WHERE removed = 0 AND path IN ({marks}) AND row < ?",
                (*some, 1 << 62 if below is None else below),
            )
        return [(row, Path(path), identity) for row, path, identity in found]

    def after(self, row: int) -> list[tuple[int, Photo, str]]:
        """The next live photos behind `row` with their contents, at most a thousand, by row."""
        found = self._db.execute(
            f"SELECT {PHOTO}, identity FROM photos WHERE removed = 0 AND row > ? ORDER BY row LIMIT {_PAGE}",
            (row,),
        )
        return [(*photo_of_row(fields), identity) for *fields, identity in found]

    def insert(self, photos: Sequence[Photo], identities: Sequence[str], sums: Sequence[int], *, row: int) -> None:
        """Write new photos with the checksums of their descriptors, the first of them for matrix row `row`."""
        self._need_sums()
        given = zip(photos, identities, sums, strict=True)
        self._db.executemany(INSERT, ((*row_of_photo(p), i, row + n, s) for n, (p, i, s) in enumerate(given)))

    def update(self, photos: Sequence[Photo], identities: Sequence[str]) -> None:
        """Give known contents their path and what is newly known of them; the unknown takes nothing away."""
        given = zip(photos, identities, strict=True)
        self._db.executemany(UPDATE, [(*row_of_photo(photo), i) for photo, i in given])

    def retire(self, paths: Iterable[Path], identities: Iterable[str], *, below: int | None = None) -> None:
        """Remove live photos at `paths` whose content is none of `identities`: their file was replaced.

        Only those before row `below` are looked at, where it is given.
        """
        current = set(identities)
        stale = [(row,) for row, _, held in self.at_paths(paths, below=below) if held not in current]
        self._db.executemany("UPDATE photos SET removed = 1 WHERE row = ?", stale)

    def remove(self, path: Path) -> int:
        """Remove the photo at `path`, or all those below it; how many."""
        # All paths below a folder lie between it with a separator behind, and with the character after that: so the
        # table's order of paths finds them, and no pattern must be escaped.
        below = os.fsencode(path).rstrip(os.sep.encode())
        bounds = {
            "path": os.fsencode(path),
            "low": below + os.sep.encode(),
            "high": below + chr(ord(os.sep) + 1).encode(),
        }
        return self._db.execute(REMOVE, bounds).rowcount

    def renumber(self, rows: npt.NDArray[np.int64], sums: npt.NDArray[np.int64]) -> None:
        """Keep the photos of `rows`, ascending, forget all others, and number them from 0 in their order.

        Args:
            rows: `[N]`, of live photos.
            sums: `[N]`, checksums of their descriptors.
        """
        self._need_sums()
        kept = set(rows.tolist())
        others = [(row,) for (row,) in self._db.execute("SELECT row FROM photos") if row not in kept]
        self._db.executemany("DELETE FROM photos WHERE row = ?", others)
        numbers = np.arange(len(rows))
        news = (numbers != rows) | (self.sums()[rows] != sums)
        # One after the other, upwards: each moves down into a place that is free by then.
        moves = zip(numbers[news].tolist(), sums[news].tolist(), rows[news].tolist(), strict=True)
        self._db.executemany("UPDATE photos SET row = ?, sum = ? WHERE row = ?", moves)

    def _sums(self, rows: npt.NDArray[np.int64], condition: str, given: object) -> npt.NDArray[np.int64]:
        """The checksums of `rows`, ascending, which a condition of SQL says too."""
        noted = np.full(len(rows), UNKNOWN, dtype=np.int64)
        if self._has_sums():  # salad 0.1.0 wrote none
            sql = f"SELECT row, CAST(sum AS INTEGER) FROM photos WHERE sum IS NOT NULL AND {condition}"
            pairs = np.fromiter(self._db.execute(sql, (given,)), dtype=[("row", np.int64), ("sum", np.int64)])
            noted[np.searchsorted(rows, pairs["row"])] = pairs["sum"]
        return noted

    def _has_sums(self) -> bool:
        return "sum" in [name for _, name, *_ in self._db.execute("PRAGMA table_info(photos)")]

    def _need_sums(self) -> None:
        """An index of salad 0.1.0 has no column for checksums: whoever writes adds it."""
        if not self._has_sums():
            self._db.execute(ADD_SUMS)
