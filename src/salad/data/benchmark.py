"""One type for every evaluation set: references, queries, and which references are right for each query.

A benchmark carries its protocol, because a recall means nothing without the rule that said what was right.
The three builders below take a user's own two folders; readers of published layouts build the same type.
"""

from __future__ import annotations

import math
import os
import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salad import geo
from salad.data.truth import Names, read_truth
from salad.errors import BenchmarkError
from salad.photos import Photo, PhotoTable, find_photos, read_photo

Rows = NDArray[np.int64]


@dataclass(frozen=True, eq=False)  # positives are arrays, and arrays have no single answer to ==
class Benchmark:
    """An evaluation set and its ground truth.

    Attributes:
        name: What the set is called in a table.
        protocol: The rule that says what is right, e.g. `frames ±2`; shown beside every figure.
        references: The photos whose places are known.
        queries: The photos to recognise.
        positives: For each query the rows of `references` that are right, ascending, int64; empty where the
            query cannot be answered.
        notes: Sentences a reader of the figures should see, e.g. how many photos were left out.
    """

    name: str
    protocol: str
    references: tuple[Photo, ...]
    queries: tuple[Photo, ...]
    positives: tuple[Rows, ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse parts that do not fit together.

        Raises:
            BenchmarkError: A side is empty, the counts differ, or a positive is no reference.
        """
        if not self.references or not self.queries:
            raise BenchmarkError(
                f"benchmark '{self.name}' has {len(self.references)} references and {len(self.queries)} "
                "queries: give at least one of each"
            )
        if len(self.positives) != len(self.queries):
            raise BenchmarkError(
                f"benchmark '{self.name}' has {len(self.queries)} queries but positives for "
                f"{len(self.positives)}: give one array a query, empty where none is right"
            )
        for query, rows in zip(self.queries, self.positives, strict=True):
            if rows.size and not (rows.min() >= 0 and rows.max() < len(self.references)):
                raise BenchmarkError(
                    f"a positive of {query.path} is not among the {len(self.references)} references "
                    f"of benchmark '{self.name}': rows count from 0"
                )

    @property
    def unanswerable(self) -> int:
        """How many queries have no right reference."""
        return sum(rows.size == 0 for rows in self.positives)


def from_truth(references: Path, queries: Path, truth_csv: Path, *, name: str | None = None) -> Benchmark:
    """Take what is right from a table with the columns `query,positives` (others are ignored).

    A name is a file name, or a path relative to its folder; positives are separated by `;` and may be none.
    The queries are those of the table, in its order; photos it does not mention are left out, with a note.

    Args:
        references: Folder of reference photos.
        queries: Folder of query photos.
        truth_csv: The table.
        name: What to call the set; by default the folder that holds both.

    Raises:
        BenchmarkError: The table cannot be read, lacks a column, repeats a query or names an unknown photo.
        PhotoError: A folder is missing or holds no photo.
    """
    reference_paths, query_paths = _two_folders(references, queries)
    truth = read_truth(truth_csv, Names(references, reference_paths), Names(queries, query_paths))
    left_out = len(query_paths) - len(truth)
    note = f"{left_out} photos of {queries} are not in {truth_csv.name} and were left out"
    return Benchmark(
        name=name or _common_name(references, queries),
        protocol=f"truth {truth_csv.name}",
        references=tuple(Photo(path) for path in reference_paths),
        queries=tuple(Photo(query_paths[row]) for row in truth),
        positives=tuple(_rows(rows) for rows in truth.values()),
        notes=(note,) if left_out else (),
    )


def from_frames(references: Path, queries: Path, tolerance: int, *, name: str | None = None) -> Benchmark:
    """Take two drives along one road: right is a reference whose frame is at most `tolerance` away.

    A photo's frame is the last whole number in its name, the suffix left aside.

    Args:
        references: Folder of one drive.
        queries: Folder of the other drive.
        tolerance: How many frames apart still counts as right; 0 asks for the same frame.
        name: What to call the set; by default the folder that holds both.

    Raises:
        BenchmarkError: A photo has no number, two references share one, or the tolerance is negative.
        PhotoError: A folder is missing or holds no photo.
    """
    if tolerance < 0:
        raise BenchmarkError(f"a tolerance of {tolerance} frames makes nothing right: give 0 or more")
    reference_paths, query_paths = _two_folders(references, queries)
    by_frame: dict[int, int] = {}
    for row, path in enumerate(reference_paths):
        first = by_frame.setdefault(_frame(path), row)
        if first != row:
            raise BenchmarkError(
                f"{reference_paths[first]} and {path} are both frame {_frame(path)}: "
                "keep one reference a frame, or say what is right with a truth table"
            )
    frames = sorted(by_frame)
    positives = []
    for path in query_paths:
        frame = _frame(path)
        near = frames[bisect_left(frames, frame - tolerance) : bisect_right(frames, frame + tolerance)]
        positives.append(_rows(by_frame[other] for other in near))
    return Benchmark(
        name=name or _common_name(references, queries),
        protocol=f"frames ±{tolerance}",
        references=tuple(Photo(path) for path in reference_paths),
        queries=tuple(Photo(path) for path in query_paths),
        positives=tuple(positives),
    )


def from_radius(
    references: Path,
    queries: Path,
    metres: float,
    *,
    table: PhotoTable | None = None,
    name: str | None = None,
) -> Benchmark:
    """Take photos that know where they were taken: right is a reference at most `metres` away.

    Args:
        references: Folder of reference photos.
        queries: Folder of query photos.
        metres: The radius, along the great circle.
        table: Positions of photos that do not carry their own (EXIF or `@` name).
        name: What to call the set; by default the folder that holds both.

    Raises:
        BenchmarkError: A photo has no position, or the radius is not a positive number.
        PhotoError: A folder is missing or holds no photo.
        PositionError: A photo's position makes no sense.
    """
    if not (metres > 0 and math.isfinite(metres)):
        raise BenchmarkError(f"a radius of {metres} m makes no sense: give a positive number of metres")
    reference_paths, query_paths = _two_folders(references, queries)
    reference_photos = tuple(read_photo(path, table) for path in reference_paths)
    query_photos = tuple(read_photo(path, table) for path in query_paths)
    return Benchmark(
        name=name or _common_name(references, queries),
        protocol=f"radius {metres:.10g} m",
        references=reference_photos,
        queries=query_photos,
        positives=_within(
            _positions(query_photos, "query"), _positions(reference_photos, "reference"), metres
        ),
    )


def _two_folders(references: Path, queries: Path) -> tuple[list[Path], list[Path]]:
    """List both folders' photos; a photo in both would find itself and lift every figure."""
    reference_paths, query_paths = find_photos([references]), find_photos([queries])
    both = set(map(os.path.realpath, reference_paths)) & set(map(os.path.realpath, query_paths))
    if both:
        raise BenchmarkError(
            f"{len(both)} photos are references and queries at once, the first {min(both)}: "
            "give two folders that share no photo"
        )
    return reference_paths, query_paths


def _common_name(references: Path, queries: Path) -> str:
    """Name a set after the folder that holds both of its folders."""
    try:
        return Path(os.path.commonpath([references.resolve(), queries.resolve()])).name or references.name
    except ValueError:  # two drives of one Windows machine have nothing in common
        return references.name


def _rows(rows: Iterable[int]) -> Rows:
    """Make row numbers ascending and unique, int64."""
    return np.unique(np.fromiter(rows, dtype=np.int64))


def _frame(path: Path) -> int:
    """Read the last whole number in a photo's name."""
    numbers = re.findall(r"[0-9]+", path.stem)
    if not numbers:
        raise BenchmarkError(f"{path} has no number in its name to tell its frame: rename it or leave it out")
    return int(numbers[-1])


def _positions(photos: Sequence[Photo], role: str) -> NDArray[np.float64]:
    """Stack latitudes and longitudes, float64 [N, 2]; every photo must have one."""
    nowhere = [photo for photo in photos if photo.where is None]
    if nowhere:
        raise BenchmarkError(
            f"{len(nowhere)} of {len(photos)} {role} photos have no position, the first {nowhere[0].path}: "
            "give photos with GPS in their EXIF data or with `@` names, or leave these out"
        )
    return np.array([(photo.where.lat, photo.where.lon) for photo in photos if photo.where is not None])


def _within(queries: NDArray[np.float64], references: NDArray[np.float64], metres: float) -> tuple[Rows, ...]:
    """Find the references at most `metres` from each query.

    Only references in the band of latitude that the radius spans are measured, so that tens of thousands a
    side take seconds and no matrix of all pairs is ever built.
    """
    order = np.argsort(references[:, 0], kind="stable")
    ordered = references[order]
    one_degree = float(geo.metres(0.0, 0.0, 1.0, 0.0))
    band = metres / one_degree * (1 + 1e-9) + 1e-9  # with room for rounding
    starts = np.searchsorted(ordered[:, 0], queries[:, 0] - band, side="left")
    stops = np.searchsorted(ordered[:, 0], queries[:, 0] + band, side="right")
    positives = []
    for (lat, lon), start, stop in zip(queries, starts, stops, strict=True):
        near = geo.metres(lat, lon, ordered[start:stop, 0], ordered[start:stop, 1]) <= metres
        positives.append(np.sort(order[start:stop][near]).astype(np.int64))
    return tuple(positives)
