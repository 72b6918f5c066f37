"""Descriptors and photos to other tools, and back.

An export is a folder: `descriptors.npy`, `photos.csv` (or `.parquet`, `.geojson`) with a line for each of its
rows in the same order, and `model.json`, which says whose descriptors they are. What another tool wrote is
taken as well: one `.npy` and one table in a folder; of which model they are, the user must say.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np

from salad.errors import PhotoError, StoreError, WrongModelError
from salad.files import read_json
from salad.geo import null_island
from salad.images.photo import Photo, content_hash
from salad.index import index_folder
from salad.index.index import Index
from salad.index.photo_list import read, writer
from salad.index.vectors import FileRows, NpyWriter, lengths
from salad.search.base import UNIT_TOLERANCE

Form = Literal["csv", "parquet", "geojson"]

_KIND = "salad export"
_MODEL, _DESCRIPTORS, _PHOTOS = "model.json", "descriptors.npy", "photos"
_TABLES = (".csv", ".parquet", ".geojson")
_COMMIT = 1 << 24  # numbers taken in with one commit
_LONGEST = 1 << 16  # bytes of what says whose descriptors they are
_LONGEST_NAME = 1000


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
        fields = read_json(path, most=_LONGEST)
        source = Source(fields["model"], fields["fingerprint"], fields["dim"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise damaged from error
    if fields.get("kind") != _KIND or not _is_name(source.model) or not _is_name(source.fingerprint):
        raise damaged
    if type(source.dim) is not int:
        raise damaged
    if source.dim != rows.dim:
        raise StoreError(
            f"{path} says descriptors of {source.dim} numbers, but {rows.path} holds {rows.dim}: export again"
        )
    return source


def take(
    index: Index,
    folder: str | Path,
    *,
    model: str | None = None,
    on_null_island: Callable[[Photo], None] | None = None,
) -> int:
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
        on_null_island: Takes each photo of which the folder says 0,0, which counts as no position.

    Returns:
        How many photos were new.

    Raises:
        WrongModelError: If the descriptors are of another model than the index's.
        StoreError: If the folder cannot be read, or makes no sense; nothing of it was added.
    """
    source = model_of(folder, name=model or index.model)
    # Another tool's folder says nothing of a model: whoever names the index's own vouches that it made them.
    ours = Path(folder, _MODEL).exists()
    vouched = model == index.model and not ours and source.dim == index.dim
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
        placed = [_settled(photo, ours=ours, on_null_island=on_null_island) for photo, _ in page]
        added += index.add(placed, some, identities=contents)
    return added


def _settled(photo: Photo, *, ours: bool, on_null_island: Callable[[Photo], None] | None) -> Photo:
    """A photo of a list with who says where it was: the list itself, where it is another tool's; and not at 0,0."""
    if null_island(photo.where):
        photo = replace(photo, where=None, source=None)
        if on_null_island is not None:
            on_null_island(photo)
    return photo if ours or photo.where is None else replace(photo, source="table")


def take_as_new(
    to: str | Path,
    folder: str | Path,
    *,
    model: str | None = None,
    on_null_island: Callable[[Photo], None] | None = None,
) -> int:
    """Make an index of what `take` takes, which appears whole or not at all, whatever happens meanwhile.

    Args:
        to: The index's folder; nothing is there, or an empty folder.
        folder: Where from.
        model: The model that made the descriptors, where the folder does not say.
        on_null_island: As `take` has it.

    Returns:
        How many photos it holds.

    Raises:
        StoreError: If the folder cannot be read or makes no sense, or no index can be made; nothing is left behind.
    """
    source = model_of(folder, name=model)
    with (
        index_folder.drafted(Path(os.path.realpath(to)), "index") as draft,
        Index.create(draft, dim=source.dim, fingerprint=source.fingerprint, model=source.model) as index,
    ):
        return take(index, folder, model=model, on_null_island=on_null_island)


def _is_name(value: Any) -> bool:
    """Whether an index can bear it: a text, of letters that there are."""
    if not isinstance(value, str) or len(value) > _LONGEST_NAME:
        return False
    return not any("\ud800" <= letter <= "\udfff" for letter in value)


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
                source=known[content].source if known[content].where else photo.source,
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
