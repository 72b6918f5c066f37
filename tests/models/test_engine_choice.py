"""A long run takes the faster engine, measured once; a short one, or one that was asked for an engine, what it has."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import salad
from salad.models import engine_choice
from salad.models.describer import Describer
from salad.models.engine_choice import LONG, settle
from salad.models.fake import FakeDescriber
from salad.models.onnx_engine import OnnxEngine
from salad.models.openvino_engine import OpenVinoEngine

pytestmark = pytest.mark.skipif(find_spec("openvino") is None, reason="the extra fast is not installed")


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SALAD_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def model() -> Describer:
    return salad.load("salad-lite", threads=1)


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """What a measurement finds; empty it, and none may be made."""
    times = {"onnx": 0.02, "openvino": 0.01}

    def find(*_: object) -> dict[str, float]:
        assert times, "measured again"
        return dict(times)

    monkeypatch.setattr(engine_choice, "_measured", find)
    return times


@pytest.mark.parametrize(("openvino", "name"), [(0.01, "openvino"), (0.0195, "onnx"), (0.03, "onnx")])
def test_the_faster_one_is_taken_if_it_is_worth_it(
    model: Describer, measured: dict[str, float], openvino: float, name: str
) -> None:
    measured["openvino"] = openvino
    photo, before = np.zeros((9, 9, 3), np.uint8), model.fingerprint
    due = model.describe([photo])
    choice = settle(model, photos=LONG)
    assert choice == model.engine_choice
    assert choice is not None
    assert choice.name == name
    assert choice.why == f"measured here: 20.0 ms a photo by onnx, {1000 * openvino:.1f} ms a photo by openvino"
    assert isinstance(model.engine, {"onnx": OnnxEngine, "openvino": OpenVinoEngine}[name])
    assert model.fingerprint == before
    assert float(model.describe([photo])[0] @ due[0]) >= 0.99999


def test_it_is_measured_once_for_all_processes(home: Path, measured: dict[str, float]) -> None:
    first, second = (salad.load("salad-lite", threads=1) for _ in range(2))
    settle(first, photos=LONG)
    measured.clear()
    assert settle(second, photos=LONG) == first.engine_choice
    assert len(json.loads((home / "engines.json").read_text())) == 1
    with pytest.raises(AssertionError, match="measured again"):
        settle(salad.load("salad-lite", threads=2), photos=LONG)  # another number of threads is another question


@pytest.mark.parametrize("held", ["", "[]", '{"a": 3}', '{"a": {"onnx": "x"}}'])
def test_a_damaged_memory_is_none(home: Path, model: Describer, measured: dict[str, float], held: str) -> None:
    home.mkdir()
    (home / "engines.json").write_text(held)
    choice = settle(model, photos=LONG)
    assert choice is not None
    assert choice.name == "openvino"


def test_where_nothing_can_be_kept_it_is_measured_all_the_same(
    tmp_path: Path, model: Describer, measured: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("SALAD_HOME", str(tmp_path / "file"))
    choice = settle(model, photos=LONG)
    assert choice is not None
    assert choice.name == "openvino"


def test_nothing_is_measured_for_few_photos_or_where_an_engine_was_asked_for(measured: dict[str, float]) -> None:
    measured.clear()
    few, asked = salad.load("salad-lite"), salad.load("salad-lite", engine="onnx")
    assert settle(few, photos=LONG - 1) == few.engine_choice
    assert settle(asked, photos=LONG) == ("onnx", "it was asked for", False)
    assert settle(FakeDescriber(), photos=LONG) is None


def test_a_real_measurement_gives_a_time_for_each(model: Describer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_choice, "SECONDS", 0.01)
    choice = settle(model, photos=LONG)
    assert choice is not None
    assert choice.name in ("onnx", "openvino")
    assert choice.why.count("ms a photo") == 2
