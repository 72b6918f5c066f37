"""Choosing by held-out places: precision by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from salad.datasets.training_place import TrainingPlace
from salad.errors import BenchmarkError
from salad.network.config import Preprocessing
from salad.training import validation
from salad.training.batches import ImageCache
from salad.training.validation import average_precision, precision_held_out


class ByRedness:
    """Describes a photo by how red it is, as an angle: near shades are near descriptors."""

    preprocessing = Preprocessing(4, 6)

    def describe(self, photos: Sequence[np.ndarray], *, batch_size: int) -> np.ndarray:
        assert all(photo.shape == (4, 6, 3) for photo in photos)
        angle = np.array([photo[..., 0].mean() for photo in photos]) / 255
        return np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)


def _place(root: Path, city: str, name: str, shades: list[int]) -> TrainingPlace:
    (root / city / name).mkdir(parents=True)
    paths = []
    for number, red in enumerate(shades):
        paths.append(root / city / name / f"{number}.png")
        Image.new("RGB", (9, 8), (red, 0, 0)).save(paths[-1])
    return TrainingPlace(name, city, tuple(paths))


@pytest.fixture
def model() -> Any:
    return ByRedness()


def test_precision_by_hand(tmp_path: Path, model: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validation, "QUERIES", 1)
    places = [
        _place(tmp_path, "x", "a", [10, 50, 12]),  # 12 is asked: 10, then the stranger 15, then 50
        _place(tmp_path, "y", "b", [15, 200, 202]),  # 202 is asked: 200, then 50, then 15
    ]
    precision = precision_held_out(model, places, ImageCache(model.preprocessing))
    assert precision == {"x": 83.33, "y": 83.33, "mean": 83.33}  # (1/1 + 2/3) / 2 for both


def test_the_newest_photos_are_asked(tmp_path: Path, model: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validation, "QUERIES", 2)
    places = [
        _place(tmp_path, "x", "a", [100, 10, 11]),  # the oldest would find a stranger first
        _place(tmp_path, "y", "b", [101, 240, 241]),
    ]
    # 10 finds 11, 100: all right. 240 finds 241, then (nearer than 101? no) 101 before 100: all right
    assert precision_held_out(model, places, ImageCache(model.preprocessing))["mean"] == 100.0


def test_places_of_one_name_in_two_cities_are_two(tmp_path: Path, model: Any) -> None:
    places = [
        _place(tmp_path, "x", "a", [10, 100]),
        _place(tmp_path, "y", "a", [101, 11]),
    ]
    precision = precision_held_out(model, places, ImageCache(model.preprocessing))
    assert precision["mean"] < 100.0


@given(st.lists(st.booleans(), min_size=1, max_size=30))
def test_average_precision_is_the_mean_of_precisions_at_each_hit(right: list[bool]) -> None:
    at_hits = [sum(right[: n + 1]) / (n + 1) for n, hit in enumerate(right) if hit]
    wanted = sum(at_hits) / len(at_hits) if at_hits else 0.0
    assert average_precision(np.array(right)) == pytest.approx(wanted)


def test_a_photo_that_cannot_be_read_is_left_out(tmp_path: Path, model: Any) -> None:
    places = [_place(tmp_path, "x", "a", [10, 12]), _place(tmp_path, "y", "b", [200, 202])]
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no photo")
    worse = [dataclasses.replace(places[0], photos=(broken, *places[0].photos)), places[1]]
    images = ImageCache(model.preprocessing)
    assert precision_held_out(model, worse, images) == {"x": 100.0, "y": 100.0, "mean": 100.0}
    assert list(images.broken) == [broken]
    with pytest.raises(BenchmarkError, match="none of the photos of 1 places held out can be read"):
        precision_held_out(model, [dataclasses.replace(places[0], photos=(broken,))], images)
