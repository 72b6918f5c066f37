"""A photo that is in both sides is found: the same file, saved anew, made smaller; and no other is."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from salad.errors import BenchmarkError
from salad.evaluation import leaks
from salad.evaluation.leaks import find_leaks
from salad.images.photo import Photo


def scene(seed: int) -> Image.Image:
    squares = np.random.default_rng(seed).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    return Image.fromarray(squares).resize((160, 160), Image.Resampling.BICUBIC)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in range(3):
        scene(number).save(tmp_path / f"r{number}.png")
    shutil.copy(tmp_path / "r0.png", tmp_path / "q0.png")
    scene(1).resize((120, 120)).save(tmp_path / "q1.jpg", quality=60)
    scene(9).save(tmp_path / "q2.png")
    return tmp_path


def sides(folder: Path) -> tuple[list[Photo], list[Photo]]:
    return (
        [Photo(folder / name) for name in ("q0.png", "q1.jpg", "q2.png")],
        [Photo(folder / f"r{number}.png") for number in range(3)],
    )


EVERY = [(0, 1, 2), (1, 0, 2), (2, 1, 0)]


def test_files_and_pictures(folder: Path) -> None:
    file, picture = find_leaks(*sides(folder), matches=EVERY)
    assert (file.query, file.reference, file.kind, file.difference) == (0, 0, "file", 0.0)
    assert (picture.query, picture.reference, picture.kind) == (1, 1, "picture")
    assert 0 < picture.difference < leaks.ALIKE
    assert Path(picture.query_path) == folder / "q1.jpg"
    assert file.reference_path == str(folder / "r0.png")


def test_without_matches_only_files_are_looked_for(folder: Path) -> None:
    assert [leak.kind for leak in find_leaks(*sides(folder))] == ["file"]


def test_only_what_is_likely_is_opened(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    first = leaks.thumbnail

    def noting(path: Path) -> np.ndarray:
        opened.append(path.name)
        return first(path)

    monkeypatch.setattr(leaks, "thumbnail", noting)
    find_leaks(*sides(folder), matches=EVERY, scores=[(1.0, 0.2, 0.1), (0.95, 0.89, 0.1), (0.3, 0.2, 0.1)])
    assert opened == ["q1.jpg", "r1.png"]  # the first pair is known already to be one file


def test_flat_pictures_are_all_alike_and_say_nothing(tmp_path: Path) -> None:
    for name, grey in (("q", 100), ("r", 101)):
        Image.new("RGB", (50, 50), (grey, grey, grey)).save(tmp_path / f"{name}.png")
    assert find_leaks([Photo(tmp_path / "q.png")], [Photo(tmp_path / "r.png")], matches=[(0,)]) == ()


def test_padding_is_no_match_and_a_missing_photo_a_sentence(folder: Path) -> None:
    queries, references = sides(folder)
    assert [leak.kind for leak in find_leaks(queries, references, matches=[(-1,)] * 3)] == ["file"]
    (folder / "r2.png").unlink()
    with pytest.raises(BenchmarkError, match=r"both sides cannot be told.*r2\.png"):
        find_leaks(queries, references)
