"""`salad export-model`: one file that another program can run with no more than ONNX Runtime."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

import salad

pytestmark = pytest.mark.torch


def test_the_file_alone_describes_as_the_model_does(cli: Any, tmp_path: Path) -> None:
    file = tmp_path / "lite.onnx"
    ran = cli("export-model", "salad-lite", "--to", str(file))
    assert ran.code == 0, ran.err
    assert ran.out.strip() == str(file)
    assert [path.name for path in tmp_path.iterdir()] == ["lite.onnx"]
    photos = np.random.default_rng(0).integers(0, 256, (2, 320, 320, 3), dtype=np.uint8)
    images = photos.transpose(0, 3, 1, 2).astype(np.float32) / 255
    session = onnxruntime.InferenceSession(file)
    (found,) = session.run(None, {"images": images})
    assert (found * salad.load("salad-lite").describe(list(photos))).sum(axis=1).min() >= 0.99999
    told = session.get_modelmeta().custom_metadata_map
    assert told["salad.model"].startswith("salad-lite ")


def test_a_file_that_is_there_stays(cli: Any, tmp_path: Path) -> None:
    file = tmp_path / "mine.onnx"
    file.write_text("mine")
    ran = cli("export-model", "salad-lite", "--to", str(file))
    assert ran.code == 2
    assert "exists already" in ran.err
    assert file.read_text() == "mine"
