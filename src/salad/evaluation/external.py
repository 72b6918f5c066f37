"""Judging any method: descriptors that somebody else made, and ranked lists in the form of the MSLS challenge.

A ranked list is one line a query, `query_key ref_key ref_key ...`, best first. A key is the photo's name without its
suffix, which is what the challenge calls it; its path below the folder does too, with the suffix or without.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from salad.datasets.benchmark import Benchmark
from salad.errors import BenchmarkError, StoreError, reason
from salad.evaluation.result import Ranked, Result, below, folder_of, write_file
from salad.images.photo import Photo
from salad.index.vectors import FileRows
from salad.tables import read_lines, shown

_LONGEST = 1 << 26  # letters of a line: it may rank all of a million references
_NUMBERS = 1 << 22  # numbers looked at at once: 32 MiB as float64


def read_descriptors(
    benchmark: Benchmark, references: Path, queries: Path
) -> tuple[FileRows, FileRows, tuple[str, ...]]:
    """Descriptors from two `.npy` files, rows in the order of the benchmark's photos.

    Returns:
        Both sides, read from the files as they are asked for, and a sentence about their lengths.

    Raises:
        BenchmarkError: If a file cannot be read, or holds other counts or numbers that are not finite.
    """
    sides, shortest, longest = [], np.inf, 0.0
    for path, photos, role in (
        (references, benchmark.references, "references"),
        (queries, benchmark.queries, "queries"),
    ):
        try:
            rows = FileRows.of_npy(path)
        except StoreError as error:
            raise BenchmarkError(str(error)) from error
        if len(rows) != len(photos):
            raise BenchmarkError(
                f"{path} has {len(rows)} rows, but there are {len(photos)} {role}: give a row a photo, in the order "
                f"of the set's photos (the first is {photos[0].path})"
            )
        sides.append(rows)
    one, two = sides
    if one.dim != two.dim:
        raise BenchmarkError(
            f"{references} has {one.dim} numbers a row and {queries} {two.dim}: describe both with one model"
        )
    # All of both files is read here, before anything is ranked: a hole found at the end of an hour is found too late.
    for path, rows in ((references, one), (queries, two)):
        for start, block in rows.blocks(numbers=_NUMBERS):
            lengths = np.linalg.norm(block.astype(np.float64), axis=1)
            bad = np.flatnonzero(~np.isfinite(lengths))
            if bad.size:
                raise BenchmarkError(
                    f"row {start + int(bad[0])} (from 0) of {path} holds NaN or infinity: describe that photo again"
                )
            shortest, longest = min(shortest, float(lengths.min())), max(longest, float(lengths.max()))
    # float16 rounds lengths by less than 0.001; what is further from 1 was not meant to be 1.
    if abs(shortest - 1) < 0.01 and abs(longest - 1) < 0.01:
        return one, two, ("descriptors from outside, of length 1: ranked by cosine",)
    note = (
        f"descriptors from outside are not of length 1 ({shortest:.3g} to {longest:.3g}): ranked by dot product as "
        "they stand, which is neither cosine nor distance; normalise them where the method does"
    )
    return one, two, (note,)


def write_photos(photos: Sequence[Photo], path: Path) -> None:
    """Write the photos' paths in their order, one a line: what descriptors from outside are to be made of.

    Raises:
        BenchmarkError: If the file cannot be written.
    """
    _write_lines(path, (str(photo.path) for photo in photos))


class _Keys:
    """Finds a photo's row by its name without suffix, or by its path below the folder."""

    def __init__(self, photos: Sequence[Photo], role: str) -> None:
        self._role, folder = role, folder_of(photos)
        self._rows: dict[str, int] = {}
        self._twice: set[str] = set()
        for row, photo in enumerate(photos):
            name = below(photo.path, folder)
            # A set: where a photo lies in the folder itself two of the three are the same.
            for key in {photo.path.stem, name, name.removesuffix(photo.path.suffix)}:
                if self._rows.setdefault(key, row) != row:
                    self._twice.add(key)

    def get(self, key: str, at: str) -> int | None:
        """The row; None where no photo is called so."""
        if key in self._twice:
            raise BenchmarkError(
                f"{at} names {shown(key)}, which several {self._role} are called: write paths below the folder"
            )
        return self._rows.get(key)


