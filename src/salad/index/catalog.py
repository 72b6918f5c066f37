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
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salad.errors import StoreError
from salad.images.photo import Photo
from salad.index.database import Database, explaining, shortened
from salad.index.facts import COLUMNS, PLACED, UNKNOWN, Known, columns_of, facts_sum, known_of_row, with_news

# Paths are bytes on most systems and need not be text; they are stored as the bytes they are (os.fsencode),
# typed as TEXT so that anyone can read the table.
SCHEMA = """
CREATE TABLE photos (
    row INTEGER PRIMARY KEY,
    path TEXT NOT NULL,
    identity TEXT NOT NULL,
    lat REAL, lon REAL, heading REAL, time TEXT,
    removed INTEGER NOT NULL DEFAULT 0,
    sum INTEGER, source TEXT, facts INTEGER
);
CREATE UNIQUE INDEX live_identity ON photos(identity) WHERE removed = 0;
CREATE INDEX live_path ON photos(path) WHERE removed = 0;
CREATE INDEX dead_row ON photos(row) WHERE removed = 1;
CREATE TABLE committed (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    rows INTEGER NOT NULL, generation INTEGER NOT NULL, matrix TEXT NOT NULL, dim INTEGER, fingerprint TEXT
);
"""
ADDED = (  # to what earlier versions wrote
    ("photos", "sum", "INTEGER"),  # salad 0.1.0
    *(("photos", "source", "TEXT"), ("photos", "facts", "INTEGER")),  # format 1
    *(("committed", "dim", "INTEGER"), ("committed", "fingerprint", "TEXT")),
)
NEEDED = {
    "photos": {"row", "path", "identity", "lat", "lon", "heading", "time", "removed"},
    "committed": {"id", "rows", "generation", "matrix"},
}
# CAST in this and all statements below: the paths are bound as bytes, which no encoding can refuse.
INSERT = """
INSERT INTO photos (path, lat, lon, heading, time, identity, source, row, sum, facts)
VALUES (CAST(? AS TEXT), ?, ?, ?, ?, ?, ?, ?, ?, ?)
"""
UPDATE = """
UPDATE photos SET path = CAST(? AS TEXT), lat = ?, lon = ?, heading = ?, time = ?, source = ?, facts = ?
WHERE row = ?
"""
REMOVE = "UPDATE photos SET removed = 1, facts = NULL WHERE removed = 0"
BELOW = "(path = CAST(:path AS TEXT) OR (path >= CAST(:low AS TEXT) AND path < CAST(:high AS TEXT)))"
CATALOG_FILE = "photos.sqlite"

_MATRIX = re.compile(r"[^/\\:\0]+\.f16")
_PAGE = 1000  # photos fetched, or paths asked for, at once
_LEAST = 8  # bytes that a row of a table takes, whatever stands in it


@dataclass(frozen=True, slots=True)
class Committed:
    """What the last commit said: rows that count, how many commits there were, and the matrix file's name."""

    rows: int
    generation: int
    matrix: str


