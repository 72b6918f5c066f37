"""One SQLite file, opened: looks that are consistent, changes that happen or do not, errors in a sentence."""

from __future__ import annotations

import os
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from salad.errors import StoreError

_CACHE_KB = 64 << 10  # the tree of contents of a million photos is touched everywhere by an addition


class Database:
    """A connection that threads share, one transaction at a time."""

    def __init__(self, path: Path, *, wait: float) -> None:
        """Open `path`, which must exist; `wait` is how many seconds to wait for another writer."""
        self.path = path
        self._lock = threading.RLock()
        with self._told():
            self._db = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode=rw",
                uri=True,
                timeout=wait,
                isolation_level=None,
                check_same_thread=False,
            )
            self._db.execute("PRAGMA synchronous = FULL")
            self._db.execute(f"PRAGMA cache_size = -{_CACHE_KB}")
        self._db.text_factory = os.fsdecode

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            self._db.close()

    @contextmanager
    def reading(self) -> Iterator[None]:
        """One consistent look: everything read inside belongs to the same commit, and nobody commits meanwhile.

        Inside another look, or a change, it is part of that.
        """
        with self._lock, self._told():
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
        with self._lock, self._told():
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

    def shrink(self) -> None:
        """Give the room of deleted rows back to the disk; outside of a change."""
        with self._lock, self._told():
            self._db.execute("VACUUM")

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn SQLite's errors into a sentence."""
        try:
            yield
        except sqlite3.Error as error:
            raise StoreError(_sentence(self.path, error)) from error


def _sentence(path: Path, error: sqlite3.Error) -> str:
    kind = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the low byte is the kind, the rest its detail
    if kind in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return f"{path.parent} is being written by another program: wait until it is done and try again"
    if kind in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM):
        return f"{path} cannot be opened for this ({error}): check that you may write to its folder"
    if kind in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
        return f"{path} cannot be written ({error}): nothing was changed; make room on the disk and try again"
    return f"{path} is damaged ({error}): restore it, or index the photos again"
