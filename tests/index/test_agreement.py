"""What an index states in two places, and what it knows of photos: damage is seen before anything is written by it."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from earlier_indexes import as_format_1, change_row
from salad.errors import StoreError
from salad.geo import GeoPoint
from salad.images.photo import Photo
from salad.index.index import Index
from salad.search.filters import Filter

DIM = 8


def unit(count: int) -> Any:
    rows = np.random.default_rng(5).normal(size=(count, DIM))
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def photo(number: int, **known: Any) -> Photo:
    where = GeoPoint(47.0 + number / 100, 8.5)
    time = datetime(2024, 5, 1, number, tzinfo=UTC)
    return Photo(Path(f"/photos/{number}.jpg"), **({"where": where, "heading": 10.0 * number, "time": time} | known))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An index of five photos, of which one is removed."""
    with Index.create(tmp_path / "i.index", dim=DIM, fingerprint="f1", model="m") as index:
        index.add([photo(n) for n in range(5)], unit(5), identities=[f"{n:032x}" for n in range(5)])
        index.remove(["/photos/3.jpg"])
    return tmp_path / "i.index"


def held(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def changed_header(folder: Path, **fields: object) -> None:
    header = json.loads((folder / "index.json").read_bytes())
    (folder / "index.json").write_text(json.dumps(header | fields))


@pytest.mark.parametrize("fields", [{"dim": DIM + 1}, {"dim": DIM - 1}, {"fingerprint": "f2"}])
def test_a_header_that_the_table_does_not_bear_out_opens_nothing(folder: Path, fields: dict[str, object]) -> None:
    changed_header(folder, **fields)
    before = held(folder)
    with pytest.raises(StoreError, match=r"index\.json says .* and the table of photos .*one of the two is damaged"):
        Index.open(folder)
    assert held(folder) == before


CHANGES: dict[str, Callable[[Index], object]] = {
    "add": lambda index: index.add([photo(9)], np.eye(index.dim)[:1], identities=["9" * 32]),
    "update": lambda index: index.update([photo(2)], [f"{2:032x}"]),
    "remove": lambda index: index.remove(["/photos/1.jpg"]),
    "compact": lambda index: index.compact(),
    "compact and drop": lambda index: index.compact(dropping=len),
    "compress": lambda index: index.compress(4),
}


@pytest.mark.parametrize("dim", [DIM + 1, DIM - 1])
@pytest.mark.parametrize("change", CHANGES)
def test_an_old_header_that_the_descriptors_do_not_bear_out_writes_nothing(folder: Path, dim: int, change: str) -> None:
    as_format_1(folder)
    changed_header(folder, dim=dim)
    before = held(folder)
    with Index.open(folder) as index, pytest.raises(StoreError, match=r"none of those looked at|damaged"):
        CHANGES[change](index)
    assert held(folder) == before


def test_the_only_photo_of_an_old_index_can_be_removed_though_it_is_damaged(tmp_path: Path) -> None:
    with Index.create(tmp_path / "i", dim=DIM, fingerprint="f", model="m") as index:
        index.add([photo(1)], unit(1), identities=["1" * 32])
    as_format_1(tmp_path / "i")
    raw = bytearray((tmp_path / "i" / "descriptors.f16").read_bytes())
    raw[3] ^= 1
    (tmp_path / "i" / "descriptors.f16").write_bytes(raw)
    with Index.open(tmp_path / "i") as index:
        assert index.remove(["/photos/1.jpg"]) == 1
        assert index.verify() == []


@pytest.mark.parametrize("sql", ["DELETE FROM photos WHERE row = 4", "UPDATE photos SET row = row + 1 WHERE row = 4"])
def test_a_table_that_lists_other_rows_than_were_committed_is_not_written_to(folder: Path, sql: str) -> None:
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db, db:
        db.execute(sql)
    before = held(folder)
    for change in ("compact", "add"):
        with Index.open(folder) as index, pytest.raises(StoreError, match=r"5 rows were committed.*nothing is written"):
            index.compact(dropping=len) if change == "compact" else index.add(
                [photo(9)], unit(1), identities=["9" * 32]
            )
    assert held(folder) == before


# --- what is known of photos -----------------------------------------------------------------


def test_the_checksum_is_the_one_that_the_format_tells(folder: Path) -> None:
    """Written down anew from docs/index-format.md."""
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db:
        rows = db.execute("SELECT path, lat, lon, heading, time, identity, source, facts FROM photos WHERE removed = 0")
        for *told, facts in rows:
            parts = []
            for value in told:
                if value is None:
                    parts.append(b"n")
                elif isinstance(value, str):
                    parts.append(b"t" + value.encode())
                else:
                    parts.append(b"r" + struct.pack("<d", value))
            assert facts == zlib.crc32(b"\0".join(parts))
        assert db.execute("SELECT facts FROM photos WHERE removed = 1").fetchall() == [(None,)]


@pytest.mark.parametrize(
    "known",
    [
        {"where": GeoPoint(-0.0, -0.0), "heading": -0.0},
        {"where": None, "heading": float("nan"), "time": None},
        {"heading": np.float64(12.5)},
        {"heading": 360},
    ],
)
def test_whatever_is_known_of_a_photo_comes_back_sound(tmp_path: Path, known: dict[str, Any]) -> None:
    with Index.create(tmp_path / "i", dim=DIM, fingerprint="f", model="m") as index:
        index.add([photo(1, **known)], unit(1), identities=["1" * 32])
        index.update([photo(1, **known)], ["1" * 32])
        assert index.verify() == []


def test_flipped_bits_of_what_is_known_is_named(folder: Path) -> None:
    """Of the page that holds the rows: whatever is read differently from what was written is told, or is no table."""
    file = folder / "photos.sqlite"
    whole = file.read_bytes()
    with Index.open(folder) as index:
        known = [(each.path, each.where, each.heading, each.time) for each in index.photos()]
    at = whole.index(b"/photos/0.jpg")
    size = int.from_bytes(whole[16:18], "big")
    unseen = []
    page = range(at // size * size, (at // size + 1) * size)
    written = [place for place in page if any(whole[max(0, place - 8) : place + 8])]
    for place in written:
        spoilt = bytearray(whole)
        spoilt[place] ^= 1 << place % 8
        file.write_bytes(spoilt)
        try:
            with Index.open(folder, wait=0) as index:
                now = [(each.path, each.where, each.heading, each.time) for each in index.photos()]
                if now != known and not index.verify():
                    unseen.append((place, now))
        except StoreError:
            continue
    assert len(written) > 400
    assert not unseen


def test_a_photo_that_a_damaged_byte_marks_as_removed_is_not_lost(folder: Path) -> None:
    change_row(folder, 1, checksum=False, removed=1)
    before = held(folder)
    with Index.open(folder) as index:
        assert any("/photos/1.jpg" in sentence for sentence in index.verify())
        with pytest.raises(StoreError, match=r"1 photos of .* are damaged \(/photos/1.jpg\)"):
            index.compact()
        assert held(folder) == before
        told: list[Path] = []
        index.compact(dropping=told.extend)
        assert told == [Path("/photos/1.jpg")]


def test_what_is_damaged_of_a_photo_counts_as_unknown_and_stays_so(folder: Path) -> None:
    change_row(folder, 1, checksum=False, lat=12.0)
    with Index.open(folder) as index:
        (best,) = index.search(unit(2)[1:], k=1)[0]
        assert (best.photo.path, best.photo.where, best.photo.heading) == (Path("/photos/1.jpg"), None, None)
        index.compact()
        assert any("the record of /photos/1.jpg" in sentence for sentence in index.verify())
        index.update([photo(1)], [f"{1:032x}"])  # as whoever indexes the photo again does
        assert index.verify() == []
        assert index.search(unit(2)[1:], k=1)[0][0].photo == photo(1)


def test_a_filter_finds_no_photo_whose_record_is_damaged(folder: Path) -> None:
    near = Filter(near=GeoPoint(47.01, 8.5), within_m=100.0)
    with Index.open(folder) as index:
        assert [match.photo for match in index.search(unit(2)[1:], k=1, where=near)[0]] == [photo(1)]
    change_row(folder, 1, checksum=False, heading=11.0)
    with Index.open(folder) as index:
        assert index.search(unit(2)[1:], k=1, where=near) == [[]]
        assert len(index.search(unit(2)[1:], k=1)[0]) == 1


@pytest.mark.parametrize("number", [np.nan, np.inf, 0.0, 30.0])
def test_a_row_that_cannot_be_is_damaged_though_its_checksum_is_right(folder: Path, number: float) -> None:
    rows = np.memmap(folder / "descriptors.f16", dtype="<f2", mode="r+", shape=(5, DIM))
    rows[1] = number
    rows.flush()
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db, db:
        db.execute("UPDATE photos SET sum = ? WHERE row = 1", (zlib.crc32(rows[1].tobytes()),))
    with Index.open(folder) as index:
        assert any("/photos/1.jpg has a damaged descriptor" in sentence for sentence in index.verify())
        assert [page.damaged for page in index.pages()] == [[Path("/photos/1.jpg")]]
        assert 1 not in {match.row for best in index.search(unit(5), k=9) for match in best}


# --- earlier versions ------------------------------------------------------------------------


@pytest.mark.parametrize("sums", [True, False], ids=["format 1", "0.1.0"])
@pytest.mark.parametrize("change", CHANGES)
def test_an_index_of_an_earlier_version_opens_and_is_upgraded_at_the_first_write(
    folder: Path, change: str, sums: bool
) -> None:
    as_format_1(folder, sums=sums)
    changed_header(folder, later="a field of somebody's own")
    before = held(folder)
    with Index.open(folder) as index:
        known = [each for each in index.photos() if change != "remove" or each.path.name != "1.jpg"]
        assert index.verify() == []
        found = [match.photo for match in index.search(unit(1), k=9)[0]]
        assert index.info().format_version == 1
    assert held(folder) == before  # reading changes nothing
    with Index.open(folder) as index:
        CHANGES[change](index)
        if change == "add":
            index.remove(["/photos/9.jpg"])
        assert (list(index.photos()), index.verify()) == (known, [])
        assert [match.photo for match in index.search(unit(1), k=9)[0]] == [each for each in found if each in known]
        assert index.info().format_version == 2
    header = json.loads((folder / "index.json").read_bytes())
    assert (header["format_version"], header["later"]) == (2, "a field of somebody's own")
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db:
        assert db.execute("SELECT COUNT(*) FROM photos WHERE removed = 0 AND facts IS NULL").fetchone() == (0,)
        assert db.execute("SELECT dim, fingerprint FROM committed").fetchone() == (DIM, "f1")
    change_row(folder, 0, checksum=False, lat=1.0)
    with Index.open(folder) as index:
        assert len(index.verify()) == 1


def test_an_upgrade_killed_halfway_is_gone_on_with(folder: Path) -> None:
    """index.json says so first; the table has its old form until the change is committed."""
    as_format_1(folder)
    changed_header(folder, format_version=2)
    with Index.open(folder) as index:
        assert len(list(index.photos())) == 4
        assert index.verify() == []
        assert index.remove(["/photos/1.jpg"]) == 1
        assert index.verify() == []
        assert index.info().format_version == 2


def test_what_was_damaged_before_the_upgrade_is_damaged_after_it(folder: Path) -> None:
    as_format_1(folder)
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db, db:
        db.execute("UPDATE photos SET lat = 99.5 WHERE row = 1")
    with Index.open(folder) as index:
        before = index.verify()
        index.remove(["/photos/0.jpg"])
        assert index.verify() == before
    assert len(before) == 1


def test_others_have_tables_and_columns_of_their_own(folder: Path) -> None:
    """As docs/index-format.md promises; a later salad keeps there what it knows of contents."""
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db, db:
        db.execute("CREATE TABLE corrections (identity TEXT PRIMARY KEY, lat REAL)")
        db.execute("INSERT INTO corrections VALUES ('x', 1.5)")
        db.execute("ALTER TABLE photos ADD COLUMN rating INTEGER")
        db.execute("UPDATE photos SET rating = row")
    with Index.open(folder) as index:
        index.add([photo(9)], unit(6)[5:], identities=["9" * 32])
        assert index.compact().kept == 5
        assert index.verify() == []
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db:
        assert db.execute("SELECT * FROM corrections").fetchall() == [("x", 1.5)]
        assert db.execute("SELECT rating FROM photos ORDER BY row").fetchall() == [(0,), (1,), (2,), (4,), (None,)]


# --- what killed processes leave -------------------------------------------------------------

_KILLED = """
import os, sys
from pathlib import Path
from salad.index.index_folder import drafted

with drafted(Path(sys.argv[1]), "index") as draft:
    (draft / "half").write_bytes(b"x")
    print("there", flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(os.name != "posix", reason="folders are locked on POSIX only")
def test_drafts_of_killed_processes_are_swept_and_those_of_living_ones_are_not(tmp_path: Path) -> None:
    target = tmp_path / "new.index"
    makers = []
    for _ in range(2):
        makers.append(
            subprocess.Popen(
                [sys.executable, "-c", _KILLED, target], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        )
        assert makers[-1].stdout is not None
        assert makers[-1].stdout.readline() == "there\n"
    dead, living = makers
    others = [tmp_path / ".new.index.mine", tmp_path / f".old.index.{'0' * 32}", tmp_path / f".new.index.{'1' * 32}"]
    for folder in others[:2]:
        folder.mkdir()
    others[2].symlink_to(others[0])
    assert len(list(tmp_path.glob(".new.index.*/half"))) == 2
    dead.kill()
    dead.communicate()
    Index.create(target, dim=DIM, fingerprint="f", model="m").close()
    assert len(list(tmp_path.glob(".new.index.*/half"))) == 1
    assert all(folder.exists() for folder in others)
    living.communicate()
    assert not list(tmp_path.glob(".new.index.*/half"))
    assert sorted(file.name for file in target.iterdir()) == ["descriptors.f16", "index.json", "photos.sqlite"]


@pytest.mark.skipif(os.name != "posix", reason="a limit to files' size is POSIX's")
@pytest.mark.parametrize("limit", [0, 100, 4096, 20_000])
def test_an_index_that_there_is_no_room_for_is_a_sentence(tmp_path: Path, limit: int) -> None:
    code = """
import resource, signal, sys
from salad.errors import StoreError
from salad.index.index import Index

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
try:
    Index.create(sys.argv[1], dim=8, fingerprint="f", model="m")
except StoreError as error:
    sys.stderr.write(f"{error}")
"""
    told = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "i", str(limit)], check=True, capture_output=True, text=True
    )
    assert "make room" in told.stderr
    assert len(told.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


# --- folders of somebody else ----------------------------------------------------------------

FILES = ("index.json", "photos.sqlite", "descriptors.f16", "codes")


def named(folder: Path, file: str) -> Path:
    return next(folder.glob("codes-*.i8")) if file == "codes" else folder / file


def try_everything(folder: Path) -> list[str]:
    """Whatever a user may do to an index: what is said of it."""
    said = []

    def attempt(do: Any) -> None:
        try:
            with Index.open(folder, wait=0) as index:
                said.extend(index.verify())
                do(index)
        except StoreError as error:
            said.append(str(error))

    attempt(lambda index: index.search(unit(1), k=3))
    attempt(lambda index: index.add([photo(9)], unit(6)[5:], identities=["9" * 32]))
    attempt(lambda index: index.remove(["/photos/2.jpg"]))
    attempt(lambda index: index.compress(6))
    attempt(lambda index: index.compact(dropping=len))
    return said


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("kind", ["link", "hard link"])
def test_nothing_is_read_or_written_through_a_link(folder: Path, tmp_path: Path, file: str, kind: str) -> None:
    with Index.open(folder) as index:
        index.compress(4)
    path, outside = named(folder, file), tmp_path / "outside"
    path.rename(outside)
    path.symlink_to(outside) if kind == "link" else os.link(outside, path)
    before = outside.read_bytes()
    said = try_everything(folder)
    assert outside.read_bytes() == before
    # index.json is never changed in place, and codes of the other size are made anew.
    assert said or kind == "hard link"
    assert all("link" in sentence or "exact" in sentence for sentence in said)


@pytest.mark.skipif(os.name != "posix", reason="pipes with names are POSIX's")
@pytest.mark.parametrize("file", [*FILES, "photos.sqlite-journal"])
def test_a_pipe_is_no_file_and_holds_nobody_up(folder: Path, file: str) -> None:
    with Index.open(folder) as index:
        index.compress(4)
    path = named(folder, file)
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    said = try_everything(folder)
    assert said
    assert any(str(path) in sentence for sentence in said)


def super_journal(naming: Path) -> bytes:
    """A hot journal without pages, which says that it is part of the change that another journal is of."""
    head = bytes.fromhex("d9d505f920a163d7") + struct.pack(">IIIII", 0, 0, 0, 512, 4096)
    name = os.fsencode(naming)
    return head.ljust(512, b"\0") + struct.pack(">I", 1 << 18) + name + struct.pack(
        ">II", len(name), sum(np.frombuffer(name, np.int8).tolist()) & 0xFFFFFFFF
    ) + bytes.fromhex("d9d505f920a163d7")  # fmt: skip


def test_a_journal_that_has_another_file_deleted_is_refused(folder: Path, tmp_path: Path) -> None:
    victim = tmp_path / "thesis.doc"
    victim.write_bytes(b"years of work")
    (folder / "photos.sqlite-journal").write_bytes(super_journal(victim))
    said = try_everything(folder)
    assert victim.read_bytes() == b"years of work"
    assert said
    assert all("photos.sqlite-journal would have another file deleted" in sentence for sentence in said)


def test_sqlite_itself_would_have_deleted_it(folder: Path, tmp_path: Path) -> None:
    """Else the test above would show nothing."""
    victim = tmp_path / "thesis.doc"
    victim.write_bytes(b"years of work")
    (folder / "photos.sqlite-journal").write_bytes(super_journal(victim))
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db, suppress(sqlite3.Error):
        db.execute("SELECT * FROM photos").fetchall()
    assert not victim.exists()


@pytest.mark.parametrize("ending", ["-wal", "-shm"])
def test_a_write_ahead_log_beside_the_table_is_not_ours(folder: Path, tmp_path: Path, ending: str) -> None:
    victim = tmp_path / "outside"
    victim.write_bytes(b"as it is")
    (folder / f"photos.sqlite{ending}").symlink_to(victim)
    assert all(f"photos.sqlite{ending} is not ours" in sentence for sentence in try_everything(folder))
    assert victim.read_bytes() == b"as it is"


def test_a_table_that_wants_a_write_ahead_log_is_refused(folder: Path) -> None:
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db:
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("SELECT * FROM photos").fetchall()
    assert all("write-ahead log" in sentence for sentence in try_everything(folder))


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x FROM n"


@pytest.mark.parametrize(
    ("sql", "named"),
    [
        (f"ALTER TABLE photos RENAME TO p; CREATE VIEW photos AS {ENDLESS}", "the view photos"),
        (f"CREATE TRIGGER t AFTER INSERT ON photos BEGIN SELECT max(x) FROM ({ENDLESS}); END", "the trigger t"),
        ("CREATE TRIGGER t AFTER UPDATE ON committed BEGIN DELETE FROM photos; END", "the trigger t"),
        ("CREATE VIRTUAL TABLE v USING fts5(x)", "the virtual table v"),
        ("ALTER TABLE photos ADD COLUMN g TEXT AS (hex(zeroblob(1000000)))", "photos has columns that are computed"),
        ("ALTER TABLE photos DROP COLUMN heading", "its table photos is not one of an index"),
        ("DROP TABLE committed", "its table committed is not one of an index"),
        ("ALTER TABLE photos RENAME TO p; CREATE TABLE photos AS SELECT * FROM p", "its table photos is not one of"),
    ],
)
def test_a_table_in_which_something_runs_is_refused(folder: Path, sql: str, named: str) -> None:
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db:
        db.executescript(sql)
    before = held(folder)
    said = try_everything(folder)
    assert said
    assert all(named in sentence for sentence in said)
    assert held(folder) == before


@pytest.mark.parametrize("row", [1 << 40, 1 << 62, -1, -(1 << 40)])
def test_a_row_of_any_number_takes_no_memory(folder: Path, row: int) -> None:
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db, db:
        db.execute("UPDATE photos SET row = ? WHERE row = 4", (row,))
        db.execute("UPDATE committed SET rows = ?", (row + 1 if row > 0 else 5,))
    assert any("damaged" in sentence for sentence in try_everything(folder))


VALUES = [None, 5, -1, 1 << 62, 2.5, float("inf"), "", "x" * 100_000, "a\0b", b"", b"\xff\xfe", b"x" * 100_000]
COLUMNS_HELD = {
    "photos": ["row", "path", "identity", "lat", "lon", "heading", "time", "removed", "sum", "source", "facts"],
    "committed": ["id", "rows", "generation", "matrix", "dim", "fingerprint"],
    "codes": ["file", "coding", "matrix", "rows", "sums"],
    "codings": ["id", "bytes", "seen", "step", "middle", "axes", "sum"],
    "code_plan": ["bytes"],
}


@pytest.mark.parametrize(
    ("table", "column"), [(table, name) for table, names in COLUMNS_HELD.items() for name in names]
)
def test_any_value_in_any_column_is_told_or_harmless(folder: Path, table: str, column: str) -> None:
    with Index.open(folder) as index:
        index.compress(4)
    whole = (folder / "photos.sqlite").read_bytes()
    for value in VALUES:
        (folder / "photos.sqlite").write_bytes(whole)
        with closing(sqlite3.connect(folder / "photos.sqlite")) as db, db, suppress(sqlite3.Error):
            db.execute("PRAGMA ignore_check_constraints = ON")
            db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = (SELECT max(rowid) FROM {table})", (value,))
        for checksum in (True, False):
            if checksum and table == "photos" and column not in ("row", "facts", "removed"):
                with suppress(sqlite3.Error):
                    change_row(folder, 4, checksum=True)
            said = try_everything(folder)
            with suppress(StoreError), Index.open(folder) as index:
                json.dumps(index.info().as_dict())
                list(index.photos())
                list(index.pages())
            assert all(len(sentence) < 1000 for sentence in said)


@pytest.mark.parametrize("name", ["descriptors-2.f16", "descriptors-3.f16", "descriptors-4.f16", "mine.f16"])
def test_a_matrix_called_as_the_next_one_would_be_is_not_written_over(folder: Path, name: str) -> None:
    (folder / "descriptors.f16").rename(folder / name)
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db, db:
        db.execute("UPDATE committed SET matrix = ?", (name,))
    with Index.open(folder) as index:
        assert index.compact().kept == 4
        assert index.verify() == []
        assert index.search(unit(5)[4:], k=1)[0][0].score > 0.99


def test_every_opening_that_fails_lets_go_of_what_it_opened(folder: Path, tmp_path: Path) -> None:
    handles = Path("/proc/self/fd")
    if not handles.exists():
        pytest.skip("this system does not list a process's open files")
    spoilt = []
    for number, (file, content) in enumerate(
        [("photos.sqlite", b"no table" * 999), ("index.json", b"{"), ("descriptors.f16", None), ("photos.sqlite", None)]
    ):
        spoilt.append(Path(shutil.copytree(folder, tmp_path / str(number))))
        if content is None:
            (spoilt[-1] / file).unlink()
        else:
            (spoilt[-1] / file).write_bytes(content)
    with closing(sqlite3.connect(spoilt[0] / "photos.sqlite")):
        before = len(list(handles.iterdir()))
    for _ in range(50):
        for each in spoilt:
            with pytest.raises(StoreError):
                Index.open(each)
    assert len(list(handles.iterdir())) <= before
