"""A dry run: what would be trained, in how much time and memory, and nothing on disk."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
import torch

from salad.datasets.training_place import TrainingPlace
from salad.errors import BenchmarkError, ModelError
from salad.models.model_folder import write_folder
from salad.network.aggregator_config import RouteConfig
from salad.network.config import ModelConfig
from salad.network.network import build
from salad.training import dry_run
from salad.training.devices import launch_fabric
from salad.training.dry_run import StepCost, measure_step
from salad.training.recipe import Preset, Recipe


def _plan(config: ModelConfig, recipe: Recipe, places: Any = None, **options: Any) -> dict[str, Any]:
    return dry_run.dry_run(Preset(config, "", recipe), places, accelerator="cpu", **options)


def test_everything_is_told_and_nothing_written(
    vit: ModelConfig,
    recipe: Recipe,
    places: list[TrainingPlace],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    told = _plan(vit, recipe, places)
    model = build(vit)
    model.backbone.train_last(1)
    every = sum(weight.numel() for weight in model.backbone.parameters())
    trained = sum(weight.numel() for weight in model.backbone.parameters() if weight.requires_grad)
    assert told["head: backbone"] == f"0 of {every:,} weights trained"
    assert told["tune: backbone"] == f"{trained:,} of {every:,} weights trained"
    assert told["batch"] == "3 places x 2 photos at 42 x 42"
    assert told["data"] == "24 photos of 4 places to learn from, 2 to choose by"
    assert told["head"].startswith("2 steps, 0 blocks trained, about ")
    assert told["tune"].startswith("2 steps, 1 blocks trained, about ")
    assert told["memory"].endswith("MB a process")
    assert "measured on" in told
    assert list(tmp_path.iterdir()) == []


def test_the_last_steps_at_full_size_cost_what_they_cost(
    vit: ModelConfig, recipe: Recipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes: list[int | None] = []

    def cost(_: Any, recipe: Recipe, **__: Any) -> StepCost:
        sizes.append(recipe.size)
        return StepCost(60.0, 10.0) if recipe.size else StepCost(180.0, 500.0)

    monkeypatch.setattr(dry_run, "measure_step", cost)
    told = _plan(vit, dataclasses.replace(recipe, head_steps=3, tune_steps=5, size=28, full_steps=2))
    assert sizes == [28, 28, None]
    assert told["tune"].startswith("3 steps, 1 blocks trained, about 60.00 s")
    assert told["tune, full size"].startswith("2 steps, 1 blocks trained, about 180.00 s")
    assert told["time"].startswith("about 12.0 minutes")
    assert told["memory"] == "about 500 MB a process"
    over = _plan(vit, dataclasses.replace(recipe, head_steps=3, tune_steps=5, size=28, full_steps=7))
    assert [over[name].split(",")[0] for name in ("head", "head, full size", "tune, full size")] == [
        "1 steps",
        "2 steps",
        "5 steps",
    ]
    assert "tune" not in over


def test_what_only_the_data_say_is_unknown_without_them(
    vit: ModelConfig, recipe: Recipe, places: list[TrainingPlace]
) -> None:
    epochs = dataclasses.replace(recipe, epochs=3, head_steps=0, sampler="one-city", mirror=False)
    told = _plan(vit, epochs)
    assert told["data"] == "none given: name it with --data"
    assert told["tune"].startswith("as many steps as the data have")
    assert told["time"] == "unknown"
    assert "head" not in told
    assert _plan(vit, epochs, places)["tune"].startswith("6 steps")  # four places, three a batch, three times


def test_a_run_that_cannot_be_is_a_sentence_before_it_is_one(
    vit: ModelConfig, recipe: Recipe, places: list[TrainingPlace]
) -> None:
    with pytest.raises(BenchmarkError, match="a batch needs 5 places, but there are 4"):
        _plan(vit, dataclasses.replace(recipe, places=5), places)
    with pytest.raises(ModelError, match="without any"):
        _plan(vit, recipe, devices=100)


def test_beside_a_model_that_stays_only_the_layout_is_counted(vit: ModelConfig, recipe: Recipe, tmp_path: Path) -> None:
    folder = write_folder(build(vit), tmp_path / "model")
    beside = RouteConfig(width=vit.backbone.width, salad=vit.aggregator, grid=2, cell_dim=3)
    frozen = dataclasses.replace(recipe, tune_steps=0)
    told = _plan(dataclasses.replace(vit, aggregator=beside), frozen, start=str(folder))
    learns = 3 * (vit.backbone.width + 1)
    assert told["head: aggregator"].startswith(f"{learns} of ")
    assert told["start"] == str(folder)


def _cost(config: ModelConfig, recipe: Recipe, *, blocks: int = 1, cached: bool = False) -> StepCost:
    model = build(config)
    model.backbone.train_last(blocks)
    return measure_step(model, recipe, fabric=launch_fabric("cpu", "32-true"), cached=cached)


def test_memory_follows_what_passes_at_once_and_what_is_trained(
    vit: ModelConfig, recipe: Recipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = dataclasses.replace(recipe, places=60, views=4, augment="none")
    whole = _cost(vit, many).megabytes
    part = _cost(vit, dataclasses.replace(many, at_once=8)).megabytes
    frozen = _cost(vit, many, blocks=0).megabytes
    assert part < whole / 5
    assert frozen < whole


def test_time_grows_with_the_batch(vit: ModelConfig, recipe: Recipe, monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter(range(100))
    monkeypatch.setattr(dry_run.time, "perf_counter", lambda: float(next(ticks)))  # a step takes a second
    batch = dataclasses.replace(recipe, places=10, views=4, augment="none")
    assert _cost(vit, batch).seconds == pytest.approx(10.0)  # forty photos, four a second
    in_parts = dataclasses.replace(batch, at_once=20)
    assert _cost(vit, in_parts).seconds == pytest.approx(40 / 3)


def test_what_a_step_holds_is_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    held = dry_run._HeldBytes()
    x = torch.ones(1000, requires_grad=True) * 1.0
    with held:
        y = x.exp()  # holds its result
        z = y * y  # holds the same again
    z.sum().backward()
    assert held.bytes == 4000


def test_cached_tokens_spare_the_backbone(vit: ModelConfig, recipe: Recipe) -> None:
    frozen = dataclasses.replace(recipe, tune_steps=0, tuned_blocks=0, cache_versions=2, augment="none")
    told = _plan(vit, frozen)
    assert "tune" not in told
    assert _cost(vit, frozen, blocks=0, cached=True).megabytes > 0
