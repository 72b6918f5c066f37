"""What moves the weights: AdamW with a rate for the head and one for the backbone, and how the rates go."""

from __future__ import annotations

import torch
from torch import nn

from salad.errors import ModelError
from salad.network.network import Network
from salad.training.recipe import Recipe


def build_optimizer(model: Network, recipe: Recipe) -> torch.optim.Optimizer:
    """AdamW over all weights that want gradients; each group knows its full rate as `rate`.

    Raises:
        ModelError: If no weight wants any.
    """
    groups = [
        {"params": [weight for weight in part.parameters() if weight.requires_grad], "rate": rate}
        for part, rate in ((model.aggregator, recipe.head_rate), (model.backbone, recipe.trunk_rate))
    ]
    groups = [group for group in groups if group["params"]]  # a part that is frozen has no rate
    if not groups:
        raise ModelError(
            f"the model {model.config.name} has nothing to train: its aggregator has no weights and its backbone is "
            "frozen; give tuned_blocks 1 or more and no head_steps"
        )
    return torch.optim.AdamW(groups, weight_decay=recipe.weight_decay)


def learning_rate_factor(step: int, steps: int, recipe: Recipe) -> float:
    """What the learning rate is multiplied by at a step of its stage: up, then linearly down, then level.

    Args:
        step: of the stage, from 0 on.
        steps: of the stage.
        recipe: says how long the rate rises, over how many steps it falls, and to what.
    """
    rising = min(1.0, (step + 1) / max(1, recipe.warmup))
    fallen = min(1.0, step / max(1, recipe.decay_over or steps))
    return rising * (1 - (1 - recipe.last) * fallen)


def set_learning_rates(optimizer: torch.optim.Optimizer, factor: float) -> None:
    """Multiply each group's full rate by `factor`."""
    for group in optimizer.param_groups:
        group["lr"] = group["rate"] * factor


@torch.no_grad()
def update_average(average: nn.Module, model: nn.Module, *, decay: float, step: int) -> None:
    """Let an exponential moving average of weights follow those of a step: it wanders less than they do.

    Args:
        average: what follows.
        model: what is followed.
        decay: how much of the average stays, 0..1; 0 makes it a copy.
        step: steps made so far; a young average soon forgets its start.
    """
    stays = min(decay, step / (step + 10))
    for old, new in zip(average.parameters(), model.parameters(), strict=True):
        old.lerp_(new, 1 - stays)
    # Statistics of a normalisation are averages already, and a count of batches has none.
    for buffer, current in zip(average.buffers(), model.buffers(), strict=True):
        buffer.copy_(current)
