"""`salad quantize`: what comes out is a model that the other commands take; and what is refused before any work."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from salad.evaluation import quantization

pytestmark = pytest.mark.skipif(find_spec("openvino") is None, reason="the extra fast is not installed")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("photos")
    for number in range(24):
        squares = np.random.default_rng(number).integers(0, 256, (9, 9, 3), dtype=np.uint8)
        Image.fromarray(squares).resize((320, 320), Image.Resampling.BICUBIC).save(made / f"{number}.png")
    return made


def test_what_it_makes_is_a_model_to_index_with(
    cli: Any, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quantization, "FEWEST", 10)
    monkeypatch.setattr(quantization, "POINT", 50.0)  # a dozen squares say nothing of how good it is
    made = tmp_path / "small"
    ran = cli("quantize", "salad-lite", "--photos", str(folder), "--to", str(made))
    assert ran.code == 0, ran.err
    assert ran.out.strip() == str(made)
    assert "salad-lite-int8: R@1 " in ran.err
    assert json.loads((made / "config.json").read_text())["precision"] == "int8"
    ran = cli("index", str(folder / "0.png"), "--to", str(tmp_path / "i"), "--model", str(made))
    assert ran.code == 0, ran.err


def test_it_is_refused_before_any_work_where_something_is_there(cli: Any, folder: Path) -> None:
    ran = cli("quantize", "salad-lite", "--photos", str(folder), "--to", str(folder))
    assert ran.code == 2
    assert f"{folder} exists already" in ran.err


def test_too_few_photos_leave_nothing_behind(cli: Any, folder: Path, tmp_path: Path) -> None:
    ran = cli("quantize", "salad-lite", "--photos", str(folder), "--to", str(tmp_path / "q"), "--precision", "bf16")
    assert ran.code == 2
    assert "24 photos are too few" in ran.err
    assert not list(tmp_path.iterdir())


def test_a_loss_is_a_sentence_and_nothing_is_written(
    cli: Any, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quantization, "FEWEST", 10)
    monkeypatch.setattr(quantization, "POINT", -1.0)  # as much more is asked for, which the same model cannot give
    monkeypatch.setattr(quantization, "quantized", lambda model, _, precision: replace_name(model, precision))
    ran = cli("quantize", "salad-lite", "--photos", str(folder), "--to", str(tmp_path / "q"))
    assert ran.code == 2
    assert "more than a point is lost, so it is not written" in ran.err
    assert not list(tmp_path.iterdir())


def replace_name(model: Any, precision: str) -> Any:
    return type(model)(replace(model.config, name=f"{model.name}-{precision}"), model.engine)


def test_where_the_extra_is_missing_it_is_named(
    cli: Any, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    ran = cli("quantize", "salad-lite", "--photos", str(folder), "--to", str(tmp_path / "q"))
    assert ran.code == 2
    assert "pip install 'salad-vpr[fast]'" in ran.err
