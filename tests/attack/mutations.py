"""Sound things with something wrong in them, put to whatever reads them: a value or a sentence comes of each.

A mutation is drawn from its seed alone: bits flipped, parts cut, put in twice, exchanged or overwritten by numbers at
the edge of what fits; and, where a file is JSON or a table of SQLite, a value of it that is something else.
"""

from __future__ import annotations

import io
import json
import random
import shutil
import sqlite3
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

EDGES = (b"\0", b"\xff", b"\x7f", b"\x80", b"\0" * 4, b"\xff" * 4, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0" * 8,
         b"\xff" * 8, b"\x7f" + b"\xff" * 7, b"\xff" * 7 + b"\x7f", b"\0\0\0\1", b"\n", b'"', b",",
         b"\xed\xa0\x80")  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2**31, 2**62, 2**63, -(2**63), 10**30, 10**400, 0.5, -0.0, 1e308, float("nan"),
    float("inf"), "", "x", "../../x", "/etc/passwd", "\0", "\ud800", "\x1b[2J", "9" * 5000, [], {}, [[]], {"": None},
    [0] * 300, "1_0", "１", "nan", "2024-01-01",
)  # fmt: skip
OF_SQLITE: tuple[Any, ...] = (
    None, 0, 1, -1, 2**31, 2**40, 2**62, 2**63 - 1, -(2**63), 0.5, 1e308, float("inf"), "", "x", "../x.f16", "\x1b[2J",
    b"", b"\xff\xfe", b"\0" * 40, "9" * 5000, "2024-13-01", "descriptors.f16", "codes-1.i8",
)  # fmt: skip


class Reader(NamedTuple):
    """What is mutated, and what reads it.

    Attributes:
        files: Names in folders of sound things, one of which is mutated.
        read: Given the folder of what came of it, and that one's path, reads it.
        share: Of all mutations, which is the less the longer it takes.
    """

    files: tuple[str, ...]
    read: Callable[[Path, Path], object]
    share: float = 1.0


def put(name: str, seeds: Sequence[int], folder: Path) -> None:
    """Put a mutation for each seed to a reader; each seed is a line of stdout, with what went wrong behind it.

    Args:
        name: Of `READERS`.
        seeds: Of mutations.
        folder: Holds `sound`, a folder of what is mutated; `mutated` is made in it, anew for each.
    """
    from salad.errors import SaladError

    warnings.simplefilter("ignore")  # of libraries, to people who see no log
    reader, work = READERS[name], folder / "mutated"
    for seed in seeds:
        print(seed, flush=True)  # noqa: T201  # so that it is known which one ended the process
        chance = random.Random(seed)
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(folder / "sound" / _first(reader.files[0]), work)
        path = work / chance.choice(reader.files).partition("/")[2]
        try:
            mutate(path, chance)
            reader.read(work, path)
        except SaladError as error:
            if not str(error).strip():
                print(seed, "says nothing")  # noqa: T201
        except BaseException as error:
            at = traceback.extract_tb(sys.exc_info()[2])[-1]
            told = f"{type(error).__name__}: {error} at {at.filename}:{at.lineno}"
            print(seed, told.replace("\n", " ")[:400].encode("ascii", "backslashreplace").decode())  # noqa: T201


def _first(name: str) -> str:
    return name.partition("/")[0]


# --- what is made wrong --------------------------------------------------------------------------


def mutate(path: Path, chance: random.Random) -> None:
    """Change a file in some way."""
    if path.suffix in (".json", ".geojson") and chance.random() < 0.6:
        path.write_bytes(another_value(path.read_bytes(), chance))
    elif path.suffix == ".sqlite" and chance.random() < 0.5:
        other_cells(path, chance)
    else:
        path.write_bytes(other_bytes(path.read_bytes(), chance))


