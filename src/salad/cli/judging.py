"""The benchmark that two folders and one rule make, for the commands that measure a model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from salad.errors import BenchmarkError

if TYPE_CHECKING:
    from salad.data.benchmark import Benchmark
    from salad.photos import PhotoTable


def benchmark_of(
    references: Path,
    queries: Path,
    *,
    truth: Path | None,
    frames: int | None,
    radius: float | None,
    heading: float | None = None,
    table: Path | None = None,
) -> Benchmark:
    """Two folders, and exactly one rule for what is right.

    Args:
        references: photos whose places are known.
        queries: photos to recognise.
        truth: a table of what is right.
        frames: right within so many frames.
        radius: right within so many metres.
        heading: with `radius`, right only where both look the same way within so many degrees.
        table: with `radius`, where photos were taken that do not say so themselves.

    Raises:
        BenchmarkError: there is no rule or more than one, or the set cannot be read.
        PositionError: the table cannot be read, or names a photo that is not there.
        PhotoError: a folder is missing or holds no photo.
    """
    from salad.data import benchmark

    rules = [rule for rule in (truth, frames, radius) if rule is not None]
    if len(rules) != 1:
        raise BenchmarkError(
            f"{len(rules)} rules say what is right, but it takes one: --truth, --frames or --radius"
        )
    if radius is None and (heading is not None or table is not None):
        option = "--table" if heading is None else "--heading"
        raise BenchmarkError(
            f"{option} says more about a radius, and there is none: give --radius, or leave it away"
        )
    if truth is not None:
        return benchmark.from_truth(references, queries, truth)
    if frames is not None:
        return benchmark.from_frames(references, queries, frames)
    assert radius is not None
    positions = positions_in(table)
    made = benchmark.from_radius(references, queries, radius, table=positions, heading=heading)
    check_positions(positions, made)
    return made


def positions_in(table: Path | None) -> PhotoTable | None:
    """The table of positions, where there is one."""
    from salad.photos import PhotoTable

    return None if table is None else PhotoTable.read(table)


def check_positions(positions: PhotoTable | None, benchmark: Benchmark) -> None:
    """Make sure that every row of a table names a photo of the set, so that a misspelt one is noticed."""
    if positions is not None:
        positions.check_used(
            photo.path for side in (benchmark.references, benchmark.queries) for photo in side
        )
