"""One type for every evaluation set: references, queries, and which references are right for each query.

A benchmark carries its protocol, because a recall means nothing without the rule that said what was right.
The three builders below take a user's own two folders; readers of published layouts build the same type.
"""

from __future__ import annotations

import math
import os
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from salad.datasets.compact_lists import Ragged, positions
from salad.datasets.coordinates import Coordinates
from salad.datasets.folders import frame, two_folders
from salad.datasets.ground_truth import PhotoNames, looking_alike, read_truth
from salad.datasets.neighbours import near_on_earth, near_on_map
from salad.errors import BenchmarkError
from salad.images.at_names import parse_at_name, split_at_name, zone_of
from salad.images.metadata import Position, settled
from salad.images.photo import Photo, placed, read_photo
from salad.images.photo_table import PhotoTable

Rows = NDArray[np.int64]
Unanswerable = Literal["drop", "miss"]


@dataclass(frozen=True, eq=False)  # positives are arrays, and arrays have no single answer to ==
class Benchmark:
    """An evaluation set and its ground truth.

    Attributes:
        name: What the set is called in a table.
        protocol: The rule that says what is right, e.g. `frames ±2`; shown beside every figure.
        references: The photos whose places are known; of a large set they are made as they are asked for.
        queries: The photos to recognise.
        positives: For each query the rows of `references` that are right, ascending, int64; empty where the
            query cannot be answered.
        notes: Sentences a reader of the figures should see, e.g. how many photos were left out.
        unanswerable_rule: What becomes of queries without a right reference: left out, or counted as misses.
        groups: For each query the drive, place or panorama it belongs to, where that is known: queries of one
            group are not independent of one another.
    """

    # Sequences and not lists: of millions of photos a `PhotoList` makes each as it is asked for.
    name: str
    protocol: str
    references: Sequence[Photo]
    queries: Sequence[Photo]
    positives: Sequence[Rows]
    notes: tuple[str, ...] = ()
    unanswerable_rule: Unanswerable = "drop"
    groups: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        """Refuse parts that do not fit together.

        Raises:
            BenchmarkError: If a side is empty, the counts differ, or a positive is no reference.
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
        if self.groups is not None and len(self.groups) != len(self.queries):
            raise BenchmarkError(
                f"benchmark '{self.name}' has {len(self.queries)} queries but groups for {len(self.groups)}: "
                "give one a query, or none at all"
            )
        flat = self.positives if isinstance(self.positives, Ragged) else Ragged.of(self.positives)
        wrong = np.flatnonzero((flat.values < 0) | (flat.values >= len(self.references)))
        if wrong.size:
            query = self.queries[int(np.searchsorted(flat.ends, wrong[0], side="right")) - 1]
            raise BenchmarkError(
                f"a positive of {query.path} is not among the {len(self.references)} references "
                f"of benchmark '{self.name}': rows count from 0"
            )

    @property
    def unanswerable(self) -> int:
        """How many queries have no right reference."""
        if isinstance(self.positives, Ragged):  # at once, where there are many
            return int((self.positives.lengths == 0).sum())
        return sum(rows.size == 0 for rows in self.positives)

    @property
    def counted(self) -> int:
        """How many queries a recall is taken of, by this benchmark's rule."""
        return len(self.queries) - (self.unanswerable if self.unanswerable_rule == "drop" else 0)


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
        BenchmarkError: If the table cannot be read, lacks a column, repeats a query or names an unknown photo.
        PhotoError: If a folder is missing or holds no photo.
    """
    reference_paths, query_paths = two_folders(references, queries)
    truth = read_truth(truth_csv, PhotoNames(references, reference_paths), PhotoNames(queries, query_paths))
    left_out = len(query_paths) - len(truth)
    # Left out in silence, a forgotten line would look like an easier set.
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
        BenchmarkError: If a photo has no number, two references share one, or the tolerance is negative.
        PhotoError: If a folder is missing or holds no photo.
    """
    if tolerance < 0:
        raise BenchmarkError(f"a tolerance of {tolerance} frames makes nothing right: give 0 or more")
    reference_paths, query_paths = two_folders(references, queries)
    by_frame: dict[int, int] = {}
    for row, path in enumerate(reference_paths):
        first = by_frame.setdefault(frame(str(path)), row)
        if first != row:
            raise BenchmarkError(
                f"{reference_paths[first]} and {path} are both frame {frame(str(path))}: "
                "keep one reference a frame, or say what is right with a truth table"
            )
    # Python's own numbers and bisect: a number in a name may be longer than any int64.
    frames = sorted(by_frame)
    positives = []
    for path in query_paths:
        here = frame(str(path))
        near = frames[bisect_left(frames, here - tolerance) : bisect_right(frames, here + tolerance)]
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
    heading: float | None = None,
    name: str | None = None,
) -> Benchmark:
    """Take photos that know where they were taken: right is a reference at most `metres` away.

    A photo is only opened for its EXIF where neither the table nor its `@` name says where it was taken. Where there
    is no table, and all names give metres and none a UTM zone or degrees, these metres are measured on the map.

    Args:
        references: Folder of reference photos.
        queries: Folder of query photos.
        metres: The radius, along the great circle; or on the map.
        table: Positions of photos that do not carry their own (EXIF or `@` name).
        heading: Where given, right is only what also looks the same way, within so many degrees.
        name: What to call the set; by default the folder that holds both.

    Raises:
        BenchmarkError: If a photo has no position or no heading, or the radius is not a positive number.
        PhotoError: If a folder is missing or holds no photo.
        PositionError: If a photo's position makes no sense.
    """
    if not (metres > 0 and math.isfinite(metres)):
        raise BenchmarkError(f"a radius of {metres} m makes no sense: give a positive number of metres")
    reference_paths, query_paths = two_folders(references, queries)
    notes: tuple[str, ...] = ()
    on_a_plane = _on_a_plane(query_paths, reference_paths) if table is None else None
    if on_a_plane is not None:
        query_photos, reference_photos = (
            tuple(Photo.of(path, parse_at_name(path.name) or Position()) for path in paths)
            for paths in (query_paths, reference_paths)
        )
        positives = near_on_map(*on_a_plane, metres)
        notes = (
            "names give metres without a UTM zone and letter, so they are measured on the map, as if all of one zone",
        )
    else:
        if table is not None:
            table, _ = table.fitted([*reference_paths, *query_paths])
        # With a tolerance of headings, a photo that says only where it stands is opened for the rest.
        reference_photos = tuple(_known(path, table, heading is not None) for path in reference_paths)
        query_photos = tuple(_known(path, table, heading is not None) for path in query_paths)
        ours, theirs = _positions(query_photos, "query"), _positions(reference_photos, "reference")
        positives = near_on_earth(ours, theirs, metres)
    if heading is not None:
        positives = looking_alike(query_photos, reference_photos, positives, heading)
    return Benchmark(
        name=name or _common_name(references, queries),
        protocol=f"radius {metres:.10g} m"
        + (" (UTM)" if on_a_plane is not None else "")
        + (f", heading ±{heading:.10g}°" if heading is not None else ""),
        references=reference_photos,
        queries=query_photos,
        positives=positives,
        notes=notes,
    )


