"""The mean of models: each weight by itself, whatever they were stored as, and what has no mean."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from salad.errors import ModelError
from salad.models.describer import Describer
from salad.network.aggregator_config import GemConfig, SaladConfig
from salad.network.checkpoints import mean
from salad.network.config import Calibration, LiteConfig, ModelConfig, Preprocessing
from salad.network.network import build

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
    assert made.config.provenance == (
        f"the mean of tiny ({models[0].fingerprint}), tiny ({models[1].fingerprint})"
    )
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
