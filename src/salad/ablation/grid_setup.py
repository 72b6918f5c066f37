"""Equal terms: what is the same for every row of a grid, and the preset that a row and a seed become."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from salad.ablation.grids import ALL_BLOCKS, GridRow
from salad.errors import ModelError, WeightsError
from salad.network.aggregator_config import compared_aggregators
from salad.network.backbones.base import build_backbone
from salad.network.checkpoints import recognise
from salad.network.config import LiteConfig, ModelConfig, Preprocessing, ViTConfig
from salad.network.network import build
from salad.network.weight_files import read_tensors
from salad.training.recipe import LITE_PHOTO, PRESETS, Preset, Recipe
from salad.training.start import imagenet
from salad.training.vocabulary import needs_fitting

IMAGENET = "imagenet"
TRAINING_SIDE = 224 / 322
"""The paper's side of a photo in training, as a fraction of its side in use."""


@dataclass(frozen=True, slots=True)
class GridSetup:
    """What every row of a grid has in common.

    Args:
        backbone: the one under every aggregator.
        stride: pixels between two tokens.
        preprocessing: how photos are prepared when the model is used.
        start: where the backbone starts: `imagenet`, or a file.
        recipe: the budget; seed, trained blocks and the side of photos in training are the row's. Where it has no
            step for the backbone, no row trains a block of it.
    """

    backbone: LiteConfig | ViTConfig
    stride: int
    preprocessing: Preprocessing
    start: str
    recipe: Recipe

    @property
    def blocks(self) -> int:
        """How many blocks the backbone has."""
        return self.backbone.depth if isinstance(self.backbone, ViTConfig) else self.backbone.blocks

    @property
    def token_grid(self) -> tuple[int, int]:
        """Rows and columns of tokens in use."""
        size = self.preprocessing
        return max(1, round(size.height / self.stride)), max(1, round(size.width / self.stride))


def grid_setup(start: str = IMAGENET, *, side: int, recipe: Recipe, depth: int | None = None) -> GridSetup:
    """The setup that a start asks for.

    Args:
        start: `imagenet` for EfficientNet-Lite0's trunk, or a file of a DINOv2 backbone's weights.
        side: of the square a photo is squeezed to, in pixels.
        recipe: the budget.
        depth: blocks kept of a file's backbone, where not all.

    Raises:
        WeightsError: If the file cannot be read, or holds no backbone.
        ModelError: If the depth is more than the file holds, or there is none to choose.
    """
    backbone: LiteConfig | ViTConfig
    if start == IMAGENET:
        if depth is not None:
            raise ModelError(f"a depth of {depth} blocks can be chosen of a file's backbone alone: give --start")
        backbone, photo = LiteConfig(), replace(LITE_PHOTO, height=side, width=side)
    else:
        tensors = read_tensors(Path(start))
        try:
            vit = recognise(tensors).backbone
        except WeightsError as error:
            raise WeightsError(f"{start}: {error}") from error
        if depth is not None and not 1 <= depth <= vit.depth:
            raise ModelError(f"a depth of {depth} blocks cannot be kept: {start} holds {vit.depth}")
        backbone, photo = replace(vit, depth=depth or vit.depth), Preprocessing(side, side)
    with torch.device("meta"):  # the backbone is asked for its stride: no weight need be made
        stride = build_backbone(backbone).stride
    return GridSetup(backbone, stride, photo, start, recipe)


def default_recipe(start: str, *, frozen: bool = False) -> Recipe:
    """The recipe of the small preset that begins with such a start; frozen, that of heads on cached tokens."""
    if frozen:
        return PRESETS["head"].recipe
    return PRESETS["small" if start == IMAGENET else "salad-vits"].recipe


def row_preset(setup: GridSetup, row: GridRow, *, seed: int) -> Preset:
    """What a row and a seed are trained as; no step at all where nothing of it can be trained.

    Raises:
        ModelError: If the row asks for an aggregator or for blocks that are not there.
    """
    with torch.device("meta"):
        compared = compared_aggregators(build_backbone(setup.backbone).width)
    if row.aggregator not in compared:
        raise ModelError(f"the row {row.name} asks for an aggregator {row.aggregator!r}, which there is not")
    config = ModelConfig(
        name=row.name,
        backbone=setup.backbone,
        aggregator=replace(compared[row.aggregator].for_grid(setup.token_grid), **row.change),
        preprocessing=setup.preprocessing,
    )
    blocks = setup.blocks if row.blocks == ALL_BLOCKS else row.blocks
    if not setup.recipe.tune_steps:
        blocks = 0
    if blocks > setup.blocks:
        raise ModelError(f"the row {row.name} trains {blocks} blocks, but the backbone has {setup.blocks}")
    recipe = replace(setup.recipe, seed=seed, tuned_blocks=blocks)
    if row.fewer_tokens:
        rows = max(1, round(setup.preprocessing.height * TRAINING_SIDE / setup.stride))
        recipe = replace(recipe, size=rows * setup.stride)
    head = any(weight.requires_grad for weight in build(config).aggregator.parameters())
    if row.fitted or not (head or blocks):
        recipe = replace(recipe, head_steps=0, tune_steps=0)
    elif not head:  # all rows take as many steps: those of a head without weights go to the backbone
        recipe = replace(recipe, head_steps=0, tune_steps=recipe.head_steps + recipe.tune_steps)
    return Preset(config, setup.start, recipe)


def start_digest(start: str) -> dict[str, str]:
    """A start's name and the SHA-256 of its file, so that another file of that name is told apart."""
    if not start:  # untrained
        return {"name": "", "sha256": ""}
    path = imagenet() if start == IMAGENET else Path(start)
    return {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def check_presets(presets: Sequence[Preset]) -> None:
    """Describe a black photo with every preset, so that what cannot work is said before an hour of training.

    Raises:
        ModelError: If a model's parts do not fit together, or its photos give it too few tokens.
    """
    for each in presets:
        model, size = build(each.model), each.model.preprocessing
        if needs_fitting(model):  # it cannot describe yet
            continue
        # A size in training of its own gives another number of tokens, which may be too few where the other is not.
        sides = {(size.height, size.width)} | ({(each.recipe.size,) * 2} if each.recipe.size else set())
        for height, width in sides:
            with torch.inference_mode():
                model(torch.zeros(1, 3, height, width))
