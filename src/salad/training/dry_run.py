"""What a run would be, before it is one: what is trained, on what, for how long, in how much memory.

Nothing is written and nothing downloaded. Time and memory come from one real step of a few photos' worth of noise on
this machine, multiplied; reading photos comes on top.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from salad.datasets.training_place import TrainingPlace
from salad.network.model_size import parameters
from salad.network.network import Network, build
from salad.training.augment import augmentation
from salad.training.batches import build_sampler, check_processes, count_steps, training_preprocessing
from salad.training.devices import launch_fabric
from salad.training.gradient_cache import Part, backward_in_parts
from salad.training.loss import multi_similarity
from salad.training.optim import build_optimizer
from salad.training.recipe import Preset, Recipe
from salad.training.start import is_whole_model, start_backbone

SAMPLE = 4  # photos of the step that is measured: two places of two, the least that the loss finds pairs in
_COPIES = 3  # of all weights in memory: as trained, their average, the best so far
_PER_TRAINED = 3  # numbers kept for each trained weight: its gradient and AdamW's two
_BYTES = 4
_MEGA, _MINUTE = 1e6, 60.0


def dry_run(
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
        MissingExtraError: If the `train` extra is not installed.
        BenchmarkError: If there are too few places.
        ModelError: If model, recipe and devices do not fit together.
        WeightsError: If a whole model that it would start from is of another architecture.
    """
    recipe, start = preset.recipe, preset.start if start is None else start
    processes = devices * nodes
    check_processes(recipe, processes)
    model = build(preset.model, seed=recipe.seed)
    if is_whole_model(start):  # what learns depends on it; other starts may have to be fetched first
        start_backbone(model, start)
    size = training_preprocessing(model, recipe)
    facts: dict[str, Any] = {
        "model": f"{preset.model.name}: {preset.model.backbone.kind} under {preset.model.aggregator.kind}",
        "descriptor": f"{preset.model.aggregator.dim} numbers",
        "start": start or "untrained",
        "batch": f"{recipe.places} places x {recipe.views} photos at {size.height} x {size.width}",
        "at once": f"{recipe.at_once or recipe.batch} photos",
        "augment": recipe.augment,
        "sampler": recipe.sampler,
        "precision": recipe.precision,
        "processes": processes,
        "data": "none given: name it with --data",
    }
    if places is not None:
        learn_from, choose_by = recipe.split(places)
        photos = sum(len(place.photos) for place in places)
        facts["data"] = f"{photos} photos of {len(learn_from)} places to learn from, {len(choose_by)} to choose by"
    stages = _planned_stages(recipe, places)
    fabric = launch_fabric(accelerator, recipe.precision)
    facts["measured on"] = f"{fabric.device}, one step of {SAMPLE} photos of noise"
    minutes = megabytes = 0.0
    for stage in stages:
        model.backbone.train_last(stage.blocks)
        seen = replace(recipe, size=None, full_steps=0) if stage.full_size else recipe
        cost = measure_step(model, seen, fabric=fabric, cached=recipe.cached(stage.blocks))
        seconds = cost.seconds / processes
        count = "as many steps as the data have" if stage.steps is None else f"{stage.steps} steps"
        facts[stage.name] = f"{count}, {stage.blocks} blocks trained, about {seconds:.2f} s a step"
        if not stage.full_size:  # the same weights are trained at either size
            for part in ("backbone", "aggregator"):
                every = parameters(getattr(model, part))
                trained = parameters(getattr(model, part), trained_only=True)
                facts[f"{stage.name}: {part}"] = f"{trained:,} of {every:,} weights trained"
        minutes += (stage.steps or 0) * seconds / _MINUTE
        megabytes = max(megabytes, cost.megabytes)
    facts["memory"] = f"about {megabytes:,.0f} MB a process"
    facts["time"] = f"about {minutes:,.1f} minutes, reading and measuring on top" if minutes else "unknown"
    return facts


