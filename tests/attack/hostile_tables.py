"""Tables, exports, arrays and lists that somebody made to be read."""

from __future__ import annotations

import io
import json
import os
import pickle
import struct
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from attack.attacks import Attack, Command
from attack.outside import Scene

POSITIONS: tuple[Command, ...] = (
    ("index", "{photos}", "--to", "{work}/new", "--table", "{given}/t.csv"),
    ("places", "{photos}", "--to", "{work}/places.csv", "--table", "{given}/t.csv"),
)
TAKEN: tuple[Command, ...] = (("index", "--from", "{given}", "--to", "{work}/new", "--model", "theirs"),)
JUDGED: tuple[Command, ...] = (
    ("evaluate", "--references", "{photos}", "--queries", "{work}/queries", "--frames", "0"),
)
HEAD = b"path,lat,lon,heading,time,identity\n"
DIM = 256

Make = Callable[[Scene], object]


def file(name: str, content: bytes | Callable[[], bytes], *, size: int = 0) -> Make:
    """A file of some bytes, that says it has `size` of them where that is more."""

    def make(scene: Scene) -> None:
        with (scene.given / name).open("wb") as opened:
            opened.write(content if isinstance(content, bytes) else content())
            if size:
                opened.truncate(size)

    return make


def endless(name: str) -> dict[str, Make]:
    """A name that stands for no file."""
    return {
        "a pipe": lambda scene: os.mkfifo(scene.given / name),
        "a link to an endless device": lambda scene: (scene.given / name).symlink_to("/dev/zero"),
        "a link to a device that gives nothing": lambda scene: (scene.given / name).symlink_to("/dev/null"),
        "a folder": lambda scene: (scene.given / name).mkdir(),
    }


TEXTS: dict[str, bytes | Callable[[], bytes]] = {
    "nothing": b"",
    "zeros": bytes(1 << 20),
    "no text": b"\xff\xfe\xfd" * 100,
    "a field of 50 MB": lambda: HEAD + b"x" * (50 << 20) + b",1,2,,,\n",
    "a quote that is never closed": lambda: HEAD + b'"' + b"x,1,2\n" * 1_000_000,
    "a line without end": lambda: b"path,lat,lon" + b",x" * 10_000_000,
    "columns that come twice": b"path,lat,lon,lat\na,1,2,3\n",
    "headings that come twice": b"path,lat,lon,heading,heading\na,1,2,3,4\n",
    "no columns": b"\n\n\n",
    "a name with a line break": b"\x1b[2J\npath\n",
    "ends of lines of old": b"path,lat,lon\ra.jpg,1,2\r" * 9,
}
LINES = {
    **{f"a latitude of {text!r}": f"0.jpg,{text},2,,,".encode() for text in (
        "nan", "inf", "1e400", "1_0", "0x10", "１２", "91", "-90.0001", "1e308", "1,5", "--1", "١", "1e", "9" * 5000)},
    **{f"a longitude of {text!r}": f"0.jpg,1,{text},,,".encode() for text in ("nan", "1_0", "181.5e9", "2 3")},
    **{f"a heading of {text!r}": f"0.jpg,1,2,{text},,".encode() for text in ("nan", "1_0", "inf", "1e300", "north")},
    **{f"a time of {text!r}": f"0.jpg,1,2,,{text},".encode() for text in (
        "yesterday", "2024-13-01", "9" * 100, "0000-01-01", "10000-01-01", "2024-05-31T25:00:00")},
    "a path with a NUL": b"0\x00.jpg,1,2,,,",
    "a path of 1 MB": b"a" * 1_000_000 + b",1,2,,,",
    "a path of 100,000 folders": b"a/" * 100_000 + b"x.jpg,1,2,,,",
    "too many fields": b"0.jpg,1,2,,,,,,,,",
    "no path": b",1,2,,,",
}  # fmt: skip
# NaN and the year 0 are what is not known; a heading may be a turn more or less.
HARMLESS = ("heading of 'nan'", "heading of '1e300'", "time of '0000-01-01'")