def _on_a_plane(queries: Sequence[Path], references: Sequence[Path]) -> tuple[Coordinates, Coordinates] | None:
    """Where photos stand on one map, if their `@` names give metres and say no more; None where any says otherwise."""
    sides, zones = list[Coordinates](), set[str]()
    for paths in (queries, references):
        numbers = np.empty((len(paths), 2))
        for row, path in enumerate(paths):
            fields = split_at_name(path.name)
            # A zone without a letter does not say where on earth, and two of them are no one map.
            if fields is None or zone_of(fields) or not math.isnan(fields.lat) or len(zones | {fields.zone}) > 1:
                return None
            zones.add(fields.zone)
            numbers[row] = fields.easting, fields.northing
        sides.append(Coordinates.on_a_plane(numbers))
    return sides[0], sides[1]


def _known(path: Path, table: PhotoTable | None, with_heading: bool) -> Photo:
    """A photo with what its name and the table say, and its EXIF only where they do not say enough."""
    photo = placed(Photo.of(path, settled([parse_at_name(path.name) or Position()])), table)
    # To open each of many photos for its EXIF takes minutes, where names and a table take seconds.
    enough = photo.where is not None and (photo.heading is not None or not with_heading)
    return photo if enough else read_photo(path, table)


def _common_name(references: Path, queries: Path) -> str:
    """Name a set after the folder that holds both of its folders."""
    try:
        return Path(os.path.commonpath([references.resolve(), queries.resolve()])).name or references.name
    except ValueError:  # two drives of one Windows machine have nothing in common
        return references.name


def _rows(rows: Iterable[int]) -> Rows:
    """Make row numbers ascending and unique, int64."""
    # A table may name a photo twice; counted twice it would count for two right references.
    return np.unique(np.fromiter(rows, dtype=np.int64))


def _positions(photos: Sequence[Photo], role: str) -> NDArray[np.float64]:
    """Stack latitudes and longitudes, float64 [N, 2]; every photo must have one."""
    where = positions(photos)
    nowhere = np.flatnonzero(np.isnan(where[:, 0]))
    if nowhere.size:
        first = photos[int(nowhere[0])]
        why = f" ({first.remark})" if first.remark else ""
        raise BenchmarkError(
            f"{nowhere.size} of {len(photos)} {role} photos have no position, the first {first.path}{why}: give photos "
            "with GPS in their EXIF data or with `@` names, or leave these out"
        )
    return where