def read_rankings(benchmark: Benchmark, path: Path) -> tuple[Ranked, tuple[str, ...]]:
    """Ranked lists of another method.

    Lines of queries that the benchmark leaves out are passed over: predictions for MSLS val name 747 queries, of
    which 740 count.

    Returns:
        What was found, without scores, and sentences about it.

    Raises:
        BenchmarkError: If the file cannot be read, a query of the benchmark is not in it or twice, or a reference is
            not one of the benchmark's or twice in a line.
    """
    queries, references = _Keys(benchmark.queries, "queries"), _Keys(benchmark.references, "references")
    rankings: dict[int, list[int]] = {}
    left_out = 0
    try:
        # Names may be in any encoding a file system has; a byte order mark is what Windows editors leave.
        for number, line in enumerate(read_lines(path, errors="surrogateescape", longest=_LONGEST), 1):
            at, words = f"line {number} of {path}", line.split()
            if not words:
                continue
            row = queries.get(words[0], at)
            if row is None:
                left_out += 1
            elif row in rankings:
                raise BenchmarkError(f"{at} ranks for {shown(words[0])} a second time: keep one line a query")
            else:
                rankings[row] = _ranking(words[1:], references, at)
    except (OSError, ValueError) as error:
        raise BenchmarkError(f"{path} cannot be read ({reason(error)}): check the name") from error
    missing = [photo.path for row, photo in enumerate(benchmark.queries) if row not in rankings]
    if missing:
        raise BenchmarkError(
            f"{path} has no line for {len(missing)} of {len(benchmark.queries)} queries, the first {missing[0]}: a "
            "figure with holes is no figure; add them (a line of the query's name alone finds nothing)"
        )
    lengths = [len(ranking) for ranking in rankings.values()]
    # Lists of unequal length, padded as searches do.
    ranked = np.full((len(rankings), max(1, max(lengths))), -1, dtype=np.int64)
    for row, ranking in rankings.items():
        ranked[row, : len(ranking)] = ranking
    notes = [f"rankings of {path.name} are {min(lengths)} references long at least"]
    if left_out:
        notes.append(f"{left_out} lines of {path.name} are of queries that the protocol leaves out")
    return Ranked(ranked), tuple(notes)


def _ranking(keys: Sequence[str], references: _Keys, at: str) -> list[int]:
    """The rows that a line names."""
    rows = []
    for key in keys:
        row = references.get(key, at)
        if row is None:
            raise BenchmarkError(
                f"{at} names {shown(key)}, which is no reference of the set: judge rankings on the set they were made "
                "on"
            )
        rows.append(row)
    if len(set(rows)) != len(rows):
        raise BenchmarkError(f"{at} names a reference twice: each takes one rank")
    return rows


def write_rankings(result: Result, path: Path) -> None:
    """Write what a result found as ranked lists, whole or not at all.

    Raises:
        BenchmarkError: If a name holds a space, which the form has no way to write, or the file cannot be written.
    """
    queries = _short_names([one.query for one in result.per_query])
    names = _short_names([one.name for one in result.known.values()])
    name_of = dict(zip(result.known, names, strict=True))
    lines = (
        " ".join([query, *(name_of[row] for row in one.matches)])
        for query, one in zip(queries, result.per_query, strict=True)
    )
    _write_lines(path, lines)


def _short_names(names: Sequence[str]) -> list[str]:
    """Names without folder and suffix where that tells them apart, else whole."""
    spaced = [name for name in names if len(name.split()) != 1]
    if spaced:
        raise BenchmarkError(
            f"{spaced[0]!r} has a space in its name, which ranked lists have no way to write: rename it"
        )
    stems = [Path(name).stem for name in names]
    return stems if len(set(stems)) == len(stems) else list(names)


def _write_lines(path: Path, lines: Iterable[str]) -> None:
    write_file(path, "".join(f"{line}\n" for line in lines).encode("utf-8", "surrogateescape"))