def positions() -> Iterator[Attack]:
    """`--table`, which says where photos were taken."""
    for what, content in TEXTS.items():
        # A table of no lines says nothing of anything.
        right = "harmless" if what in ("ends of lines of old", "a line without end") else "refused"
        yield Attack(f"a table is {what}", file("t.csv", content), right, _named(right, "t.csv"), POSITIONS)
    for what, line in LINES.items():
        right = "harmless" if any(word in what for word in HARMLESS) else "refused"
        if "path of" in what:  # no photo has it
            right = "harmless"
        yield Attack(
            f"a table with {what}", file("t.csv", HEAD + line + b"\n"), right, _named(right, "t.csv"), POSITIONS
        )
    for what, make in endless("t.csv").items():
        yield Attack(f"a table is {what}", make, "refused", "t.csv", POSITIONS)
    yield Attack(
        "a table of 5 GB of zeros", file("t.csv", HEAD, size=5 << 30), "refused", "t.csv", POSITIONS, long=True
    )
    climbing = HEAD + b"../outside/photo.jpg,1,2,,,\n/etc/passwd,1,2,,,\n"
    yield Attack("a table whose paths climb", file("t.csv", climbing), "harmless", "", POSITIONS)
    parquet = tuple(tuple(part.replace("t.csv", "t.parquet") for part in command) for command in POSITIONS)
    for what, content in {
        "nothing": b"",
        "text": b"PAR1 text PAR1",
        "a footer of 4 GB": b"PAR1" + bytes(100) + b"\xff\xff\xff\xff" + b"PAR1",
        "a footer of zeros": b"PAR1" + bytes(100) + b"\x40\0\0\0" + b"PAR1",
    }.items():
        yield Attack(f"Parquet is {what}", file("t.parquet", content), "refused", "t.parquet", parquet)
    for what, make in endless("t.parquet").items():
        yield Attack(f"Parquet is {what}", make, "refused", "t.parquet", parquet)


def _named(right: str, name: str) -> str:
    return name if right == "refused" else ""


# --- exports ---------------------------------------------------------------------------------------


def npy(shape: str, *, kind: str = "'<f2'", order: str = "False", body: bytes = b"") -> bytes:
    """A `.npy` file whose header says that."""
    return npy_of(f"{{'descr': {kind}, 'fortran_order': {order}, 'shape': {shape}, }}".encode(), body)


def npy_of(head: bytes, body: bytes = b"", *, version: bytes = b"\1\0", length: int | None = None) -> bytes:
    """A `.npy` file with that header, whatever it is."""
    size = struct.pack("<H" if version == b"\1\0" else "<I", len(head) if length is None else length)
    return b"\x93NUMPY" + version + size + head + body


def rows(count: int, number: float = 1 / 16) -> bytes:
    """Descriptors of length 1, or of that number."""
    out = io.BytesIO()
    np.save(out, np.full((count, DIM), number, np.float16))
    return out.getvalue()


def export(*, model: object = None, names: Mapping[str, bytes | Callable[[], bytes]] | None = None) -> Make:
    """A folder with descriptors and a table of one photo, which may be other files."""

    def make(scene: Scene) -> None:
        files = {"descriptors.npy": rows(1), "photos.csv": HEAD + b"0.jpg,1,2,,,\n"} | dict(names or {})
        if model is not None:
            files["model.json"] = model if isinstance(model, bytes) else json.dumps(model).encode()
        for name, content in files.items():
            (scene.given / name).write_bytes(content if isinstance(content, bytes) else content())

    return make


def _left_nothing(scene: Scene) -> list[str]:
    """An import that failed leaves no index."""
    return [f"{path.name} was left" for path in scene.work.iterdir() if path.name not in ("mine.index", "queries")]


