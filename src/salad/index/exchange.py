"""Descriptors and photos to other tools, and back.

An export is a folder: `descriptors.npy`, `photos.csv` (or `.parquet`, `.geojson`) with a line for each of its
rows in the same order, and `model.json`, which says whose descriptors they are. What another tool wrote is
taken as well: one `.npy` and one table in a folder; of which model they are, the user must say.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np

from salad.errors import PhotoError, StoreError, WrongModelError
from salad.index import forms, layout, matrix
from salad.index.npy import Matrix, Writer
from salad.index.store import Index
from salad.photos import Photo, identity

_KIND = "salad export"
_MODEL, _DESCRIPTORS, _PHOTOS = "model.json", "descriptors.npy", "photos"
_TABLES = (".csv", ".parquet", ".geojson")
_COMMIT = 1 << 24  # numbers taken in with one commit


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


# --- out -----------------------------------------------------------------------------------


def export(
    index: Index,
    folder: str | Path,
    *,
    form: forms.Form = "csv",
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
    with layout.drafted(target, "export") as draft:
        told = {"kind": _KIND, **asdict(Source(index.model, index.fingerprint, index.dim))}
        (draft / _MODEL).write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
        with (
            forms.writer(draft / f"{_PHOTOS}.{form}") as put,
            Writer(draft / _DESCRIPTORS, dim=index.dim, dtype=dtype) as file,
        ):
            for page in index.pages():
                put(page.photos, page.identities)
                file.write(page.descriptors)
                damaged += page.damaged
    return Exported(file.rows, damaged)


# --- in ------------------------------------------------------------------------------------


def model_of(folder: str | Path, *, name: str | None = None) -> Source:
    """Whose descriptors a folder holds.

    Another tool's folder does not say; then `name` tells the model, and stands, with the dimension, for its
    fingerprint.

    Raises:
        StoreError: If the folder holds no descriptors, does not say of which model and no name is given, or
            is damaged.
    """
    found = _matrix_in(Path(folder))
    told = Path(folder, _MODEL)
    if told.exists():
        source = _told(told)
        if source.dim != found.dim:
            raise StoreError(
                f"{told} says descriptors of {source.dim} numbers, but {found.path} holds {found.dim}: export again"
            )
        return source
    if not name:
        raise StoreError(f"{folder} does not say which model its descriptors are of: name it with --model")
    return Source(name, _fingerprint(name, found.dim), found.dim)


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
    _check_model(index, Path(folder), model)
    rows, table = _matrix_in(Path(folder)), _table_in(Path(folder))
    photos = sum(1 for _ in forms.read(table))
    if photos != rows.rows:
        raise StoreError(
            f"{table} lists {photos} photos, but {rows.path} holds {rows.rows} descriptors: they must be as many, "
            "in the same order"
        )
    _check_lengths(rows)
    lines, added = forms.read(table), 0
    for some in rows.blocks(numbers=_COMMIT):
        page = list(islice(lines, len(some)))
        contents = [told or _content(photo) for photo, told in page]
        added += index.add([photo for photo, _ in page], some, identities=contents)
    return added


def _check_model(index: Index, folder: Path, model: str | None) -> None:
    source = model_of(folder, name=model or index.model)
    vouched = model == index.model and not (folder / _MODEL).exists() and source.dim == index.dim
    if source.fingerprint != index.fingerprint and not vouched:
        raise wrong_model(index, folder, source.model, source.fingerprint)


def wrong_model(index: Index, folder: Path, model: str, fingerprint: str) -> WrongModelError:
    """The sentence for descriptors in `folder` that are of another model than the index's."""
    return WrongModelError(
        f"{index.folder} was made with {index.model} ({index.fingerprint}), but {folder} holds descriptors of "
        f"{model} ({fingerprint}): take them into an index of their own"
    )


def _told(path: Path) -> Source:
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        source = Source(fields["model"], fields["fingerprint"], fields["dim"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _damaged(path) from error
    whole = isinstance(source.model, str) and isinstance(source.fingerprint, str)
    if fields.get("kind") != _KIND or not whole or not isinstance(source.dim, int):
        raise _damaged(path)
    return source


def _damaged(path: Path) -> StoreError:
    return StoreError(
        f"{path} is damaged or not of a salad export: export again, or delete it and name --model"
    )


def _fingerprint(name: str, dim: int) -> str:
    return f"foreign-{hashlib.blake2b(f'{dim} {name}'.encode(), digest_size=8).hexdigest()}"


def _matrix_in(folder: Path) -> Matrix:
    return Matrix.open(_one_of(folder, (".npy",), Path(_DESCRIPTORS).stem, "descriptors"))


def _table_in(folder: Path) -> Path:
    return _one_of(folder, _TABLES, _PHOTOS, "a table of photos")


def _one_of(folder: Path, endings: Sequence[str], ours: str, what: str) -> Path:
    """The file named as we name it, else the only one with such an ending."""
    try:
        found = sorted(file for file in folder.iterdir() if file.suffix.lower() in endings)
    except OSError as error:
        raise StoreError(
            f"{folder} cannot be read ({error.strerror}): give the folder of an export"
        ) from error
    found = [file for file in found if file.stem == ours] or found
    if len(found) != 1:
        raise StoreError(
            f"{folder} holds {len(found) or 'no'} files that could be {what} ({', '.join(endings)}): it must hold one"
        )
    return found[0]


def _check_lengths(rows: Matrix) -> None:
    start = 0
    for block in rows.blocks():
        with np.errstate(all="ignore"):
            lengths = np.linalg.norm(block.astype(np.float32), axis=1)
        bad = (~(np.abs(lengths - 1) <= matrix.UNIT_TOLERANCE)).nonzero()[0]
        if len(bad):
            raise StoreError(
                f"{rows.path}, row {start + bad[0]}: its length is {lengths[bad[0]]:g}, not 1; divide each row by "
                "its length (rows / numpy.linalg.norm(rows, axis=1, keepdims=True)), if the model's likeness is "
                "the cosine"
            )
        start += len(block)


def _content(photo: Photo) -> str:
    """What tells the photo from others: its file's content or, where there is no such file, its path."""
    try:
        return identity(photo.path)
    except PhotoError:
        path = os.fsencode(os.path.realpath(photo.path))
        return hashlib.blake2b(b"no file: " + path, digest_size=16).hexdigest()
