"""The gradient of a batch that is too large to pass through the model at once.

A loss over pairs needs all descriptors together, but a descriptor needs only its own photo. So the batch is described
in parts without gradients; the loss gives the gradient at the descriptors; then each part is described once more, now
with gradients, and passes its share of that on to the weights. The sum is the gradient of the whole batch, in the
memory of a part. Source: Gao et al., "Scaling Deep Contrastive Learning Batch Size under Memory Limited Setup" (2021).

Over several processes the descriptors of all are gathered before the loss, so a batch is one batch however many
devices share it: every process has the same loss, and the mean of their gradients is that of the whole batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from salad.network.tokens import Tokens
from salad.training.devices import combined_seed, gather_slices, rank_slice
from salad.training.loss import Objective

Part = Float[Tensor, "batch 3 height width"] | Tokens
"""What is described at once: normalised photos, or the tokens of as many."""


def backward_in_parts(
    fabric: Any,
    module: nn.Module,
    *,
    parts: Sequence[Part],
    labels: Int64[Tensor, " batch"],
    objective: Objective,
    seed: int,
) -> Float[Tensor, ""]:
    """Add the gradient of a batch's loss to the weights of `module`.

    Args:
        fabric: the run's Fabric.
        module: what describes a part, set up by `fabric`.
        parts: this process's slice of the batch (`rank_slice`), in one part or more.
        labels: which place each photo of the whole batch shows, the slices one after another.
        objective: descriptors and labels -> loss.
        seed: of what is random within the parts of this process, so that a part is described twice alike.

    Returns:
        The loss, the same in every process; not a number where a descriptor is none.
    """
    if len(parts) == 1:  # a batch that fits is described once
        described = [module(parts[0]).float()]
    else:
        with torch.no_grad():
            described = [_seeded(module, part, seed, number) for number, part in enumerate(parts)]
    mine = torch.cat([part.detach() for part in described])

    ranks = fabric.world_size
    everyones = gather_slices(fabric, mine, len(labels)).detach().requires_grad_()
    loss = objective(everyones, labels)
    (gradient,) = torch.autograd.grad(loss, everyones)
    # The processes' gradients are averaged later, while the batch's is their sum.
    my_gradient = gradient[rank_slice(len(labels), fabric.global_rank, ranks)] * ranks

    by_part = torch.split(my_gradient, [len(part) for part in described])
    for number, (part, of_part) in enumerate(zip(parts, by_part, strict=True)):
        # Processes may have one part more or less than others: they meet at their last one alone.
        with fabric.no_backward_sync(module, enabled=number + 1 < len(parts)):
            once = described[0] if len(parts) == 1 else _seeded(module, part, seed, number)
            fabric.backward(once, gradient=of_part)
    # A miner finds no pair among descriptors that are no numbers, and calls that a loss of nothing.
    sound = everyones.detach().isfinite().all()
    return torch.where(sound, loss.detach(), torch.nan)


def _seeded(module: nn.Module, part: Part, seed: int, number: int) -> Float[Tensor, "part dim"]:
    torch.manual_seed(combined_seed(seed, number))  # the same hidden numbers are dropped both times
    described: Tensor = module(part).float()
    return described
