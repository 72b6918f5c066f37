"""Indexes that somebody made to be opened: each is a sound one, damaged by hand through SQLite or in its bytes."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from attack.attacks import Answer, Attack
from attack.outside import Scene
from salad.index.index import Index

TABLE, JOURNAL, HEADER, ROWS = "photos.sqlite", "photos.sqlite-journal", "index.json", "descriptors.f16"
_MAGIC = bytes.fromhex("d9d505f920a163d7")  # of SQLite's rollback journal
_PHOTO = "row, path, identity, lat, lon, heading, time, removed, sum"
# A view that has no end, as a table's columns.
_ENDLESS = (
    "WITH RECURSIVE n(row) AS (SELECT 0 UNION ALL SELECT row + 1 FROM n) SELECT row, '/p/' || row AS path, "
    "hex(row) AS identity, 1.0 AS lat, 2.0 AS lon, NULL AS heading, NULL AS time, 0 AS removed, 0 AS sum FROM n"
)


def copied(scene: Scene) -> Path:
    """A sound index, to be damaged."""
    folder = scene.given / "city.index"
    shutil.copytree(scene.index, folder)
    return folder


def in_sql(*statements: str, values: tuple[Any, ...] = ()) -> Callable[[Scene], None]:
    """A sound index whose table went through some statements; `values` are the last one's."""

    def make(scene: Scene) -> None:
        with closing(sqlite3.connect(copied(scene) / TABLE, isolation_level=None)) as db:
            db.execute("PRAGMA writable_schema = ON")
            for statement in statements:
                db.execute(statement, values if statement is statements[-1] else ())

    return make


def recreated(columns: str, *more: str) -> Callable[[Scene], None]:
    """A sound index whose table of photos has other columns, or is none; `more` follows."""
    return in_sql(
        "ALTER TABLE photos RENAME TO kept",
        *(f"DROP INDEX {name}" for name in ("live_identity", "live_path", "dead_row")),
        f"CREATE {columns}",
        *more,
    )


def in_header(**fields: Any) -> Callable[[Scene], None]:
    """A sound index whose `index.json` says something else."""

    def make(scene: Scene) -> None:
        path = copied(scene) / HEADER
        path.write_text(json.dumps(json.loads(path.read_text()) | fields))

    return make


def header_of(content: bytes) -> Callable[[Scene], None]:
    """A sound index with another `index.json`."""

    def make(scene: Scene) -> None:
        (copied(scene) / HEADER).write_bytes(content)

    return make


def file_of(name: str, *, size: int) -> Callable[[Scene], None]:
    """A sound index, one file of which says that it has so many bytes; the disk holds none of them."""

    def make(scene: Scene) -> None:
        with (copied(scene) / name).open("ab") as file:
            file.truncate(size)

    return make


# --- names that lead elsewhere -----------------------------------------------------------------


def put(name: str, how: Callable[[Scene, Path], object]) -> Callable[[Scene], None]:
    """A sound index, in which something else stands at a name (`codes` is the file of codes)."""

    def make(scene: Scene) -> None:
        folder = copied(scene)
        path = next(iter(folder.glob("codes-*"))) if name == "codes" else folder / name
        path.unlink(missing_ok=True)
        how(scene, path)

    return make


def link(to: str) -> Callable[[Scene, Path], None]:
    """A symbolic link to a file outside, or an absolute path."""
    return lambda scene, path: path.symlink_to(scene.outside / to)


def hard_link(to: str) -> Callable[[Scene, Path], None]:
    """Another name of a file outside."""
    return lambda scene, path: path.hardlink_to(scene.outside / to)


def pipe(_: Scene, path: Path) -> None:
    """A pipe that nobody writes to."""
    os.mkfifo(path)


def folder(_: Scene, path: Path) -> None:
    """A folder, with something in it."""
    path.mkdir()
    (path / "something").write_bytes(b"x")


PLACES: dict[str, Callable[[Scene, Path], object]] = {
    "a link to a file outside": link("rows.f16"),
    "a link to nothing": link("nothing"),
    "a link to an endless device": link("/dev/zero"),
    "a pipe": pipe,
    "a folder": folder,
}


