"""The rate's course, the running mean, what is handed to the optimizer; and the loss against numbers by hand."""

from __future__ import annotations

import dataclasses
import math
import sys

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from salad.errors import MissingExtraError, ModelError
from salad.network.baseline_config import GemConfig
from salad.network.config import ModelConfig
from salad.network.network import build
from salad.training.loss import multi_similarity
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


# four unit vectors in the plane at these angles; the first two show one place, the others another
ANGLES = (0, 40, 60, 130)
LABELS = torch.tensor([0, 0, 1, 1])


def _vectors(angles: tuple[float, ...] = ANGLES) -> torch.Tensor:
    radians = torch.tensor(angles, dtype=torch.float64).deg2rad()
    return torch.stack([radians.cos(), radians.sin()], dim=1)


def _by_hand(*, alpha: float, beta: float, base: float, margin: float) -> float:
    """The paper's equations for these four vectors, pair by pair (Wang et al., equations 10 to 15)."""
    likeness = [[math.cos(math.radians(a - b)) for a in ANGLES] for b in ANGLES]
    total = 0.0
    for i in range(4):
        same = [likeness[i][j] for j in range(4) if j != i and LABELS[j] == LABELS[i]]
        other = [likeness[i][j] for j in range(4) if LABELS[j] != LABELS[i]]
        hard_same = [s for s in same if s - margin < max(other)]
        hard_other = [s for s in other if s + margin > min(same)]
        total += math.log(1 + sum(math.exp(-alpha * (s - base)) for s in hard_same)) / alpha
        total += math.log(1 + sum(math.exp(beta * (s - base)) for s in hard_other)) / beta
    return total / 4


@pytest.mark.parametrize(
    "options",
    [
        {"alpha": 1.0, "beta": 50.0, "base": 0.0, "margin": 0.1},
        {"alpha": 2.0, "beta": 10.0, "base": 0.5, "margin": 0.3},
    ],
)
def test_the_loss_is_the_papers(options: dict[str, float]) -> None:
    loss = multi_similarity(**options)(_vectors(), LABELS)
    assert float(loss) == pytest.approx(_by_hand(**options), rel=1e-6)


def test_the_papers_numbers_are_the_ones_meant() -> None:
    """Worked out on paper for the defaults, every pair but (0, 130 degrees) hard:
    (ln(1 + e^-cos 40) + ln(1 + e^-cos 40) + 2 ln(1 + e^-cos 70) + pairs of two places) / 4."""
    near, far = math.cos(math.radians(40)), math.cos(math.radians(70))
    same = 2 * math.log(1 + math.exp(-far))
    # place 0's vector at 0: hardest stranger cos 60 = 0.5 < 0.766 - 0.1, so it learns nothing
    same += math.log(1 + math.exp(-near))  # at 40: a stranger at cos 20 = 0.94
    others = math.log(1 + math.exp(50 * math.cos(math.radians(20)))) / 50  # at 40; cos 90 = 0 is no threat
    others += math.log(1 + math.exp(50 * 0.5) + math.exp(50 * math.cos(math.radians(20)))) / 50  # at 60
    # at 130: strangers at cos 130 and cos 90 = 0, against its own at cos 70 = 0.342 - 0.1: nothing to push
    same -= math.log(1 + math.exp(-far))
    loss = multi_similarity()(_vectors(), LABELS)
    assert float(loss) == pytest.approx((same + others) / 4, rel=1e-6)


def test_places_far_apart_teach_nothing() -> None:
    vectors = F.normalize(torch.tensor([[1.0, 0.0], [1.0, 0.01], [-1.0, 0.0], [-1.0, 0.01]]), dim=1)
    assert float(multi_similarity()(vectors, LABELS)) == 0.0


def test_learning_draws_a_place_together() -> None:
    vectors = _vectors().requires_grad_()
    multi_similarity()(vectors, LABELS).backward()
    assert vectors.grad is not None
    moved = F.normalize(vectors.detach() - 0.1 * vectors.grad, dim=1)
    before = vectors.detach()
    assert float(moved[2] @ moved[3]) > float(before[2] @ before[3])
    assert float(moved[1] @ moved[2]) < float(before[1] @ before[2])


def test_without_the_extra_its_name_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pytorch_metric_learning", None)
    with pytest.raises(MissingExtraError, match=r"training needs the 'train' extra: pip install 'salad-vpr\[train\]'"):
        multi_similarity()
