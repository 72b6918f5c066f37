"""Photos found by what a table calls them, and those that look the same way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.datasets.compact_lists import Ragged
from salad.datasets.ground_truth import PhotoNames, looking_alike, read_truth
from salad.errors import BenchmarkError
from salad.images.photo import Photo

FOLDER = Path("set/refs")
NAMES = PhotoNames(FOLDER, [FOLDER / name for name in ("a.jpg", "in/b.jpg", "in/c.jpg", "on/c.jpg")])


@pytest.mark.parametrize(
    ("called", "row"),
    [("a.jpg", 0), ("./a.jpg", 0), ("b.jpg", 1), ("in/b.jpg", 1), ("in\\c.jpg", 2), ("on/c.jpg", 3)],
)
def test_by_path_or_by_a_name_that_only_one_bears(called: str, row: int) -> None:
    assert NAMES.row(called, "line 7") == row


@pytest.mark.parametrize(
    ("called", "says"),
    [
        ("c.jpg", "2 photos of .* write the path"),
        ("A.jpg", "is not a photo of"),
        ("in/a.jpg", "is not a photo"),
    ],
)
def test_a_name_of_none_or_of_several_is_told_with_its_line(called: str, says: str) -> None:
    with pytest.raises(BenchmarkError, match=f"line 7 names '{called}'.*{says}"):
        NAMES.row(called, "line 7")


@pytest.mark.parametrize(
    "text",
    [
        "query,positives\na.jpg,in/b.jpg;in/c.jpg\nin/b.jpg,\n",
        'query;positives\na.jpg;"in/b.jpg;in/c.jpg"\nin/b.jpg;\n',
        "query;positives\na.jpg;in/b.jpg;in/c.jpg\nin/b.jpg;\n",
        "sep=\t\nquery\tpositives\na.jpg\tin/b.jpg;in\\c.jpg\nin/b.jpg\t\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_truth_table_may_be_saved_by_any_spreadsheet(tmp_path: Path, text: str, encoding: str) -> None:
    (tmp_path / "truth.csv").write_bytes(text.encode(encoding))
    assert read_truth(tmp_path / "truth.csv", NAMES, NAMES) == {0: [1, 2], 1: []}


headings = st.lists(st.integers(0, 359), min_size=1, max_size=8)


@given(ours=headings, theirs=headings, tolerance=st.integers(0, 180), seed=st.integers(0, 99))
def test_looking_alike_against_every_pair(ours: list[int], theirs: list[int], tolerance: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    near = [np.flatnonzero(rng.random(len(theirs)) < 0.7) for _ in ours]
    sides = [[Photo(Path(f"{row}.jpg"), heading=float(h)) for row, h in enumerate(side)] for side in (ours, theirs)]
    alike = looking_alike(sides[0], sides[1], Ragged.of(near), tolerance)
    for heading, rows, kept in zip(ours, near, alike, strict=True):
        turns = [(theirs[row] - heading) % 360 for row in rows]
        right = [row for row, turn in zip(rows.tolist(), turns, strict=True) if min(turn, 360 - turn) <= tolerance]
        assert kept.tolist() == right
