"""What a protocol is: which set, how many photos, what is right, and what becomes of queries without an answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import Float64, Int64

from salad.datasets.benchmark import Unanswerable
from salad.datasets.compact_lists import PhotoList, Ragged
from salad.datasets.folders import frame
from salad.datasets.neighbours import Coordinates, near_on_map
from salad.errors import BenchmarkError

# --- what is right -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Radius:
    """A reference at most so many metres away, on the map as the set was measured (UTM)."""

    metres: float = 25.0

    def __str__(self) -> str:
        return f"within {self.metres:g} m (UTM)"


@dataclass(frozen=True, slots=True)
class Frames:
    """A reference at most so many frames away, by the numbers in the names."""

    tolerance: int

    def __str__(self) -> str:
        return f"within {self.tolerance} frames, by the numbers in the names"


@dataclass(frozen=True, slots=True)
class Every:
    """Query i, counted in order, is reference `step * i`; right is what is at most `tolerance` from it."""

    step: int
    tolerance: int

    def __str__(self) -> str:
        if self.step == 1 and self.tolerance == 0:
            return "the same index"
        return f"query i, references {self.step}i ± {self.tolerance}"


@dataclass(frozen=True, slots=True)
class Paired:
    """The reference whose name, its suffix left aside, is the query's."""

    def __str__(self) -> str:
        return "the pair of one name"


@dataclass(frozen=True, slots=True)
class Told:
    """What the set's own table says."""

    what: str = "its own table"

    def __str__(self) -> str:
        return f"by {self.what}"


Rule = Radius | Frames | Every | Paired | Told

# --- a protocol, and what a layout holds ----------------------------------------------------


@dataclass(frozen=True)
class Protocol:
    """A named way to judge.

    Attributes:
        name: what stands beside every figure.
        rule: what is right.
        layouts: the names of the layouts it is read from, the first that is there.
        references: how many references there are; None where the set has no one size.
        queries: how many queries count, likewise.
        about: by how many references a folder may differ, where only a round number is published.
        unanswerable: whether queries without a right reference are left out or count as misses.
        stems: what its files are called: `<stem>.mat`, `<stem>_gt.npy`, and what its folder may be called.
        split: the folder of the exchange format: `images/<split>/`.
        sides: what the folders of references and queries are called in the exchange format.
        subset: the column of MSLS' `subtask_index.csv` that says which queries count, where not all do.
        zone: the UTM zone its positions are counted in, where its files do not say it, such as `17T`.
        get: where to get the set.
        licence: what its photos may be used for, in a few words.
        yours: whether its folders are a user's own, so that `salad evaluate` takes its rule from options.
    """

    name: str
    rule: Rule
    layouts: tuple[str, ...]
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


@dataclass(frozen=True, eq=False)
class Sides:
    """What a layout holds.

    Attributes:
        references: photos whose places are known.
        queries: photos to recognise.
        spots: where the queries and the references stand, in this order, where the layout says.
        positives: what the layout itself says is right.
        groups: for each query the drive, place or panorama it belongs to.
        told_by: the file that says what is right, where `positives` are given.
        notes: sentences a reader of the figures should see.
    """

    references: PhotoList
    queries: PhotoList
    spots: tuple[Coordinates, Coordinates] | None = None
    positives: Ragged | None = None
    groups: tuple[str, ...] | None = None
    told_by: str = ""
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class Layout:
    """A way in which sets lie on disk.

    Attributes:
        name: what it is called.
        what: what it looks like, in a few words.
        looked_for: what is looked for, as texts for a sentence.
        find: what of it is there, or None; a look at few names, which opens nothing.
        read: what it holds; only called where `find` found something.
    """

    name: str
    what: str
    looked_for: Callable[[Protocol], Sequence[str]]
    find: Callable[[Path, Protocol], Path | None]
    read: Callable[[Path, Protocol], Sides]


# --- applying a rule -----------------------------------------------------------------------


def right_by(rule: Rule, sides: Sides) -> Ragged:
    """For each query the rows of the right references.

    Raises:
        BenchmarkError: the layout does not hold what the rule needs.
    """
    if sides.positives is not None:
        return sides.positives
    if isinstance(rule, Radius) and sides.spots is not None:
        return near_on_map(*sides.spots, rule.metres)
    if isinstance(rule, Frames):
        return _frames(rule, sides)
    if isinstance(rule, Every):
        at = rule.step * np.arange(len(sides.queries), dtype=np.int64)
        return _window(at, np.arange(len(sides.references), dtype=np.int64), rule.tolerance)
    if isinstance(rule, Paired):
        return _pairs(sides)
    raise BenchmarkError(
        f"{sides.references.folder} does not say what is right ({rule}): take another layout of it"
    )


def _frames(rule: Frames, sides: Sides) -> Ragged:
    """By the numbers in the names, which must be frames of one count on both sides."""
    ours, theirs = (
        np.array([_small(frame(name)) for name in photos.names], dtype=np.int64)
        for photos in (sides.queries, sides.references)
    )
    consecutive = len(ours) < len(theirs) and np.array_equal(ours, np.arange(len(ours)) + ours[0])
    if consecutive and len(theirs) == len(np.unique(theirs)) and ours[0] <= 1:
        raise BenchmarkError(
            f"the queries of {sides.queries.folder} are numbered {ours[0]} to {ours[-1]} without a gap, so their names "
            f"do not say which of {len(theirs)} frames each is: give names with the frame, or the set's _gt.npy"
        )
    return _window(ours, theirs, rule.tolerance)


def _small(number: int) -> int:
    if number >= 1 << 60:
        raise BenchmarkError(f"{number} is no frame's number: rename the photos")
    return number


def _window(ours: Int64[np.ndarray, " q"], theirs: Int64[np.ndarray, " r"], tolerance: int) -> Ragged:
    """References at most `tolerance` from each query, by whole numbers."""
    order = np.argsort(theirs, kind="stable")
    starts = np.searchsorted(theirs[order], ours - tolerance, side="left")
    stops = np.searchsorted(theirs[order], ours + tolerance, side="right")
    return Ragged.of(np.sort(order[start:stop]) for start, stop in zip(starts, stops, strict=True))


def _pairs(sides: Sides) -> Ragged:
    theirs: dict[str, list[int]] = {}
    for row, name in enumerate(sides.references.names):
        theirs.setdefault(PurePosixPath(name).stem, []).append(row)
    ours = (theirs.get(PurePosixPath(name).stem, []) for name in sides.queries.names)
    return Ragged.of(np.array(rows, dtype=np.int64) for rows in ours)


def spots_of(
    grid: Float64[np.ndarray, "n 2"],
    zone: Int64[np.ndarray, " n"] | None = None,
    globe: Float64[np.ndarray, "n 2"] | None = None,
) -> Coordinates:
    """Places on the map, of no zone and nowhere on earth unless that is given."""
    return Coordinates(
        grid,
        np.zeros(len(grid), dtype=np.int64) if zone is None else zone,
        np.full((len(grid), 2), np.nan) if globe is None else globe,
    )
