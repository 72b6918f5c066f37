"""The recipes: the paper's line by line, what is refused, and that every preset is a model."""

from __future__ import annotations

import dataclasses
import inspect
import math
from typing import Any

import pytest
import torch

import salad
from salad.errors import ModelError
from salad.network.aggregator_config import PRESETS as PAPERS_AGGREGATORS
from salad.network.backbones.dinov2 import ViT
from salad.network.config import VITS, ModelConfig
from salad.network.network import Network
from salad.training.augment import augmentation
from salad.training.loss import multi_similarity
from salad.training.optim import build_optimizer, learning_rate_factor
from salad.training.rand_augment import RandAugment
from salad.training.recipe import PRESETS, Preset, Recipe, preset, with_defaults

PAPER = PRESETS["paper"]
LINES: list[tuple[str, Any, Any]] = [
    # what docs/method.md's source says, what the preset has, what that must be
    ("60 places x 4 photos a batch", (PAPER.recipe.places, PAPER.recipe.views), (60, 4)),
    ("a batch within one city", PAPER.recipe.sampler, "one-city"),
    ("224 x 224 for training", PAPER.recipe.size, 224),
    (
        "322 x 322 for evaluation",
        (PAPER.model.preprocessing.height, PAPER.model.preprocessing.width),
        (322, 322),
    ),
    ("RandAugment", PAPER.recipe.augment, "paper"),
    ("no photo is mirrored", PAPER.recipe.mirror, False),
    ("lr 6e-5", (PAPER.recipe.head_rate, PAPER.recipe.trunk_rate), (6e-5, 6e-5)),
    ("weight decay 9.5e-9", PAPER.recipe.weight_decay, 9.5e-9),
    ("falls linearly to 20 %", PAPER.recipe.last, 0.2),
    ("over 4,000 iterations", PAPER.recipe.decay_over, 4000),
    ("from the first iteration on", PAPER.recipe.warmup, 0),
    ("4 epochs", PAPER.recipe.epochs, 4),
    ("mixed precision", PAPER.recipe.precision.endswith("-mixed"), True),
    ("the last 4 blocks train", PAPER.recipe.tuned_blocks, 4),
    ("from the first step on", PAPER.recipe.head_steps, 0),
    ("no mean of the weights", PAPER.recipe.average, 0.0),
    ("no gradient is shortened", PAPER.recipe.clip, None),
    ("all places are learnt from", PAPER.recipe.held_out, 0.0),
    ("DINOv2 ViT-B/14", (PAPER.model.backbone, PAPER.start), (VITS["vitb14"], "dinov2-vitb14")),
    ("m 64, l 128, g 256", PAPER.model.aggregator, PAPERS_AGGREGATORS["full"]),
    ("descriptor 8448", PAPER.model.aggregator.dim, 8448),
    ("hidden width 512", getattr(PAPER.model.aggregator, "hidden", None), 512),
    ("dropout 0.3", getattr(PAPER.model.aggregator, "dropout", None), 0.3),
]


@pytest.mark.parametrize(("line", "has", "must"), LINES, ids=[line for line, _, _ in LINES])
def test_the_papers_recipe_line_by_line(line: str, has: Any, must: Any) -> None:
    assert has == must, line


def test_the_papers_loss_is_the_loops() -> None:
    """Multi-similarity loss alpha 1, beta 50, base 0; miner margin 0.1."""
    defaults = {name: given.default for name, given in inspect.signature(multi_similarity).parameters.items()}
    assert defaults == {"alpha": 1.0, "beta": 50.0, "base": 0.0, "margin": 0.1}


def test_the_papers_changes_are_randaugment_of_three() -> None:
    (found,) = (part for part in augmentation("paper", 224, 224).modules() if isinstance(part, RandAugment))
    assert found.count == 3


def test_a_recipe_written_before_the_papers_changes_were_its_own_means_kornias() -> None:
    now = dataclasses.asdict(PAPER.recipe)
    assert with_defaults(now)["augment"] == "paper"
    before = {name: value for name, value in now.items() if name != "version"}
    assert with_defaults(before) == now | {"augment": "kornia"}
    assert with_defaults(before | {"augment": "robust"})["augment"] == "robust"


def test_the_papers_rate_over_its_iterations() -> None:
    recipe = PAPER.recipe
    factors = [learning_rate_factor(step, 4160, recipe) for step in (0, 2000, 4000, 4159)]
    assert factors == pytest.approx([1.0, 0.6, 0.2, 0.2])


