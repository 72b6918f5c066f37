"""A run of a few steps on tiny photos: it learns, stops, goes on, and ends as it would have."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from salad.datasets.training_place import TrainingPlace
from salad.errors import BenchmarkError, MissingExtraError, ModelError, TrainingError
from salad.models.describer import Describer
from salad.models.model_folder import load
from salad.network.config import ModelConfig
from salad.network.network import build
from salad.training import trainer
from salad.training.batches import ImageCache
from salad.training.recipe import Recipe
from salad.training.validation import precision_held_out

Teach = Callable[..., Path]


@pytest.fixture(scope="module")
def whole(teach: Teach, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing disturbed."""
    to = tmp_path_factory.mktemp("whole")
    teach(to)
    return to


def _weights(run: Path, which: str = "model") -> dict[str, torch.Tensor]:
    return load_file(run / which / "model.safetensors")


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
    seconds = [line["seconds"] for line in told]
    assert seconds == sorted(seconds)


def test_a_run_says_in_full_what_it_is(whole: Path, recipe: Recipe) -> None:
    told = json.loads((whole / "config.json").read_text())
    assert told["recipe"] == dataclasses.asdict(recipe)
    assert (told["steps"], told["start"]) == (4, "")
    assert told["data"] == {"places": 6, "photos": 24, "cities": ["set"]}
    assert told["versions"]["torch"] == torch.__version__
    assert ModelConfig.from_dict(told["model"]).name == "tiny"


def _judge_by(scores: list[float]) -> Callable[[Describer], dict[str, float]]:
    told = iter(scores)
    return lambda _: {"R@1": 1.0, "mean": next(told)}


def test_the_best_weights_of_the_run_and_its_last_are_kept(teach: Teach, tmp_path: Path) -> None:
    teach(tmp_path / "four", judge=_judge_by([1.0, 5.0, 2.0, 4.9]))  # the second is the best
    teach(tmp_path / "two", judge=_judge_by([1.0, 5.0]), recipe={"tune_steps": 0})
    kept, stopped = _weights(tmp_path / "four"), _weights(tmp_path / "two")
    assert all(torch.equal(kept[key], stopped[key]) for key in kept)
    last = _weights(tmp_path / "four", "last")
    assert not all(torch.equal(kept[key], last[key]) for key in kept)
    lines = (tmp_path / "four" / "log.jsonl").read_text().splitlines()
    assert [json.loads(line)["benchmark"]["mean"] for line in lines] == [1.0, 5.0, 2.0, 4.9]


def test_weights_are_kept_on_the_way_from_the_first_stage_to_the_second(teach: Teach, tmp_path: Path) -> None:
    seen: dict[str, list[dict[str, torch.Tensor]]] = {}

    def run(name: str, share: float) -> dict[str, torch.Tensor]:
        seen[name] = []

        def judge(model: Describer) -> dict[str, float]:
            seen[name].append({key: value.clone() for key, value in model.network.state_dict().items()})
            return {"mean": float(len(seen[name]))}

        teach(tmp_path / name, judge=judge, recipe={"tuned_share": share})
        return _weights(tmp_path / name)

    before, after, between = run("none", 0.0), run("all", 1.0), run("part", 0.25)
    first = seen["all"][1]  # measured at the first stage's end
    trained = [
        key for key in first if first[key].is_floating_point() and not torch.equal(first[key], seen["all"][3][key])
    ]
    assert trained
    for key in trained:
        torch.testing.assert_close(seen["none"][3][key], first[key])
        torch.testing.assert_close(seen["part"][3][key], 0.75 * first[key] + 0.25 * seen["all"][3][key])
        torch.testing.assert_close(between[key], (0.75 * before[key] + 0.25 * after[key]).half(), atol=2e-3, rtol=2e-3)
    for stage in (0, 1):  # in the first stage there is no way back yet
        torch.testing.assert_close(seen["none"][stage], seen["all"][stage])


