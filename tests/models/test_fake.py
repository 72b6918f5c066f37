"""The describer without a network."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from salad.errors import ModelError, PhotoError
from salad.models.fake import FakeDescriber
from salad.network.config import Preprocessing


def _picture(seed: int, height: int = 50, width: int = 70) -> np.ndarray:
    coarse = np.random.default_rng(seed).integers(0, 256, (4, 5, 3), dtype=np.uint8)
    return np.asarray(Image.fromarray(coarse).resize((width, height), Image.Resampling.BILINEAR))


def test_rows_have_length_one_whatever_the_photo() -> None:
    photos = [_picture(1), np.zeros((64, 64, 3), np.uint8), np.full((1, 900, 3), 255, np.uint8)]
    rows = FakeDescriber(17).describe(photos)
    assert rows.dtype == np.float32
    assert rows.shape == (3, 17)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-6)
    assert FakeDescriber().describe([]).shape == (0, 32)


def test_paths_images_and_arrays_are_the_same_photo(tmp_path: Path) -> None:
    pixels = _picture(2)
    image, path = Image.fromarray(pixels), tmp_path / "a.png"
    image.save(path)
    rows = FakeDescriber().describe([path, str(path), image, pixels], batch_size=2)
    np.testing.assert_array_equal(rows, np.repeat(rows[:1], 4, axis=0))


def test_photos_alike_are_closer_than_others() -> None:
    first, other = _picture(3), _picture(4)
    dimmed = (first * 0.9).astype(np.uint8)
    rows = FakeDescriber().describe([first, dimmed, other])
    assert rows[0] @ rows[1] > 0.95 > rows[0] @ rows[2]


def test_settings_change_the_fingerprint_and_names_do_not() -> None:
    models = [
        FakeDescriber(),
        FakeDescriber(16),
        FakeDescriber(seed=1),
        FakeDescriber(preprocessing=Preprocessing(height=64, width=80)),
    ]
    assert len({model.fingerprint for model in models}) == 4
    assert FakeDescriber(name="other").fingerprint == models[0].fingerprint


def test_bad_settings_and_photos_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="0 numbers"):
        FakeDescriber(0)
    with pytest.raises(ModelError, match="batch of 0"):
        FakeDescriber().describe([], batch_size=0)
    with pytest.raises(PhotoError):
        FakeDescriber().describe([tmp_path / "none.jpg"])
