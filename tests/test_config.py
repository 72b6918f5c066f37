"""Configurations: both ways through JSON, the paper's widths, and damaged ones refused."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.config import (
    PRESETS,
    VITS,
    Calibration,
    GemConfig,
    LiteConfig,
    ModelConfig,
    Preprocessing,
    SaladConfig,
    SceneConfig,
    ViTConfig,
)
from salad.errors import ModelError

few = st.integers(1, 4096)
channels = st.tuples(*[st.floats(0.01, 1) | st.just(1)] * 3)
backbones = st.builds(ViTConfig, few, few, few, few, few, st.sampled_from([0, 4]), st.booleans()) | st.builds(
    LiteConfig, st.integers(1, 16)
)
aggregators = (
    st.builds(SaladConfig, few, few, few, few, few, st.floats(0, 0.9), st.none() | few)
    | st.builds(SceneConfig, few)
    | st.builds(GemConfig, few, st.floats(1, 9))
)
preparations = st.builds(
    Preprocessing, few, few, channels, channels, st.sampled_from(["bilinear", "bicubic"])
)
weights = st.floats(0, 1e6)
calibrations = st.builds(
    Calibration,
    weights,
    st.floats(-1e6, 1e6),
    *[weights] * 4,
    st.floats(1e-6, 1e3),
    st.floats(0, 1),
    st.text(),
)
models = st.builds(
    ModelConfig,
    st.text(),
    backbones,
    aggregators,
    preparations,
    st.text(),
    st.text(),
    st.none() | calibrations,
)


def _plain() -> dict[str, Any]:
    return ModelConfig("a", LiteConfig(), PRESETS["small"]).as_dict()


@settings(deadline=None, max_examples=60)
@given(models)
def test_json_brings_back_the_same_model(config: ModelConfig) -> None:
    text = json.dumps(config.as_dict())
    again = ModelConfig.from_dict(json.loads(text))
    assert again == config
    assert json.dumps(again.as_dict()) == text  # to the letter: fingerprints are made of it


@pytest.mark.parametrize(("name", "dim"), [("full", 8448), ("medium", 2112), ("small", 544)])
def test_presets_are_the_papers(name: str, dim: int) -> None:
    preset = PRESETS[name]
    assert (preset.dim, preset.hidden, preset.dropout, preset.width) == (dim, 512, 0.3, 768)


def test_a_final_linear_layer_decides_the_width() -> None:
    assert SaladConfig(width=768, cluster_dim=256, linear=8448).dim == 8448
    assert SceneConfig(width=7).dim == GemConfig(width=7).dim == 7


def test_dinov2_has_heads_of_64_numbers_and_the_giant_a_swiglu() -> None:
    assert {name: config.width // config.heads for name, config in VITS.items()} == dict.fromkeys(VITS, 64)
    assert [name for name, config in VITS.items() if config.swiglu] == ["vitg14"]


def test_reading_leaves_the_given_settings_alone() -> None:
    settings_, before = _plain(), _plain()
    ModelConfig.from_dict(settings_)
    assert settings_ == before


@pytest.mark.parametrize(
    ("part", "setting", "value", "said"),
    [
        ("backbone", "kind", "resnet", "kind 'resnet' is unknown; known are vit, lite0"),
        ("aggregator", "kind", None, "kind None is unknown; known are salad, scene, gem"),
        ("aggregator", "temperature", 3, "temperature"),
        ("preprocessing", "mean", [0.5, 0.5], "three numbers"),
        ("preprocessing", "std", [1.0, 1.0, 0.0], "std above 0"),
        ("preprocessing", "std", [1.0, 1.0, float("nan")], "three numbers"),
        ("preprocessing", "mean", "abc", "real number"),
        ("preprocessing", "height", 0, "whole pixels"),
        ("preprocessing", "width", "322", "whole pixels"),
        ("preprocessing", "resample", "magic", "bilinear, bicubic"),
        ("preprocessing", "gamma", 2, "gamma"),
    ],
)
def test_a_damaged_setting_is_named(part: str, setting: str, value: object, said: str) -> None:
    data = _plain()
    data[part][setting] = value
    with pytest.raises(ModelError, match=said):
        ModelConfig.from_dict(data)


@pytest.mark.parametrize("lost", ["name", "backbone", "aggregator", "preprocessing"])
def test_a_lost_part_is_named(lost: str) -> None:
    data = _plain()
    del data[lost]
    with pytest.raises(ModelError, match=lost):
        ModelConfig.from_dict(data)


@pytest.mark.parametrize("data", [None, 3, {"backbone": 3, "aggregator": [], "preprocessing": ""}])
def test_what_is_no_configuration_is_refused(data: Any) -> None:
    with pytest.raises(ModelError, match="cannot be read"):
        ModelConfig.from_dict(data)


def test_a_model_nobody_has_calibrated_says_nothing_of_it() -> None:
    assert "calibration" not in _plain()
    assert ModelConfig.from_dict(_plain()).calibration is None
    assert ModelConfig.from_dict({**_plain(), "calibration": None}).calibration is None


@pytest.mark.parametrize(
    ("setting", "value", "said"),
    [
        ("sharpness", -1.0, "sharpness"),
        ("top", -0.1, "top"),
        ("gap", float("nan"), "gap"),
        ("spread", "2", "spread"),
        ("share", True, "share"),
        ("bias", float("inf"), "bias"),
        ("radius", 0, "radius 0 must be above 0"),
        ("min_confidence", 1.01, "at most 1"),
        ("colour", 1, "nothing else and nothing less"),
    ],
)
def test_a_damaged_calibration_is_named(setting: str, value: object, said: str) -> None:
    data = {**_plain(), "calibration": {**Calibration().as_dict(), setting: value}}
    with pytest.raises(ModelError, match=said):
        ModelConfig.from_dict(data)


@pytest.mark.parametrize("data", [3, [], {"bias": 1.0}])
def test_what_is_no_calibration_is_refused(data: Any) -> None:
    with pytest.raises(ModelError, match="a calibration holds"):
        Calibration.from_dict(data)


def test_nobody_can_change_a_configuration() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        PRESETS["full"].clusters = 3  # type: ignore[misc]


def test_it_imports_no_torch() -> None:
    code = "import sys, salad.config, salad.train.recipe; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