def test_a_run_cut_off_on_the_way_ends_as_it_would_have(teach: Teach, tmp_path: Path) -> None:
    def stop(line: str) -> None:
        if '"step": 4,' in line:
            raise Interrupted

    share = {"tuned_share": 0.5}
    teach(tmp_path / "whole", recipe=share)
    with pytest.raises(Interrupted):
        teach(tmp_path / "cut", recipe=share, say=stop)
    teach(tmp_path / "cut", recipe=share, resume=True)
    torch.testing.assert_close(_weights(tmp_path / "cut"), _weights(tmp_path / "whole"), rtol=0, atol=0)


def test_a_judge_without_a_verdict_is_a_sentence(teach: Teach, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="no mean that is a number at step 1"):
        teach(tmp_path, judge=lambda _: {"mean": float("nan")})


class Interrupted(Exception):
    """Somebody pulled the plug."""


@pytest.mark.parametrize("backbone", ["lite", "vit"])
@pytest.mark.parametrize("step", [2, 3, 4])
def test_an_interrupted_run_ends_as_it_would_have(
    teach: Teach, whole: Path, tmp_path: Path, step: int, backbone: str, request: pytest.FixtureRequest
) -> None:
    """Interrupted before step 2, 3 or 4 is saved: within the first stage, between the two, within the second."""
    said: list[str] = []
    model = request.getfixturevalue(backbone)

    def stop(line: str) -> None:
        if f'"step": {step},' in line:
            raise Interrupted

    if backbone == "vit":
        whole = tmp_path / "whole"
        teach(whole, model=model)
    with pytest.raises(Interrupted):
        teach(tmp_path / "cut", model=model, say=stop)
    assert not (tmp_path / "cut" / "model").exists()
    teach(tmp_path / "cut", model=model, say=said.append, resume=True)
    assert f"going on from step {step - 1}" in said
    torch.testing.assert_close(_weights(tmp_path / "cut"), _weights(whole), rtol=0, atol=0)
    told = [json.loads(line)["step"] for line in (tmp_path / "cut" / "log.jsonl").read_text().splitlines()]
    assert told == [1, 2, 3, 4]  # the line that was told but not saved is there once


def test_a_run_that_ended_is_written_again_without_a_step(teach: Teach, tmp_path: Path) -> None:
    teach(tmp_path)
    expected, lines = _weights(tmp_path), (tmp_path / "log.jsonl").read_text()
    teach(tmp_path)
    torch.testing.assert_close(_weights(tmp_path), expected, rtol=0, atol=0)
    assert (tmp_path / "log.jsonl").read_text() == lines


def test_what_cannot_be_resumed_is_a_sentence(teach: Teach, tmp_path: Path) -> None:
    short = {"head_steps": 1, "tune_steps": 0}
    with pytest.raises(TrainingError, match=r"no run in .* to go on with"):
        teach(tmp_path, recipe=short, resume=True)
    assert not list(tmp_path.iterdir())
    teach(tmp_path, recipe=short)
    with pytest.raises(TrainingError, match="has ended after 1 steps"):
        teach(tmp_path, recipe=short, resume=True)


def test_a_folder_of_another_run_is_refused(
    teach: Teach, places: list[TrainingPlace], tmp_path: Path, vit: ModelConfig
) -> None:
    short = {"head_steps": 1, "tune_steps": 0}
    teach(tmp_path, recipe=short)
    before = (tmp_path / "last.ckpt").read_bytes()
    with pytest.raises(ModelError, match=r"last\.ckpt belongs to a run of another recipe \(head_rate 0\.001, not 0"):
        teach(tmp_path, recipe=short | {"head_rate": 0.5})
    with pytest.raises(ModelError, match=r"last\.ckpt belongs to a run of another architecture"):
        teach(tmp_path, recipe=short, model=vit)
    with pytest.raises(ModelError, match=r"last\.ckpt belongs to a run of another data"):
        teach(tmp_path, recipe=short, places=places[1:])
    with pytest.raises(ModelError, match=r"last\.ckpt belongs to a run of another judge"):
        teach(tmp_path, recipe=short, judge=_judge_by([1.0]))
    assert (tmp_path / "last.ckpt").read_bytes() == before


