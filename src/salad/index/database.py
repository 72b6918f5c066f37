"""SQLite, opened as a file that somebody else may have made, and shared by threads.

SQLite does more to files than read them: a journal beside the table is rolled back, and one that names a
super-journal has that file deleted, whatever it is. So everything beside the table is looked at before SQLite is
asked, and again before each look and change. Nothing in a table may run: triggers, views, virtual tables and
generated columns are refused, and no statement runs for ever.
"""

from __future__ import annotations

import os
import sqlite3
import stat
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

from salad.errors import StoreError
from salad.files import open_file

_WAYS_OUT = "restore it, or index the photos again"
_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_CACHE_KB = 64 << 10  # the tree of contents of a million photos is touched everywhere by an addition
_SECONDS, _BYTES_A_SECOND = 20.0, 1 << 20  # that a statement may take, and what a slow disk gives
_QUOTED = 200  # letters of what a file holds that a sentence repeats
_STEPS = 100_000  # of SQLite's machine between two looks at the clock
_LIMITS = {  # what no table of ours comes near; a new one is built beside the old by VACUUM, hence one attached
    sqlite3.SQLITE_LIMIT_LENGTH: 1 << 28,
    sqlite3.SQLITE_LIMIT_SQL_LENGTH: 1 << 20,
    sqlite3.SQLITE_LIMIT_ATTACHED: 1,
    sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH: 1,
}


