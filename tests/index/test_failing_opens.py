"""An index that cannot be opened leaves nothing open: no connection, no file, however often it is tried."""

from __future__ import annotations

import gc
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from salad.errors import StoreError
from salad.images.photo import Photo
from salad.index.index import Index

TIMES = 1000


class Counted(sqlite3.Connection):
    """A connection that is known until it is closed; one that is only forgotten stays known."""

    known: ClassVar[set[int]] = set()

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.known.add(id(self))

    def close(self) -> None:
        self.known.discard(id(self))
        super().close()


@pytest.fixture(autouse=True)
def connections(monkeypatch: pytest.MonkeyPatch) -> Iterator[set[int]]:
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *given, **set_: connect(*given, **{"factory": Counted} | set_))
    Counted.known.clear()
    yield Counted.known
    Counted.known.clear()


@pytest.fixture
def index(tmp_path: Path) -> Path:
    folder = tmp_path / "index"
    rows = np.eye(3, 8, dtype=np.float32)
    with Index.create(folder, dim=8, fingerprint="f", model="m") as made:
        made.add([Photo(tmp_path / f"{n}.jpg") for n in range(3)], rows, identities=list("abc"))
    return folder


def change(sql: str) -> Callable[[Path], None]:
    def run(folder: Path) -> None:
        db = sqlite3.connect(folder / "photos.sqlite")
        db.executescript(sql)
        db.close()

    return run


DAMAGE: dict[str, Callable[[Path], object]] = {
    "no header": lambda folder: (folder / "index.json").unlink(),
    "no table": lambda folder: (folder / "photos.sqlite").unlink(),
    "an empty table": lambda folder: (folder / "photos.sqlite").write_bytes(b""),
    "no database": lambda folder: (folder / "photos.sqlite").write_bytes(b"no database" * 1000),
    "a table cut short": lambda folder: os.truncate(folder / "photos.sqlite", 5000),
    "a table by a link": lambda folder: (
        shutil.move(folder / "photos.sqlite", folder / "other"),
        (folder / "photos.sqlite").symlink_to("other"),
    ),
    "no commit": change("DELETE FROM committed"),
    "a commit that makes no sense": change("UPDATE committed SET matrix = '../x'"),
    "a view": change("ALTER TABLE photos RENAME TO p; CREATE VIEW photos AS SELECT * FROM p"),
    "a trigger": change("CREATE TRIGGER t AFTER INSERT ON photos BEGIN SELECT 1; END"),
    "no descriptors": lambda folder: [file.unlink() for file in folder.glob("*.f16")],
    "a folder for descriptors": lambda folder: [(file.unlink(), file.mkdir()) for file in folder.glob("*.f16")],
}


def handles() -> int:
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208  # names alone


@pytest.mark.parametrize("damage", DAMAGE)
def test_no_failing_open_leaves_a_connection(index: Path, damage: str, connections: set[int]) -> None:
    DAMAGE[damage](index)
    assert connections == set()
    for use in (lambda _: None, Index.verify, Index.info, Index.compact, lambda held: held.remove(["/x"])):
        with suppress(StoreError), Index.open(index) as opened:
            use(opened)
        assert connections == set()


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="this system does not list a process's open files there")
@pytest.mark.parametrize("damage", ["no database", "a trigger", "a folder for descriptors"])
def test_a_thousand_failing_opens_hold_no_file(index: Path, damage: str) -> None:
    DAMAGE[damage](index)
    with suppress(StoreError), Index.open(index) as opened:
        opened.verify()
    gc.disable()  # what only the collector would find counts as held
    try:
        before = handles()
        for _ in range(TIMES):
            with suppress(StoreError), Index.open(index) as opened:
                opened.verify()
        assert handles() == before
    finally:
        gc.enable()