def exports() -> Iterator[Attack]:
    """`salad index --from`: arrays, tables and JSON."""

    def taken(name: str, make: Make, right: str = "refused", names: str = "given", *, long: bool = False) -> Attack:
        also = _left_nothing if right == "refused" else None
        return Attack(f"an export: {name[:80]}", make, right, _named(right, names), TAKEN, also=also, long=long)  # type: ignore[arg-type]  # a literal

    for what, content in ARRAYS.items():
        yield taken(f"descriptors are {what}", export(names={"descriptors.npy": content}))
    for what, content in TEXTS.items():
        right = "harmless" if what in ("ends of lines of old",) else "refused"
        yield taken(f"its table is {what}", export(names={"photos.csv": content}), right)
    for what, line in LINES.items():
        easy = any(word in what for word in ("path of", *HARMLESS))
        yield taken(
            f"its table has {what}",
            export(names={"photos.csv": HEAD + line + b"\n"}),
            "harmless" if easy else "refused",
        )
    for text in ("x", "../x", "0" * 31, "0" * 33, "g" * 32, "0" * 1_000_000, "\x1b[2J"):
        content = HEAD + f"0.jpg,1,2,,,{text}\n".encode()
        yield taken(f"an identity of {text[:8]!r}, {len(text)} long", export(names={"photos.csv": content}))
    twice = {
        "photos.csv": HEAD + b"0.jpg,1,2,,,%b\n1.jpg,1,2,,,%b\n" % (b"0" * 32, b"0" * 32),
        "descriptors.npy": rows(2),
    }
    yield taken("an identity that comes twice", export(names=twice), "harmless")
    for name in ("descriptors.npy", "photos.csv"):
        for what, how in endless(name).items():

            def make(scene: Scene, name: str = name, how: Make = how) -> None:
                export()(scene)
                (scene.given / name).unlink()
                how(scene)

            yield taken(f"{name} is {what}", make)
    deep = 100_000
    for what, content in {
        "lists 100,000 deep": b"[" * deep,
        "objects 100,000 deep": b'{"features":' * deep,
        "no text": b"\xff",
        "a list": b"[]",
        "features that are none": b'{"features": 5}',
        "points that are none": b'{"features": [{"properties": {"path": "x"}, "geometry": {"coordinates": "ab"}}]}',
        "points of texts": b'{"features": [{"properties": {"path": "x"}, "geometry": {"coordinates": ["1", "2"]}}]}',
        "points of NaN": b'{"features": [{"properties": {"path": "x"}, "geometry": {"coordinates": [NaN, 1e999]}}]}',
        "points without end": b'{"features": [{"properties": {"path": "x"}, "geometry": {"coordinates": ['
        + b"1," * 999_999
        + b"1]}}]}",
        "a path that is a list": b'{"features": [{"properties": {"path": ["x"]}, "geometry": null}]}',
    }.items():  # fmt: skip

        def geojson(scene: Scene, content: bytes = content) -> None:
            (scene.given / "descriptors.npy").write_bytes(rows(1))
            (scene.given / "photos.geojson").write_bytes(content)

        # What is not known is NaN to many tools, and a point of many numbers begins with two.
        right = "harmless" if what in ("points of NaN", "points without end", "points of texts") else "refused"
        yield taken(f"GeoJSON is {what}", geojson, right)
    sound = {"kind": "salad export", "model": "theirs", "fingerprint": "theirs", "dim": DIM}
    for what, model in {
        "lists 100,000 deep": b"[" * deep,
        "a list": [],
        "of dim true": sound | {"dim": True},
        "of dim 10^30": sound | {"dim": 10**30},
        "of another kind": sound | {"kind": "x"},
        "of a number for a model": sound | {"model": 5},
        "of half a letter": sound | {"fingerprint": "\ud800"},
        "of letters that a terminal obeys": sound | {"model": "\x1b[2J"},
    }.items():
        right = "harmless" if "half" in what or "obeys" in what else "refused"
        yield taken(f"model.json is {what}", export(model=model), right)
    fixed = dict(sound)
    yield taken("model.json has 5 GB", lambda scene: (
        export(model=fixed)(scene), os.truncate(scene.given / "model.json", 5 << 30)))  # fmt: skip