def names_that_lead_elsewhere() -> Iterator[Attack]:
    """Every file of an index as a link, a pipe, a device or a folder; and as another name of a file outside."""
    for name in (HEADER, TABLE, ROWS, JOURNAL):
        for what, how in PLACES.items():
            # Whoever adds to what has no header is told that a folder is in its way.
            named = "city.index" if (name, what) == (HEADER, "a link to nothing") else name
            yield Attack(f"{name} is {what}", put(name, how), "refused", named, every=name in (JOURNAL, ROWS))
    for what, how in PLACES.items():
        # Codes are of no need: without them searches are exact.
        yield Attack(f"codes are {what}", put("codes", how), "told", "codes-")
        yield Attack(f"a log beside the table is {what}", put(TABLE + "-wal", how), "harmless")
        yield Attack(f"shared memory beside the table is {what}", put(TABLE + "-shm", how), "harmless")
    yield Attack("the table is a link to another table", put(TABLE, link("other.sqlite")), "refused", TABLE)
    yield Attack("the table is a hard link to another", put(TABLE, hard_link("other.sqlite")), "harmless")
    yield Attack("the table is a hard link to one of another index", _shared_table, "harmless", every=True)
    # Its first byte is 0, by which SQLite knows a journal that is of no use, and writes over it.
    yield Attack("the journal is a link to a file of zeros", put(JOURNAL, link("zeros.bin")), "refused", JOURNAL)
    yield Attack("the journal is a hard link", put(JOURNAL, hard_link("zeros.bin")), "harmless", every=True)
    yield Attack("descriptors are a hard link", put(ROWS, hard_link("rows.f16")), "harmless", every=True)
    yield Attack("codes are a hard link", put("codes", hard_link("rows.f16")), "harmless")
    yield Attack("index.json is a hard link", put(HEADER, hard_link("note.txt")), "refused", HEADER)
    for name in ("descriptors-1.f16", "descriptors-9.f16", "codes-1.i8", "codes-9.i8"):
        yield Attack(f"a leftover {name} is a link", put(name, link("rows.f16")), "harmless")
        yield Attack(f"a leftover {name} is a folder", put(name, folder), "harmless")
    yield Attack("whatever a compaction makes is there", _all_generations(link("rows.f16")), "harmless", every=True)
    yield Attack("whatever a compaction makes is linked hard", _all_generations(hard_link("rows.f16")), "harmless")


def _shared_table(scene: Scene) -> None:
    """Two indexes with one table, as a copy of hard links has them: what is written to one is not the other's."""
    (copied(scene) / TABLE).rename(scene.outside / TABLE)
    (scene.given / "city.index" / TABLE).hardlink_to(scene.outside / TABLE)


def _all_generations(how: Callable[[Scene, Path], object]) -> Callable[[Scene], None]:
    def make(scene: Scene) -> None:
        folder = copied(scene)
        for number in range(40):
            for name in (f"descriptors-{number}.f16", f"codes-{number}.i8"):
                if not (folder / name).exists():
                    how(scene, folder / name)

    return make


# --- journals and logs ---------------------------------------------------------------------------


