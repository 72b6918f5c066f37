"""What a training run is, as data. Imports no torch, so the command line can show and check it at once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from salad.datasets.places import split
from salad.datasets.training_place import TrainingPlace
from salad.errors import ModelError
from salad.network.aggregator_config import PRESETS as AGGREGATORS_OF_THE_PAPER
from salad.network.aggregator_config import RouteConfig, SaladConfig
from salad.network.config import VITS, LiteConfig, ModelConfig, Preprocessing, ViTConfig

Precision = Literal["bf16-mixed", "16-mixed", "32-true"]
Augment = Literal["lite", "paper", "kornia", "robust", "none"]
Sampling = Literal["mixed", "one-city", "cliques"]


_LEAST: dict[str, int] = {
    name: least
    for least, names in (
        (0, "head_steps tune_steps head_rate trunk_rate weight_decay warmup last average tuned_share clip"),
        (0, "tuned_blocks held_out full_steps cache_versions mine_every seed split_seed"),
        (1, "epochs decay_over measure_every save_every size at_once"),
        # With fewer photos of a place, or places, nothing can be told apart or drawn together.
        (2, "places views clique"),
    )
    for name in names.split()
}


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a model is trained: first the head alone, then the last blocks of the backbone with it.

    The defaults are those of the model that ships.

    Args:
        head_steps: steps with the backbone frozen.
        tune_steps: steps with the head and the last `tuned_blocks` of the backbone trained.
        epochs: in place of `tune_steps`, how often the second stage goes through all places.
        places: places in a batch.
        views: photos of each.
        head_rate: learning rate of the aggregator.
        trunk_rate: learning rate of the backbone once it is trained.
        weight_decay: AdamW's.
        warmup: steps over which a stage's learning rate rises; after that it falls linearly to `last`.
        last: fraction of the learning rate left at a stage's end.
        decay_over: steps over which the rate falls, where not over the whole stage; after them it stays.
        average: decay of the running mean of the weights, which is what is measured and kept; 0 for no mean.
        tuned_share: how far the weights kept lie on the way from the end of the first stage to where the second has
            come: 1 for all the way. A backbone knows less of photos unlike those it is tuned on, so somewhere on
            the way is better at both. Source: Wortsman et al., "Robust fine-tuning of zero-shot models", 2022.
        clip: longest gradient of a step; a longer one is shortened to this. None for any.
        tuned_blocks: the last blocks of the backbone, trained in the second stage.
        held_out: fraction of the places kept for choosing, never trained on.
        measure_every: steps between two measurements on the places held out; the best of all is kept.
        save_every: steps between two checkpoints; one is written at each measurement too.
        precision: Fabric's word for it; `bf16-mixed` halves the time where the processor has bfloat16.
        augment: how photos are changed: `lite`, `paper` (RandAugment), `kornia` (that library's), `robust`, or `none`.
        sampler: how batches are drawn: `mixed` from all cities, each from `one-city`, or of `cliques` of places
            that look alike to the model as it stands.
        mirror: whether half of the places are mirrored; a mirrored place is another place.
        size: side in pixels of the squares trained on, where not the size of photos in use: a smaller one costs less.
        full_steps: with `size`, so many of the last steps at the size in use all the same, since the dustbin's share
            depends on how many tokens there are.
        at_once: photos that pass through the model at once. A batch of more is learnt from in parts, by gradient
            caching: the same gradients in the memory of a part, for a third more time. None for the whole batch.
        cache_versions: with a frozen backbone, so many augmented versions of each photo, whose tokens are kept on
            disk as float16; 0 for a fresh one at every step.
        mine_every: with `cliques`, steps between two searches for places that look alike; batches are mixed until
            the first.
        clique: places in a clique.
        seed: of everything random.
        split_seed: of which places are held out, where not `seed` too. Runs of other seeds that are to be compared,
            averaged, or gone on with from one another need the same places held out.
        version: of what the settings mean. Before 2, `paper` was what `kornia` is.

    Raises:
        ModelError: If a number is out of its range, or two settings do not go together.
    """

    head_steps: int = 75
    tune_steps: int = 600
    epochs: int | None = None
    places: int = 16
    views: int = 4
    head_rate: float = 1e-3
    trunk_rate: float = 2e-4
    weight_decay: float = 1e-4
    warmup: int = 20
    last: float = 0.05
    decay_over: int | None = None
    average: float = 0.99
    tuned_share: float = 1.0
    clip: float | None = 1.0
    tuned_blocks: int = 8
    held_out: float = 0.2
    measure_every: int = 100
    save_every: int = 50
    precision: Precision = "bf16-mixed"
    augment: Augment = "lite"
    sampler: Sampling = "mixed"
    mirror: bool = True
    size: int | None = None
    full_steps: int = 0
    at_once: int | None = None
    cache_versions: int = 0
    mine_every: int = 0
    clique: int = 4
    seed: int = 0
    split_seed: int | None = None
    version: int = 2

    def __post_init__(self) -> None:
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if value is not None and not (least <= value < math.inf):
                raise ModelError(f"{name} of the recipe is {value}: give {least} or more")
        for name in ("last", "tuned_share", "held_out", "average"):
            value, up_to_one = getattr(self, name), name in ("last", "tuned_share")
            # Nothing could be learnt from with all places held out, and an average of decay 1 never moves.
            if value > 1 or (value == 1 and not up_to_one):
                raise ModelError(f"{name} of the recipe is {value}: give a share {'up to' if up_to_one else 'below'} 1")
        if self.clip is not None and self.clip == 0:
            raise ModelError("clip of the recipe is 0, so that nothing is ever learnt: give more, or none")
        if self.full_steps and self.size is None:
            raise ModelError(
                f"full_steps of the recipe is {self.full_steps}, but all steps are at the size in use: give a size too"
            )
        if self.sampler == "cliques" and not self.mine_every:
            raise ModelError("batches of cliques need mine_every: steps between two searches for them")
        if self.cache_versions and self.tuned_blocks and (self.tune_steps or self.epochs):
            raise ModelError(
                f"tokens can be cached only under a frozen backbone, but {self.tuned_blocks} blocks are to be "
                "trained: give tuned_blocks 0 or cache_versions 0"
            )

    @property
    def batch(self) -> int:
        """Photos in a batch."""
        return self.places * self.views

    def split(self, places: Sequence[TrainingPlace]) -> tuple[list[TrainingPlace], list[TrainingPlace]]:
        """The places to learn from, and those held out to choose by."""
        seed = self.seed if self.split_seed is None else self.split_seed
        return split(places, held_out=self.held_out, seed=seed)

    def cached(self, blocks: int) -> bool:
        """Whether a stage that trains so many blocks learns from tokens kept on disk."""
        return blocks == 0 and self.cache_versions > 0

    def of_steps(self, steps: int) -> Recipe:
        """The same recipe over so many steps in all, shared between the stages as before.

        Raises:
            ModelError: If there is no step to make.
        """
        if steps < 1:
            raise ModelError(f"{steps} steps teach nothing: give 1 or more")
        before = self.head_steps + self.tune_steps
        # Epochs are of the second stage alone, and how many steps they would be is not known without the data.
        head = 0 if self.epochs or not before else round(steps * self.head_steps / before)
        return replace(
            self,
            head_steps=head,
            tune_steps=steps - head,
            epochs=None,
            decay_over=self.decay_over and min(self.decay_over, steps),
            full_steps=round(steps * self.full_steps / before) if before else 0,
        )