def test_the_papers_last_blocks_norm_and_aggregator_train_by_adamw() -> None:
    with torch.device("meta"):
        model = Network(PAPER.model)
    model.backbone.train_last(PAPER.recipe.tuned_blocks)
    assert isinstance(model.backbone, ViT)
    trained = {name for name, weight in model.named_parameters() if weight.requires_grad}
    wanted = {f"backbone.blocks.{number}." for number in (8, 9, 10, 11)} | {"backbone.norm.", "aggregator."}
    assert {prefix for prefix in wanted if any(name.startswith(prefix) for name in trained)} == wanted
    assert all(name.startswith(tuple(wanted)) for name in trained)
    optimizer = build_optimizer(model, PAPER.recipe)
    assert type(optimizer) is torch.optim.AdamW
    assert {group["weight_decay"] for group in optimizer.param_groups} == {9.5e-9}


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_model_whose_parts_fit(name: str) -> None:
    made = PRESETS[name]
    with torch.device("meta"):
        model = Network(made.model)
    assert model.config.name == name.removesuffix("-whole")  # a second run of a model is still that model
    model.backbone.train_last(made.recipe.tuned_blocks)
    assert ModelConfig.from_dict(made.model.as_dict()) == made.model


@pytest.mark.parametrize("name", [name for name in PRESETS if name.endswith("-whole")])
def test_a_second_run_goes_on_from_the_model_that_ships_and_trains_every_block(name: str) -> None:
    made = PRESETS[name]
    model = salad.load(made.start).network
    assert model.config.backbone == made.model.backbone
    assert model.config.aggregator == made.model.aggregator
    assert made.recipe.head_steps == 0
    model.backbone.train_last(made.recipe.tuned_blocks)
    frozen = {weight.split(".")[1] for weight, value in model.named_parameters() if not value.requires_grad}
    before_the_first = {"patch_embed", "pos_embed", "cls_token", "mask_token"}
    assert frozen <= before_the_first


def test_a_preset_there_is_not_lists_those_there_are() -> None:
    assert preset("salad-lite") is PRESETS["salad-lite"]
    with pytest.raises(ModelError, match=r"no preset 'salad-xl': choose one of salad-lite"):
        preset("salad-xl")


def test_the_head_preset_trains_nothing_but_the_head() -> None:
    recipe = PRESETS["head"].recipe
    assert (recipe.tune_steps, recipe.tuned_blocks) == (0, 0)
    assert recipe.cache_versions > 0


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"places": 1}, "places of the recipe is 1: give 2 or more"),
        ({"views": 0}, "views of the recipe is 0"),
        ({"head_steps": -1}, "head_steps of the recipe is -1: give 0 or more"),
        ({"measure_every": 0}, "measure_every of the recipe is 0: give 1 or more"),
        ({"at_once": 0}, "at_once of the recipe is 0"),
        ({"epochs": 0}, "epochs of the recipe is 0"),
        ({"head_rate": math.nan}, "head_rate of the recipe is nan"),
        ({"trunk_rate": math.inf}, "trunk_rate of the recipe is inf"),
        ({"held_out": 1.0}, "held_out of the recipe is 1.0: give a share below 1"),
        ({"average": 1.5}, "average of the recipe is 1.5"),
        ({"last": 1.5}, "last of the recipe is 1.5"),
        ({"clip": 0.0}, "clip of the recipe is 0"),
        ({"seed": -3}, "seed of the recipe is -3"),
        ({"sampler": "cliques"}, "batches of cliques need mine_every"),
        ({"cache_versions": 2}, "tokens can be cached only under a frozen backbone"),
    ],
)
def test_senseless_settings_are_a_sentence(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        Recipe(**settings)


def test_other_steps_are_shared_as_before() -> None:
    recipe = Recipe(head_steps=75, tune_steps=225, decay_over=100)
    assert (recipe.of_steps(100).head_steps, recipe.of_steps(100).tune_steps) == (25, 75)
    assert recipe.of_steps(40).decay_over == 40
    assert recipe.of_steps(400).decay_over == 100
    paper = PAPER.recipe.of_steps(300)
    assert (paper.head_steps, paper.tune_steps, paper.epochs) == (0, 300, None)
    assert PRESETS["head"].recipe.of_steps(50).head_steps == 50
    with pytest.raises(ModelError, match="0 steps teach nothing"):
        recipe.of_steps(0)


def test_a_preset_is_plain_data() -> None:
    assert isinstance(PAPER, Preset)
    assert Recipe(**dataclasses.asdict(PAPER.recipe)) == PAPER.recipe