class _PlannedStage(NamedTuple):
    """A stretch of steps alike: how many (None where only the data can say), and whether at the size in use."""

    name: str
    steps: int | None
    blocks: int
    full_size: bool = False


def _planned_stages(recipe: Recipe, places: Sequence[TrainingPlace] | None) -> list[_PlannedStage]:
    """Every stretch that has any step, in the order they are walked."""
    head, tune = recipe.head_steps, None if recipe.epochs else recipe.tune_steps
    if places is not None:
        learn_from, _ = recipe.split(places)
        head, end = count_steps(recipe, build_sampler(recipe, learn_from))
        tune = end - head
    # The last ones, whichever stage they fall into: so they are given out from the end.
    left = recipe.full_steps
    stages: list[_PlannedStage] = []
    for name, steps, blocks in (("tune", tune, recipe.tuned_blocks), ("head", head, 0)):
        full = 0 if recipe.cached(blocks) else left if steps is None else min(left, steps)
        left -= full
        stages = [
            _PlannedStage(name, None if steps is None else steps - full, blocks),
            _PlannedStage(f"{name}, full size", full, blocks, full_size=True),
            *stages,
        ]
    return [stage for stage in stages if stage.steps != 0]


class StepCost(NamedTuple):
    """What a stage's step costs here: seconds of the whole batch, reading left out; megabytes held meanwhile."""

    seconds: float
    megabytes: float


def measure_step(model: Network, recipe: Recipe, *, fabric: Any, cached: bool) -> StepCost:
    """What a step of the whole batch costs, from one of a few photos; `model` is changed by it.

    Args:
        model: what is trained, as far as its weights want gradients.
        recipe: how.
        fabric: where.
        cached: whether tokens come from a cache, so that only the head runs.
    """
    model.to(fabric.device)
    module, optimizer = fabric.setup(model.aggregator if cached else model, build_optimizer(model, recipe))
    at_once = recipe.at_once or recipe.batch
    sample = min(SAMPLE, at_once)
    labels = torch.arange(sample, device=fabric.device) // 2
    objective = multi_similarity()
    size = training_preprocessing(model, recipe)
    augment = augmentation(recipe.augment, size.height, size.width)
    seconds, held = math.inf, 0
    for _ in range(2):  # the first is slower: everything is met for the first time
        began = time.perf_counter()
        noise = torch.rand(sample, 3, size.height, size.width, device=fabric.device)
        if cached:
            with torch.no_grad(), fabric.autocast():
                part: Part = model.tokens(noise)
        else:
            part = augment(noise)
        counter = _HeldBytes()
        with counter:
            backward_in_parts(fabric, module.train(), parts=[part], labels=labels, objective=objective, seed=0)
        optimizer.step()
        optimizer.zero_grad()
        seconds, held = min(seconds, time.perf_counter() - began), counter.bytes
    every, trained = parameters(model), parameters(model, trained_only=True)
    in_bytes = _BYTES * (_COPIES * every + _PER_TRAINED * trained) + held / sample * at_once
    # Gradient caching describes a batch of several parts once more, without a way back: a third of a step.
    passes = 4 / 3 if at_once < recipe.batch else 1.0
    return StepCost(seconds / sample * recipe.batch * passes, in_bytes / _MEGA)


class _HeldBytes(torch.autograd.graph.saved_tensors_hooks):
    """Counts the bytes that a step holds for its way back, each stretch of memory once."""

    def __init__(self) -> None:
        super().__init__(self._count, lambda kept: kept)
        self.bytes = 0
        self._seen: set[int] = set()

    def _count(self, tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        # Weights are held anyway, and several saved tensors may be views of one stretch.
        if storage.data_ptr() not in self._seen and not isinstance(tensor, nn.Parameter):
            self._seen.add(storage.data_ptr())
            self.bytes += storage.nbytes()
        return tensor