def with_defaults(settings: Mapping[str, Any]) -> dict[str, Any]:
    """A recipe as it was written down, with what an older version did not know at its default."""
    written = dict(settings)
    if "version" not in written and written.get("augment") == "paper":
        written["augment"] = "kornia"
    return {**asdict(Recipe()), **written}


@dataclass(frozen=True, slots=True)
class Preset:
    """A model to make, where it starts, and how it is trained."""

    model: ModelConfig
    start: str
    recipe: Recipe


# Twice the paper's clusters of half the numbers: as long a descriptor, but the dustbin leaves twice the tokens.
LITE_TRUNK = LiteConfig(blocks=15, kind="lite2")
LITE_HEAD = SaladConfig(width=120, clusters=128, cluster_dim=64)
LITE_SALAD = replace(LITE_HEAD, dustbin_share=0.35)  # as it is anyway at 224 px; larger photos lose no more
SMALL_HEAD = SaladConfig(width=112, clusters=128, cluster_dim=16, scene_dim=128, hidden=256)
LITE_PHOTO = Preprocessing(height=320, width=320, mean=(127 / 255,) * 3, std=(128 / 255,) * 3)
SMALL_PHOTO = replace(LITE_PHOTO, height=224, width=224)
PAPER = Recipe(
    head_steps=0,
    tune_steps=0,
    epochs=4,
    places=60,
    views=4,
    head_rate=6e-5,
    trunk_rate=6e-5,
    weight_decay=9.5e-9,
    warmup=0,
    last=0.2,
    decay_over=4000,
    average=0.0,
    clip=None,
    tuned_blocks=4,
    held_out=0.0,
    measure_every=500,
    save_every=100,
    augment="paper",
    sampler="one-city",
    mirror=False,
    size=224,
)

