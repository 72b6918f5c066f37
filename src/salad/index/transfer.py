"""Descriptors and photos to other tools, and back.

An export is a folder: `descriptors.npy`, `photos.csv` (or `.parquet`, `.geojson`) with a line for each of its
rows in the same order, and `model.json`, which says whose descriptors they are. What another tool wrote is
taken as well: one `.npy` and one table in a folder; of which model they are, the user must say.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np

from salad.errors import PhotoError, PositionError, StoreError, WrongModelError
from salad.files import json_text
from salad.geo import GeoPoint
from salad.images.photo import Photo, content_hash
from salad.index import index_folder
from salad.index.index import Index
from salad.index.vectors import FileRows, NpyWriter, lengths
from salad.search.base import UNIT_TOLERANCE
from salad.tables import CsvError, read_csv, read_parquet, write_table

Form = Literal["csv", "parquet", "geojson"]
Put = Callable[[Sequence[Photo], Sequence[str]], None]
Record = Mapping[str, Any]

COLUMNS = ("path", "lat", "lon", "heading", "time", "identity")
_DEGREES = ("lat", "lon", "heading")

_KIND = "salad export"
_MODEL, _DESCRIPTORS, _PHOTOS = "model.json", "descriptors.npy", "photos"
_TABLES = (".csv", ".parquet", ".geojson")
_COMMIT = 1 << 24  # numbers taken in with one commit


@contextmanager
def writer(path: Path) -> Iterator[Put]:
    """Begin a table at `path`, of the form its name ends in; what it gives takes photos and their contents.

    CSV keeps every name, even one that is not UTF-8; Parquet cannot. GeoJSON has the photos as points, with null for
    those without a position.

    Raises:
        MissingExtraError: If it is to be Parquet, and what writes it is not installed.
    """
    kinds = {name: float if name in _DEGREES else str for name in COLUMNS}
    with _write_geojson(path) if path.suffix == ".geojson" else write_table(path, kinds) as write:

        def put(photos: Sequence[Photo], identities: Sequence[str]) -> None:
            strange = next((photo.path for photo in photos if not _is_text(str(photo.path))), None)
            if strange is not None and path.suffix == ".parquet":
                raise StoreError(
                    f"{os.fsencode(strange)!r} is not UTF-8, and Parquet holds no other names: export as csv"
                )
            pairs = zip(photos, identities, strict=True)
            write(photo.as_dict() | {"identity": identity} for photo, identity in pairs)

        yield put


@contextmanager
def _write_geojson(path: Path) -> Iterator[Callable[[Iterable[Record]], None]]:
    with path.open("w", encoding="utf-8") as file:
        between = ""
        file.write('{"type": "FeatureCollection", "features": [')

        def write(records: Iterable[Record]) -> None:
            nonlocal between
            for record in records:
                lat, lon = record["lat"], record["lon"]
                feature = {
                    "type": "Feature",
                    "geometry": None if lat is None else {"type": "Point", "coordinates": [lon, lat]},
                    "properties": {name: record[name] for name in COLUMNS if name not in ("lat", "lon")},
                }
                written = json_text(feature, indent=None) if _is_text(record["path"]) else json.dumps(feature)
                file.write(f"{between}\n{written}")  # names that are not UTF-8 are escaped
                between = ","

        yield write
        file.write("\n]}\n")


def _is_text(path: str) -> bool:
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True


def read(path: Path) -> Iterator[tuple[Photo, str | None]]:
    """The photos of a table, of the form its name ends in, with their contents where it tells them.

    Columns: `path` (seen from the table's folder), and `lat`, `lon`, `heading`, `time` and `identity` where
    they are known. More columns do no harm.

    Raises:
        StoreError: If the table cannot be read, or a line of it makes no sense; it is named.
        MissingExtraError: If it is Parquet, and what reads it is not installed.
    """
    done = 0
    try:
        for record in _records(path):
            yield _photo(record, path.parent)
            done += 1
    except OSError as error:
        raise StoreError(f"{path} cannot be read ({error}): check the name and permissions") from error
    except (ValueError, KeyError, TypeError, AttributeError, PositionError, CsvError) as error:
        raise StoreError(f"{path}, photo {done + 1}: {error}; correct it, or leave it out") from error


def _records(path: Path) -> Iterator[Record]:
    match path.suffix.lower():
        case ".geojson":
            for feature in json.loads(path.read_text(encoding="utf-8"))["features"]:
                record, point = dict(feature["properties"]), feature["geometry"]
                if point is not None:
                    # GeoJSON's order; a height may follow.
                    record["lon"], record["lat"], *_ = point["coordinates"]
                yield record
        case ".parquet":
            yield from (record for _, record in read_parquet(path))
        case _:
            for _, record in read_csv(path, _header, errors="surrogateescape"):
                if None in record:
                    raise ValueError("it has more fields than the first line (put names with commas in quotes)")
                yield record


def _header(names: list[str]) -> list[str]:
    header = [name.strip().lower() for name in names]
    if header.count("path") != 1:
        raise ValueError(f"it needs one column 'path', but has {', '.join(header) or 'none'}")
    return header


def _photo(record: Record, folder: Path) -> tuple[Photo, str | None]:
    path, time = record["path"], record.get("time")
    if not isinstance(path, str) or not path or "\0" in path:
        raise ValueError(f"{path!r} is no file's name")
    lat, lon, heading = (_degrees(record.get(name), name) for name in _DEGREES)
    if (lat is None) != (lon is None):
        raise ValueError(f"{path} has a latitude or a longitude, but not both")
    where = GeoPoint(lat, lon) if lat is not None and lon is not None else None
    when = time if isinstance(time, datetime) else datetime.fromisoformat(time) if time else None
    turned = heading if heading is None or 0 <= heading <= 360 else heading % 360
    return Photo(folder / path, where, turned, when), record.get("identity") or None


def _degrees(value: object, name: str) -> float | None:
    if value is None or value == "":
        return None
    with suppress(ValueError):
        number = float(str(value))
        if math.isnan(number):  # as pandas writes what is not known
            return None
        if abs(number) <= 1e6:  # not so large that a turn is lost in rounding
            return number
    raise ValueError(f"{name} {value!r} is not a number of degrees")


@dataclass(frozen=True, slots=True)
class Source:
    """Whose descriptors a folder holds: the model's name and fingerprint, and numbers in a descriptor."""

    model: str
    fingerprint: str
    dim: int


@dataclass(frozen=True, slots=True)
class Exported:
    """How many photos were written, and which were not, since their descriptors are damaged or lost."""

    photos: int
    damaged: list[Path]


def export(
    index: Index,
    folder: str | Path,
    *,
    form: Form = "csv",
    dtype: Literal["float16", "float32"] = "float16",
) -> Exported:
    """Write an index's descriptors and photos for other tools; memory stays small.

    Args:
        index: What to write; another program may add to it meanwhile.
        folder: Where to; it must not exist or be empty, and appears whole or not at all.
        form: Of the table of photos.
        dtype: Of the descriptors; as float32 they are the same numbers, in twice the room.

    Raises:
        StoreError: If the folder is in use or cannot be written, or the index is compacted meanwhile.
        MissingExtraError: If Parquet is asked for, and what writes it is not installed.
    """
    target = Path(os.path.realpath(folder))
    damaged: list[Path] = []
    with index_folder.drafted(target, "export") as draft:
        source = {"kind": _KIND, **asdict(Source(index.model, index.fingerprint, index.dim))}
        (draft / _MODEL).write_text(json.dumps(source, indent=2) + "\n", encoding="utf-8")
        with (
            writer(draft / f"{_PHOTOS}.{form}") as put,
            NpyWriter(draft / _DESCRIPTORS, dim=index.dim, dtype=dtype) as file,
        ):
            for page in index.pages():
                put(page.photos, page.identities)
                file.write(page.descriptors)
                damaged += page.damaged
    return Exported(file.rows, damaged)


def model_of(folder: str | Path, *, name: str | None = None) -> Source:
    """Whose descriptors a folder holds.

    Another tool's folder does not say; then `name` tells the model, and stands, with the dimension, for its
    fingerprint.

    Raises:
        StoreError: If the folder holds no descriptors, does not say of which model and no name is given, or
            is damaged.
    """
    rows = _rows_in(Path(folder))
    path = Path(folder, _MODEL)
    if not path.exists():
        if not name:
            raise StoreError(f"{folder} does not say which model its descriptors are of: name it with --model")
        digest = hashlib.blake2b(f"{rows.dim} {name}".encode(), digest_size=8).hexdigest()
        return Source(name, f"foreign-{digest}", rows.dim)
    damaged = StoreError(f"{path} is damaged or not of a salad export: export again, or delete it and name --model")
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        source = Source(fields["model"], fields["fingerprint"], fields["dim"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise damaged from error
    kinds = [type(value) for value in (source.model, source.fingerprint, source.dim)]
    if fields.get("kind") != _KIND or kinds != [str, str, int]:
        raise damaged
    if source.dim != rows.dim:
        raise StoreError(
            f"{path} says descriptors of {source.dim} numbers, but {rows.path} holds {rows.dim}: export again"
        )
    return source


def take(index: Index, folder: str | Path, *, model: str | None = None) -> int:
    """Take in the descriptors and photos of a folder: an export's, or another tool's `.npy` and table.

    The table has a line for each row, in order, with the columns `path` and, where known, `lat`, `lon`,
    `heading`, `time`. A photo whose file is not on this machine goes by its path instead of its content. Rows
    must have length 1: what was measured with others is another likeness than the index's. Interrupted, it
    goes on when called again.

    Args:
        index: Where to.
        folder: Where from.
        model: The model that made them, where the folder does not say; who names the index's own vouches
            for it.

    Returns:
        How many photos were new.

    Raises:
        WrongModelError: If the descriptors are of another model than the index's.
        StoreError: If the folder cannot be read, or makes no sense; nothing of it was added.
    """
    source = model_of(folder, name=model or index.model)
    # Another tool's folder says nothing of a model: whoever names the index's own vouches that it made them.
    vouched = model == index.model and not Path(folder, _MODEL).exists() and source.dim == index.dim
    if source.fingerprint != index.fingerprint and not vouched:
        raise wrong_model(index, Path(folder), source.model, source.fingerprint)
    rows = _rows_in(Path(folder))
    table = _one_of(Path(folder), _TABLES, _PHOTOS, "a table of photos")
    photos = sum(1 for _ in read(table))
    if photos != rows.rows:
        raise StoreError(
            f"{table} lists {photos} photos, but {rows.path} holds {rows.rows} descriptors: they must be as many, "
            "in the same order"
        )
    for start, block in rows.blocks():
        found = lengths(block)
        bad = (~(np.abs(found - 1) <= UNIT_TOLERANCE)).nonzero()[0]
        if len(bad):
            raise StoreError(
                f"{rows.path}, row {start + bad[0]}: its length is {found[bad[0]]:g}, not 1; divide each row by "
                "its length (rows / numpy.linalg.norm(rows, axis=1, keepdims=True)), if the model's likeness is "
                "the cosine"
            )
    lines, added = read(table), 0  # read once more: a million photos need not be in memory
    for _, some in rows.blocks(numbers=_COMMIT):
        page = list(islice(lines, len(some)))
        contents = [content or _content(photo) for photo, content in page]
        added += index.add([photo for photo, _ in page], some, identities=contents)
    return added


def wrong_model(index: Index, folder: Path, model: str, fingerprint: str) -> WrongModelError:
    """The sentence for descriptors in `folder` that are of another model than the index's."""
    return WrongModelError(
        f"{index.folder} was made with {index.model} ({index.fingerprint}), but {folder} holds descriptors of "
        f"{model} ({fingerprint}): take them into an index of their own"
    )


def _rows_in(folder: Path) -> FileRows:
    return FileRows.of_npy(_one_of(folder, (".npy",), Path(_DESCRIPTORS).stem, "descriptors"))


def _one_of(folder: Path, endings: Sequence[str], ours: str, what: str) -> Path:
    """The file named as we name it, else the only one with such an ending."""
    try:
        found = sorted(file for file in folder.iterdir() if file.suffix.lower() in endings)
    except OSError as error:
        raise StoreError(f"{folder} cannot be read ({error.strerror}): give the folder of an export") from error
    found = [file for file in found if file.stem == ours] or found
    if len(found) != 1:
        raise StoreError(
            f"{folder} holds {len(found) or 'no'} files that could be {what} ({', '.join(endings)}): it must hold one"
        )
    return found[0]


def _content(photo: Photo) -> str:
    """What tells the photo from others: its file's content or, where there is no such file, its path."""
    try:
        return content_hash(photo.path)
    except PhotoError:
        path = os.fsencode(os.path.realpath(photo.path))
        return hashlib.blake2b(b"no file: " + path, digest_size=16).hexdigest()


@dataclass(frozen=True, slots=True)
class Merged:
    """What `merge` did.

    Attributes:
        added: Photos that are new in the index.
        held: Photos whose content it held already.
        other: Photos left out since the index holds another content at their path.
        damaged: Photos left out since their descriptors are damaged or lost.
    """

    added: int
    held: int
    other: list[Path]
    damaged: list[Path]


def merge(into: Index, other: Index) -> Merged:
    """Take the photos of another index of the same model; each content is held once.

    A content both hold keeps its place in `into`, which learns what only the other knows of it. Where both
    have a photo at one path with different contents, `into` keeps its own. Interrupted, it goes on when
    called again.

    Raises:
        WrongModelError: If they are of different models.
        StoreError: If `into` cannot be written, or `other` is compacted meanwhile.
    """
    if other.fingerprint != into.fingerprint:
        raise wrong_model(into, other.folder, other.model, other.fingerprint)
    added, held, left, damaged = 0, 0, list[Path](), list[Path]()
    for page in other.pages():
        known = into.find(page.identities)
        taken = into.taken([photo.path for photo in page.photos])
        news = list(zip(page.photos, page.identities, strict=True))
        fresh = [n for n, (photo, content) in enumerate(news) if content not in known and photo.path not in taken]
        added += into.add(
            [page.photos[n] for n in fresh],
            page.descriptors[fresh],
            identities=[page.identities[n] for n in fresh],
        )
        # What only the other index knows of the photos both hold.
        filled = {
            content: replace(
                known[content],
                where=known[content].where or photo.where,
                heading=photo.heading if known[content].heading is None else known[content].heading,
                time=known[content].time or photo.time,
            )
            for photo, content in news
            if content in known
        }
        if learned := [content for content, photo in filled.items() if photo != known[content]]:
            into.update([filled[content] for content in learned], learned)
        held += len(known)
        left += [photo.path for photo, content in news if content not in known and photo.path in taken]
        damaged += page.damaged
    return Merged(added, held, left, damaged)
