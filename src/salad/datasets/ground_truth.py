"""What a user's own set says is right: a table that names photos, or headings that tell who looks the same way."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from salad.datasets.compact_lists import Ragged, headings
from salad.errors import BenchmarkError, reason
from salad.geo import turn_between
from salad.images.photo import Photo
from salad.tables import CsvError, read_csv


class PhotoNames:
    """Finds a photo of one folder by its path below the folder, or by its bare name where only one bears it.

    Args:
        folder: The folder.
        paths: Its photos; a row is a place in this list.
    """

    def __init__(self, folder: Path, paths: Sequence[Path]) -> None:
        self._folder = folder
        self._by_path = {os.path.relpath(path, folder).replace(os.sep, "/"): row for row, path in enumerate(paths)}
        # Two folders may hold an a.jpg each: such a name is refused where it is used, not here.
        self._by_name: dict[str, list[int]] = {}
        for row, path in enumerate(paths):
            self._by_name.setdefault(path.name, []).append(row)

    def row(self, name: str, at: str) -> int:
        """Give the row of the photo called `name`; `at` says where that name was read.

        Raises:
            BenchmarkError: If no photo is called so, or several are.
        """
        # Tables are written on Windows too, and by `find`.
        plain = name.replace("\\", "/").removeprefix("./")
        if plain in self._by_path:
            return self._by_path[plain]
        rows = self._by_name.get(plain, [])
        if len(rows) > 1:
            raise BenchmarkError(
                f"{at} names '{name}', which {len(rows)} photos of {self._folder} are called: "
                "write the path below the folder"
            )
        if not rows:
            raise BenchmarkError(
                f"{at} names '{name}', which is not a photo of {self._folder}: "
                "correct the name or add the photo (names are relative to the folder, suffix included)"
            )
        return rows[0]


def read_truth(truth_csv: Path, references: PhotoNames, queries: PhotoNames) -> dict[int, list[int]]:
    """Read a table `query,positives`, positives separated by `;`; other columns are ignored.

    Returns:
        The rows of the right references by the row of their query, in the order of the table.

    Raises:
        BenchmarkError: If the table cannot be read, lacks a column, repeats a query or names an unknown photo.
    """

    def header(names: list[str]) -> list[str]:
        for column in ("query", "positives"):
            if column not in names:
                raise BenchmarkError(
                    f"line 1 of {truth_csv} lacks the column '{column}': "
                    "the first line must name the columns query,positives"
                )
        return names

    truth: dict[int, list[int]] = {}
    try:
        for line, fields in read_csv(truth_csv, header, missing=None):
            at = f"line {line} of {truth_csv}"
            query = (fields["query"] or "").strip()
            # An empty cell says that nothing is right; a line that ends before it says nothing at all.
            if not query or fields["positives"] is None:
                raise BenchmarkError(
                    f"{at} lacks a query or its positives: "
                    "write query,positives (positives separated by ; and empty where none is right)"
                )
            row = queries.row(query, at)
            if row in truth:
                raise BenchmarkError(f"{at} names the query '{query}' a second time: keep one line a query")
            # Where semicolons part the fields, and no quotes hold the positives, all but the first are in no column.
            cells = [fields["positives"], *fields.get(None, ())]  # type: ignore[call-overload]  # so `read_csv` has it
            names = (positive.strip() for cell in cells for positive in cell.split(";"))
            truth[row] = [references.row(name, at) for name in names if name]
    except (OSError, UnicodeDecodeError, CsvError) as error:
        raise BenchmarkError(
            f"the truth table {truth_csv} cannot be read ({reason(error)}): give a CSV file in UTF-8"
        ) from error
    return truth


def looking_alike(queries: Sequence[Photo], references: Sequence[Photo], positives: Ragged, tolerance: float) -> Ragged:
    """Keep of each query's positives those that look the same way, within `tolerance` degrees.

    Raises:
        BenchmarkError: If a photo has no heading, or the tolerance is not between 0 and 180.
    """
    if not 0 <= tolerance <= 180:
        raise BenchmarkError(f"headings within {tolerance} degrees make no sense: give 0 to 180")
    ours, theirs = headings(queries), headings(references)
    for photos, known in ((queries, ours), (references, theirs)):
        lost = np.flatnonzero(np.isnan(known))
        if lost.size:
            raise BenchmarkError(
                f"{lost.size} of {len(photos)} photos have no heading, the first {photos[int(lost[0])].path}: "
                "give a table with headings, or leave the tolerance of headings away"
            )
    query = np.repeat(np.arange(len(ours)), positives.lengths)
    apart = turn_between(theirs[positives.values], ours[query])
    alike = apart <= tolerance + 1e-9  # with room for rounding
    counts = np.bincount(query[alike], minlength=len(ours))
    return Ragged(positives.values[alike], counts)