LITE_LICENCE = (
    "Apache-2.0; the photos it learnt from are research data with terms of their own, none of which is contained in "
    "the weights; see docs/model-card.md"
)

VITS_MODEL = ModelConfig(
    name="salad-vits",
    backbone=ViTConfig(width=384, depth=9, heads=6),
    aggregator=replace(LITE_HEAD, width=384),
    preprocessing=Preprocessing(height=322, width=322),
    provenance="initialised from blocks 0 to 8 of a saliency-fine-tuned DINOv2 ViT-S/14, under a SALAD head, "
    "trained with `salad train --preset salad-vits` and then `--preset salad-vits-whole` on street photos, webcams "
    "and campus photos; see docs/model-card.md",
    licence=LITE_LICENCE,
)

PRESETS: dict[str, Preset] = {
    "salad-lite": Preset(
        model=ModelConfig(
            name="salad-lite",
            backbone=LITE_TRUNK,
            aggregator=LITE_SALAD,
            preprocessing=LITE_PHOTO,
            provenance="EfficientNet-Lite2's ImageNet trunk up to block 14 under a SALAD head, trained with `salad "
            "train --preset salad-lite` on street photos, webcams and campus photos; see docs/model-card.md",
            licence=LITE_LICENCE,
        ),
        start="imagenet",
        recipe=Recipe(head_steps=100, tune_steps=500, size=224, full_steps=200, tuned_share=0.7),
    ),
    "salad-vits": Preset(
        model=VITS_MODEL,
        start="vits14_blocks0-8.safetensors",  # scripts/extract_vits14.py makes it
        recipe=Recipe(
            head_steps=100,
            tune_steps=500,
            head_rate=5e-4,
            trunk_rate=5e-5,
            tuned_blocks=4,
            tuned_share=0.7,
            size=224,
            full_steps=150,
        ),
    ),
    "salad-vits-whole": Preset(
        model=VITS_MODEL,
        start="salad-vits",
        recipe=Recipe(
            head_steps=0,
            tune_steps=200,
            head_rate=5e-4,
            trunk_rate=3e-5,
            tuned_blocks=9,
            tuned_share=0.7,
            augment="robust",
            size=224,
        ),
    ),
    "salad-lite-route": Preset(
        model=ModelConfig(
            name="salad-lite-route",
            backbone=LITE_TRUNK,
            aggregator=RouteConfig(width=120, salad=LITE_SALAD, cell_dim=32, weight=0.5),
            preprocessing=LITE_PHOTO,
            provenance="salad-lite with a 4 x 4 layout beside its descriptor, trained with `salad train --preset "
            "salad-lite-route` on the same photos; see docs/model-card.md",
            licence=LITE_LICENCE,
        ),
        start="salad-lite",
        recipe=Recipe(head_steps=120, tune_steps=0, tuned_blocks=0, measure_every=60, cache_versions=1),
    ),
    "paper": Preset(
        model=ModelConfig(name="paper", backbone=VITS["vitb14"], aggregator=AGGREGATORS_OF_THE_PAPER["full"]),
        start="dinov2-vitb14",
        recipe=PAPER,
    ),
    "small": Preset(
        model=ModelConfig(name="small", backbone=LiteConfig(), aggregator=SMALL_HEAD, preprocessing=SMALL_PHOTO),
        start="imagenet",
        recipe=Recipe(head_steps=40, tune_steps=160, trunk_rate=4e-4, warmup=10, average=0.97),
    ),
    "head": Preset(
        model=ModelConfig(name="head", backbone=LiteConfig(), aggregator=SMALL_HEAD, preprocessing=LITE_PHOTO),
        start="imagenet",
        recipe=Recipe(head_steps=1000, tune_steps=0, tuned_blocks=0, cache_versions=4, measure_every=100),
    ),
}
"""`salad-lite`, `salad-lite-route` (a layout beside it for fixed viewpoints) and the larger `salad-vits`, trained on as
`salad-vits-whole`, made the models that ship; `paper` is docs/method.md's recipe; `small` learns in minutes on two
cores; `head` learns on cached tokens, the backbone never run again."""


def preset(name: str) -> Preset:
    """Look a preset up.

    Raises:
        ModelError: If there is none of that name.
    """
    if name not in PRESETS:
        raise ModelError(f"there is no preset {name!r}: choose one of {', '.join(PRESETS)}")
    return PRESETS[name]
