"""Choosing by held-out places: recall by hand, photos read once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from salad.config import Preprocessing
from salad.data.places import TrainingPlace
from salad.errors import PhotoError
from salad.train import choose
from salad.train.choose import Shelf, recall_held_out


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


def test_recall_by_hand(tmp_path: Path, model: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choose, "QUERIES", 4)
    places = [
        _place(
            tmp_path, "x", "dark", [10, 12, 11, 200, 14, 13]
        ),  # one of four queries looks like another place
        _place(tmp_path, "x", "bright", [200, 202, 201, 205]),
        _place(
            tmp_path, "y", "dark", [60, 60, 12, 61, 62, 63, 12]
        ),  # the newest four are asked, one of them wrong
    ]
    recall = recall_held_out(model, places, Shelf(model))
    assert recall == {"x": 83.3, "y": 75.0, "mean": 79.15}


def test_places_of_one_name_in_two_cities_are_two(tmp_path: Path, model: Any) -> None:
    places = [
        _place(tmp_path, "x", "a", [10, 10, 100, 100]),
        _place(tmp_path, "y", "a", [100, 100, 10, 10]),
    ]
    assert recall_held_out(model, places, Shelf(model))["mean"] == 0.0


def test_a_photo_is_read_once(tmp_path: Path, model: Any) -> None:
    place = _place(tmp_path, "x", "a", [10, 20, 30, 40])
    shelf = Shelf(model)
    first = shelf.photos(place.photos)
    assert first.shape == (4, 3, 4, 6)
    assert first[:, 0, 0, 0].tolist() == [10, 20, 30, 40]
    for path in place.photos:
        path.unlink()
    assert shelf.photos(place.photos).equal(first)


def test_a_photo_that_cannot_be_read_is_named(tmp_path: Path, model: Any) -> None:
    with pytest.raises(PhotoError, match=r"gone\.jpg"):
        Shelf(model).photos([tmp_path / "gone.jpg"])
