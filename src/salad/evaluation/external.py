"""Judging any method: descriptors that somebody else made, and ranked lists in the form of the MSLS challenge.

A ranked list is one line a query, `query_key ref_key ref_key ...`, best first. A key is the photo's name without its
suffix, which is what the challenge calls it; its path below the folder does too, with the suffix or without.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from salad.datasets.benchmark import Benchmark
from salad.errors import BenchmarkError, StoreError
from salad.evaluation.result import Ranked, Result, below, folder_of
from salad.files import write_whole
from salad.images.photo import Photo
from salad.index.vectors import FileRows

_NUMBERS = 1 << 22  # numbers looked at at once


def read_descriptors(
    benchmark: Benchmark, references: Path, queries: Path
) -> tuple[FileRows, FileRows, tuple[str, ...]]:
    """Descriptors from two `.npy` files, rows in the order of the benchmark's photos.

    Returns:
        Both sides, read from the files as they are asked for, and a sentence about their lengths.

    Raises:
        BenchmarkError: a file cannot be read, or holds other counts or numbers that are not finite.
    """
    sides = []
    for path, photos, role in (
        (references, benchmark.references, "references"),
        (queries, benchmark.queries, "queries"),
    ):
        matrix = _matrix(path)
        if matrix.rows != len(photos):
            raise BenchmarkError(
                f"{path} has {matrix.rows} rows, but there are {len(photos)} {role}: give a row a photo, in the order "
                f"of the set's photos (the first is {photos[0].path})"
            )
        sides.append(matrix)
    one, two = sides
    if one.dim != two.dim:
        raise BenchmarkError(
            f"{references} has {one.dim} numbers a row and {queries} {two.dim}: describe both with one model"
        )
    return one, two, _lengths_told((references, one), (queries, two))


def write_photos(photos: Sequence[Photo], path: Path) -> None:
    """Write the photos' paths in their order, one a line: what descriptors from outside are to be made of.

    Raises:
        BenchmarkError: the file cannot be written.
    """
    _write(path, (str(photo.path) for photo in photos))


def _matrix(path: Path) -> FileRows:
    try:
        return FileRows.of_npy(path)
    except StoreError as error:
        raise BenchmarkError(str(error)) from error


def _lengths_told(*sides: tuple[Path, FileRows]) -> tuple[str, ...]:
    """Make sure that all numbers are finite, and say whether rows are of length 1."""
    least, most = np.inf, 0.0
    for path, rows in sides:
        for start, block in rows.blocks(numbers=_NUMBERS):
            lengths = np.linalg.norm(block.astype(np.float64), axis=1)
            bad = np.flatnonzero(~np.isfinite(lengths))
            if bad.size:
                raise BenchmarkError(
                    f"row {start + int(bad[0])} (from 0) of {path} holds NaN or infinity: describe that photo again"
                )
            least, most = min(least, float(lengths.min())), max(most, float(lengths.max()))
    if abs(least - 1) < 0.01 and abs(most - 1) < 0.01:
        return ("descriptors from outside, of length 1: ranked by cosine",)
    return (
        f"descriptors from outside are not of length 1 ({least:.3g} to {most:.3g}): ranked by dot product as they "
        "stand, which is neither cosine nor distance; normalise them where the method does",
    )


# --- ranked lists --------------------------------------------------------------------------


class _Keys:
    """Finds a photo's row by its name without suffix, or by its path below the folder."""

    def __init__(self, photos: Sequence[Photo], role: str) -> None:
        self._role, folder = role, folder_of(photos)
        self._rows: dict[str, int] = {}
        self._twice: set[str] = set()
        for row, photo in enumerate(photos):
            name = below(photo.path, folder)
            for key in {photo.path.stem, name, name.removesuffix(photo.path.suffix)}:
                if self._rows.setdefault(key, row) != row:
                    self._twice.add(key)

    def __len__(self) -> int:
        return len(self._rows)

    def get(self, key: str, at: str) -> int | None:
        """The row; None where no photo is called so."""
        if key in self._twice:
            raise BenchmarkError(
                f"{at} names {key!r}, which several {self._role} are called: write paths below the folder"
            )
        return self._rows.get(key)