class Catalog(Database):
    """The table of photos. Whatever reads or writes it runs inside `reading` or `writing`."""

    def __init__(self, folder: Path, *, wait: float, before_writing: Callable[[Catalog], None] | None = None) -> None:
        """Open the table of the index in `folder`.

        Args:
            folder: The index.
            wait: Seconds to wait for another writer.
            before_writing: What is to be seen to inside of the first change, and may refuse it.

        Raises:
            StoreError: If it is missing, damaged, or not to be trusted.
        """
        self._columns: dict[str, set[str]] = {}
        self._before_writing = before_writing
        super().__init__(folder / CATALOG_FILE, wait=wait)

    @staticmethod
    def create(folder: Path, *, matrix: str, dim: int, fingerprint: str) -> None:
        """Make an empty table in `folder` for the matrix file named `matrix`, with descriptors of `dim` numbers.

        Raises:
            StoreError: If the disk has no room for it.
        """
        path = folder / CATALOG_FILE
        # Which makes the file; `Database` opens what is there.
        with explaining(path), closing(sqlite3.connect(path)) as db:
            db.executescript(SCHEMA)
            db.execute("INSERT INTO committed VALUES (1, 0, 0, ?, ?, ?)", (matrix, dim, fingerprint))
            db.commit()

    @contextmanager
    def writing(self) -> Iterator[None]:
        """One change, whole or not at all."""
        with super().writing():
            if self._before_writing is not None:
                self._before_writing(self)
            yield
        self._before_writing = None  # once it went through

    def has(self, table: str, column: str) -> bool:
        """Whether a table has this column; inside of a look or a change."""
        return column in self._columns[table]

    def is_todays(self) -> bool:
        """Whether the tables have today's form."""
        return all(self.has(table, column) for table, column, _ in ADDED)

    def bring_up_to_date(self, dim: int, fingerprint: str) -> None:
        """Inside of a change: give tables that an earlier version made today's form.

        Args:
            dim: Numbers in a descriptor.
            fingerprint: The model's fingerprint.
        """
        missing = [(table, column, kind) for table, column, kind in ADDED if not self.has(table, column)]
        for table, column, kind in missing:
            self._run(f"ALTER TABLE {table} ADD COLUMN {column} {kind}")
        self._check_schema()
        self._run("UPDATE committed SET dim = ?, fingerprint = ?", (dim, fingerprint))
        if ("photos", "facts", "INTEGER") in missing:  # else a checksum would be written over what is damaged
            self._note_facts()

    def committed(self) -> Committed:
        """What the last commit said.

        Raises:
            StoreError: If there is none, or it makes no sense.
        """
        row = self._run("SELECT rows, generation, matrix FROM committed").fetchone()
        if row is None:
            raise StoreError(f"{self.path} is damaged (no commit in it): restore it, or index the photos again")
        rows, generation, matrix = row
        counts = isinstance(rows, int) and isinstance(generation, int) and rows >= 0 and 0 <= generation < 1 << 53
        # No photo, no row: a damaged number, as large as it may be, must not have us ask for so much memory.
        ((listed,),) = self._run("SELECT COALESCE(MAX(row), -1) + 1 FROM photos").fetchall()
        counts = counts and min(rows, listed) <= os.lstat(self.path).st_size // _LEAST
        # A name with a folder in it, or of another file, would have us write where we must not.
        if not counts or not isinstance(matrix, str) or not _MATRIX.fullmatch(matrix):
            raise StoreError(
                f"{self.path} is damaged (its commit says {shortened(row)}): restore it, or index the photos again"
            )
        return Committed(min(rows, listed), generation, matrix)

    def made_with(self) -> tuple[int, str] | None:
        """Numbers in a descriptor and the model's fingerprint, as the table has them; None where format 1 did not."""
        if not self.has("committed", "dim"):
            return None
        ((dim, fingerprint),) = self._run("SELECT dim, fingerprint FROM committed").fetchall() or [(None, None)]
        return dim, fingerprint

    def commit_rows(self, rows: int, *, matrix: str | None = None) -> None:
        """Say that from this commit on `rows` rows count, of the matrix file named `matrix` if it is another."""
        self._run(
            "UPDATE committed SET rows = ?, generation = generation + 1, matrix = COALESCE(?, matrix)",
            (rows, matrix),
        )

    def contradiction(self) -> str:
        """Where the rows that the table lists are not those that were committed: how so."""
        ((count, first, top, rows),) = self._run(
            "SELECT COUNT(*), COALESCE(MIN(row), 0), COALESCE(MAX(row), -1), (SELECT rows FROM committed) FROM photos"
        ).fetchall()
        if (count, first, top) == (rows, 0, rows - 1):
            return ""
        return f"it lists {count} photos up to row {top}, but {rows} rows were committed"

    def dead_rows(self) -> npt.NDArray[np.int64]:
        """Rows that count and whose photo was removed, ascending."""
        rows = self.committed().rows
        found = self._run("SELECT row FROM photos WHERE removed = 1 AND row BETWEEN 0 AND ? ORDER BY row", (rows - 1,))
        return np.fromiter((row for (row,) in found), dtype=np.int64)

    def live_rows(self, *, start: int = 0) -> npt.NDArray[np.int64]:
        """Rows from `start` on whose photo can be found, ascending."""
        found = self._run("SELECT row FROM photos WHERE removed = 0 AND row >= ? ORDER BY row", (start,))
        return np.fromiter((row for (row,) in found), dtype=np.int64)

    def count(self, *, start: int = 0) -> int:
        """How many photos can be found, from row `start` on."""
        found = self._run("SELECT COUNT(*) FROM photos WHERE removed = 0 AND row >= ?", (start,))
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
            self._run(
                "SELECT identity, row FROM photos WHERE removed = 0 AND identity IN (SELECT value FROM json_each(?))",
                (json.dumps(list(identities)),),
            ).fetchall()
        )

    def positions(self) -> npt.NDArray[np.float64]:
        """Latitude and longitude of every live photo that has them: `[N, 2]`."""
        found = self._run(f"SELECT lat, lon FROM photos WHERE removed = 0 AND {PLACED}")
        pairs = np.fromiter(found, dtype=[("lat", np.float64), ("lon", np.float64)])
        return pairs.view(np.float64).reshape(-1, 2)

    def at_null_island(self) -> int:
        """How many live photos an earlier version wrote down at 0,0, which counts as no position."""
        found = self._run("SELECT COUNT(*) FROM photos WHERE removed = 0 AND lat = 0 AND lon = 0")
        return int(found.fetchone()[0])

    def find(self, identities: Iterable[str]) -> dict[str, Photo]:
        """The live photos with these contents, by content."""
        return {known.identity: known.photo for known in self._found(identities)}

    def at_rows(self, rows: Iterable[int]) -> dict[int, Known]:
        """What is known of these rows, removed ones too: a search may have begun before a removal."""
        numbers = json.dumps([int(row) for row in rows])
        found = self._known("row IN (SELECT value FROM json_each(?))", (numbers,))
        return {known.row: known for known in found}

    def photos_at(self, rows: Iterable[int], *, vectors: str) -> dict[int, Known] | None:
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
            found += self._run(
                f"SELECT row, path, identity FROM photos WHERE removed = 0 AND path IN ({marks}) AND row < ?",
                (*some, 1 << 62 if below is None else below),
            )
        return [(row, Path(path), identity) for row, path, identity in found]

    def after(self, row: int, *, removed: bool = False) -> list[Known]:
        """The next live photos behind `row`, at most a thousand, by row; the removed ones too where asked for."""
        condition = "row > ?" if removed else "removed = 0 AND row > ?"
        found = list(self._known(f"{condition} ORDER BY row LIMIT {_PAGE}", (row,)))
        self._check_order([row, *(known.row for known in found)])
        return found

    def insert(self, photos: Sequence[Photo], identities: Sequence[str], sums: Sequence[int], *, row: int) -> None:
        """Write new photos with the checksums of their descriptors, the first of them for matrix row `row`."""
        told = [(*columns_of(p), i, p.source) for p, i in zip(photos, identities, strict=True)]
        rows = ((*t, row + n, s, facts_sum(t)) for n, (t, s) in enumerate(zip(told, sums, strict=True)))
        self._run_many(INSERT, rows)

    def update(self, photos: Sequence[Photo], identities: Sequence[str]) -> None:
        """Give known contents their path and what is newly known of them; the unknown takes nothing away."""
        held = {known.identity: known for known in self._found(identities)}
        for photo, identity in zip(photos, identities, strict=True):
            if known := held.get(identity):
                held[identity] = known._replace(photo=with_news(known.photo, photo))
        rows = ((columns_of(k.photo), k.photo.source, k.identity, k.row) for k in held.values())
        self._run_many(UPDATE, ((*told, s, facts_sum((*told, i, s)), row) for told, s, i, row in rows))

    def retire(self, paths: Iterable[Path], identities: Iterable[str], *, below: int | None = None) -> None:
        """Remove live photos at `paths` whose content is none of `identities`: their file was replaced.

        Only those before row `below` are looked at, where it is given.
        """
        current = set(identities)
        stale = [(row,) for row, _, held in self.at_paths(paths, below=below) if held not in current]
        self._run_many(f"{REMOVE} AND row = ?", stale)

    def remove(self, path: Path) -> int:
        """Remove the photo at `path`, or all those below it; how many."""
        return self._run(f"{REMOVE} AND {BELOW}", _bounds(path)).rowcount

    def count_below(self, path: Path) -> int:
        """How many photos can be found at `path`, or below it."""
        found = self._run(f"SELECT COUNT(*) FROM photos WHERE removed = 0 AND {BELOW}", _bounds(path))
        return int(found.fetchone()[0])

    def renumber(self, rows: npt.NDArray[np.int64], sums: npt.NDArray[np.int64]) -> None:
        """Keep the photos of `rows`, ascending, forget all others, and number them from 0 in their order.

        Args:
            rows: `[N]`, of live photos.
            sums: `[N]`, checksums of their descriptors.
        """
        kept = set(rows.tolist())
        others = [(row,) for (row,) in self._run("SELECT row FROM photos") if row not in kept]
        self._run_many("DELETE FROM photos WHERE row = ?", others)
        numbers = np.arange(len(rows))
        news = (numbers != rows) | (self.sums()[rows] != sums)
        # One after the other, upwards: each moves down into a place that is free by then.
        moves = zip(numbers[news].tolist(), sums[news].tolist(), rows[news].tolist(), strict=True)
        self._run_many("UPDATE photos SET row = ?, sum = ? WHERE row = ?", moves)

    def _note_facts(self) -> None:
        """Write the checksums of all photos as they are, whatever is damaged in them already."""
        sql = f"SELECT {COLUMNS} FROM photos WHERE removed = 0 AND row > ? ORDER BY row LIMIT {_PAGE}"
        last = -1
        while page := self._run(sql, (last,)).fetchall():
            noted = [(facts_sum(told), row) for row, *told, _, _ in page]
            self._run_many("UPDATE photos SET facts = ? WHERE row = ?", noted)
            self._check_order([last, *(row for row, *_ in page)])
            ((last, *_),) = page[-1:]

    def _check_order(self, rows: Sequence[int]) -> None:
        """Whoever goes through rows that are out of order would never come to an end."""
        if any(behind <= before for before, behind in pairwise(rows)):
            raise StoreError(
                f"{self.path} is damaged (its rows are out of order): restore it, or index the photos again"
            )

    def _found(self, identities: Iterable[str]) -> Iterator[Known]:
        condition = "removed = 0 AND identity IN (SELECT value FROM json_each(?))"
        return self._known(condition, (json.dumps(list(identities)),))

    def _known(self, condition: str, given: Sequence[Any]) -> Iterator[Known]:
        """What is known of the rows that a condition of SQL lets through."""
        columns = (
            COLUMNS
            if self.has("photos", "facts")
            else COLUMNS.replace("source, removed, facts", f"NULL, removed, {UNKNOWN}")
        )
        found = self._run(f"SELECT {columns} FROM photos WHERE {condition}", given).fetchall()
        return map(known_of_row, found)

    def _sums(self, rows: npt.NDArray[np.int64], condition: str, given: object) -> npt.NDArray[np.int64]:
        """The checksums of `rows`, ascending, which a condition of SQL says too."""
        noted = np.full(len(rows), UNKNOWN, dtype=np.int64)
        if self.has("photos", "sum"):  # salad 0.1.0 wrote none
            sql = f"SELECT row, CAST(sum AS INTEGER) FROM photos WHERE sum IS NOT NULL AND {condition}"
            pairs = np.fromiter(self._run(sql, (given,)), dtype=[("row", np.int64), ("sum", np.int64)])
            noted[np.searchsorted(rows, pairs["row"])] = pairs["sum"]
        return noted

    def _check_tables(self) -> None:
        for table, needed in NEEDED.items():
            columns = self._run(f"PRAGMA table_xinfo({table})").fetchall()
            self._columns[table] = {name for _, name, *_ in columns}
            keys = [(name, str(kind).upper()) for _, name, kind, _, _, key, _ in columns if key]
            # An integer that is the key is the row's own number: else it may hold anything.
            if not needed <= self._columns[table] or keys not in ([("row", "INTEGER")], [("id", "INTEGER")]):
                raise StoreError(
                    f"{self.path} is damaged (its table {table} is not one of an index): restore it, or index the "
                    "photos again"
                )
        self._run("SELECT rowid FROM photos LIMIT 0")


def _bounds(path: Path) -> dict[str, bytes]:
    """What `BELOW` wants to know.

    All paths below a folder lie between it with a separator behind, and with the character after that: so the table's
    order of paths finds them, and no pattern must be escaped.
    """
    below = os.fsencode(path).rstrip(os.sep.encode())
    return {
        "path": os.fsencode(path),
        "low": below + os.sep.encode(),
        "high": below + chr(ord(os.sep) + 1).encode(),
    }
