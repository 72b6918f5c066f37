"""The loop against the one that made the weights that ship, written out plainly: the same weights, to the last bit."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from salad.datasets.places import split
from salad.datasets.samplers import MixedSampler
from salad.datasets.training_place import TrainingPlace
from salad.network.config import ModelConfig
from salad.network.network import Network, build
from salad.training.augment import augmentation
from salad.training.loss import multi_similarity
from salad.training.recipe import PRESETS, Recipe
from tiny_runs import images_of

Teach = Callable[..., Path]


def _taught_plainly(config: ModelConfig, places: list[TrainingPlace], recipe: Recipe) -> tuple[Network, ...]:
    """Two stages: batches, augmentation, loss, AdamW, clipped at 1, and a running mean of the weights."""
    from lightning_fabric import Fabric

    learn, _ = split(places, held_out=recipe.held_out, seed=recipe.seed)
    model = build(config, seed=recipe.seed)
    mean = copy.deepcopy(model)
    fabric = Fabric(accelerator="cpu", devices=1, precision=recipe.precision)
    change = augmentation("lite", config.preprocessing.height, config.preprocessing.width)
    objective, step = multi_similarity(), 0
    for first, end, blocks in (
        (0, recipe.head_steps, 0),
        (recipe.head_steps, recipe.head_steps + recipe.tune_steps, recipe.tuned_blocks),
    ):
        model.backbone.train_last(blocks)
        groups = [
            {"params": [weight for weight in part.parameters() if weight.requires_grad], "rate": rate}
            for part, rate in ((model.aggregator, recipe.head_rate), (model.backbone, recipe.trunk_rate))
        ]
        module, optimizer = fabric.setup(
            model,
            torch.optim.AdamW([each for each in groups if each["params"]], weight_decay=recipe.weight_decay),
        )
        sampler = MixedSampler(learn, per_batch=recipe.places, views=recipe.views, seed=recipe.seed)
        while step < end:
            rising = min(1.0, (step - first + 1) / max(1, recipe.warmup))
            falling = 1 - (1 - recipe.last) * (step - first) / max(1, end - first)
            for group in optimizer.param_groups:
                group["lr"] = group["rate"] * (rising * falling)
            batch = sampler.batch(step)
            torch.manual_seed(recipe.seed * 1_000_003 + step)
            module.train()
            photos = images_of(model, [view.path for view in batch]) * model.std + model.mean
            photos = (photos * 255).round() / 255
            mirrored = torch.tensor([view.mirrored for view in batch])[:, None, None, None]
            with torch.no_grad():
                photos = change(torch.where(mirrored, photos.flip(-1), photos)).clamp(0, 1)
                images = (photos - model.mean) / model.std
            labels = torch.tensor([view.label for view in batch])
            fabric.backward(objective(module(images).float(), labels))
            fabric.clip_gradients(module, optimizer, max_norm=1.0, error_if_nonfinite=False)
            optimizer.step()
            optimizer.zero_grad()
            decay = min(recipe.average, step / (step + 10))
            with torch.no_grad():
                for old, new in zip(mean.parameters(), model.parameters(), strict=True):
                    old.lerp_(new, 1 - decay)
            step += 1
    return model, mean


@pytest.mark.parametrize("precision", ["32-true", "bf16-mixed"])
@pytest.mark.parametrize("backbone", ["lite", "vit"])
def test_the_weights_are_those_of_the_plain_loop(
    teach: Teach,
    places: list[TrainingPlace],
    recipe: Recipe,
    tmp_path: Path,
    backbone: str,
    precision: str,
    request: pytest.FixtureRequest,
) -> None:
    config = request.getfixturevalue(backbone)
    settings: dict[str, Any] = {"precision": precision, "head_steps": 3, "tune_steps": 4, "warmup": 2}
    teach(tmp_path, model=config, recipe=settings)
    saved = torch.load(tmp_path / "last.ckpt", weights_only=True)
    model, mean = _taught_plainly(config, places, dataclasses.replace(recipe, **settings))
    for mine, wanted in ((saved["model"], model.state_dict()), (saved["average"], mean.state_dict())):
        assert mine.keys() == wanted.keys()
        assert [key for key in wanted if not torch.equal(mine[key], wanted[key])] == []


def test_the_shipped_models_recipe_is_the_plain_one() -> None:
    recipe = PRESETS["salad-lite"].recipe
    assert recipe == Recipe(head_steps=100, tune_steps=500, size=224, full_steps=200, tuned_share=0.7)
    told = {name: getattr(recipe, name) for name in ("augment", "sampler", "mirror", "clip", "at_once")}
    assert told == {
        "augment": "lite",
        "sampler": "mixed",
        "mirror": True,
        "clip": 1.0,
        "at_once": None,
    }
    assert (recipe.cache_versions, recipe.decay_over, recipe.epochs) == (0, None, None)
