"""What a training run is, as data. Imports no torch, so the command line can show and check it at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from salad.config import LiteConfig, ModelConfig, Preprocessing, SaladConfig, ViTConfig
from salad.errors import ModelError

Precision = Literal["bf16-mixed", "16-mixed", "32-true"]


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a model is trained: first the head alone, then most of the backbone with it.

    Args:
        head_steps: steps with the backbone frozen.
        tune_steps: steps with the head and the last `tuned_blocks` of the backbone trained.
        places: places in a batch.
        views: photos of each.
        head_rate: learning rate of the aggregator.
        trunk_rate: learning rate of the backbone once it is trained.
        weight_decay: AdamW's.
        warmup: steps over which a stage's learning rate rises; after that it falls linearly to `last`.
        last: share of the learning rate left at a stage's end.
        average: decay of the running mean of the weights, which is what is measured and kept.
        tuned_blocks: the last blocks of the backbone, trained in the second stage.
        held_out: share of the places kept for choosing, never trained on.
        measure_every: steps between two measurements on the places held out; the best of all is kept.
        precision: Fabric's word for it; `bf16-mixed` halves the time where the processor has bfloat16.
        seed: of everything random.
    """

    head_steps: int = 75
    tune_steps: int = 700
    places: int = 16
    views: int = 4
    head_rate: float = 1e-3
    trunk_rate: float = 2e-4
    weight_decay: float = 1e-4
    warmup: int = 20
    last: float = 0.05
    average: float = 0.99
    tuned_blocks: int = 8
    held_out: float = 0.2
    measure_every: int = 50
    precision: Precision = "bf16-mixed"
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Preset:
    """A model to make, where its backbone starts, and how it is trained."""

    model: ModelConfig
    start: str
    recipe: Recipe


LITE_HEAD = SaladConfig(width=112, clusters=64, cluster_dim=32, scene_dim=128, hidden=256, dropout=0.3)
LITE_PHOTO = Preprocessing(height=320, width=320, mean=(127 / 255,) * 3, std=(128 / 255,) * 3)

PRESETS: dict[str, Preset] = {
    "salad-lite": Preset(
        model=ModelConfig(
            name="salad-lite",
            backbone=LiteConfig(),
            aggregator=LITE_HEAD,
            preprocessing=LITE_PHOTO,
            provenance="EfficientNet-Lite0's ImageNet trunk up to block 10 under a SALAD head, trained with `salad "
            "train --preset salad-lite` on street photos, webcams and campus photos; see docs/model-card.md",
            licence="Apache-2.0; the photos it learnt from are research data with terms of their own, none of which "
            "is contained in the weights; see docs/model-card.md",
        ),
        start="imagenet",
        recipe=Recipe(),
    ),
    "salad-vits": Preset(
        model=ModelConfig(
            name="salad-vits",
            backbone=ViTConfig(width=384, depth=9, heads=6),
            aggregator=SaladConfig(
                width=384, clusters=64, cluster_dim=32, scene_dim=128, hidden=256, dropout=0.3
            ),
            preprocessing=Preprocessing(height=224, width=224),
        ),
        start="",  # a file given with --start
        recipe=Recipe(head_rate=5e-4, trunk_rate=3e-5, tuned_blocks=2),
    ),
}
"""`salad-lite` is the model that ships; `salad-vits` is what it was measured against."""


def preset(name: str) -> Preset:
    """Look a preset up.

    Raises:
        ModelError: there is none of that name.
    """
    if name not in PRESETS:
        raise ModelError(f"there is no preset {name!r}: choose one of {', '.join(PRESETS)}")
    return PRESETS[name]
