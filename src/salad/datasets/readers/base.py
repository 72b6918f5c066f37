"""What a reader is: a layout on disk, and the two sides of a set that it gives; and what a protocol says is right.

A protocol names a rule and the layouts it is read from. A layout's reader says where photos stand, or what their files
call right, and knows nothing of rules; a rule looks at these two sides and nothing else. So any protocol can be read
from any layout that holds what its rule needs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import Int64

from salad.datasets.benchmark import Unanswerable
from salad.datasets.compact_lists import PhotoList, Ragged
from salad.datasets.coordinates import Coordinates
from salad.datasets.folders import frame
from salad.datasets.neighbours import near_on_map
from salad.errors import BenchmarkError


@dataclass(frozen=True, eq=False)
class Sides:
    """What a layout holds.

    Attributes:
        references: Photos whose places are known.
        queries: Photos to recognise.
        coordinates: Where the queries and the references stand, in this order, where the layout says.
        positives: What the layout itself says is right.
        groups: For each query the drive, place or panorama it belongs to.
        told_by: The file that says what is right, where `positives` are given.
        notes: Sentences a reader of the figures should see.
    """

    references: PhotoList
    queries: PhotoList
    coordinates: tuple[Coordinates, Coordinates] | None = None
    positives: Ragged | None = None
    groups: tuple[str, ...] | None = None
    told_by: str = ""
    notes: tuple[str, ...] = ()


# Rules. Each says in words what is right, and finds it: None where the sides do not hold what it needs.


@dataclass(frozen=True, slots=True)
class Radius:
    """A reference at most so many metres away, on the map as the set was measured (UTM)."""

    metres: float = 25.0

    def __str__(self) -> str:
        return f"within {self.metres:g} m (UTM)"

    def positives(self, sides: Sides) -> Ragged | None:
        """By where photos stand."""
        return near_on_map(*sides.coordinates, self.metres) if sides.coordinates else None


@dataclass(frozen=True, slots=True)
class Frames:
    """A reference at most so many frames away, by the numbers in the names."""

    tolerance: int

    def __str__(self) -> str:
        return f"within {self.tolerance} frames, by the numbers in the names"

    def positives(self, sides: Sides) -> Ragged:
        """By the numbers in the names, which must be frames of one count on both sides.

        Raises:
            BenchmarkError: If the queries are numbered by themselves, or a number is too large to be a frame's.
        """
        ours, theirs = (_frames(photos) for photos in (sides.queries, sides.references))
        # Nordland's queries are every eighth frame. Where a copy numbers them anew from 0, these numbers would read as
        # frames too, and what is right would be wrong in silence.
        consecutive = len(ours) < len(theirs) and np.array_equal(ours, np.arange(len(ours)) + ours[0])
        if consecutive and len(theirs) == len(np.unique(theirs)) and ours[0] <= 1:
            raise BenchmarkError(
                f"the queries of {sides.queries.folder} are numbered {ours[0]} to {ours[-1]} without a gap, so their "
                f"names do not say which of {len(theirs)} frames each is: give names with the frame, or the set's "
                "_gt.npy"
            )
        return _within_frames(ours, theirs, self.tolerance)


@dataclass(frozen=True, slots=True)
class EveryNth:
    """Query i, counted in order, is reference `step * i`; right is what is at most `tolerance` from it."""

    step: int
    tolerance: int

    def __str__(self) -> str:
        if self.step == 1 and self.tolerance == 0:
            return "the same index"
        return f"query i, references {self.step}i ± {self.tolerance}"

    def positives(self, sides: Sides) -> Ragged:
        """By the order of the photos."""
        ours = self.step * np.arange(len(sides.queries), dtype=np.int64)
        return _within_frames(ours, np.arange(len(sides.references), dtype=np.int64), self.tolerance)


@dataclass(frozen=True, slots=True)
class SameName:
    """The reference whose name, its suffix left aside, is the query's."""

    def __str__(self) -> str:
        return "the pair of one name"

    def positives(self, sides: Sides) -> Ragged:
        """By the names."""
        theirs: dict[str, list[int]] = {}
        for row, name in enumerate(sides.references.names):
            theirs.setdefault(PurePosixPath(name).stem, []).append(row)
        ours = (theirs.get(PurePosixPath(name).stem, []) for name in sides.queries.names)
        return Ragged.of(np.array(rows, dtype=np.int64) for rows in ours)