def other_bytes(raw: bytes, chance: random.Random) -> bytes:
    """Bytes that differ in one to eight places, more often near the beginning, where headers are."""
    made = bytearray(raw)
    for _ in range(chance.choice((1, 1, 1, 2, 4, 8))):
        size = len(made)
        near = size if chance.random() < 0.5 else min(size, 400)
        at, long = chance.randrange(near + 1), chance.choice((1, 2, 4, 8, 50, max(1, size // 3)))
        match chance.randrange(7):
            case 0 | 1 if at < size:
                made[at] ^= 1 << chance.randrange(8)
            case 2:
                edge = chance.choice(EDGES)
                made[at : at + len(edge)] = edge
            case 3:
                del made[at : at + long]
            case 4:
                made[at:at] = made[at : at + long] or b"\0"
            case 5:
                other = chance.randrange(size + 1)
                made[at : at + long], made[other : other + long] = made[other : other + long], made[at : at + long]
            case _:
                if chance.random() < 0.3:
                    del made[at:]
                else:
                    made[at:at] = chance.randbytes(min(long, 1000))
    return bytes(made)


def another_value(raw: bytes, chance: random.Random) -> bytes:
    """JSON of which a value, or a name, is another."""
    whole = json.loads(raw)
    places: list[tuple[Any, Any]] = []
    left = [whole]
    while left:
        inner = left.pop()
        keys = list(inner) if isinstance(inner, dict) else range(len(inner)) if isinstance(inner, list) else ()
        places += [(inner, key) for key in keys]
        left += [inner[key] for key in keys]
    for inner, key in chance.sample(places, min(len(places), chance.choice((1, 1, 2, 3)))):
        if isinstance(inner, dict) and key in inner and chance.random() < 0.15:
            inner[chance.choice(("x", ""))] = inner.pop(key)
        elif isinstance(inner, list) and chance.random() < 0.15:
            inner.append(chance.choice(VALUES))
        else:
            inner[key] = chance.choice(VALUES)
    sys.set_int_max_str_digits(0)
    text = json.dumps(whole)
    sys.set_int_max_str_digits(4300)
    return text.encode()


def other_cells(path: Path, chance: random.Random) -> None:
    """A table of SQLite with other values in some cells."""
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("PRAGMA ignore_check_constraints = ON")
        tables = [name for (name,) in db.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")]
        for _ in range(chance.choice((1, 1, 2, 4))):
            table = chance.choice(tables)
            column = chance.choice([name for _, name, *_ in db.execute(f"PRAGMA table_info({table})")])
            ((count,),) = db.execute(f"SELECT COUNT(*) FROM {table}")
            where = f"rowid IN (SELECT rowid FROM {table} LIMIT 1 OFFSET {chance.randrange(count or 1)})"
            try:
                value = chance.choice(OF_SQLITE)
                db.execute(
                    f"UPDATE {table} SET {column} = ? {'' if chance.random() < 0.2 else 'WHERE ' + where}", (value,)
                )
            except sqlite3.Error:  # a value that the schema does not take
                continue


# --- who reads it ------------------------------------------------------------------------------------


def an_index(folder: Path, _: Path) -> None:
    """Everything that is done with an index."""
    from salad.errors import SaladError
    from salad.images.photo import Photo
    from salad.index.index import Index
    from salad.search.filters import Filter

    query = np.full(16, 0.25, np.float32)
    with Index.open(folder, wait=0) as index:
        looks: list[Callable[[], object]] = [
            index.info,
            index.verify,
            lambda: index.search(query, k=4),
            lambda: index.search(query, k=4, where=Filter(heading=10.0), centred=True),
            lambda: list(index.photos()),
            lambda: list(index.pages()),
            index.missing,
            index.wants_codes,
            lambda: index.add([Photo(Path("/p/new.jpg"))], query[None], identities=["f" * 32]),
            lambda: index.remove([Path("/p/1.jpg")]),
            index.compress,
            index.compact,
            index.verify,
        ]
        for look in looks:
            try:
                look()
            except SaladError:  # a sentence; the others are asked all the same
                continue


def a_photo(_: Path, path: Path) -> None:
    from salad.errors import PhotoError
    from salad.images.decode import decode
    from salad.images.photo import content_hash, read_photo

    content_hash(path)
    try:
        decode(path, 32, 32)
    except PhotoError:
        read_photo(path)
        raise
    read_photo(path)


def beside(folder: Path, _: Path) -> None:
    from salad.images.photo import sayings

    sayings(folder / "a.jpg")


def a_table(_: Path, path: Path) -> None:
    from salad.images.photo_table import PhotoTable

    PhotoTable.read(path).get("/p/0.jpg")


def an_export(folder: Path, _: Path) -> None:
    from salad.index.index import Index
    from salad.index.transfer import model_of, take

    source = model_of(folder)
    with Index.create(folder / "new", dim=source.dim, fingerprint=source.fingerprint, model=source.model) as index:
        take(index, folder)
        index.verify()


def a_result(folder: Path, path: Path) -> None:
    from salad.evaluation.result import as_csv, read_result
    from salad.evaluation.significance import differences
    from salad.report.evaluation_page import write_report

    result = read_result(path)
    as_csv(result)
    write_report(result, folder / "page.html")
    differences(result, result, times=10)


def a_model(folder: Path, _: Path) -> None:
    import hashlib

    from salad.models.model_folder import load

    # A checksum that does not fit would keep all else from being read.
    try:
        config = json.loads((folder / "config.json").read_bytes())
        for name in config["files"]:
            if (folder / name).is_file():
                config["files"][name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        (folder / "config.json").write_text(json.dumps(config))
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    load(folder)


def an_array(_: Path, path: Path) -> None:
    from salad.datasets.safe_numpy import read_npy, read_npz

    if path.suffix == ".npz":
        read_npz(path)
    else:
        arrays = read_npy(path)
        for take in (arrays.numbers, arrays.rows, arrays.texts):
            take()


def matlab(_: Path, path: Path) -> None:
    from salad.datasets.matlab import read_struct

    read_struct(path, "dbStruct")


READERS: dict[str, Reader] = {
    "the table of an index": Reader(("index/photos.sqlite",), an_index, share=0.3),
    "an index": Reader(
        tuple(f"index/{name}" for name in ("index.json", "descriptors.f16", "codes-2.i8", "photos.sqlite-journal")),
        an_index,
        share=0.3,
    ),
    "a photo": Reader(
        tuple(f"photos/a.{end}" for end in ("jpg", "png", "webp", "tif", "bmp", "gif", "ppm", "jp2", "avif", "mpo")),
        a_photo,
    ),
    "EXIF": Reader(("photos/exif.jpg", "photos/exif.png", "photos/exif.webp"), a_photo),
    "a RAW photo": Reader(("raw/a.dng",), a_photo, share=0.3),
    "what lies beside a photo": Reader(("beside/a.jpg.xmp", "beside/a.xmp", "beside/a.jpg.json"), beside),
    "a table": Reader(("tables/t.csv",), a_table),
    "a table of Parquet": Reader(("tables/t.parquet",), a_table, share=0.1),  # a process looks at each beforehand
    "an export": Reader(("export/descriptors.npy", "export/photos.csv", "export/model.json"), an_export, share=0.3),
    "GeoJSON": Reader(("export-geojson/photos.geojson",), an_export, share=0.3),
    "a result": Reader(("results/r.json",), a_result),
    "a model": Reader(("model/config.json", "model/model.safetensors", "model/graph.onnx"), a_model, share=0.1),
    "an array": Reader(("arrays/numbers.npy", "arrays/objects.npy", "arrays/both.npz"), an_array),
    "a file of MATLAB": Reader(("matlab/s.mat",), matlab),
}


# --- sound things ----------------------------------------------------------------------------------


def prepare(folder: Path) -> None:
    """Make `sound` in a folder: one thing of each kind that is read."""
    from salad.index.index import Index
    from salad.index.transfer import export

    sound = folder / "sound"
    sound.mkdir(parents=True)
    chance = np.random.default_rng(0)
    rows = chance.standard_normal((12, 16))
    photos = [_photo(number) for number in range(12)]
    with Index.create(sound / "index", dim=16, fingerprint="f", model="fake") as index:
        index.add(
            photos, rows / np.linalg.norm(rows, axis=1, keepdims=True), identities=[f"{n:032x}" for n in range(12)]
        )
        index.remove([photos[3].path])
        index.compress(8)
        export(index, sound / "export")
        export(index, sound / "export-geojson", form="geojson")
        export(index, sound / "parquet", form="parquet")
    (sound / "tables").mkdir()
    shutil.copy(sound / "export" / "photos.csv", sound / "tables" / "t.csv")
    shutil.copy(sound / "parquet" / "photos.parquet", sound / "tables" / "t.parquet")
    codes = next((sound / "index").glob("codes-*.i8"))
    codes.rename(sound / "index" / "codes-2.i8")
    with closing(sqlite3.connect(sound / "index" / "photos.sqlite", isolation_level=None)) as db:
        db.execute("UPDATE codes SET file = 'codes-2.i8'")
        # As a process that is killed in the middle of a change leaves it.
        db.execute("PRAGMA synchronous = OFF")
        db.execute("BEGIN")
        db.execute("UPDATE photos SET heading = heading + 1")
        journal = (sound / "index" / "photos.sqlite-journal").read_bytes()
        db.execute("ROLLBACK")
    (sound / "index" / "photos.sqlite-journal").write_bytes(journal)
    _photos(sound / "photos")
    _beside(sound / "beside")
    _arrays(sound / "arrays")
    _rest(sound)


def _photo(number: int) -> Any:
    from datetime import datetime

    from salad.geo import GeoPoint
    from salad.images.photo import Photo

    return Photo(
        Path(f"/p/{number}.jpg"), GeoPoint(48.0 + number / 100, 11.0), 30.0 * number, datetime(2024, 5, 1 + number)
    )


def _photos(folder: Path) -> None:
    from datetime import datetime

    from PIL import Image, features

    from images.test_raw import picture as jpeg
    from images.test_raw import raw
    from salad.geo import GeoPoint
    from salad.images.exif import to_exif
    from salad.images.metadata import Position

    folder.mkdir()
    picture = Image.fromarray(np.random.default_rng(1).integers(0, 256, (24, 24, 3), dtype=np.uint8))
    for end, form in {"jpg": "JPEG", "png": "PNG", "webp": "WEBP", "tif": "TIFF", "bmp": "BMP", "gif": "GIF",
                      "ppm": "PPM", "jp2": "JPEG2000", "avif": "AVIF", "mpo": "MPO"}.items():  # fmt: skip
        if form == "AVIF" and not features.check("avif"):  # a Pillow without it: another photo stands in
            form = "PNG"
        picture.save(folder / f"a.{end}", form)
    exif = to_exif(Position(GeoPoint(48.1, 11.5), 30.0, datetime(2024, 5, 1, 12)))
    for end in ("jpg", "png", "webp"):
        picture.save(folder / f"exif.{end}", exif=exif)
    (folder.parent / "raw").mkdir()
    (folder.parent / "raw" / "a.dng").write_bytes(raw(jpeg(1200, 900), jpeg(160, 120)))


def _beside(folder: Path) -> None:
    folder.mkdir()
    (folder / "a.jpg.json").write_text(json.dumps({
        "title": "a.jpg", "photoTakenTime": {"timestamp": "1714564800"},
        "geoData": {"latitude": 48.1, "longitude": 11.5}, "geoDataExif": {"latitude": 0.0, "longitude": 0.0},
    }))  # fmt: skip
    for name, place in (
        ("a.jpg.xmp", ' exif:GPSLatitude="48,6.0N" exif:GPSLongitude="11,30.0E" exif:GPSImgDirection="2758/10"'),
        ("a.xmp", ' drone-dji:GpsLatitude="+48.1" drone-dji:GpsLongitude="+11.5" drone-dji:GimbalYawDegree="-84.2"'),
    ):
        (folder / name).write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
            '<rdf:Description xmlns:exif="http://ns.adobe.com/exif/1.0/" '
            f'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"{place}>'
            "<exif:DateTimeOriginal>2024-05-01T12:00:00+02:00</exif:DateTimeOriginal>"
            "</rdf:Description></rdf:RDF></x:xmpmeta>"
        )


def _arrays(folder: Path) -> None:
    folder.mkdir()
    ragged = np.empty(4, dtype=object)
    ragged[:] = [np.arange(n) for n in range(4)]
    np.save(folder / "numbers.npy", np.arange(24.0).reshape(12, 2))
    np.save(folder / "objects.npy", ragged, allow_pickle=True)
    np.savez_compressed(folder / "both.npz", a=np.arange(9), b=ragged, c=np.array(["x", "yy"]))


def _rest(sound: Path) -> None:
    from scipy.io import savemat

    from attack.hostile_models import SHIPPED
    from attack.hostile_results import result

    for name in ("results", "matlab"):
        (sound / name).mkdir()
    (sound / "results" / "r.json").write_text(json.dumps(result()))
    struct = {
        "dbImage": np.array([["a.jpg"], ["b.jpg"]], dtype=object),
        "utmDb": np.arange(4.0).reshape(2, 2),
        "x": {"y": 1.0},
    }
    made = io.BytesIO()
    savemat(made, {"dbStruct": struct})
    (sound / "matlab" / "s.mat").write_bytes(made.getvalue())
    shutil.copytree(SHIPPED, sound / "model")
