"""The published layouts: whose names are whose, and what the shapes tell."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from salad.errors import ModelError, WeightsError
from salad.models.describer import Describer
from salad.network.aggregator_config import SaladConfig
from salad.network.baseline_config import GemConfig, SceneConfig
from salad.network.checkpoints import mean, recognise
from salad.network.config import Calibration, LiteConfig, ModelConfig, Preprocessing, ViTConfig
from salad.network.network import build

VIT = ViTConfig(width=16, depth=2, heads=2, patch=4, grid=3)
HEAD = SaladConfig(width=16, clusters=3, cluster_dim=4, scene_dim=5, hidden=6)
THEIRS = {"scene": "token_features", "feature": "cluster_features", "score": "score", "dustbin": "dust_bin"}


def _published(vit: ViTConfig, head: SaladConfig | SceneConfig, layout: str) -> dict[str, Tensor]:
    """Weights of a fresh model under a layout's names, its 1 x 1 convolutions with four axes."""
    raw: dict[str, Tensor] = {}
    for key, value in build(ModelConfig("x", vit, head)).state_dict().items():
        side, _, rest = key.partition(".")
        first, _, end = rest.partition(".")
        if side == "backbone":
            raw[{"flat": "backbone.model.", "megaloc": "backbone.", "hub": ""}[layout] + rest] = value
        elif first == "linear":
            raw[key] = value
        else:
            convolution = first in ("feature", "score") and value.ndim == 2
            name = ".".join(filter(None, (THEIRS[first], end)))
            prefix = "aggregator." if layout == "flat" else "aggregator.agg."
            raw[prefix + name] = value[:, :, None, None] if convolution else value
    if layout != "megaloc":
        raw["backbone.model.mask_token" if layout == "flat" else "mask_token"] = torch.zeros(1, vit.width)
    return raw


@settings(deadline=None, max_examples=15)
@given(
    st.sampled_from(["flat", "megaloc", "hub"]),
    st.integers(1, 3),
    st.sampled_from([2, 7]),
    st.sampled_from([0, 4]),
    st.booleans(),
    st.tuples(*[st.integers(1, 6)] * 4),
)
def test_everything_is_read_off_the_shapes(
    layout: str, depth: int, patch: int, registers: int, swiglu: bool, shape: tuple[int, int, int, int]
) -> None:
    vit = ViTConfig(16, depth, 2, patch=patch, grid=depth + 1, registers=registers, swiglu=swiglu)
    clusters, cluster_dim, scene_dim, hidden = shape
    linear = 9 if layout == "megaloc" else None
    head = SaladConfig(16, clusters, cluster_dim, scene_dim, hidden, linear=linear)
    wanted = SceneConfig(16) if layout == "hub" else head
    found = recognise(_published(vit, wanted, layout), heads=2)
    assert (found.layout, found.backbone, found.aggregator) == (layout, vit, wanted)
    model = build(ModelConfig("x", vit, wanted))
    model.load_state_dict(found.weights)  # strict: no name and no shape is off
    assert set(found.weights) == set(model.state_dict())


def test_heads_are_a_sixty_fourth_of_the_width_unless_told() -> None:
    wide = dataclasses.replace(VIT, width=192, heads=3)
    raw = _published(wide, SceneConfig(192), "hub")
    assert recognise(raw).backbone.heads == 3
    assert recognise(raw, heads=12).backbone.heads == 12
    assert recognise(_published(VIT, SceneConfig(16), "hub")).backbone.heads == 1


@pytest.mark.parametrize("raw", [{}, {"conv1.weight": torch.zeros(3), "fc.bias": torch.zeros(1)}])
def test_strange_names_are_refused(raw: dict[str, Tensor]) -> None:
    said = "conv1.weight, fc.bias" if raw else "no tensor at all"
    with pytest.raises(WeightsError, match=rf"{said} .*belong to no layout known here"):
        recognise(raw)


@pytest.mark.parametrize(
    ("lost", "ours"),
    [
        ("backbone.model.cls_token", "backbone.cls_token"),
        ("backbone.model.pos_embed", "backbone.pos_embed"),
        ("aggregator.cluster_features.3.weight", "aggregator.feature.3.weight"),
    ],
)
def test_a_tensor_the_shape_hangs_on_is_missed_by_name(lost: str, ours: str) -> None:
    raw = _published(VIT, HEAD, "flat")
    del raw[lost]
    with pytest.raises(WeightsError, match=f"{ours}.* is missing"):
        recognise(raw)


def test_a_tensor_with_too_few_axes_is_refused() -> None:
    raw = _published(VIT, HEAD, "flat")
    raw["backbone.model.pos_embed"] = torch.zeros(3)
    with pytest.raises(WeightsError, match="too few axes"):
        recognise(raw)


# --- the mean of models: each weight by itself, whatever they were stored as ----------------

CONFIG = ModelConfig(
    "tiny",
    LiteConfig(blocks=1),
    SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=4, hidden=8),
    Preprocessing(32, 32),
    licence="CC0",
    calibration=Calibration(),
)


def _models(count: int) -> list[Describer]:
    return [build(CONFIG, seed=seed) for seed in range(count)]


@pytest.mark.parametrize("count", [2, 3, 5])
def test_every_weight_is_the_mean_of_theirs(count: int) -> None:
    models = _models(count)
    made = mean(models).state_dict()
    for name, weight in made.items():
        theirs = [model.state_dict()[name] for model in models]
        if weight.is_floating_point():
            expected = sum(each.double() for each in theirs) / count
            assert torch.equal(weight, expected.to(weight.dtype)), name
        else:
            assert torch.equal(weight, theirs[0]), name
    assert any(not torch.equal(made[name], weight) for name, weight in models[0].state_dict().items())


def test_a_model_with_itself_is_that_model_and_stays_as_it_is() -> None:
    model = _models(1)[0]
    before = model.fingerprint
    assert mean([model, model, model]).fingerprint == before == model.fingerprint


def test_the_mean_says_of_what_it_is_and_leaves_the_calibration() -> None:
    models = _models(2)
    made = mean(models)
    assert made.config.provenance == (f"the mean of tiny ({models[0].fingerprint}), tiny ({models[1].fingerprint})")
    assert made.config == dataclasses.replace(CONFIG, provenance=made.config.provenance, calibration=None)
    assert not made.training


def test_one_model_has_no_mean() -> None:
    with pytest.raises(ModelError, match="two models or more, not 1"):
        mean(_models(1))


@pytest.mark.parametrize(
    ("part", "other"),
    [
        ("backbone", LiteConfig(blocks=1, kind="lite2")),
        ("aggregator", GemConfig(16)),
        ("preprocessing", Preprocessing(32, 48)),
    ],
)
def test_models_built_differently_have_no_mean(part: str, other: object) -> None:
    model = _models(1)[0]
    made = build(dataclasses.replace(CONFIG, **{part: other}))  # type: ignore[arg-type]  # one of three kinds
    with pytest.raises(ModelError, match=f"tiny .* and tiny .* differ in their {part}"):
        mean([model, made])