@dataclass(frozen=True, slots=True)
class OwnTable:
    """What the set's own table says."""

    what: str = "its own table"

    def __str__(self) -> str:
        return f"by {self.what}"

    def positives(self, _: Sides) -> None:
        """Nothing: a layout that has the table says itself what is right."""


Rule = Radius | Frames | EveryNth | SameName | OwnTable


def right_by(rule: Rule, sides: Sides) -> Ragged:
    """For each query the rows of the right references: as the layout itself says, else by the rule.

    Raises:
        BenchmarkError: If the layout does not hold what the rule needs.
    """
    # A set's own truth goes before ours: published figures were measured by it, rounding and all.
    positives = rule.positives(sides) if sides.positives is None else sides.positives
    if positives is None:
        raise BenchmarkError(
            f"{sides.references.folder} does not say what is right ({rule}): take another layout of it"
        )
    return positives


def _frames(photos: PhotoList) -> Int64[np.ndarray, " n"]:
    """The frame in each photo's name."""
    numbers = [frame(name) for name in photos.names]
    longest = max(numbers, default=0)
    if longest >= 1 << 60:  # so that a tolerance more or less still fits an int64
        raise BenchmarkError(f"{longest} is no frame's number: rename the photos")
    return np.array(numbers, dtype=np.int64)


def _within_frames(ours: Int64[np.ndarray, " q"], theirs: Int64[np.ndarray, " r"], tolerance: int) -> Ragged:
    """For each query the rows of the references whose frame is at most `tolerance` from its own."""
    # Names need not sort by their numbers: 9.jpg comes after 10.jpg.
    order = np.argsort(theirs, kind="stable")
    starts = np.searchsorted(theirs[order], ours - tolerance, side="left")
    stops = np.searchsorted(theirs[order], ours + tolerance, side="right")
    return Ragged.of(np.sort(order[start:stop]) for start, stop in zip(starts, stops, strict=True))


@dataclass(frozen=True)
class Protocol:
    """A named way to judge.

    Attributes:
        name: What stands beside every figure.
        rule: What is right.
        layouts: The names of the layouts it is read from, the first that is there.
        references: How many references there are; None where the set has no one size.
        queries: How many queries count, likewise.
        about: By how many references a folder may differ, where only a round number is published.
        unanswerable: Whether queries without a right reference are left out or count as misses.
        stems: What its files are called: `<stem>.mat`, `<stem>_gt.npy`, and what its folder may be called.
        split: The folder of the exchange format: `images/<split>/`.
        sides: What the folders of references and queries are called in the exchange format.
        subset: The column of MSLS' `subtask_index.csv` that says which queries count, where not all do.
        zone: The UTM zone its positions are counted in, where its files do not say it, such as `17T`.
        get: Where to get the set.
        licence: What its photos may be used for, in a few words.
        yours: Whether its folders are a user's own, so that `salad evaluate` takes its rule from options.
    """

    name: str
    rule: Rule
    layouts: tuple[str, ...]
    # Published counts guard against a set that is not whole, or is another split: its figures would not compare.
    references: int | None = None
    queries: int | None = None
    about: int = 0
    unanswerable: Unanswerable = "miss"
    stems: tuple[str, ...] = ()
    split: str = "test"
    sides: tuple[tuple[str, str], ...] = (("database", "queries"),)
    subset: str = ""
    zone: str = ""
    get: str = ""
    licence: str = ""
    yours: bool = False


@dataclass(frozen=True)
class Layout:
    """A way in which sets lie on disk.

    Attributes:
        name: What it is called.
        what: What it looks like, in a few words.
        looked_for: What is looked for, as texts for a sentence.
        find: The file or folder in a root by which the layout is known, or None; a look at few names, which opens
            nothing.
        read: What it holds, by the root and what was found in it. Raises a BenchmarkError where files cannot be read,
            are damaged, or do not fit together.
    """

    # Three functions and no class to inherit from: a reader is a file that fills these in.
    name: str
    what: str
    looked_for: Callable[[Protocol], Sequence[str]]
    find: Callable[[Path, Protocol], Path | None]
    read: Callable[[Path, Path, Protocol], Sides]
