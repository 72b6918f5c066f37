"""The benchmark that two folders and one rule make, for the commands that measure a model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from salad.errors import BenchmarkError

if TYPE_CHECKING:
    from salad.data.benchmark import Benchmark


def benchmark_of(
    references: Path, queries: Path, *, truth: Path | None, frames: int | None, radius: float | None
) -> Benchmark:
    """Two folders, and exactly one rule for what is right.

    Args:
        references: photos whose places are known.
        queries: photos to recognise.
        truth: a table of what is right.
        frames: right within so many frames.
        radius: right within so many metres.

    Raises:
        BenchmarkError: there is no rule or more than one, or the set cannot be read.
        PhotoError: a folder is missing or holds no photo.
    """
    from salad.data import benchmark

    rules = [rule for rule in (truth, frames, radius) if rule is not None]
    if len(rules) != 1:
        raise BenchmarkError(
            f"{len(rules)} rules say what is right, but it takes one: --truth, --frames or --radius"
        )
    if truth is not None:
        return benchmark.from_truth(references, queries, truth)
    if frames is not None:
        return benchmark.from_frames(references, queries, frames)
    assert radius is not None
    return benchmark.from_radius(references, queries, radius)