ARRAYS: dict[str, bytes | Callable[[], bytes]] = {
    **{f"of shape {shape}": npy(shape) for shape in (
        "(1, 100000000000000000000000000)", "(100000000000000000000000000, 256)", "(True, True)", "(1, True)",
        "(-1, 256)", "(1, -256)", "(0, 0)", "(1, 0)", "()", "(256,)", "(1, 1, 256)", "(1.0, 256)", "('1', 256)",
        "[1, 256]", "1", "None", "(1, 2**40)", "(1 << 40, 256)", "(1, 256", "(4611686018427387904, 4)",
        "(1,) * 100000000", "(" * 5000 + ")" * 5000, "-" * 5000 + "1", "(1, 256),",
        "(9" + "9" * 5000 + ", 256)")},
    **{f"of type {kind}": npy("(1, 256)", kind=kind, body=bytes(512)) for kind in (
        "'|O'", "'<f16'", "'<i8'", "'<c8'", "'|V512'", "'<U99999999'", "[('a', '<f2')]", "'f2,f2'", "None", "5",
        "('<f2', (1000000000, 1000000000))", "'<M8[D]'", "'" + "x" * 5000 + "'")},
    "in another order": npy("(1, 256)", order="True", body=bytes(512)),
    "in no order": npy("(1, 256)", order="5", body=bytes(512)),
    "header of 4 GB": npy_of(b"{}", version=b"\2\0", length=0xFFFFFFFF),
    "header of 100 MB": lambda: npy_of(b" " * (100 << 20), version=b"\2\0"),
    "header of brackets": npy_of(b"[" * 60_000),
    "header of signs": npy_of(b"-" * 60_000 + b"1"),
    "header that runs something": npy_of(b"__import__('os').system('touch ran')"),
    "header of NULs": npy_of(bytes(100)),
    "header of no text": npy_of(b"\xff" * 100),
    "header of version 9": npy_of(b"{}", version=b"\x09\0"),
    "nothing": b"",
    "text": b"descriptors",
    "a pickle": pickle.dumps([1, 2, 3]),
    "NaN": rows(1, float("nan")),
    "zero": rows(1, 0.0),
    "too short": npy("(1, 256)", body=bytes(100)),
}  # fmt: skip


# --- judging -------------------------------------------------------------------------------------------


