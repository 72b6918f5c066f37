"""The rate's course, the running mean, and what is handed to the optimizer."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from torch import nn

from salad.errors import ModelError
from salad.models.describer import build
from salad.network.aggregator_config import GemConfig
from salad.network.config import ModelConfig
from salad.training.optim import build_optimizer, learning_rate_factor, set_learning_rates, update_average
from salad.training.recipe import Recipe


def test_the_rate_rises_then_falls_to_its_last_share() -> None:
    recipe = Recipe(warmup=4, last=0.2)
    factors = [learning_rate_factor(step, 100, recipe) for step in range(101)]
    assert factors[0] == pytest.approx(0.25)
    assert max(factors) == factors[3]
    assert factors[50] == pytest.approx(0.6)
    assert factors[100] == pytest.approx(0.2)


def test_the_rate_may_fall_sooner_and_stays_then() -> None:
    recipe = Recipe(warmup=0, last=0.2, decay_over=40)
    factors = [learning_rate_factor(step, 100, recipe) for step in range(101)]
    assert factors[0] == 1.0
    assert factors[20] == pytest.approx(0.6)
    assert factors[40:] == pytest.approx([0.2] * 61)


def test_head_and_trunk_have_rates_of_their_own(vit: ModelConfig) -> None:
    model = build(vit)
    model.backbone.train_last(1)
    recipe = Recipe(head_rate=0.5, trunk_rate=0.25, weight_decay=0.125)
    optimizer = build_optimizer(model, recipe)
    set_learning_rates(optimizer, 0.1)
    assert [group["lr"] for group in optimizer.param_groups] == pytest.approx([0.05, 0.025])
    assert {group["weight_decay"] for group in optimizer.param_groups} == {0.125}
    given = sum(len(group["params"]) for group in optimizer.param_groups)
    assert given == sum(weight.requires_grad for weight in model.parameters())
    model.backbone.train_last(0)
    assert len(build_optimizer(model, recipe).param_groups) == 1


def test_a_model_with_nothing_to_train_is_a_sentence(vit: ModelConfig) -> None:
    model = build(dataclasses.replace(vit, aggregator=GemConfig(16)))
    model.backbone.train_last(0)
    with pytest.raises(ModelError, match="tiny has nothing to train"):
        build_optimizer(model, Recipe())


def test_the_mean_forgets_its_start_and_then_wanders_slowly() -> None:
    mean, towards = nn.Linear(1, 1, bias=False), nn.Linear(1, 1, bias=False)
    nn.init.constant_(mean.weight, 5.0)
    nn.init.constant_(towards.weight, 1.0)
    update_average(mean, towards, decay=0.9, step=0)
    assert mean.weight.item() == 1.0
    nn.init.constant_(towards.weight, 2.0)
    update_average(mean, towards, decay=0.9, step=10_000)
    assert mean.weight.item() == pytest.approx(1.1)
    update_average(mean, towards, decay=0.0, step=10_000)
    assert mean.weight.item() == pytest.approx(2.0)


def test_counters_that_no_gradient_moves_follow_at_once() -> None:
    mean, towards = nn.BatchNorm1d(2), nn.BatchNorm1d(2)
    assert towards.running_mean is not None
    assert mean.running_mean is not None
    towards.running_mean.fill_(3.0)
    update_average(mean, towards, decay=0.99, step=50)
    assert torch.equal(mean.running_mean, towards.running_mean)
