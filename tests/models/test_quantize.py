"""Models in fewer bits: other models, which say so in every way."""

from __future__ import annotations

import dataclasses
import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import salad
from salad.errors import ModelError, WeightsError
from salad.models import openvino_engine, quantize
from salad.models.describer import Describer
from salad.models.model_folder import load, write_calibration, write_folder
from salad.models.quantize import Reduced, quantized
from salad.network.config import Calibration
from salad.network.export import made_pictures

pytestmark = pytest.mark.skipif(find_spec("openvino") is None, reason="the extra fast is not installed")

PRECISIONS: list[Reduced] = ["bf16", "int8"]
NEAR = 0.9  # a cosine that no other model's descriptors have


@pytest.fixture(scope="module")
def model() -> Describer:
    """One that was trained: in one that was not, all photos look alike, and so do all precisions."""
    return salad.load("salad-lite", engine="openvino", threads=1)


@pytest.fixture(scope="module", params=PRECISIONS)
def precision(request: pytest.FixtureRequest) -> Reduced:
    return request.param


def made_of(model: Describer, precision: Reduced) -> Describer:
    return quantized(model, made_pictures(model.preprocessing, 12), precision=precision)


@pytest.fixture(scope="module")
def made(model: Describer, precision: Reduced) -> Describer:
    made = made_of(model, precision)
    try:
        made.describe([np.zeros((9, 9, 3), np.uint8)])
    except ModelError as error:
        pytest.skip(str(error))  # where the processor has no such instructions, which the sentence says
    return made


def test_it_is_another_model_that_describes_nearly_alike(model: Describer, made: Describer, precision: Reduced) -> None:
    photos = list(made_pictures(model.preprocessing, 6, seed=1))
    described = made.describe(photos)
    np.testing.assert_allclose(np.linalg.norm(described, axis=1), 1, atol=1e-5)
    cosines = (described * model.describe(photos)).sum(axis=1)
    assert NEAR < cosines.min() < 1 - 1e-7
    assert made.fingerprint != model.fingerprint
    assert made.name == f"salad-lite-{precision}"
    assert made.config.provenance == f"{model.config.provenance}; salad-lite ({model.fingerprint}) in {precision}"


def test_it_is_the_same_from_disk(made: Describer, precision: Reduced, tmp_path: Path) -> None:
    folder = write_folder(made, tmp_path / "q")
    read = load(folder)
    photos = list(made_pictures(made.preprocessing, 2, seed=1))
    np.testing.assert_array_equal(read.describe(photos), made.describe(photos))
    assert (read.fingerprint, read.config) == (made.fingerprint, made.config)
    assert read.engine_choice == ("openvino", f"nothing else runs a model in {precision}", False)


def test_the_precision_and_every_number_count_in_its_fingerprint(made: Describer) -> None:
    weights = dict(made.weights())
    for name, values in weights.items():
        changed = values.copy()
        changed[len(changed) // 2] ^= 1
        assert made.config.fingerprint({**weights, name: changed}) != made.fingerprint
    assert dataclasses.replace(made.config, precision="float32").fingerprint(weights) != made.fingerprint


def test_an_older_version_refuses_it_by_its_format(made: Describer, tmp_path: Path) -> None:
    """It compares the number before anything else, and says to upgrade; but asks first whether there are weights."""
    folder = write_folder(made, tmp_path / "q")
    assert json.loads((folder / "config.json").read_text())["format"] == 2
    assert (folder / "model.safetensors").is_file()


def test_it_can_be_calibrated(made: Describer, tmp_path: Path) -> None:
    folder = write_folder(made, tmp_path / "q")
    write_calibration(folder, Calibration(sharpness=7))
    read = load(folder)
    assert read.calibration == Calibration(sharpness=7)
    assert read.fingerprint == made.fingerprint


@pytest.mark.parametrize("change", [{"format": 1}, {"precision": "int4"}, {"precision": "float32"}])
def test_a_config_that_contradicts_itself_is_refused(
    made: Describer, change: dict[str, object], tmp_path: Path
) -> None:
    config = write_folder(made, tmp_path / "q") / "config.json"
    config.write_text(json.dumps(json.loads(config.read_text()) | change))
    with pytest.raises(WeightsError, match=r"config\.json"):
        load(config.parent)


def test_other_settings_than_it_was_made_for_is_refused(made: Describer, tmp_path: Path) -> None:
    config = write_folder(made, tmp_path / "q") / "config.json"
    config.write_text(config.read_text().replace('"bilinear"', '"bicubic"'))
    with pytest.raises(WeightsError, match=r"made of other settings .* anew with 'salad quantize'"):
        load(config.parent)


def test_no_other_engine_runs_it(made: Describer, tmp_path: Path) -> None:
    folder = write_folder(made, tmp_path / "q")
    for engine in ("onnx", "torch"):
        with pytest.raises(ModelError, match=f"by OpenVINO alone: ask for the engine auto, and not for {engine}"):
            load(folder, engine=engine)
    with pytest.raises(ModelError, match="has no torch module"):
        _ = made.network


def test_it_is_made_of_a_model_in_float32_by_openvino(model: Describer, made: Describer) -> None:
    for wrong in (made, salad.load("salad-lite")):
        with pytest.raises(ModelError, match="cannot be made int8: open a model in float32 with the engine openvino"):
            made_of(wrong, "int8")
    with pytest.raises(ModelError, match="without photos"):
        quantized(model, made_pictures(model.preprocessing, 0), precision="int8")


@pytest.mark.parametrize("exact", [True, False])
def test_eight_bits_are_for_processors_that_do_not_overflow(
    model: Describer, exact: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quantize, "adds_in_32_bits", lambda: exact)
    made = made_of(model, "int8")
    monkeypatch.setattr(openvino_engine, "adds_in_32_bits", lambda: False)
    photo = made_pictures(model.preprocessing, 1)[0]
    if exact:
        with pytest.raises(ModelError, match="salad-lite-int8 was made int8 for processors with VNNI"):
            made.describe([photo])
    else:
        assert made.describe([photo]) @ model.describe([photo])[0] > NEAR
