"""Gradient caching: a batch learnt from in parts has the gradient of the whole."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch
from torch import nn

from salad.models.describer import Describer
from salad.network.config import ModelConfig
from salad.network.network import build
from salad.network.tokens import Tokens
from salad.training.devices import combined_seed, launch_fabric, rank_slice, step_seed
from salad.training.gradient_cache import backward_in_parts
from salad.training.loss import multi_similarity

LABELS = torch.arange(5).repeat_interleave(2)  # of ten photos
SEED = 11


def _photos() -> torch.Tensor:
    """Each of a colour of its own, so that a model without training tells them apart."""
    chance = torch.Generator().manual_seed(1)
    colours = 2 * torch.randn(len(LABELS), 3, 1, 1, generator=chance)
    return colours + torch.rand(len(LABELS), 3, 42, 42, generator=chance)


def _made(config: ModelConfig, *, dropout: float) -> Describer:
    aggregator: Any = dataclasses.replace(config.aggregator, dropout=dropout)
    model = build(dataclasses.replace(config, aggregator=aggregator), seed=3)
    model.backbone.train_last(1)
    return model.train()


def _gradients(module: nn.Module) -> dict[str, torch.Tensor]:
    return {name: weight.grad for name, weight in module.named_parameters() if weight.grad is not None}


def _learnt(model: Describer, at_once: int, *, precision: Any = "32-true") -> tuple[float, dict[str, torch.Tensor]]:
    model.zero_grad()
    fabric = launch_fabric("cpu", precision)
    module = fabric.setup(model)
    parts = list(torch.split(_photos(), at_once))
    loss = backward_in_parts(fabric, module, parts=parts, labels=LABELS, objective=multi_similarity(), seed=SEED)
    return float(loss), _gradients(model)


def _plain(model: Describer, at_once: int, *, precision: Any = "32-true") -> tuple[float, dict[str, torch.Tensor]]:
    """The same by one way back through everything, each part's hidden numbers dropped as they will be."""
    model.zero_grad()
    fabric = launch_fabric("cpu", precision)
    module = fabric.setup(model)
    described = []
    for number, part in enumerate(torch.split(_photos(), at_once)):
        torch.manual_seed(combined_seed(SEED, number))
        described.append(module(part).float())
    loss = multi_similarity()(torch.cat(described), LABELS)
    fabric.backward(loss)
    return loss.item(), _gradients(model)


def _close(found: dict[str, torch.Tensor], wanted: dict[str, torch.Tensor], *, within: float) -> None:
    assert found.keys() == wanted.keys()
    assert max(float(gradient.abs().max()) for gradient in wanted.values()) > 0.01  # there is something to learn
    for name, gradient in wanted.items():
        torch.testing.assert_close(found[name], gradient, rtol=0, atol=within, msg=name)


@pytest.mark.parametrize("backbone", ["lite", "vit"])
@pytest.mark.parametrize("at_once", [1, 3, 5])
def test_the_gradient_is_the_whole_batchs(backbone: str, at_once: int, request: pytest.FixtureRequest) -> None:
    model = _made(request.getfixturevalue(backbone), dropout=0.0)
    whole, wanted = _learnt(model, len(LABELS))
    loss, found = _learnt(model, at_once)
    assert loss == pytest.approx(whole, abs=1e-6)
    _close(found, wanted, within=1e-5)


@pytest.mark.parametrize("precision", ["32-true", "bf16-mixed"])
@pytest.mark.parametrize("dropout", [0.0, 0.5])
def test_what_is_dropped_at_random_is_dropped_both_times(vit: ModelConfig, dropout: float, precision: str) -> None:
    model = _made(vit, dropout=dropout)
    whole, wanted = _plain(model, 4, precision=precision)
    loss, found = _learnt(model, 4, precision=precision)
    assert loss == pytest.approx(whole, abs=1e-6)
    _close(found, wanted, within=1e-5)


def test_a_batch_at_once_is_the_plain_way(vit: ModelConfig) -> None:
    model = _made(vit, dropout=0.5)
    torch.manual_seed(combined_seed(SEED, 0))
    _, found = _learnt(model, len(LABELS))
    _, wanted = _plain(model, len(LABELS))
    for name, gradient in wanted.items():
        assert torch.equal(found[name], gradient), name


def test_the_model_never_sees_more_than_a_part(vit: ModelConfig) -> None:
    model = _made(vit, dropout=0.5)
    seen: list[int] = []
    model.backbone.register_forward_hook(lambda _, given, __: seen.append(len(given[0])))
    kept: list[bool] = []
    model.register_forward_hook(lambda _, __, out: kept.append(out.requires_grad))
    _learnt(model, 4)
    assert seen == [4, 4, 2, 4, 4, 2]
    assert kept == [False] * 3 + [True] * 3  # nothing is held for a way back the first time


def test_tokens_are_parts_too(vit: ModelConfig) -> None:
    model = _made(vit, dropout=0.0)
    model.backbone.train_last(0)
    _, wanted = _learnt(model, 4)
    with torch.no_grad():
        tokens = model.tokens(_photos())
    model.zero_grad()
    fabric = launch_fabric("cpu", "32-true")
    head = fabric.setup(model.aggregator)
    parts = [
        Tokens(patches, scene, tokens.grid, tokens.stride)
        for patches, scene in zip(torch.split(tokens.patches, 4), torch.split(tokens.cls, 4), strict=True)
    ]
    backward_in_parts(fabric, head, parts=parts, labels=LABELS, objective=multi_similarity(), seed=SEED)
    _close(_gradients(model), wanted, within=1e-5)


@pytest.mark.parametrize("at_once", [4, 10])
def test_descriptors_that_are_no_numbers_are_no_loss_of_nothing(vit: ModelConfig, at_once: int) -> None:
    model = _made(vit, dropout=0.0)
    with torch.no_grad():
        model.backbone.norm.weight.fill_(torch.nan)
    loss, _ = _learnt(model, at_once)
    assert loss != loss  # which only one that is no number is


@pytest.mark.parametrize("ranks", [1, 2, 3, 8])
@pytest.mark.parametrize("total", [8, 9, 23, 240])
def test_everything_is_one_processes_share(total: int, ranks: int) -> None:
    shares = [rank_slice(total, rank, ranks) for rank in range(ranks)]
    assert [number for share in shares for number in range(total)[share]] == list(range(total))
    sizes = [share.stop - share.start for share in shares]
    assert max(sizes) - min(sizes) <= 1
    assert min(sizes) >= 1


def test_no_two_steps_parts_or_processes_share_a_seed() -> None:
    seeds = [step_seed(seed, step, rank) for seed in range(3) for step in range(50) for rank in range(4)]
    seeds += [combined_seed(step, part) for step in range(20) for part in range(8)]
    assert len(set(seeds)) == len(seeds)
