"""Folders of photos, listed once."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from salad.datasets.folders import in_order, names_below
from salad.errors import BenchmarkError


def test_names_in_order() -> None:
    assert in_order(["10.jpg", "9.jpg", "a1.jpg"]) == ["a1.jpg", "9.jpg", "10.jpg"]
    assert in_order(["b.jpg", "9.jpg"]) == ["9.jpg", "b.jpg"]


def test_what_is_hidden_or_no_photo_is_left_out(tmp_path: Path, fakes: ModuleType) -> None:
    fakes.touch(tmp_path, ["b.JPG", "a/x.png", ".hidden.jpg", ".cache/y.jpg", "notes.txt"])
    (tmp_path / "a" / "round").symlink_to(tmp_path)
    assert names_below(tmp_path) == ["a/x.png", "b.JPG"]


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="holds no photos"):
        names_below(tmp_path)
    with pytest.raises(BenchmarkError, match="cannot be read"):
        names_below(tmp_path / "absent")
