"""One model out of several that were trained from one start: the mean of their weights.

Runs that differ in their batches, or in how photos are changed, end on different sides of the same basin. Its middle is
often better than each of them and costs nothing in use. Models of different starts have no such middle.

Source: Wortsman et al., "Model soups: averaging weights of multiple fine-tuned models improves accuracy without
increasing inference time", ICML 2022.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import torch

from salad.errors import ModelError
from salad.model.describer import Describer, build

_ALIKE = ("backbone", "aggregator", "preprocessing")


def mean(models: Sequence[Describer]) -> Describer:
    """Average models of one architecture; what is counted, not weighed, is the first's.

    The mean bears the first one's name, and no calibration: that was of other scores.

    Args:
        models: two or more; they stay as they are.

    Raises:
        ModelError: there are fewer than two, or they are not built alike.
    """
    if len(models) < 2:  # a mean of one is that one
        raise ModelError(f"a mean takes two models or more, not {len(models)}: name the others too")
    first = models[0]
    for other in models[1:]:
        for part in _ALIKE:
            if getattr(other.config, part) != getattr(first.config, part):
                raise ModelError(
                    f"{first.name} ({first.fingerprint}) and {other.name} ({other.fingerprint}) differ in their "
                    f"{part}, so their weights have no mean: give models built alike"
                )
    told = ", ".join(f"{model.name} ({model.fingerprint})" for model in models)
    made = build(dataclasses.replace(first.config, provenance=f"the mean of {told}", calibration=None))
    states = [model.state_dict() for model in models]
    for name, weight in made.state_dict().items():
        if weight.is_floating_point():
            weight.copy_(torch.stack([state[name].to("cpu", torch.float64) for state in states]).mean(dim=0))
        else:  # a batch norm counts its batches too
            weight.copy_(states[0][name])
    return made
