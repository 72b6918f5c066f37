"""Photos squeezed to a model's size: read by threads ahead of their turn, kept as far as memory is granted.

A photo that cannot be read is remembered and never shown as something else: another photo of its place stands in.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from salad.config import Preprocessing
from salad.data.places import TrainingPlace, View
from salad.errors import BenchmarkError, PhotoError
from salad.photos import open_rgb, squeeze

Pixels = UInt8[np.ndarray, "height width 3"]

_MEGA = 1_000_000
_THREADS = 8  # at most; decoding leaves Python's lock, so that as many cores work


class Shelf:
    """Photos by their paths, as bytes of a model's size. Use it from one thread; it has its own for reading.

    Args:
        preprocessing: to what size photos are squeezed, and how.
        megabytes: memory for keeping photos. What comes first stays: over an epoch every photo is as likely
            to come again as any other, so nothing is gained by putting one out for another.

    Attributes:
        broken: a sentence for each photo that could not be read.
    """

    def __init__(self, preprocessing: Preprocessing, *, megabytes: int = 4096) -> None:
        self.preprocessing = preprocessing
        self.broken: dict[Path, str] = {}
        self._room = megabytes * _MEGA // (3 * preprocessing.height * preprocessing.width)
        self._kept: dict[Path, Pixels] = {}
        self._now: dict[Path, Future[Pixels]] = {}  # of the batch being fetched
        self._ahead: deque[dict[Path, Future[Pixels]]] = deque()  # of the two batches last expected
        self._pool = ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1), thread_name_prefix="salad-shelf")
        self._told = 0

    def array(self, path: Path) -> Pixels:
        """One photo as bytes.

        Raises:
            PhotoError: it cannot be read; `broken` knows it from then on.
        """
        if path in self._kept:
            return self._kept[path]
        if path in self.broken:
            raise PhotoError(self.broken[path])
        try:
            pixels = self._coming(path).result()
        except PhotoError as error:
            self.broken[path] = str(error)
            raise
        if len(self._kept) < self._room:
            self._kept[path] = pixels
        return pixels

    def photos(self, views: Sequence[View]) -> UInt8[Tensor, "photos 3 height width"]:
        """The photos of a batch as one tensor; another of its place stands in for one that cannot be read.

        Which one depends on the files alone: the next of the place, in a circle, that the batch does not show
        yet, or any of them where it shows all.

        Raises:
            BenchmarkError: no photo of a place can be read.
        """
        self._now = self._begun(views)
        shown = {view.path for view in views}
        seen: dict[Path, Pixels] = {}
        rows = []
        for view in views:
            path = view.path
            if path not in seen and not self._readable(path, seen):
                path = self._stand_in(view, shown, seen)
                shown.add(path)
            rows.append(seen[path])
        return torch.from_numpy(np.stack(rows)).permute(0, 3, 1, 2)

    def expect(self, views: Sequence[View]) -> None:
        """Begin to read what a batch to come shows; what was expected before the last call is let go."""
        while len(self._ahead) > 1:
            for future in self._ahead.popleft().values():
                future.cancel()
        self._ahead.append(self._begun(views))

    def news(self) -> str:
        """One sentence on the photos that could not be read since this was last asked; empty where there are none."""
        fresh = list(self.broken.values())[self._told :]
        self._told = len(self.broken)
        if not fresh:
            return ""
        what = "1 photo cannot be read" if len(fresh) == 1 else f"{len(fresh)} photos cannot be read"
        return f"{what}, and others of their places stand in; the first: {fresh[0]}"

    def close(self) -> None:
        """Let go of the threads; what is kept stays."""
        self._pool.shutdown(cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _readable(self, path: Path, seen: dict[Path, Pixels]) -> bool:
        try:
            seen[path] = self.array(path)
        except PhotoError:
            return False
        return True

    def _stand_in(self, view: View, shown: set[Path], seen: dict[Path, Pixels]) -> Path:
        others = _after(view.place, view.path)
        fresh = [path for path in others if path not in shown]
        for path in (*fresh, *others):
            if path in seen or self._readable(path, seen):
                return path
        raise BenchmarkError(
            f"no photo of the place {view.place.name} in {view.place.city} can be read; the first: "
            f"{self.broken[view.path]}"
        )

    def _begun(self, views: Sequence[View]) -> dict[Path, Future[Pixels]]:
        """What of these photos is neither kept nor on its way is now read."""
        known: tuple[Mapping[Path, object], ...] = (self._kept, self.broken, self._now, *self._ahead)
        wanted = dict.fromkeys(view.path for view in views)
        return {path: self._read(path) for path in wanted if not any(path in part for part in known)}

    def _coming(self, path: Path) -> Future[Pixels]:
        for begun in (self._now, *self._ahead):
            if path in begun:
                return begun.pop(path)
        return self._read(path)

    def _read(self, path: Path) -> Future[Pixels]:
        return self._pool.submit(_decoded, path, self.preprocessing)


def _decoded(path: Path, to: Preprocessing) -> Pixels:
    return squeeze(open_rgb(path), to.height, to.width, to.resample)


def _after(place: TrainingPlace, path: Path) -> tuple[Path, ...]:
    """The place's photos from the one after `path` on, in a circle, itself left out."""
    at = place.photos.index(path)
    return place.photos[at + 1 :] + place.photos[:at]