def test_how_often_it_is_saved_is_no_other_run(teach: Teach, tmp_path: Path) -> None:
    short = {"head_steps": 1, "tune_steps": 0}
    teach(tmp_path, recipe=short)
    said: list[str] = []
    teach(tmp_path, recipe=short | {"save_every": 7}, say=said.append)
    assert "going on from step 1" in said


def test_the_first_stage_leaves_the_backbone_alone(teach: Teach, tmp_path: Path, lite: ModelConfig) -> None:
    teach(tmp_path, recipe={"tune_steps": 0, "average": 0.0})
    fresh, learnt = build(lite, seed=0).state_dict(), _weights(tmp_path)
    for key, value in fresh.items():
        same = torch.equal(value.half() if value.is_floating_point() else value, learnt[key])
        if key.startswith("backbone."):
            assert same, key
    assert not torch.equal(fresh["aggregator.feature.0.weight"].half(), learnt["aggregator.feature.0.weight"])


def test_the_second_stage_trains_the_last_blocks_alone(teach: Teach, tmp_path: Path, vit: ModelConfig) -> None:
    recipe = {"head_steps": 0, "tune_steps": 1, "average": 0.0, "trunk_rate": 0.01}
    teach(tmp_path, model=vit, recipe=recipe)
    fresh, learnt = build(vit, seed=0).state_dict(), _weights(tmp_path)
    backbone = [key for key in fresh if key.startswith("backbone.")]
    changed = {key for key in backbone if not torch.equal(fresh[key].half(), learnt[key])}
    trained = ("backbone.blocks.1.", "backbone.norm.")
    assert changed
    assert all(key.startswith(trained) for key in changed)
    assert {"backbone.norm.bias", "backbone.blocks.1.mlp.fc2.weight"} <= changed


@pytest.mark.parametrize("backbone", ["lite", "vit"])
def test_nothing_is_kept_of_the_frozen_prefix(backbone: str, request: pytest.FixtureRequest) -> None:
    """No gradient is wanted before the first trained block, so nothing is held for a way back there."""
    config = request.getfixturevalue(backbone)
    if backbone == "lite":
        config = dataclasses.replace(config, backbone=dataclasses.replace(config.backbone, blocks=2))
        config = dataclasses.replace(config, aggregator=dataclasses.replace(config.aggregator, width=24))
    model = build(config)
    model.backbone.train_last(1)
    blocks = list(getattr(model.backbone, "blocks", None) or model.backbone._blocks)
    wanted: list[bool] = []
    for block in blocks:
        block.register_forward_hook(lambda _, __, out: wanted.append(out.requires_grad))
    model.train()(torch.rand(2, 3, 42, 42))
    assert wanted == [False, True]


def test_no_block_may_be_trained_at_all(teach: Teach, tmp_path: Path, vit: ModelConfig) -> None:
    teach(tmp_path, model=vit, recipe={"tuned_blocks": 0, "average": 0.0, "trunk_rate": 0.01})
    fresh, learnt = build(vit, seed=0).state_dict(), _weights(tmp_path)
    assert all(torch.equal(fresh[key].half(), learnt[key]) for key in fresh if key.startswith("backbone."))


def test_without_places_held_out_nothing_is_measured(teach: Teach, tmp_path: Path) -> None:
    teach(tmp_path, recipe={"held_out": 0.0, "tune_steps": 0})
    assert "held_out" not in (tmp_path / "log.jsonl").read_text()


