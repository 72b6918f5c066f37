"""The published layouts of weights: whose names are whose, and what shapes tell; and the mean of models.

Four layouts are known: `flat` (SALAD's release), the same inside a Lightning checkpoint, `megaloc`, and `hub`
(DINOv2's backbone alone). Each is renamed to our own, and everything a file says (widths, depths, clusters,
registers, a final linear layer) is read off its tensors' shapes.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from salad.errors import ModelError, WeightsError
from salad.network.aggregator_config import AggregatorConfig, SaladConfig
from salad.network.baseline_config import SceneConfig
from salad.network.config import ModelConfig, ViTConfig
from salad.network.network import Network, build, load_weights
from salad.network.weight_files import read_tensors

HEAD_WIDTH = 64  # numbers a head has in every published DINOv2
UNUSED = "backbone.mask_token"  # DINOv2's pretraining alone needs it

# the published names of the aggregator, and ours
AGGREGATOR = {
    "token_features": "scene",
    "cluster_features": "feature",
    "score": "score",
    "dust_bin": "dustbin",
}

Weights = dict[str, Tensor]


class Published(NamedTuple):
    """Weights under our own names, with what their shapes tell of the model."""

    layout: str
    backbone: ViTConfig
    aggregator: AggregatorConfig
    weights: Weights


def read_published(path: Path, *, heads: int | None = None, name: str | None = None) -> Network:
    """A model in one of the published layouts, read strictly.

    Args:
        path: The file.
        heads: Attention heads, which no tensor tells; width / 64 where not given.
        name: What to call the model; the file's name where not given.

    Raises:
        WeightsError: If the file is not of a layout known here, or lacks or adds a tensor; the message lists them.
    """
    tensors = read_tensors(path)
    try:
        found = recognise(tensors, heads=heads)
    except WeightsError as error:
        raise WeightsError(f"{path}: {error}") from error
    config = ModelConfig(
        name=name or path.stem,
        backbone=found.backbone,
        aggregator=found.aggregator,
        provenance=f"{path.name}, layout {found.layout}",
    )
    return load_weights(config, found.weights, source=path)


def recognise(raw: Mapping[str, Tensor], *, heads: int | None = None) -> Published:
    """Rename published weights to our own names and read the model's shape off them.

    Args:
        raw: The file's tensors under its own names.
        heads: Attention heads, which no tensor tells; width / 64 where not given.

    Raises:
        WeightsError: If the names belong to no layout known here, or a tensor that must be there is missing or has
            too few axes.
    """
    # Told apart by the one name that each has and the others lack; Lightning's is the flat one, unwrapped already.
    keys = raw.keys()
    if any(key.startswith("backbone.model.") for key in keys):
        layout, weights = "flat", {_flat(key): value for key, value in raw.items()}
    elif any(key.startswith("aggregator.agg.") for key in keys):
        layout, weights = (
            "megaloc",
            {_flat(key.replace(".agg.", ".", 1)): value for key, value in raw.items()},
        )
    elif "cls_token" in keys:
        layout, weights = "hub", {f"backbone.{key}": value for key, value in raw.items()}
    else:
        seen = ", ".join(sorted(keys)[:3]) or "no tensor at all"
        raise WeightsError(
            f"its tensors ({seen} ...) belong to no layout known here; known are SALAD's release, its Lightning "
            "checkpoints, MegaLoc and DINOv2's backbones"
        )
    weights.pop(UNUSED, None)
    try:
        vit = _vit(weights, heads)
        # A backbone alone is a model too: its cls token is the plainest descriptor, and training starts from it.
        aggregator = SceneConfig(width=vit.width) if layout == "hub" else _salad(weights)
    except KeyError as error:
        raise WeightsError(f"the tensor {error} is missing; the file may be cut short") from error
    except (IndexError, ValueError) as error:
        raise WeightsError("a tensor has too few axes for its name; the file may be damaged") from error
    for key, value in weights.items():
        if key.startswith("aggregator.") and value.ndim == 4:
            weights[key] = value.flatten(1)  # a 1 x 1 convolution is the linear layer that we have in its place
    return Published(layout, vit, aggregator, weights)


def _flat(key: str) -> str:
    key = key.replace("backbone.model.", "backbone.", 1)
    return re.sub(r"^aggregator\.(\w+)", lambda name: f"aggregator.{AGGREGATOR.get(name[1], name[1])}", key)


def _vit(weights: Weights, heads: int | None) -> ViTConfig:
    width = weights["backbone.cls_token"].shape[-1]
    # Counted by the highest number and not by how many there are: a block that is missing is then said by name.
    numbers = [int(found[1]) for key in weights if (found := re.match(r"backbone\.blocks\.([0-9]{1,9})\.", key))]
    registers = weights.get("backbone.register_tokens")
    return ViTConfig(
        width=width,
        depth=max(numbers, default=-1) + 1,
        heads=heads or max(1, width // HEAD_WIDTH),
        patch=weights["backbone.patch_embed.proj.weight"].shape[-1],
        grid=math.isqrt(weights["backbone.pos_embed"].shape[1] - 1),
        registers=0 if registers is None else registers.shape[1],
        swiglu="backbone.blocks.0.mlp.w12.weight" in weights,
    )


def _salad(weights: Weights) -> SaladConfig:
    linear = weights.get("aggregator.linear.weight")
    return SaladConfig(
        width=weights["aggregator.score.0.weight"].shape[1],
        hidden=weights["aggregator.score.0.weight"].shape[0],
        clusters=weights["aggregator.score.3.weight"].shape[0],
        cluster_dim=weights["aggregator.feature.3.weight"].shape[0],
        scene_dim=weights["aggregator.scene.2.weight"].shape[0],
        linear=None if linear is None else linear.shape[0],
    )


def mean(models: Sequence[Network]) -> Network:
    """Make one model of several that were trained from one start: the mean of their weights.

    Runs that differ in their batches, or in how photos are changed, end on different sides of the same basin. Its
    middle is often better than each of them and costs nothing in use. Models of different starts have no such middle.
    The mean bears the first one's name, and no calibration: that was of other scores.

    Source: Wortsman et al., "Model soups: averaging weights of multiple fine-tuned models improves accuracy without
    increasing inference time", ICML 2022.

    Args:
        models: Two or more; they stay as they are.

    Raises:
        ModelError: If there are fewer than two, or they are not built alike.
    """
    if len(models) < 2:  # a mean of one is that one
        raise ModelError(f"a mean takes two models or more, not {len(models)}: name the others too")
    names = [f"{model.config.name} ({model.fingerprint})" for model in models]
    first = models[0].config
    for other, name in zip(models, names, strict=True):
        for part in ("backbone", "aggregator", "preprocessing"):
            if getattr(other.config, part) != getattr(first, part):
                raise ModelError(
                    f"{names[0]} and {name} differ in their {part}, so their weights have no mean: give models "
                    "built alike"
                )
    averaged = build(dataclasses.replace(first, provenance=f"the mean of {', '.join(names)}", calibration=None))
    states = [model.state_dict() for model in models]
    for key, weight in averaged.state_dict().items():
        if weight.is_floating_point():
            # In double: the mean of a model with itself is then that model, to the last bit.
            weight.copy_(torch.stack([state[key].to("cpu", torch.float64) for state in states]).mean(dim=0))
        else:  # a batch norm counts its batches too
            weight.copy_(states[0][key])
    return averaged
