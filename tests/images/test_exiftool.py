"""Position, heading, time and orientation beside what exiftool says: the same, or different for a reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.exiftool import FACTS, compare, exiftool_version
from benchmarks.odd_photos import make
from salad.images.finding import SUFFIXES

pytestmark = pytest.mark.skipif(
    not exiftool_version(), reason="exiftool is not installed: apt install libimage-exiftool-perl"
)


def test_drawn_photos(tmp_path: Path) -> None:
    paths = make(tmp_path, 60, 7)
    found = compare(paths)
    assert not found.unexplained
    for fact in FACTS:
        told = sum(count for (of, _), count in found.differences.items() if of == fact)
        assert found.agreed[fact] + told == len(paths)
        assert found.agreed[fact] > len(paths) / 2


def test_folders_of_real_trouble(shared: Path) -> None:
    cases = shared / "cases"
    if not cases.is_dir():
        pytest.skip(f"there is no {cases}: it is not part of the repository")
    beside = ("sidecar", "takeout")  # what stands beside a photo exiftool reads only when it is told to
    paths = [
        path
        for path in sorted(cases.glob("*/**/*"))
        if path.is_file() and path.suffix.lower() in SUFFIXES and not path.name.startswith(beside)
    ]
    assert len(paths) > 100
    assert not compare(paths).unexplained
