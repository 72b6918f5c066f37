"""Descriptors kept between evaluations, by the model's fingerprint and each photo's content.

    DIR/<fingerprint>-decoder<version>/<digest>.safetensors      contents [N, 16] bytes, descriptors [N, dim] float32

A file is written whole or not at all, named after the contents in it and never changed; so an evaluation that is
cut short keeps all but its last block, and several may share a folder. They are float32: a figure from the cache is
the figure that was measured, to the last digit. A file that is damaged counts for nothing, and is written anew.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float32, Int64

from salad.errors import BenchmarkError, ModelError, PhotoError
from salad.files import write_whole
from salad.images.decode import DECODER
from salad.images.photo import Photo, content_hash
from salad.search.base import ArrayRows, Block, Numbers, Rows

if TYPE_CHECKING:
    from salad.models.describer import Describes


# --- Describing both sides of a benchmark, photo by photo, or from descriptors described before ---


Progress = Callable[[int, int], None]


class Described:
    """How photos become descriptors: by a model, in batches, each checked.

    Args:
        model: what turns photos into descriptors.
        batch_size: photos described at once.
    """

    def __init__(self, model: Describes, *, batch_size: int) -> None:
        self.model, self.batch_size = model, batch_size

    def batch(self, paths: Sequence[Path]) -> Float32[np.ndarray, "photos dim"]:
        """Describe some photos.

        Raises:
            BenchmarkError: one cannot be read: a figure with holes is no figure.
            ModelError: the model gives descriptors of another shape than it says, or numbers that are not finite.
        """
        try:
            described = self.model.describe(paths, batch_size=self.batch_size)
        except PhotoError as error:
            raise unreadable(error) from error
        due = (len(paths), self.model.dim)
        if described.shape != due or not np.isfinite(described).all():
            raise ModelError(
                f"model '{self.model.name}' gave {described.shape} numbers for {len(paths)} photos "
                f"from {paths[0]} on, where {due} finite ones were due: use other weights"
            )
        return described

    def sides(
        self, references: Sequence[Photo], queries: Sequence[Photo], *, progress: Progress | None
    ) -> tuple[Rows, Rows]:
        """Describe references and queries, in memory."""
        total, done, sides = len(references) + len(queries), 0, []
        for photos in (references, queries):
            descriptors = np.empty((len(photos), self.model.dim), dtype=np.float32)
            for start in range(0, len(photos), self.batch_size):
                some = range(start, min(start + self.batch_size, len(photos)))
                descriptors[some.start : some.stop] = self.batch([photos[row].path for row in some])
                done += len(some)
                if progress is not None:
                    progress(done, total)
            sides.append(ArrayRows(descriptors))
        return sides[0], sides[1]


def unreadable(error: PhotoError) -> BenchmarkError:
    """What to say of a photo that cannot be read."""
    return BenchmarkError(
        f"a figure with holes is no figure, and a photo cannot be read: {error}; mend it, or take it out of the set"
    )


_SUFFIX = ".safetensors"
_NUMBERS, _PHOTOS = 1 << 23, 1024  # in a file at most: 32 MiB, and what an interrupt may cost
_HEAD = 1 << 20  # bytes that a file's table may have; ours have a few hundred
_KEY = 16  # bytes that tell a photo's content

Place = tuple[int, int]  # a file's number, and the row in it


class Cache:
    """Descriptors of one model in a folder.

    Args:
        folder: where caches are kept; made where there is none.
        described: the model that describes what is not there yet.

    Raises:
        BenchmarkError: the folder cannot be made or read.
    """

    def __init__(self, folder: Path, described: Described) -> None:
        self._described, self._dim = described, described.model.dim
        self._folder = (
            folder / f"{described.model.fingerprint}-decoder{DECODER}"
        )  # of another decoder: not found
        self._files: list[_File] = []
        self._places: dict[bytes, Place] = {}
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            for path in sorted(self._folder.glob(f"*{_SUFFIX}")):
                self._take(_File.open(path, dim=self._dim))
        except OSError as error:
            raise BenchmarkError(
                f"the cache {folder} cannot be used ({error.strerror}): name another folder, or leave --cache away"
            ) from error

    def sides(
        self, references: Sequence[Photo], queries: Sequence[Photo], *, progress: Progress | None = None
    ) -> tuple[Rows, Rows]:
        """Describe what is not here yet; the descriptors of both sides, read from the files as they are asked for.

        Raises:
            BenchmarkError: a photo cannot be read, or the cache not written.
            ModelError: the model gives descriptors of another shape than it says, or numbers that are not finite.
        """
        total = len(references) + len(queries)
        keys = np.zeros((total, _KEY), dtype=np.uint8)
        waiting: dict[bytes, Path] = {}
        for number, photo in enumerate(_both(references, queries)):
            key = _key(photo.path)
            keys[number] = np.frombuffer(key, dtype=np.uint8)
            if key not in self._places:
                waiting[key] = photo.path
            if len(waiting) == _PHOTOS or len(waiting) * self._dim >= _NUMBERS:
                self._fill(waiting)
                waiting = {}
            if progress is not None:
                progress(number + 1, total)
        self._fill(waiting)
        places = np.array([self._places[key.tobytes()] for key in keys], dtype=np.int64).reshape(-1, 2)
        return self._rows(places[: len(references)]), self._rows(places[len(references) :])

    def _rows(self, places: Int64[np.ndarray, "rows 2"]) -> Rows:
        return _Kept(tuple(self._files), places, self._dim)

    def _fill(self, waiting: dict[bytes, Path]) -> None:
        """Describe these photos and keep them in one file."""
        if not waiting:
            return
        paths, size = list(waiting.values()), self._described.batch_size
        rows = np.empty((len(paths), self._dim), dtype=np.float32)
        for low in range(0, len(paths), size):
            rows[low : low + size] = self._described.batch(paths[low : low + size])
        keys = b"".join(waiting)
        path = self._folder / f"{hashlib.blake2b(keys, digest_size=16).hexdigest()}{_SUFFIX}"
        try:
            write_whole(path, _packed(keys, rows))
            self._take(_File.open(path, dim=self._dim))
        except OSError as error:
            raise BenchmarkError(
                f"{path} cannot be written ({error.strerror}): make room, or leave --cache away"
            ) from error

    def _take(self, file: _File | None) -> None:
        if file is None:
            return
        for row in range(file.count):
            self._places.setdefault(file.keys[row * _KEY : (row + 1) * _KEY], (len(self._files), row))
        self._files.append(file)


@dataclass(frozen=True, eq=False)
class _File:
    """One file: its photos' contents, and where its descriptors begin."""

    path: Path
    keys: bytes
    start: int
    dim: int

    @property
    def count(self) -> int:
        return len(self.keys) // _KEY

    @classmethod
    def open(cls, path: Path, *, dim: int) -> _File | None:
        """Look at a file; None where it is cut short, damaged, or not one of ours."""
        with path.open("rb") as file:
            length = int.from_bytes(file.read(8), "little")
            if not 2 <= length <= _HEAD:
                return None
            try:
                table = json.loads(file.read(length))
                count = int(table["contents"]["shape"][0])
                told = _table(count, dim, table["__metadata__"]["crc32"])
            except (ValueError, KeyError, TypeError, IndexError, RecursionError):
                return None
            size = path.stat().st_size - 8 - length
            if table != told or count < 1 or size != count * (_KEY + 4 * dim):
                return None
            keys = file.read(count * _KEY)
            sum_ = zlib.crc32(keys)
            while block := file.read(1 << 22):
                sum_ = zlib.crc32(block, sum_)
        sound = f"{sum_:08x}" == table["__metadata__"]["crc32"]
        return cls(path, keys, 8 + length + len(keys), dim) if sound else None

    def read(self, low: int, high: int) -> Float32[np.ndarray, "rows dim"]:
        """Rows from `low` to `high`."""
        wanted = high - low
        try:
            with self.path.open("rb") as file:
                file.seek(self.start + 4 * low * self.dim)
                rows = np.fromfile(file, dtype="<f4", count=wanted * self.dim)
        except OSError as error:
            raise BenchmarkError(f"{self.path} cannot be read ({error.strerror}): evaluate again") from error
        if len(rows) != wanted * self.dim:
            raise BenchmarkError(f"{self.path} was cut short while it was read: evaluate again")
        return rows.reshape(wanted, self.dim).astype(np.float32, copy=False)


