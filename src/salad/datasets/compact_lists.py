"""Sequences that hold millions of photos and of rows in flat arrays, and make each item when it is asked for."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar, overload

import numpy as np
from jaxtyping import Float64, Int64

from salad.geo import GeoPoint, in_degrees
from salad.images.photo import Photo

_T = TypeVar("_T", covariant=True)


class _MadeOnRequest(Sequence[_T]):
    """A sequence that makes an item when it is asked for: millions of photos as objects would take gigabytes."""

    def _one(self, row: int) -> _T:
        """The item of a row that is there, counted from 0."""
        raise NotImplementedError

    @overload
    def __getitem__(self, row: int) -> _T: ...
    @overload
    def __getitem__(self, row: slice) -> Sequence[_T]: ...
    def __getitem__(self, row: int | slice) -> _T | Sequence[_T]:
        if isinstance(row, slice):
            return [self._one(number) for number in range(*row.indices(len(self)))]
        from_start = row + len(self) if row < 0 else row
        if not 0 <= from_start < len(self):
            raise IndexError(f"{row} is not among {len(self)}")
        return self._one(from_start)


class Strings(_MadeOnRequest[str]):
    """Texts in one block of bytes: 2.8 million names take what their letters take.

    Args:
        texts: In any number.
    """

    def __init__(self, texts: Iterable[str]) -> None:
        # A file's name may hold bytes that are no text; surrogates stand for them, as Path has it.
        coded = [text.encode("utf-8", "surrogateescape") for text in texts]
        # One block of bytes and where each ends: a text of its own takes some 50 bytes more than its letters.
        self._ends = np.cumsum([0, *map(len, coded)], dtype=np.int64)
        self._bytes = b"".join(coded)

    def __len__(self) -> int:
        return len(self._ends) - 1

    def _one(self, row: int) -> str:
        return self._bytes[self._ends[row] : self._ends[row + 1]].decode("utf-8", "surrogateescape")


class Ragged(_MadeOnRequest["Int64[np.ndarray, ' n']"]):
    """Arrays of any length each, one after the other in one array.

    Args:
        values: `[V]` all of them.
        lengths: `[N]` how many each holds.

    Attributes:
        ends: `[N + 1]` where each begins, and where the last one ends; the first is 0.
    """

    def __init__(self, values: Int64[np.ndarray, " v"], lengths: Sequence[int] | Int64[np.ndarray, " n"]) -> None:
        self.values, self.ends = values, np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)])

    @classmethod
    def of(cls, arrays: Iterable[Int64[np.ndarray, " n"]]) -> Ragged:
        """These arrays, put together."""
        held = list(arrays)
        # The empty one in front gives a type to a list of none, and to empty ones of any other.
        return cls(np.concatenate([np.zeros(0, np.int64), *held]).astype(np.int64), list(map(len, held)))

    @property
    def lengths(self) -> Int64[np.ndarray, " n"]:
        """How many each holds."""
        return np.diff(self.ends)

    def __len__(self) -> int:
        return len(self.ends) - 1

    def _one(self, row: int) -> Int64[np.ndarray, " n"]:
        return self.values[self.ends[row] : self.ends[row + 1]]


class PhotoList(_MadeOnRequest[Photo]):
    """Photos by name, each with where it was taken and which way it looked, as far as that is known.

    Args:
        folder: What the names are below.
        names: Paths below the folder.
        where: `[N, 2]` latitudes and longitudes in degrees, NaN where unknown.
        headings: `[N]` degrees clockwise from north, NaN where unknown.
    """

    def __init__(
        self,
        folder: Path,
        names: Iterable[str],
        *,
        where: Float64[np.ndarray, "n 2"] | None = None,
        headings: Float64[np.ndarray, " n"] | None = None,
    ) -> None:
        self.folder = folder
        self.names = Strings(names)
        self.where = np.full((len(self.names), 2), math.nan) if where is None else where
        self.headings = np.full(len(self.names), math.nan) if headings is None else headings

    def __len__(self) -> int:
        return len(self.names)

    def _one(self, row: int) -> Photo:
        lat, lon = self.where[row].tolist()
        heading = float(self.headings[row])
        return Photo(
            self.folder / self.names[row],
            None if math.isnan(lat) else GeoPoint(lat, lon),
            None if math.isnan(heading) else heading,
        )

    def subset(self, rows: Int64[np.ndarray, " m"]) -> PhotoList:
        """These photos of it, in this order."""
        # Names are kept below the folder and not whole: the folder's own path is shared by all.
        names = (self.names[row] for row in rows.tolist())
        return PhotoList(self.folder, names, where=self.where[rows], headings=self.headings[rows])


def positions(photos: Sequence[Photo]) -> Float64[np.ndarray, "n 2"]:
    """Latitudes and longitudes in degrees, NaN where a photo has none; at once where photos are a `PhotoList`."""
    if isinstance(photos, PhotoList):  # whose array is there already: no photo need be made
        return photos.where
    return in_degrees(photo.where for photo in photos)


def headings(photos: Sequence[Photo]) -> Float64[np.ndarray, " n"]:
    """Which way photos look, in degrees clockwise from north, NaN where one does not say."""
    if isinstance(photos, PhotoList):
        return photos.headings
    known = (photo.heading for photo in photos)
    return np.array([math.nan if heading is None else heading for heading in known], dtype=np.float64)