def judging() -> Iterator[Attack]:
    """`salad evaluate` and `salad datasets`: descriptors, rankings, truth, and layouts of strangers."""
    side = ("--descriptors", "{given}/a.npy", "{given}/a.npy")
    for number, (what, content) in enumerate(ARRAYS.items()):
        yield Attack(
            f"judged descriptors are {what[:60]}",
            file("a.npy", content),
            commands=((*JUDGED[0], *side),),
            names="a.npy",
            long=number % 8 > 0,  # they are read as an export's are
        )
    for what, make in endless("a.npy").items():
        yield Attack(f"judged descriptors are {what}", make, commands=((*JUDGED[0], *side),), names="a.npy")
    ranked = ((*JUDGED[0], "--rankings", "{given}/r.txt"),)
    truth = ((*JUDGED[0][:-2], "--truth", "{given}/r.txt"),)
    for name, commands in (("rankings", ranked), ("truth", truth)):
        for what, content in {
            "nothing": b"",
            "no text": b"\xff\xfe" * 50,
            "zeros": bytes(1 << 20),
            "a line without end": lambda: b"0.jpg " + b"1.jpg " * 5_000_000,
            "names that climb": b"../outside/photo.jpg ../../x /etc/passwd\n",
        }.items():
            yield Attack(f"{name} are {what}", file("r.txt", content), commands=commands, names="r.txt")
        for what, make in endless("r.txt").items():
            yield Attack(f"{name} are {what}", make, commands=commands, names="r.txt")
        yield Attack(
            f"{name} have 5 GB", file("r.txt", b"x", size=5 << 30), commands=commands, names="r.txt", long=True
        )
    checked: tuple[Command, ...] = (
        ("datasets", "check", "{given}"),
        ("evaluate", "--protocol", "sped", "--data", "{given}"),
        ("evaluate", "--protocol", "pitts30k-test", "--data", "{given}"),
        ("evaluate", "--protocol", "msls-val", "--data", "{given}"),
    )
    for name in ("ground_truth_new.npy", "SPED_gt.npy", "gt.npz", "pitts30k_test.mat", "dbstruct.mat", "gps.npy"):
        for what, content in STRANGE.items():
            yield Attack(
                f"a data set's {name} is {what}",
                _data(name, content),
                "harmless",
                commands=checked[:1],
                long=name != "gt.npz",
            )
    for end in ("npy", "npz", "mat", "csv", "txt"):
        for what, content in STRANGE.items():
            yield Attack(
                f"all of a data set's .{end} are {what}",
                _everywhere(end, content),
                "harmless",
                commands=checked,
                long=True,
            )
    for what, names in {
        "with 10^400 for a position": ["@1" + "0" * 200 + "@2@.jpg"],
        "with NaN for a position": ["@nan@nan@32@U@.jpg", "@inf@1@99@Z@.jpg"],
        "without end": ["@" * 120 + ".jpg"],
        "with digits of others": ["@１２@٣@10@S@.jpg"],
    }.items():

        def named(scene: Scene, names: list[str] = names) -> None:
            for name in names:
                (scene.given / name).write_bytes((scene.photos / "0.jpg").read_bytes())

        commands = (
            ("evaluate", "--references", "{given}", "--queries", "{given}", "--radius", "25"),
            ("index", "{given}", "--to", "{work}/new"),
        )
        yield Attack(f"names {what}", named, "harmless", commands=commands)


def _zip_bomb() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed, packed.open("utmDb.npy", "w") as one:
        one.write(npy("(1 << 30,)"))
        for _ in range(256):
            one.write(bytes(1 << 20))
    return out.getvalue()


class Running:
    """What a pickle runs when it is read."""

    def __reduce__(self) -> tuple[object, ...]:
        return os.system, ("touch ran",)


STRANGE: dict[str, bytes | Callable[[], bytes]] = {
    "a pickle that runs something": npy("(1,)", kind="'|O'", body=pickle.dumps(Running())),
    "a pickle without end": npy("(1,)", kind="'|O'", body=b"\x80\x02" + b"(" * 1_000_000),
    "a pickle that doubles": npy("(1,)", kind="'|O'", body=b"\x80\x02]" + b"q\0(h\0h\0l" * 60 + b"."),
    "a petabyte": npy("(1125899906842624,)"),
    "an array packed a thousandfold": _zip_bomb,
    "a struct of MATLAB": b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + struct.pack("<II", 14, 0xFFFFFFF0),
    "structs in structs of MATLAB": b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + b"\x0e\0\0\0\x00\x10\0\0" * 512,
    "nothing": b"",
}


def _data(name: str, content: bytes | Callable[[], bytes]) -> Make:
    def make(scene: Scene) -> None:
        for side in ("ref", "query", "references", "queries"):
            (scene.given / side).mkdir()
            (scene.given / side / "0.jpg").write_bytes((scene.photos / "0.jpg").read_bytes())
        (scene.given / name).write_bytes(content if isinstance(content, bytes) else content())

    return make


def _everywhere(end: str, content: bytes | Callable[[], bytes]) -> Make:
    """Wherever a layout looks for a file that ends so."""
    import re

    import salad

    layouts = Path(salad.__file__).parent / "datasets" / "readers"
    names = {
        name for file in layouts.glob("*.py") for name in re.findall(rf'"([\w/{{}}.-]+\.{end})"', file.read_text())
    }

    def make(scene: Scene) -> None:
        _data(f"x.{end}", content)(scene)
        for name in names:
            path = scene.given / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content if isinstance(content, bytes) else content())

    return make


ALL = [attack for some in (positions, exports, judging) for attack in some()]
