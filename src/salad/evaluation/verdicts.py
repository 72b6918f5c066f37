"""What became of each query, in words that outlive the data set: names below a folder, rows, metres."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from salad.data.benchmark import Benchmark
from salad.data.folders import frame
from salad.data.lazy import PhotoList
from salad.errors import BenchmarkError
from salad.evaluation import metres
from salad.evaluation.ranking import Ranked
from salad.evaluation.recall import first_hits
from salad.evaluation.result import Reference, Verdict
from salad.photos import Photo


def verdicts_of(benchmark: Benchmark, ranked: Ranked, folder: str) -> tuple[Verdict, ...]:
    """What became of each query, named by its path below a folder."""
    places = first_hits(ranked.rows, benchmark.positives)
    best = ranked.rows[:, 0] if ranked.rows.shape[1] else np.full(len(ranked.rows), -1)
    apart = metres.errors(benchmark.queries, benchmark.references, best)
    return tuple(
        _verdict(
            benchmark,
            ranked,
            number,
            below(benchmark.queries[number].path, folder),
            float(places[number]),
            float(apart[number]),
        )
        for number in range(len(ranked.rows))
    )


def _verdict(
    benchmark: Benchmark, ranked: Ranked, number: int, name: str, place: float, apart: float
) -> Verdict:
    found = ranked.rows[number] >= 0
    rows = ranked.rows[number][found].tolist()
    right = benchmark.positives[number]
    first = None if math.isinf(place) else int(place)
    where = benchmark.queries[number].where
    return Verdict(
        query=name,
        positives=len(right),
        first_right=None if first is None else first + 1,
        matches=tuple(rows),
        scores=None if ranked.scores is None else tuple(ranked.scores[number][found].tolist()),
        right=int(ranked.rows[number][first]) if first is not None else int(right[0]) if len(right) else None,
        metres=apart if math.isfinite(apart) else None,
        where=None if where is None else (where.lat, where.lon),
        group=benchmark.groups[number] if benchmark.groups is not None else None,
    )


def known(benchmark: Benchmark, verdicts: Sequence[Verdict], folder: str) -> dict[int, Reference]:
    """The references that verdicts name, by row: their paths below a folder, and where they are."""
    rows = {row for one in verdicts for row in one.matches}
    rows |= {one.right for one in verdicts if one.right is not None}
    photos = {row: benchmark.references[row] for row in sorted(rows)}
    return {
        row: Reference(
            below(photo.path, folder), None if photo.where is None else (photo.where.lat, photo.where.lon)
        )
        for row, photo in photos.items()
    }


def folder_of(photos: Sequence[Photo]) -> str:
    """The folder that all photos lie below, in full; empty where they lie on several drives of a system."""
    if isinstance(photos, PhotoList):
        return os.path.abspath(photos.folder)  # noqa: PTH100  # links are left as they are named
    try:
        return os.path.commonpath({os.path.abspath(photo.path.parent) for photo in photos})  # noqa: PTH100  # the same
    except ValueError:
        return ""


def below(path: Path, folder: str) -> str:
    """A photo's path below a folder, with `/`; in full where it does not lie there."""
    full = os.path.abspath(path)  # noqa: PTH100  # the same
    inside = folder.rstrip(os.sep) + os.sep
    return full.removeprefix(inside).replace(os.sep, "/") if folder else full


def along(paths: Sequence[Path]) -> tuple[int, ...]:
    """Each photo's place along a drive: the last number in its name, else as it stands."""
    try:
        return tuple(frame(path.name) for path in paths)
    except BenchmarkError:  # a name without a number
        return tuple(range(len(paths)))


def names_digest(photos: Sequence[Photo], folder: str) -> str:
    """Tells one sequence of photos from another by their paths below a folder."""
    digest = hashlib.blake2b(digest_size=16)
    names = photos.names if isinstance(photos, PhotoList) else (below(each.path, folder) for each in photos)
    for name in names:
        digest.update(name.encode("utf-8", "surrogateescape") + b"\0")
    return digest.hexdigest()


def rows_digest(positives: Sequence[Int64[np.ndarray, " n"]]) -> str:
    """Tells one ground truth from another."""
    digest = hashlib.blake2b(digest_size=16)
    for rows in positives:
        digest.update(np.append(np.asarray(rows, dtype="<i8"), -1).tobytes())
    return digest.hexdigest()