@dataclass(frozen=True, eq=False)
class _Kept:
    """Descriptors of photos in order, wherever they lie: `salad.search.base.Rows`, of any length."""

    files: tuple[_File, ...]
    places: Int64[np.ndarray, "rows 2"]
    dim: int
    dtype = np.dtype(np.float32)
    longest = None

    def __len__(self) -> int:
        return len(self.places)

    def block(self, start: int, stop: int, spare: Block) -> Block:  # noqa: ARG002  # runs come in another order
        return self._at(self.places[start:stop])

    def take(self, rows: Numbers) -> Block:
        return self._at(self.places[rows])

    def _at(self, places: Int64[np.ndarray, "block 2"]) -> Float32[np.ndarray, "block dim"]:
        """Read rows, each run of neighbouring ones at once."""
        block = np.empty((len(places), self.dim), dtype=np.float32)
        order = np.lexsort((places[:, 1], places[:, 0]))
        ordered = places[order]
        steps = (np.diff(ordered[:, 0]) != 0) | (np.diff(ordered[:, 1]) > 1)
        ends = [0, *(np.flatnonzero(steps) + 1).tolist(), len(ordered)]
        for low, high in pairwise(ends):
            file, first = ordered[low].tolist()
            read = self.files[file].read(first, int(ordered[high - 1, 1]) + 1)
            block[order[low:high]] = read[ordered[low:high, 1] - first]  # a photo may stand there twice
        return block


def _both(references: Sequence[Photo], queries: Sequence[Photo]) -> Iterator[Photo]:
    yield from references
    yield from queries


def _key(path: Path) -> bytes:
    try:
        return bytes.fromhex(content_hash(path))
    except PhotoError as error:
        raise unreadable(error) from error


def _table(count: int, dim: int, sum_: str) -> dict[str, Any]:
    """What stands at the head of a file, as safetensors wants it."""
    middle = count * _KEY
    return {
        "__metadata__": {"crc32": sum_},
        "contents": {"dtype": "U8", "shape": [count, _KEY], "data_offsets": [0, middle]},
        "descriptors": {
            "dtype": "F32",
            "shape": [count, dim],
            "data_offsets": [middle, middle + 4 * count * dim],
        },
    }


def _packed(keys: bytes, rows: Float32[np.ndarray, "rows dim"]) -> bytes:
    data = keys + np.ascontiguousarray(rows, dtype="<f4").tobytes()
    head = json.dumps(_table(len(rows), rows.shape[1], f"{zlib.crc32(data):08x}")).encode()
    head += b" " * (-len(head) % 8)
    return len(head).to_bytes(8, "little") + head + data