class Database:
    """A connection that threads share, one transaction at a time."""

    def __init__(self, path: Path, *, wait: float) -> None:
        """Open `path`, which must exist; `wait` is how many seconds to wait for another writer.

        Raises:
            StoreError: If it is no regular file or no database, or something beside it would have SQLite touch more
                than this file.
        """
        self.path = path
        self._lock = threading.RLock()
        self._schema = -1  # version of the schema that was found harmless
        self._seconds = wait + _SECONDS
        self._until = 0.0
        before = self._look()
        with explaining(path):
            self._db = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode=rw",
                uri=True,
                timeout=wait,
                isolation_level=None,  # Python's module begins no transactions of its own
                check_same_thread=False,  # the lock sees to that
            )
        try:
            self._db.set_progress_handler(self._is_late, _STEPS)
            with self._explaining():
                self._settle()
            self._check_same(before)
        except BaseException:
            self._db.close()
            raise

    def _check_same(self, before: os.stat_result) -> None:
        """SQLite opens by name: see that nobody has put another file there meanwhile."""
        after = self._look()
        if (before.st_dev, before.st_ino) != (after.st_dev, after.st_ino):
            raise StoreError(f"{self.path} was put in place of another while it was opened: try again")

    def _settle(self) -> None:
        """As SQLite advises for files of strangers (sqlite.org/security.html), and as we want it."""
        for number, most in _LIMITS.items():
            self._db.setlimit(number, most)
        ((mode,),) = self._run("PRAGMA journal_mode").fetchall()
        if mode == "wal":
            raise StoreError(f"{self.path} wants a write-ahead log, which we never write: {_WAYS_OUT}")
        if sys.version_info >= (3, 12):
            self._db.setconfig(sqlite3.SQLITE_DBCONFIG_DEFENSIVE, True)
        for setting in (
            "trusted_schema = OFF",
            "cell_size_check = ON",
            "mmap_size = 0",  # a file cut short under a map kills the process
            "synchronous = FULL",  # a commit that returned survives a power cut
            f"cache_size = -{_CACHE_KB}",
        ):
            self._run(f"PRAGMA {setting}")
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
            self._look()
            try:  # around BEGIN too: an interrupt may come right behind it
                self._run("BEGIN")
                self._check_schema()
                yield
            finally:
                if self._db.in_transaction:
                    self._run("ROLLBACK")

    @contextmanager
    def writing(self) -> Iterator[None]:
        """One change, whole or not at all; the lock is taken at once, so two writers never both begin."""
        with self._lock, self._explaining():
            if self._db.in_transaction:  # what an interrupt cut short: nothing else comes before a change
                self._run("ROLLBACK")
            if self._look().st_nlink > 1:
                raise StoreError(
                    f"{self.path} is a hard link, and what else is linked to it would change too: copy the folder, and "
                    "write to the copy"
                )
            try:
                self._run("BEGIN IMMEDIATE")
                self._check_schema()
                yield
                self._run("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._run("ROLLBACK")
                raise

    def select(self, sql: str, parameters: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """What a query finds; part of the look or change it is asked in, else a look of its own."""
        with self.reading():
            return self._run(sql, parameters).fetchall()

    def change(self, sql: str, parameters: Sequence[Any] = ()) -> int:
        """Run a statement of a change that somebody else began; the number of the row it inserted last."""
        return self._run(sql, parameters).lastrowid or 0

    def shrink(self) -> None:
        """Give the room of deleted rows back to the disk; outside of a change."""
        with self._lock, self._explaining():
            self._look()
            self._run("VACUUM")

    def _run(self, sql: str, parameters: Sequence[Any] | dict[str, Any] = ()) -> sqlite3.Cursor:
        """Have SQLite run a statement, in the time that its file is worth."""
        self._until = monotonic() + self._seconds
        return self._db.execute(sql, parameters)

    def _run_many(self, sql: str, each: Iterator[Sequence[Any]] | Sequence[Sequence[Any]]) -> None:
        self._until = monotonic() + self._seconds
        self._db.executemany(sql, each)

    def _is_late(self) -> bool:
        return monotonic() > self._until

    def _look(self) -> os.stat_result:
        """See that SQLite will find a file of ours, and nothing beside it that would have it touch another.

        Raises:
            StoreError: If not.
        """
        foreign = f"{self.path.parent} is not to be trusted as it is"
        try:
            status = os.lstat(
                self.path
            )  # never opened: to close it would take SQLite's locks away, all over the process
        except OSError as error:
            raise StoreError(f"{self.path} cannot be opened ({error.strerror}): {_WAYS_OUT}") from error
        if not stat.S_ISREG(status.st_mode):
            raise StoreError(f"{self.path} cannot be opened (it is a link, or no regular file): {_WAYS_OUT}")
        self._seconds = max(self._seconds, _SECONDS + status.st_size / _BYTES_A_SECOND)
        beside = {ending: self.path.with_name(self.path.name + ending) for ending in ("-wal", "-shm", "-journal")}
        for ending in ("-wal", "-shm"):
            if os.path.lexists(beside[ending]):
                raise StoreError(f"{foreign} ({beside[ending]} is not ours): delete that file if you trust the rest")
        try:
            with open_file(beside["-journal"], follow=False) as journal:
                length, names = os.fstat(journal.fileno()).st_size, os.fstat(journal.fileno()).st_nlink
                if names > 1:  # SQLite would write its own into it
                    raise StoreError(
                        f"{foreign} ({beside['-journal']} is a hard link): delete it if you trust the rest"
                    )
                journal.seek(max(0, length - len(_JOURNAL_MAGIC)))
                # So ends a journal that names a super-journal, which SQLite would delete; ours names none.
                if length >= 16 and journal.read(len(_JOURNAL_MAGIC)) == _JOURNAL_MAGIC:
                    raise StoreError(
                        f"{foreign} ({beside['-journal']} would have another file deleted): delete that file if you "
                        "trust the rest"
                    )
        except FileNotFoundError:
            pass
        except OSError as error:
            raise StoreError(
                f"{foreign} ({beside['-journal']} cannot be read: {error.strerror}): delete it if you trust the rest"
            ) from error
        return status

    def _check_schema(self) -> None:
        """Inside of a look: see that nothing in the table runs by itself; once for each version of its schema.

        Raises:
            StoreError: If something does.
        """
        ((version,),) = self._run("PRAGMA schema_version").fetchall()
        if version == self._schema:
            return
        foreign = f"{self.path} is not to be trusted"
        for kind, name, sql in self._run("SELECT type, name, sql FROM sqlite_master").fetchall():
            if kind not in ("table", "index"):
                raise StoreError(f"{foreign} (it holds the {kind} {shortened(name)}, and we write none): restore it")
            if kind == "table" and str(sql).upper().startswith("CREATE VIRTUAL"):
                raise StoreError(
                    f"{foreign} (it holds the virtual table {shortened(name)}, and we write none): restore it"
                )
            if kind == "table":
                quoted = str(name).replace('"', '""')
                columns = self._run(f'PRAGMA table_xinfo("{quoted}")').fetchall()
                if any(hidden for *_, hidden in columns):
                    raise StoreError(
                        f"{foreign} ({shortened(name)} has columns that are computed, and we write none): restore it"
                    )
        self._check_tables()
        self._schema = version

    def _check_tables(self) -> None:
        """See that the tables are there that we need; whoever needs some says which."""

    @contextmanager
    def _explaining(self) -> Iterator[None]:
        """Turn SQLite's errors into a sentence."""
        with explaining(self.path):
            try:
                yield
            except sqlite3.OperationalError as error:
                # A signal that comes while the clock is looked at stops the statement, and Python keeps it to itself.
                if error.sqlite_errorcode == sqlite3.SQLITE_INTERRUPT and not self._is_late():
                    raise KeyboardInterrupt from error
                raise


def shortened(value: object) -> str:
    """A value that a stranger wrote, as a sentence may quote it."""
    text = str(value)
    return text if len(text) <= _QUOTED else f"{text[:_QUOTED]}..."


@contextmanager
def explaining(path: Path) -> Iterator[None]:
    """Turn SQLite's errors about `path` into a sentence.

    Raises:
        StoreError: In place of what SQLite raises.
    """
    try:
        yield
    # Of a damaged file SQLite quotes what it read there, and Python fails to read that as text.
    except (sqlite3.Error, UnicodeDecodeError) as error:
        kind = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the low byte; the rest is its detail
        if kind in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            text = f"{path.parent} is being written by another program: wait until it is done and try again"
        elif kind in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM):
            text = f"{path} cannot be opened for this ({error}): check that you may write to its folder"
        elif kind in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
            text = f"{path} cannot be written ({error}): nothing was changed; make room on the disk and try again"
        elif kind == sqlite3.SQLITE_INTERRUPT:
            text = f"{path} takes far too long to read, so it is damaged: {_WAYS_OUT}"
        else:
            text = f"{path} is damaged ({shortened(error)}): {_WAYS_OUT}"
        raise StoreError(text) from error