def journal(scene: Scene, *, victim: Path | bytes, pages: int | None = None) -> None:
    """A journal that says it is one of several, whose list is the victim: SQLite deletes that list when it is done."""
    folder = copied(scene)
    table = folder / TABLE
    size = int.from_bytes(table.read_bytes()[16:18], "big")
    count = table.stat().st_size // size if pages is None else pages
    head = _MAGIC + struct.pack(">IIIII", 0, 1, count, 512, size)
    name = victim if isinstance(victim, bytes) else os.fsencode(victim)
    # 2^30 is where SQLite locks: no page of a table is written there.
    tail = struct.pack(">I", (1 << 30) // size + 1) + name
    tail += struct.pack(">II", len(name), sum(letter - 256 * (letter > 127) for letter in name) & 0xFFFFFFFF) + _MAGIC
    (folder / JOURNAL).write_bytes(head.ljust(512, b"\0") + tail)


def _list_beside(scene: Scene) -> None:
    """The same, the list an index's own file."""
    journal(scene, victim=scene.given / "city.index" / ROWS)


def _truncating(scene: Scene) -> None:
    """A journal by which the table had one page before."""
    journal(scene, victim=b"", pages=1)
    path = scene.given / "city.index" / JOURNAL
    path.write_bytes(path.read_bytes()[:512])


def in_log_mode(*, beside: bool) -> Callable[[Scene], None]:
    """A table that keeps its changes in a log, with logs beside it that are none."""

    def make(scene: Scene) -> None:
        folder = copied(scene)
        raw = bytearray((folder / TABLE).read_bytes())
        raw[18:20] = b"\x02\x02"
        (folder / TABLE).write_bytes(raw)
        if beside:
            (folder / (TABLE + "-wal")).symlink_to(scene.outside / "rows.f16")
            (folder / (TABLE + "-shm")).symlink_to(scene.outside / "zeros.bin")

    return make


def _hard_log(scene: Scene) -> None:
    in_log_mode(beside=False)(scene)
    for end, victim in (("-wal", "rows.f16"), ("-shm", "zeros.bin")):
        (scene.given / "city.index" / (TABLE + end)).hardlink_to(scene.outside / victim)


def journals() -> Iterator[Attack]:
    """What SQLite finds beside its table, and acts upon by itself."""
    for victim in ("photo.jpg", "note.txt", "other.sqlite", "private/letter.txt"):

        def make(scene: Scene, victim: str = victim) -> None:
            journal(scene, victim=scene.outside / victim)

        yield Attack(f"a journal whose list is {victim}", make, "refused", JOURNAL, every=True)
    yield Attack("a journal whose list is the descriptors", _list_beside, "refused", JOURNAL)
    yield Attack("a journal that cuts the table", _truncating, "harmless")
    yield Attack("a table in log mode", in_log_mode(beside=False), "harmless")
    yield Attack("a table in log mode with links beside", in_log_mode(beside=True), "harmless")
    yield Attack("a table in log mode with hard links beside", _hard_log, "harmless")


# --- what is stated in two places ------------------------------------------------------------------


def headers() -> Iterator[Attack]:
    """`index.json` that lies."""
    for dim in (255, 257, 128, 512, 1, 10**9, 10**18, 10**30, -1, 0, 256.0, 1e300, True, "256", None, [256]):
        yield Attack(f"dim is {dim!r}", in_header(dim=dim), "refused", every=dim in (257, 10**18))
    yield Attack("another fingerprint", in_header(fingerprint="fake-0123456789abcdef"), "harmless")
    yield Attack("a version of 10^30", in_header(format_version=10**30), "refused", "newer salad")
    for version in (0, -1, 1.5, True, "1", None):
        yield Attack(f"version {version!r}", in_header(format_version=version), "refused", HEADER)
    yield Attack("a date with offset 23:59", in_header(created="9999-12-31T23:59:59+23:59"), "harmless")
    yield Attack("a date before all zones", in_header(created="0001-01-01T00:00:00+23:59"), "harmless")
    for name in ("\x1b]0;owned\x07\x1b[2J", "a\nphotos  0", "\ud800", "m" * 5_000_000, "../../x", "/dev/zero"):
        yield Attack(f"a model named {name[:12]!r}", in_header(model=name), "harmless")
    yield Attack("a fingerprint that is no text", in_header(fingerprint="\udcff\x1b[2J"), "harmless")
    deep = 100_000
    for what, content in {
        "lists 100,000 deep": b"[" * deep,
        "closed lists 100,000 deep": b"[" * deep + b"]" * deep,
        "objects 100,000 deep": b'{"kind":' * deep,
        "a number of a million digits": b'{"kind":"salad index","format_version":1,"dim":' + b"9" * 1_000_000 + b"}",
        "no text": b"\xff\xfe\x00",
        "nothing": b"",
        "NaN": b"NaN",
        "a string": b'"salad index"',
        "zeros": b"\0" * 4096,
    }.items():
        yield Attack(f"index.json is {what}", header_of(content), "refused", HEADER, every="100,000" in what)
    yield Attack("index.json has 5 GB", file_of(HEADER, size=5 << 30), "refused", HEADER)


def commits() -> Iterator[Attack]:
    """The table `committed` that lies."""
    for name in (
        *("../x.f16", "/tmp/x.f16", "a/b.f16", "..", ".f16/..", HEADER, TABLE, "", "x.f16\0y", "x\n.f16"),
        *("descriptors-1.f16", "descriptors-2.f16", "descriptors-3.f16", "descriptors-4.f16", "descriptors-5.f16"),
    ):
        yield Attack(f"the matrix is {name!r}", in_sql("UPDATE committed SET matrix = ?", values=(name,)), "refused")

    def absolute(scene: Scene) -> None:
        in_sql("UPDATE committed SET matrix = ?", values=(str(scene.outside / "rows.f16"),))(scene)

    yield Attack("the matrix is a file outside", absolute, "refused", TABLE)
    for number in range(4):
        next_is = f"{number} commits from now"
        yield Attack(
            f"the file of {next_is} is today's", _next_is_today(number), "harmless", every=True, also=still_whole
        )
        yield Attack(
            f"the codes of {next_is} are today's", _next_codes(number), "harmless", every=True, also=still_whole
        )
    for what, value in {"a blob": b"\xff" * 9, "a text": "many", "-1": -1, "2^62": 1 << 62, "nothing": None}.items():
        for column in ("rows", "generation"):
            statement = f"UPDATE committed SET {column} = ?"
            yield Attack(f"{column} of the commit is {what}", _loosely(statement, value), "harmless")
    yield Attack("no commit", in_sql("DELETE FROM committed"), "refused", TABLE)
    yield Attack("no table of commits", in_sql("DROP TABLE committed"), "refused", TABLE)
    yield Attack("commits without end", in_sql(
        "ALTER TABLE committed RENAME TO were", "CREATE VIEW committed AS WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL "
        "SELECT i + 1 FROM n) SELECT i AS rows, i AS generation, 'x.f16' AS matrix FROM n WHERE i < 0"),
        "refused")  # fmt: skip


def _loosely(statement: str, value: object) -> Callable[[Scene], None]:
    """A value that the table's own schema would not take: so it has another before."""
    looser = "UPDATE sqlite_schema SET sql = replace(sql, 'NOT NULL', '') WHERE name = 'committed'"

    def make(scene: Scene) -> None:
        in_sql(looser)(scene)
        with closing(sqlite3.connect(scene.given / "city.index" / TABLE, isolation_level=None)) as db:
            db.execute(statement, (value,))

    return make


def still_whole(scene: Scene) -> list[str]:
    """Whether all photos are found in an index as they were, but for the one that a removal is asked to remove."""
    with Index.open(scene.given / "city.index") as index, Index.open(scene.index) as sound:
        now, before = ({identity for page in each.pages() for identity in page.identities} for each in (index, sound))
        lost = [f"{len(before - now)} photos are lost"] if len(before - now) > 1 else []
        return lost + index.verify()


def _next_is_today(step: int) -> Callable[[Scene], None]:
    """The catalog names, as its own, the file that a compaction would make `step` commits from now."""

    def make(scene: Scene) -> None:
        folder = copied(scene)
        with closing(sqlite3.connect(folder / TABLE, isolation_level=None)) as db:
            (generation, matrix), *_ = db.execute("SELECT generation, matrix FROM committed")
            name = f"descriptors-{generation + step}.f16"
            db.execute("UPDATE committed SET matrix = ?", (name,))
            db.execute("UPDATE codes SET matrix = ?", (name,))
        (folder / matrix).rename(folder / name)

    return make


def _next_codes(step: int) -> Callable[[Scene], None]:
    def make(scene: Scene) -> None:
        folder = copied(scene)
        with closing(sqlite3.connect(folder / TABLE, isolation_level=None)) as db:
            ((generation,),) = db.execute("SELECT generation FROM committed")
            ((file,),) = db.execute("SELECT file FROM codes")
            db.execute("UPDATE codes SET file = ?", (name := f"codes-{generation + step}.i8",))
        (folder / file).rename(folder / name)

    return make


# --- SQLite as hostile input -------------------------------------------------------------------------


def schemas() -> Iterator[Attack]:
    """Views, triggers, virtual tables and the like."""
    yield Attack("photos is a view without end", recreated(f"VIEW photos AS {_ENDLESS}"), "refused", TABLE, every=True)
    yield Attack("photos is a view of a product without end", recreated(
        f"VIEW photos AS SELECT {_PHOTO} FROM ({_ENDLESS}) WHERE row < 0"), "refused", TABLE)  # fmt: skip
    yield Attack("photos is a view of the table", recreated("VIEW photos AS SELECT * FROM kept"), "refused", TABLE)
    yield Attack("an unused view without end", in_sql(f"CREATE VIEW other AS {_ENDLESS}"), "harmless")
    for event in ("INSERT ON photos", "UPDATE ON photos", "DELETE ON photos", "UPDATE ON committed", "INSERT ON codes"):
        for what, body in {
            "deletes all": "DELETE FROM photos",
            "moves all": "UPDATE photos SET lat = 0.0, lon = 0.0",
            "never ends": f"INSERT INTO photos (path, identity) SELECT path, identity FROM ({_ENDLESS})",
        }.items():
            trigger = f"CREATE TRIGGER hidden AFTER {event} BEGIN {body}; END"
            yield Attack(
                f"a trigger at {event} that {what}",
                in_sql(trigger),
                "refused",
                TABLE,
                every=event == "UPDATE ON photos",
            )
    yield Attack("photos is a virtual table", recreated(
        "VIRTUAL TABLE photos USING fts5(path, identity, lat, lon, heading, time, removed, sum)"),
        "refused", TABLE)  # fmt: skip
    yield Attack("a virtual table beside", in_sql("CREATE VIRTUAL TABLE more USING rtree(id, a, b)"), "refused", TABLE)
    for what, expression in {
        "that fills memory": "hex(zeroblob(900000000))",
        "that only adds": "row + 1",
        "that nobody knows": "nobody(row)",
    }.items():
        yield Attack(f"a generated column {what}", _generated(expression), "refused", TABLE)
    heavy = "length(hex(zeroblob(400000000))) > 0"
    yield Attack("an index over what fills memory", in_sql(
        f"CREATE INDEX heavy ON photos(path) WHERE removed = 0 AND {heavy}"), "harmless")  # fmt: skip
    yield Attack("a check that fills memory", in_sql(
        f"UPDATE sqlite_schema SET sql = replace(sql, 'sum INTEGER', 'sum INTEGER CHECK ({heavy})') "
        "WHERE name = 'photos'"), "harmless")  # fmt: skip
    yield Attack("an order that nobody knows", in_sql(
        "UPDATE sqlite_schema SET sql = replace(sql, 'path TEXT', 'path TEXT COLLATE nobody') "
        "WHERE name = 'photos'"), "harmless")  # fmt: skip
    yield Attack("statistics that lie", in_sql(
        "CREATE TABLE x(a)", "INSERT INTO x VALUES (1)", "CREATE INDEX y ON x(a)", "ANALYZE",
        "INSERT INTO sqlite_stat1 VALUES ('photos', 'live_path', '9223372036854775807 -1 x')"), "harmless")  # fmt: skip
    yield Attack("no table of photos", in_sql("DROP TABLE photos"), "refused", TABLE)
    yield Attack("a column lacks", recreated("TABLE photos AS SELECT row, path, identity FROM kept"), "refused", TABLE)
    yield Attack("columns in another order and two more", recreated(
        "TABLE photos (note TEXT, sum INTEGER, removed INTEGER NOT NULL DEFAULT 0, time TEXT, heading REAL, lon REAL, "
        "lat REAL, identity TEXT NOT NULL, path TEXT NOT NULL, row INTEGER PRIMARY KEY, colour TEXT)",
        f"INSERT INTO photos ({_PHOTO}) SELECT {_PHOTO} FROM kept"), "harmless")  # fmt: skip
    yield Attack("row numbers that come twice", recreated(
        "TABLE photos AS SELECT * FROM kept UNION ALL SELECT * FROM kept"), "harmless")  # fmt: skip
    yield Attack("a table whose name is no text", _broken_name, "harmless")
    yield Attack("20,000 more tables", in_sql(*(f"CREATE TABLE t{number}(a)" for number in range(2000))), "harmless")
    yield Attack("a schema of 4,000 columns", in_sql(
        f"CREATE TABLE wide ({', '.join(f'c{number}' for number in range(1900))})"), "harmless")  # fmt: skip


def _generated(expression: str) -> Callable[[Scene], None]:
    """A table whose `time` is worked out whenever it is read."""

    def make(scene: Scene) -> None:
        plain = _PHOTO.replace(" time,", "")
        recreated(
            f"TABLE photos ({plain.replace('row,', 'row INTEGER PRIMARY KEY,')}, "
            "time TEXT GENERATED ALWAYS AS (1) VIRTUAL)",
            f"INSERT INTO photos ({plain}) SELECT {plain} FROM kept",
            f"UPDATE sqlite_schema SET sql = replace(sql, 'AS (1)', 'AS ({expression})') WHERE name = 'photos'",
        )(scene)

    return make


def _broken_name(scene: Scene) -> None:
    """What SQLite quotes in its sentence is no text."""
    path = copied(scene) / TABLE
    raw = path.read_bytes()
    at = raw.index(b"CREATE TABLE photos")
    path.write_bytes(raw[:at] + b"CREATE T\xff\xfe\x80E photos" + raw[at + len(b"CREATE TABLE photos") :])


def values() -> Iterator[Attack]:
    """What stands in a column and cannot be."""
    for row in (1 << 40, 1 << 62, (1 << 63) - 1, -1, -(1 << 63), 1000):
        moved = f"UPDATE photos SET row = {row} WHERE row = 2"
        yield Attack(f"a photo at row {row}", in_sql(moved), "told", "")
        both = in_sql(moved, f"UPDATE committed SET rows = {min(row + 1, (1 << 63) - 1)}")
        yield Attack(f"a photo at row {row}, and as many committed", both, "harmless", every=row in (1 << 40, 1 << 62))
    wrong: dict[str, Any] = {
        "a blob": b"\xff\x00\xfe",
        "a text": "x\x1b[2J\ny",
        "a text that is no UTF-8": "CAST(x'ff61fe' AS TEXT)",
        "a NUL": "CAST(x'2f610062' AS TEXT)",
        "a number": 7,
        "a fraction": 0.5,
        "infinity": float("inf"),
        "absurd": 1e308,
        "2^63 - 1": (1 << 63) - 1,
        "60 MB": "CAST(zeroblob(60000000) AS TEXT)",
    }
    for column in ("path", "identity", "lat", "lon", "heading", "time", "removed", "sum"):
        for what, value in wrong.items():
            shown = str(value) if isinstance(value, str) and value.startswith("CAST") else "?"
            statement = f"UPDATE photos SET {column} = {shown} WHERE row = 1"
            made = in_sql(statement, values=(value,) if shown == "?" else ())
            long = column not in ("path", "lat") and what not in ("a blob", "infinity")
            yield Attack(f"{column} is {what}", made, _right_of(column, what), long=long)
    for what, fields in {
        "a line break": "'/p/a.jpg\n/p/b.jpg is sound'",
        "what a terminal obeys": "CAST(x'2f701b5b324a' AS TEXT)",
        "climbing": "'/p/../../../../etc/passwd'",
        "bare": "'photo.jpg'",
        "empty": "''",
        "half a letter": "CAST(x'2f70eda080' AS TEXT)",
    }.items():
        made = in_sql(f"UPDATE photos SET path = {fields} WHERE row = 1")
        yield Attack(f"a path that is {what}", made, "harmless")
    yield Attack("all paths are one", in_sql("UPDATE photos SET path = '/p/a.jpg'"), "harmless")
    yield Attack("a time in the year 9999", in_sql("UPDATE photos SET time = '9999-12-31T23:59:59-23:59'"), "harmless")


def _right_of(column: str, what: str) -> Answer:
    """Whether `verify` has to name it: a number too is text to SQLite where a column is."""
    return "told" if column in ("path", "lat", "lon", "heading", "time") and what != "a fraction" else "harmless"


# --- descriptors and codes -----------------------------------------------------------------------------


def _rows(change: Callable[[bytes], bytes]) -> Callable[[Scene], None]:
    def make(scene: Scene) -> None:
        path = copied(scene) / ROWS
        path.write_bytes(change(path.read_bytes()))

    return make


def _with_sums(row: bytes) -> Callable[[Scene], None]:
    """All rows are that one, and their checksums are right."""

    def make(scene: Scene) -> None:
        import zlib

        folder = copied(scene)
        count = (folder / ROWS).stat().st_size // len(row)
        (folder / ROWS).write_bytes(row * count)
        with closing(sqlite3.connect(folder / TABLE, isolation_level=None)) as db:
            db.execute("UPDATE photos SET sum = ?", (zlib.crc32(row),))
            db.execute("DELETE FROM codes")

    return make


def descriptors() -> Iterator[Attack]:
    """Numbers that are none, and files that are not as long as they say."""
    import numpy as np

    for what, number in {"NaN": np.nan, "infinite": np.inf, "zero": 0.0, "huge": 65504.0, "tiny": 6e-8}.items():
        made = _with_sums(np.full(256, number, np.float16).tobytes())
        yield Attack(f"every number of a descriptor is {what}, with its checksum", made, "told")
    yield Attack("descriptors are empty", _rows(lambda raw: b""), "told", ROWS)
    yield Attack("descriptors are cut within a row", _rows(lambda raw: raw[:700]), "told", ROWS)
    yield Attack("descriptors have 4 TB", file_of(ROWS, size=1 << 42), "harmless")
    yield Attack("descriptors are gone", put(ROWS, lambda *_: None), "refused", ROWS)


def codes() -> Iterator[Attack]:
    """Codes that lie: they are of no need, so nothing but speed may depend on them."""
    for column, numbers in {
        "bytes": (0, -1, 1 << 40, 1 << 62),
        "seen": (-1, 1 << 62),
        "step": (0.0, -1.0, 1e308),
        "sum": (0, -1),
    }.items():
        for number in numbers:
            made = in_sql(f"UPDATE codings SET {column} = ?", values=(number,))
            yield Attack(f"{column} of a coding is {number}", made, "harmless")
    for column in ("bytes", "seen", "step", "sum", "middle", "axes"):
        for what, value in {"a text": "x", "a blob": b"\xff" * 11}.items():
            made = in_sql(f"UPDATE codings SET {column} = ?", values=(value,))
            yield Attack(f"{column} of a coding is {what}", made, "harmless")
    for number in (-1, 1 << 40, 1 << 62):
        yield Attack(f"{number} rows have codes", in_sql("UPDATE codes SET rows = ?", values=(number,)), "harmless")
    for name in ("../x.i8", "photos.sqlite", "index.json", "codes-1.i8\0", "/tmp/codes-1.i8", b"codes-1.i8", 7):
        made = in_sql("UPDATE codes SET file = ?", values=(name,))
        yield Attack(f"codes are in {name!r}", made, "harmless")
    for what, value in {"nothing": b"", "odd": b"\1\2\3", "a text": "abcd", "a number": 5}.items():
        made = in_sql("UPDATE codes SET sums = ?", values=(value,))
        yield Attack(f"checksums of codes are {what}", made, "harmless")
    yield Attack("codes are a view without end", in_sql(
        "ALTER TABLE codes RENAME TO were", "CREATE VIEW codes AS WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT "
        "i + 1 FROM n) SELECT 'codes-' || i || '.i8' AS file, 1 AS coding, 'x' AS matrix, i AS rows, x'' AS sums "
        "FROM n"), "refused", TABLE)  # fmt: skip
    yield Attack("the plan is for 2^62 bytes", in_sql("UPDATE code_plan SET bytes = ?", values=(1 << 62,)), "harmless")
    yield Attack("the plan is a text", in_sql("UPDATE code_plan SET bytes = ?", values=("x",)), "harmless")
    yield Attack("codes have 4 TB", put("codes", _sparse(1 << 42)), "harmless")


def _sparse(size: int) -> Callable[[Scene, Path], None]:
    def how(_: Scene, path: Path) -> None:
        with path.open("wb") as file:
            file.truncate(size)

    return how


ALL = [
    attack
    for some in (names_that_lead_elsewhere, journals, headers, commits, schemas, values, descriptors, codes)
    for attack in some()
]