def read_rankings(benchmark: Benchmark, path: Path) -> tuple[Ranked, tuple[str, ...]]:
    """Ranked lists of another method.

    Lines of queries that the benchmark leaves out are passed over: predictions for MSLS val name 747 queries, of
    which 740 count.

    Returns:
        What was found, without scores, and sentences about it.

    Raises:
        BenchmarkError: the file cannot be read, a query of the benchmark is not in it or twice, or a reference is not
            one of the benchmark's or twice in a line.
    """
    queries, references = _Keys(benchmark.queries, "queries"), _Keys(benchmark.references, "references")
    found: dict[int, list[int]] = {}
    over = 0
    for at, (key, *named) in _lines(path):
        row = queries.get(key, at)
        if row is None:
            over += 1
        elif row in found:
            raise BenchmarkError(f"{at} ranks for {key!r} a second time: keep one line a query")
        else:
            found[row] = _ranking(named, references, at)
    missing = [photo.path for row, photo in enumerate(benchmark.queries) if row not in found]
    if missing:
        raise BenchmarkError(
            f"{path} has no line for {len(missing)} of {len(benchmark.queries)} queries, the first {missing[0]}: a "
            "figure with holes is no figure; add them (a line of the query's name alone finds nothing)"
        )
    return _padded(found, len(benchmark.references)), _told(path, found, over)


def write_rankings(result: Result, path: Path) -> None:
    """Write what a result found as ranked lists, whole or not at all.

    Raises:
        BenchmarkError: a name holds a space, which the form has no way to write, or two are alike; or the file cannot
            be written.
    """
    short = (
        _short([one.query for one in result.per_query]),
        _short([one.name for one in result.known.values()]),
    )
    keys = dict(zip(result.known, short[1], strict=True))
    lines = (
        " ".join([query, *(keys[row] for row in one.matches)])
        for query, one in zip(short[0], result.per_query, strict=True)
    )
    _write(path, lines)


def _write(path: Path, lines: Iterable[str]) -> None:
    try:
        write_whole(path, "".join(f"{line}\n" for line in lines).encode("utf-8", "surrogateescape"))
    except OSError as error:
        raise BenchmarkError(
            f"{path} cannot be written ({error.strerror}): name a file in a folder that is there"
        ) from error


def _short(names: Sequence[str]) -> list[str]:
    """Names without folder and suffix where that tells them apart, else without the suffix alone."""
    spaced = [name for name in names if len(name.split()) != 1]
    if spaced:
        raise BenchmarkError(
            f"{spaced[0]!r} has a space in its name, which ranked lists have no way to write: rename it"
        )
    stems = [Path(name).stem for name in names]
    return stems if len(set(stems)) == len(stems) else list(names)


def _lines(path: Path) -> Iterator[tuple[str, list[str]]]:
    try:
        with path.open(encoding="utf-8-sig", errors="surrogateescape") as file:
            for number, line in enumerate(file, 1):
                if words := line.split():
                    yield f"line {number} of {path}", words
    except OSError as error:
        raise BenchmarkError(f"{path} cannot be read ({error.strerror}): check the name") from error


def _ranking(named: Sequence[str], references: _Keys, at: str) -> list[int]:
    rows = []
    for key in named:
        row = references.get(key, at)
        if row is None:
            raise BenchmarkError(
                f"{at} names {key!r}, which is no reference of the set: judge rankings on the set they were made on"
            )
        rows.append(row)
    if len(set(rows)) != len(rows):
        raise BenchmarkError(f"{at} names a reference twice: each takes one rank")
    return rows


def _padded(found: dict[int, list[int]], references: int) -> Ranked:
    longest = max(1, min(references, max(map(len, found.values()))))
    rows: Int64[np.ndarray, "queries k"] = np.full((len(found), longest), -1, dtype=np.int64)
    for row, ranking in found.items():
        rows[row, : len(ranking)] = ranking
    return Ranked(rows)


def _told(path: Path, found: dict[int, list[int]], over: int) -> tuple[str, ...]:
    least = min(map(len, found.values()))
    told = [f"rankings of {path.name} are {least} references long at least"]
    if over:
        told.append(f"{over} lines of {path.name} are of queries that the protocol leaves out")
    return tuple(told)


def depth(ranked: Ranked, references: int, ks: Sequence[int]) -> tuple[int, ...]:
    """The ks that rankings are long enough for: beyond the longest, nothing was asked of the method."""
    longest = ranked.rows.shape[1]
    return tuple(k for k in ks if k <= longest or longest >= references) or (1,)
