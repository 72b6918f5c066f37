"""What a run would be, before it is one: what is trained, on what, for how long, in how much memory.

Nothing is written and nothing downloaded. Time and memory come from one real step of a few photos' worth of noise on
this machine, multiplied; reading photos comes on top.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from salad.datasets.training_place import TrainingPlace
from salad.models.describer import Describer, build
from salad.network.model_size import parameters
from salad.training.augment import augmentation
from salad.training.batches import divided, preprocessing_of, sampler_of, steps_of
from salad.training.devices import launched
from salad.training.gradient_cache import Part, learn
from salad.training.optim import multi_similarity, optimizer_of
from salad.training.recipe import Preset, Recipe
from salad.training.start import is_whole, start_backbone

SAMPLE = 4  # photos of the step that is measured: two places of two
_KEPT = 3  # copies of all weights in memory: as trained, their mean, the best so far
_PER_TRAINED = 3  # numbers beside each trained weight: its gradient and AdamW's two
_BYTES = 4
_MEGA, _MINUTE = 1e6, 60.0


@dataclass(frozen=True, slots=True)
class Cost:
    """What a stage's step costs here, measured on a small one.

    Args:
        seconds: of the whole batch, reading left out.
        megabytes: held while it is learnt from.
    """

    seconds: float
    megabytes: float


def plan(
    preset: Preset,
    places: Sequence[TrainingPlace] | None = None,
    *,
    start: str | None = None,
    accelerator: str = "auto",
    devices: int = 1,
    nodes: int = 1,
) -> dict[str, Any]:
    """Everything that would be trained, in words and numbers; nothing is written.

    Args:
        preset: the model, where its backbone starts, and the recipe.
        places: what would be learnt from, where it is at hand.
        start: other weights for the backbone than the preset's.
        accelerator: where to measure a step, in Fabric's words.
        devices: devices of each machine the run would have.
        nodes: machines.

    Raises:
        MissingExtraError: the `train` extra is not installed.
        BenchmarkError: there are too few places.
        ModelError: model, recipe and devices do not fit together.
        WeightsError: a whole model that it would start from is of another architecture.
    """
    recipe, start = preset.recipe, preset.start if start is None else start
    divided(recipe, devices * nodes)
    model = build(preset.model, seed=recipe.seed)
    if is_whole(start):  # what learns depends on it; other starts may have to be fetched first
        start_backbone(model, start)
    size = preprocessing_of(model, recipe)
    told: dict[str, Any] = {
        "model": f"{model.name}: {preset.model.backbone.kind} under {preset.model.aggregator.kind}",
        "descriptor": f"{model.dim} numbers",
        "start": start or "untrained",
        "batch": f"{recipe.places} places x {recipe.views} photos at {size.height} x {size.width}",
        "at once": f"{recipe.at_once or recipe.batch} photos",
        "augment": recipe.augment,
        "sampler": recipe.sampler,
        "precision": recipe.precision,
        "processes": devices * nodes,
    }
    told |= _data(recipe, places)
    stages = _stages(recipe, places)
    fabric = launched(accelerator, recipe.precision)
    told["measured on"] = f"{fabric.device}, one step of {SAMPLE} photos of noise"
    minutes = most = 0.0
    for stage in stages:
        model.backbone.train_last(stage.blocks)
        shown = replace(recipe, size=None, full_steps=0) if stage.full else recipe
        cost = measured(model, shown, fabric=fabric, cached=recipe.cached(stage.blocks))
        told[stage.name] = _told(stage, cost, processes=devices * nodes)
        if not stage.full:
            told |= {
                f"{stage.name}: {part}": _counted(getattr(model, part)) for part in ("backbone", "aggregator")
            }
        minutes += (stage.steps or 0) * cost.seconds / (devices * nodes) / _MINUTE
        most = max(most, cost.megabytes)
    told["memory"] = f"about {most:,.0f} MB a process"
    told["time"] = f"about {minutes:,.1f} minutes, reading and measuring on top" if minutes else "unknown"
    return told


def _data(recipe: Recipe, places: Sequence[TrainingPlace] | None) -> dict[str, Any]:
    if places is None:
        return {"data": "none given: name it with --data"}
    learn_from, choose = recipe.split(places)
    photos = sum(len(place.photos) for place in places)
    return {"data": f"{photos} photos of {len(learn_from)} places to learn from, {len(choose)} to choose by"}


class _Stage(NamedTuple):
    """A stretch of steps alike: how many (None where only the data can say), and whether at the size in use."""

    name: str
    steps: int | None
    blocks: int
    full: bool = False


def _stages(recipe: Recipe, places: Sequence[TrainingPlace] | None) -> list[_Stage]:
    """Every stretch that has any step, in the order they are walked."""
    head, tune = recipe.head_steps, None if recipe.epochs else recipe.tune_steps
    if places is not None:
        learn_from, _ = recipe.split(places)
        head, end = steps_of(recipe, sampler_of(recipe, learn_from))
        tune = end - head
    left = recipe.full_steps  # the last ones, whichever stage they fall into
    walked: list[_Stage] = []
    for name, steps, blocks in (("tune", tune, recipe.tuned_blocks), ("head", head, 0)):
        full = 0 if recipe.cached(blocks) else left if steps is None else min(left, steps)
        left -= full
        rest = None if steps is None else steps - full
        walked = [_Stage(name, rest, blocks), _Stage(f"{name}, full size", full, blocks, full=True), *walked]
    return [stage for stage in walked if stage.steps != 0]


def _told(stage: _Stage, cost: Cost, *, processes: int) -> str:
    count = "as many steps as the data have" if stage.steps is None else f"{stage.steps} steps"
    return f"{count}, {stage.blocks} blocks trained, about {cost.seconds / processes:.2f} s a step"


def _counted(part: nn.Module) -> str:
    every, trained = parameters(part), parameters(part, trained_only=True)
    return f"{trained:,} of {every:,} weights trained"


def measured(model: Describer, recipe: Recipe, *, fabric: Any, cached: bool) -> Cost:
    """What a step of the whole batch costs, from one of a few photos; `model` is changed by it.

    Args:
        model: what is trained, as far as its weights want gradients.
        recipe: how.
        fabric: where.
        cached: whether tokens come from a cache, so that only the head runs.
    """
    model.to(fabric.device)
    module, optimizer = fabric.setup(model.aggregator if cached else model, optimizer_of(model, recipe))
    sample = min(SAMPLE, recipe.at_once or recipe.batch)
    labels = torch.arange(sample, device=fabric.device) // 2
    objective = multi_similarity()
    seconds, held = math.inf, 0
    for _ in range(2):  # the first is slower: everything is met for the first time
        began = time.perf_counter()
        part = _noise(model, recipe, sample, fabric=fabric, cached=cached)
        counter = _Held()
        with counter:
            learn(fabric, module.train(), parts=[part], labels=labels, objective=objective, seed=0)
        optimizer.step()
        optimizer.zero_grad()
        seconds, held = min(seconds, time.perf_counter() - began), counter.bytes
    at_once = recipe.at_once or recipe.batch
    twice = 4 / 3 if at_once < recipe.batch else 1.0  # the first pass of gradient caching has no way back
    return Cost(seconds / sample * recipe.batch * twice, _megabytes(model, held / sample * at_once))


def _noise(model: Describer, recipe: Recipe, photos: int, *, fabric: Any, cached: bool) -> Part:
    size = preprocessing_of(model, recipe)
    images = torch.rand(photos, 3, size.height, size.width, device=fabric.device)
    if cached:
        with torch.no_grad(), fabric.autocast():
            return model.tokens(images)
    changed: Tensor = augmentation(recipe.augment, size.height, size.width)(images)
    return changed


def _megabytes(model: nn.Module, activations: float) -> float:
    every, trained = parameters(model), parameters(model, trained_only=True)
    return (_BYTES * (_KEPT * every + _PER_TRAINED * trained) + activations) / _MEGA


class _Held:
    """Counts the bytes that a step holds for its way back, each stretch of memory once."""

    def __init__(self) -> None:
        self.bytes = 0
        self._seen: set[int] = set()
        self._hooks = torch.autograd.graph.saved_tensors_hooks(self._count, lambda kept: kept)

    def _count(self, tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in self._seen and not isinstance(tensor, nn.Parameter):
            self._seen.add(storage.data_ptr())
            self.bytes += storage.nbytes()
        return tensor

    def __enter__(self) -> None:
        self._hooks.__enter__()

    def __exit__(self, *raised: Any) -> None:
        self._hooks.__exit__(*raised)
