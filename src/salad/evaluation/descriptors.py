"""Descriptors of both sides of a benchmark, described now or kept from an evaluation before.

    DIR/<fingerprint>-decoder<version>/<digest>.safetensors      contents [N, 16] bytes, descriptors [N, dim] float32

A photo is known by its content, and a cache by all that makes a descriptor of it: the model's fingerprint and the
version of the decoder. A photo is opened once, by workers that read while the model describes: hashed, and decoded
from the same bytes. A file is written whole or not at all, named after the contents in it and never changed; so an
evaluation that is cut short keeps all but its last block, and several may share a folder. They are float32: a figure
from the cache is the figure that was measured, to the last digit. A file that is damaged counts for nothing, and is
written anew.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from jaxtyping import Float32, Int64
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from salad.datasets.benchmark import Benchmark
from salad.errors import BenchmarkError, ModelError, PhotoError, reason
from salad.files import open_file, write_whole
from salad.images.decode import DECODER, Pixels
from salad.images.photo import Photo
from salad.images.worker_process import PhotoRead
from salad.images.workers import Workers
from salad.search.base import ArrayRows, Block, Numbers, Rows

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike

Progress = Callable[[int, int], None]

_SUFFIX = ".safetensors"
_NUMBERS, _PHOTOS = 1 << 23, 1024  # in a file at most: 32 MiB, and what an interrupt may cost
_KEY = 16  # bytes that tell a photo's content


def describe_sides(
    benchmark: Benchmark,
    model: DescriberLike,
    *,
    batch_size: int = 16,
    cache: Path | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> tuple[Rows, Rows]:
    """Describe references and queries.

    Args:
        benchmark: The photos.
        model: What turns them into descriptors.
        batch_size: Photos described at once.
        cache: A folder of descriptors to take from and to add to; in memory alone where not given.
        threads: Photos read at a time; one a processor where not given.
        progress: Told how many photos are described, and of how many.

    Returns:
        The descriptors of both sides, a row a photo.

    Raises:
        BenchmarkError: If a photo cannot be read, or the cache not be used.
        ModelError: If the model gives descriptors of another shape than it says, or numbers that are not finite.
    """
    photos = benchmark.references, benchmark.queries
    if cache is not None:
        return DescriptorCache(cache, model).sides(*photos, batch_size=batch_size, threads=threads, progress=progress)
    total, done, sides, to = sum(map(len, photos)), 0, [], model.preprocessing
    with Workers(total, at_once=threads) as workers:
        for side in photos:
            paths = (side[row].path for row in range(len(side)))
            decoded = workers.in_order(
                lambda path: (path, workers.decode(path, to.height, to.width, to.resample)),
                paths,
                ahead=2 * batch_size,
            )
            descriptors = np.empty((len(side), model.dim), dtype=np.float32)
            for start in range(0, len(side), batch_size):
                try:
                    batch = list(islice(decoded, batch_size))
                except PhotoError as error:
                    raise unreadable(error) from error
                descriptors[start : start + len(batch)] = describe_batch(model, batch)
                done += len(batch)
                if progress is not None:
                    progress(done, total)
            sides.append(ArrayRows(descriptors))
    return sides[0], sides[1]


def describe_batch(model: DescriberLike, photos: Sequence[tuple[Path, Pixels]]) -> Float32[np.ndarray, "photos dim"]:
    """Describe some photos at once, and see that these are descriptors.

    Args:
        model: What describes them.
        photos: Where each is from, for errors, and its pixels as the model takes them.

    Raises:
        ModelError: If the model gives descriptors of another shape than it says, or numbers that are not finite.
    """
    described = model.describe([pixels for _, pixels in photos], batch_size=len(photos))
    due = (len(photos), model.dim)
    if described.shape != due or not np.isfinite(described).all():
        raise ModelError(
            f"model '{model.name}' gave {described.shape} numbers for {len(photos)} photos "
            f"from {photos[0][0]} on, where {due} finite ones were due: use other weights"
        )
    return described


def unreadable(error: PhotoError) -> BenchmarkError:
    """What to say of a photo that cannot be read."""
    return BenchmarkError(
        f"a figure with holes is no figure, and a photo cannot be read: {error}; mend it, or take it out of the set"
    )


class DescriptorCache:
    """Descriptors of one model in a folder.

    Args:
        folder: Where caches are kept; made where there is none.
        model: What describes what is not there yet.

    Raises:
        BenchmarkError: If the folder cannot be made or read.
    """

    def __init__(self, folder: Path, model: DescriberLike) -> None:
        self._model = model
        # What another decoder made of a photo is another descriptor, and must not be found here.
        self._folder = folder / f"{model.fingerprint}-decoder{DECODER}"
        self._guess_known = False
        self._files: list[_CacheFile] = []
        self._rows: dict[bytes, tuple[int, int]] = {}  # by content: the number of a file, and the row in it
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            for path in sorted(self._folder.glob(f"*{_SUFFIX}")):
                self._take(path)
        except OSError as error:
            raise BenchmarkError(
                f"the cache {folder} cannot be used ({error.strerror}): name another folder, or leave --cache away"
            ) from error

    def sides(
        self,
        references: Sequence[Photo],
        queries: Sequence[Photo],
        *,
        batch_size: int = 16,
        threads: int | None = None,
        progress: Progress | None = None,
    ) -> tuple[Rows, Rows]:
        """Describe what is not here yet; the descriptors of both sides, read from the files as they are asked for.

        Args:
            references: The one side.
            queries: The other.
            batch_size: Photos described at once.
            threads: Photos read at a time; one a processor where not given.
            progress: Told how many photos are looked at, and of how many.

        Raises:
            BenchmarkError: If a photo cannot be read, or the cache not written.
            ModelError: If the model gives descriptors of another shape than it says, or numbers that are not finite.
        """
        total = len(references) + len(queries)
        # An array: millions of bytes objects would take ten times it.
        keys = np.zeros((total, _KEY), dtype=np.uint8)
        block = _Block(self, self._model, batch_size)
        with Workers(total, at_once=threads) as workers:
            paths = (photo.path for photo in chain(references, queries))
            found = workers.in_order(
                lambda path: self._read(workers, path, guess_known=self._guess_known), paths, ahead=2 * batch_size
            )
            for number in range(total):
                try:
                    path, read = next(found)
                    if not self._is_known(read, block) and read.pixels is None and not read.trouble:
                        # The guess was wrong. All of it anew: by now it may be another photo.
                        path, read = self._read(workers, path, guess_known=False)
                except PhotoError as error:
                    raise unreadable(error) from error
                key = bytes.fromhex(read.content_hash)
                keys[number] = np.frombuffer(key, dtype=np.uint8)
                self._guess_known = key in self._rows
                if not self._is_known(read, block):
                    if read.pixels is None:
                        raise unreadable(PhotoError(read.trouble))
                    block.add(key, path, read.pixels)
                if progress is not None:  # photos looked at, described or known: so it runs evenly to its end
                    progress(number + 1, total)
        block.write()
        rows = np.array([self._rows[key.tobytes()] for key in keys], dtype=np.int64).reshape(-1, 2)
        files, dim = tuple(self._files), self._model.dim
        return (
            _CachedRows(files, rows[: len(references)], dim),
            _CachedRows(files, rows[len(references) :], dim),
        )

    def _read(self, workers: Workers, path: Path, *, guess_known: bool) -> tuple[Path, PhotoRead]:
        """One trip to a photo; it is decoded where it is guessed to be new, as the one before it was."""
        to = self._model.preprocessing
        return path, workers.read(path, None if guess_known else (to.height, to.width, to.resample))

    def _is_known(self, read: PhotoRead, block: _Block) -> bool:
        key = bytes.fromhex(read.content_hash)
        return key in self._rows or block.holds(key)

    def keep(self, keys: npt.NDArray[np.uint8], rows: npt.NDArray[np.float32]) -> None:
        """Keep descriptors `[N, dim]` of contents `[N, 16]` in one file.

        Raises:
            BenchmarkError: If it cannot be written.
        """
        path = self._folder / f"{hashlib.blake2b(keys.tobytes(), digest_size=16).hexdigest()}{_SUFFIX}"
        sum_ = zlib.crc32(rows.tobytes(), zlib.crc32(keys.tobytes()))
        content = save({"contents": keys, "descriptors": rows}, metadata={"crc32": f"{sum_:08x}"})
        try:
            write_whole(path, content)
            self._take(path)
        except OSError as error:
            raise BenchmarkError(
                f"{path} cannot be written ({error.strerror}): make room, or leave --cache away"
            ) from error

    def _take(self, path: Path) -> None:
        """Know the photos of a file, if it is sound."""
        file = _CacheFile(path)
        keys = file.keys(self._model.dim)
        for row, key in enumerate(keys):
            # Two evaluations at once may both have described a photo: either will do.
            self._rows.setdefault(key, (len(self._files), row))
        if keys:
            self._files.append(file)


class _Block:
    """Photos on their way into one file of a cache: described some at a time, for their pixels take more room."""

    def __init__(self, cache: DescriptorCache, model: DescriberLike, batch_size: int) -> None:
        self._cache, self._model, self._batch_size = cache, model, batch_size
        self._keys: dict[bytes, None] = {}  # of each content once: copies of a photo are described once
        self._waiting: list[tuple[Path, Pixels]] = []
        self._rows: list[npt.NDArray[np.float32]] = []

    def holds(self, key: bytes) -> bool:
        return key in self._keys

    def add(self, key: bytes, path: Path, pixels: Pixels) -> None:
        """Take in a photo; describe a batch, or write the file, where that is full."""
        self._keys[key] = None
        self._waiting.append((path, pixels))
        full = len(self._keys) == _PHOTOS or len(self._keys) * self._model.dim >= _NUMBERS
        if full:
            self.write()
        elif len(self._waiting) == self._batch_size:
            self._describe()

    def write(self) -> None:
        """Write what is here to a file of its own, and begin anew."""
        self._describe()
        if self._keys:
            keys = np.frombuffer(b"".join(self._keys), dtype=np.uint8).reshape(-1, _KEY)
            self._cache.keep(keys, np.concatenate(self._rows))
            self._keys, self._rows = {}, []

    def _describe(self) -> None:
        if self._waiting:
            self._rows.append(describe_batch(self._model, self._waiting).astype(np.float32, copy=False))
            self._waiting = []


@dataclass(frozen=True, slots=True)
class _CacheFile:
    path: Path

    def keys(self, dim: int) -> list[bytes]:
        """The contents of its photos; none where it is cut short, damaged, or not one of ours."""
        open_file(self.path).close()  # safetensors would wait for what is no regular file
        try:
            with safe_open(self.path, "numpy") as file:
                contents, rows = file.get_tensor("contents"), file.get_slice("descriptors")
                kinds = contents.dtype, rows.get_dtype(), contents.shape[1:], rows.get_shape()
                if kinds != (np.uint8, "F32", (_KEY,), [len(contents), dim]):
                    return []
                # safetensors knows how long a file must be, but not what was in it: a flipped bit shows here.
                sum_, step = zlib.crc32(contents.tobytes()), max(1, _NUMBERS // dim)
                for low in range(0, len(contents), step):
                    sum_ = zlib.crc32(rows[low : min(low + step, len(contents))].tobytes(), sum_)
                sound = (file.metadata() or {}).get("crc32") == f"{sum_:08x}"
        except SafetensorError:
            return []
        return [key.tobytes() for key in contents] if sound else []

    def read(self, low: int, high: int) -> Float32[np.ndarray, "rows dim"]:
        """Rows from `low` to `high`."""
        try:
            with safe_open(self.path, "numpy") as file:
                rows: Float32[np.ndarray, "rows dim"] = file.get_slice("descriptors")[low:high]
        except (OSError, SafetensorError) as error:
            raise BenchmarkError(f"{self.path} cannot be read any more ({reason(error)}): evaluate again") from error
        return rows


@dataclass(frozen=True, eq=False)
class _CachedRows:
    """Descriptors of photos in order, wherever they lie: `salad.search.base.Rows`, of any length.

    Attributes:
        files: Where they lie.
        where: `[rows, 2]` the number of a file, and the row in it.
        dim: Numbers in a row.
    """

    files: tuple[_CacheFile, ...]
    where: Int64[np.ndarray, "rows 2"]
    dim: int
    dtype = np.dtype(np.float32)
    longest = None

    def __len__(self) -> int:
        return len(self.where)

    def block(self, start: int, stop: int, spare: Block) -> Block:  # noqa: ARG002  # runs come in another order
        return self.take(np.arange(start, min(stop, len(self))))

    def take(self, rows: Numbers) -> Block:
        """These rows, each run of neighbours in a file read at once."""
        if not len(rows):
            return np.empty((0, self.dim), dtype=np.float32)
        where = self.where[rows]
        block = np.empty((len(where), self.dim), dtype=np.float32)
        # Photos mostly lie as they were described, in the order of the set: so a block is a few long runs.
        order = np.lexsort((where[:, 1], where[:, 0]))
        ordered = where[order]
        steps = (np.diff(ordered[:, 0]) != 0) | (np.diff(ordered[:, 1]) > 1)
        ends = [0, *(np.flatnonzero(steps) + 1).tolist(), len(ordered)]
        for low, high in pairwise(ends):
            file, first = ordered[low].tolist()
            read = self.files[file].read(first, int(ordered[high - 1, 1]) + 1)
            block[order[low:high]] = read[ordered[low:high, 1] - first]  # a photo may stand there twice
        return block