def test_runs_of_other_seeds_may_hold_the_same_places_out(
    teach: Teach, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    apart: list[set[str]] = []

    def watched(model: Any, places: Sequence[TrainingPlace], images: ImageCache) -> dict[str, float]:
        apart.append({place.photos[0].parent.name for place in places})
        return precision_held_out(model, places, images)

    monkeypatch.setattr(trainer, "precision_held_out", watched)
    settings = {"head_steps": 1, "tune_steps": 0}
    for seed in range(4):
        teach(tmp_path / f"own {seed}", recipe={**settings, "seed": seed})
        teach(tmp_path / f"same {seed}", recipe={**settings, "seed": seed, "split_seed": 0})
    own, same = apart[::2], apart[1::2]
    assert any(each != own[0] for each in own)
    assert all(each == own[0] for each in same)


def test_too_few_places_are_a_sentence(teach: Teach, tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="a batch needs 5 places, but there are 4"):
        teach(tmp_path / "run", recipe={"places": 5})
    assert not (tmp_path / "run").exists()


def test_epochs_need_a_sampler_that_counts_them(teach: Teach, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="epochs are counted by the sampler one-city alone"):
        teach(tmp_path / "run", recipe={"epochs": 2})
    teach(tmp_path, recipe={"epochs": 2, "head_steps": 0, "sampler": "one-city", "places": 2, "mirror": False})
    steps = [json.loads(line)["step"] for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert steps == [1, 2, 3, 4]  # four places, two a batch, twice


def test_batches_of_places_that_look_alike_are_looked_for_every_so_often(teach: Teach, tmp_path: Path) -> None:
    said: list[str] = []
    settings = {"sampler": "cliques", "mine_every": 2, "clique": 2, "held_out": 0.0, "tune_steps": 3}
    teach(tmp_path / "whole", recipe=settings, say=said.append)
    assert [line.split()[-1] for line in said if "look alike" in line] == ["2", "4"]

    def stop(line: str) -> None:
        if '"step": 4,' in line:
            raise Interrupted

    with pytest.raises(Interrupted):
        teach(tmp_path / "cut", recipe=settings, say=stop)
    teach(tmp_path / "cut", recipe=settings)
    torch.testing.assert_close(_weights(tmp_path / "cut"), _weights(tmp_path / "whole"), rtol=0, atol=0)


def test_a_photo_that_cannot_be_read_is_told_once(teach: Teach, places: list[TrainingPlace], tmp_path: Path) -> None:
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"no photo")
    worse = [dataclasses.replace(place, photos=(broken, *place.photos[1:])) for place in places]
    said: list[str] = []
    teach(tmp_path / "run", places=worse, recipe={"views": 4}, say=said.append)
    assert len([line for line in said if "cannot be read" in line]) == 1
    assert (tmp_path / "run" / "model").is_dir()


def test_progress_is_told(teach: Teach, tmp_path: Path) -> None:
    told: list[tuple[int, int | None]] = []
    teach(tmp_path, progress=lambda done, total: told.append((done, total)))
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_one_batch_is_learnt_by_heart(
    teach: Teach, places: list[TrainingPlace], tmp_path: Path, lite: ModelConfig
) -> None:
    """All photos of all places in every batch, nothing changed or dropped: the loss goes to nothing."""
    settings = {"places": 6, "views": 4, "held_out": 0.0, "augment": "none", "mirror": False, "average": 0.0}
    steps = {"head_steps": 0, "tune_steps": 120, "measure_every": 10, "head_rate": 1e-2, "trunk_rate": 1e-2}
    model = dataclasses.replace(lite, aggregator=dataclasses.replace(lite.aggregator, dropout=0.0))
    made = teach(tmp_path, model=model, recipe=settings | steps | {"last": 0.2, "clip": None})
    losses = [json.loads(line)["loss"] for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert losses[0] > 0.05
    assert min(losses) < 0.02
    photos = [photo for place in places for photo in place.photos]
    rows = load(made).describe(photos)
    likeness = rows @ rows.T
    np.fill_diagonal(likeness, -1)
    assert (likeness.argmax(axis=1) // 4 == np.arange(24) // 4).all()


def _failing(at: int) -> Callable[[], Callable[..., torch.Tensor]]:
    """An objective that gives a sound loss but at one of its calls."""
    sound, calls = trainer.multi_similarity(), iter(range(100))

    def objective(descriptors: torch.Tensor, labels: torch.Tensor) -> torch.Tensor:
        loss = sound(descriptors, labels)
        return loss * torch.nan if next(calls) == at else loss

    return lambda: objective


def test_a_loss_that_is_no_number_stops_with_its_batch_named_and_nothing_lost(
    teach: Teach, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(trainer, "multi_similarity", _failing(2))
        with pytest.raises(TrainingError, match=r"the loss is nan at step 3, in the batch of .*\.png.* and 2 more"):
            teach(tmp_path)
    stopped = json.loads((tmp_path / "stopped.json").read_text())
    assert (stopped["step"], len(stopped["photos"])) == (2, 6)
    assert all(Path(photo).is_file() for photo in stopped["photos"])
    said: list[str] = []
    teach(tmp_path, say=said.append)  # whatever it was, it is mended
    assert "going on from step 2" in said
    torch.testing.assert_close(_weights(tmp_path), _weights(whole), rtol=0, atol=0)


def test_a_gradient_without_an_end_stops_too(teach: Teach, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def steep(descriptors: torch.Tensor, _: torch.Tensor) -> torch.Tensor:
        return (descriptors * 0).clamp(min=0).sqrt().sum()  # nothing, with an infinite slope

    monkeypatch.setattr(trainer, "multi_similarity", lambda: steep)
    with pytest.raises(TrainingError, match="the gradient's length is nan at step 1"):
        teach(tmp_path)


def test_half_precision_overshoots_lowers_its_scale_and_remembers_it(
    teach: Teach, tmp_path: Path, vit: ModelConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gradients that are infinite for their scale alone are no reason to stop: the step is left out."""
    from lightning_fabric import Fabric
    from lightning_fabric.plugins.precision import MixedPrecision

    def launch_fabric(*_: object, **__: object) -> Fabric:
        scaler = torch.amp.GradScaler("cpu", init_scale=2.0**30)
        precision = MixedPrecision("16-mixed", "cpu", scaler)
        return Fabric(accelerator="cpu", devices=1, plugins=[precision])

    def stop(line: str) -> None:
        if '"step": 4,' in line:
            raise Interrupted

    monkeypatch.setattr(trainer, "launch_fabric", launch_fabric)
    teach(tmp_path / "whole", model=vit)
    scale = torch.load(tmp_path / "whole" / "last.ckpt", weights_only=True)["scaler"]["scale"]
    assert scale < 2.0**30
    with pytest.raises(Interrupted):
        teach(tmp_path / "cut", model=vit, say=stop)
    teach(tmp_path / "cut", model=vit)
    assert torch.load(tmp_path / "cut" / "last.ckpt", weights_only=True)["scaler"]["scale"] == scale
    torch.testing.assert_close(_weights(tmp_path / "cut"), _weights(tmp_path / "whole"), rtol=0, atol=0)


@pytest.mark.parametrize("missing", ["kornia", "pytorch_metric_learning", "lightning_fabric"])
def test_without_the_extra_its_name_is_told(
    teach: Teach, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(MissingExtraError, match="'train' extra"):
        teach(tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_an_accelerator_there_is_not_is_a_sentence(teach: Teach, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="training cannot run on 1 of 'abacus'"):
        teach(tmp_path / "run", accelerator="abacus")
    assert not (tmp_path / "run").exists()


def test_what_is_fitted_to_photos_is_fitted_once(teach: Teach, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fitted: list[dict[str, Any]] = []

    def fit(model: Describer, photos: list[Path], **settings: Any) -> None:
        fitted.append({"photos": len(photos), "seed": settings["seed"]})
        settings["passed_over"](ValueError("gone.jpg"))

    monkeypatch.setattr(trainer, "needs_fitting", lambda _: True)
    monkeypatch.setattr(trainer, "fit", fit)
    said: list[str] = []
    teach(tmp_path, recipe={"head_steps": 1, "tune_steps": 0}, say=said.append)
    teach(tmp_path, recipe={"head_steps": 1, "tune_steps": 0})
    assert fitted == [{"photos": 16, "seed": 0}]
    assert "left out: gone.jpg" in said
