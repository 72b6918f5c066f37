"""The folder of a run: what is in it, and how it is written so that no kill at any time loses or tears anything.

`config.json` says what the run is, `log.jsonl` has a line for each measurement, `last.ckpt` is where to go on from;
in the end `model/` holds the best weights and `last/` the last ones.
"""

from __future__ import annotations

import copy
import hashlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from salad.datasets.training_place import TrainingPlace
from salad.errors import ModelError, TrainingError
from salad.files import write_whole
from salad.models.describer import Describer
from salad.network.config import ModelConfig
from salad.training.devices import versions
from salad.training.recipe import Preset, Recipe, in_full

CHECKPOINT, LOG, CONFIG, MODEL, LAST = "last.ckpt", "log.jsonl", "config.json", "model", "last"
STOPPED = "stopped.json"
_INSTEAD = "choose another folder with --to, or remove the file to begin anew"
_NO_MATTER = {"save_every"}  # settings that may differ when a run goes on: they change no weight
_YOUNGER = {"data": None, "start": None, "judge": None}  # what checkpoints of older versions do not tell


def identity(
    recipe: Recipe, config: ModelConfig, places: Sequence[TrainingPlace], *, start: str, judge: str
) -> dict[str, Any]:
    """What makes a run this one: the same seed gives the same weights only where all of this is the same."""
    settings = {name: value for name, value in asdict(recipe).items() if name not in _NO_MATTER}
    return {
        "recipe": settings,
        "architecture": config.as_dict(),
        "data": _digest(places),
        "start": Path(start).name,  # its folder may be mounted elsewhere
        "judge": judge,
    }


def _digest(places: Sequence[TrainingPlace]) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for place in places:
        digest.update(json.dumps([place.city, place.name, [photo.name for photo in place.photos]]).encode())
    return digest.hexdigest()


def resolved(preset: Preset, places: Sequence[TrainingPlace], *, start: str, steps: int) -> dict[str, Any]:
    """Everything a run is, as `config.json` holds it."""
    return {
        "recipe": asdict(preset.recipe),
        "steps": steps,
        "model": preset.model.as_dict(),
        "start": start,
        "data": {
            "places": len(places),
            "photos": sum(len(place.photos) for place in places),
            "cities": sorted({place.city for place in places}),
        },
        "versions": versions(),
    }


def take_up(folder: Path, mine: Mapping[str, Any]) -> dict[str, Any] | None:
    """What the run in `folder` saved last; None where there is none.

    Args:
        folder: the run's.
        mine: the `identity` of the run to go on with.

    Raises:
        ModelError: the run found there is another one.
        TrainingError: its checkpoint cannot be read.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        return None
    saved = _read(path)
    _compare(path, saved, mine)
    return saved


def insist(folder: Path, saved: Mapping[str, Any] | None, *, steps: int) -> None:
    """Refuse to begin a run where one was to be gone on with, up to `steps`.

    Raises:
        TrainingError: nothing was saved, or all steps were made and the model is there.
    """
    if saved is None:
        raise TrainingError(f"there is no run in {folder} to go on with: leave --resume out to begin one")
    if saved["step"] >= steps and (folder / MODEL).is_dir():
        raise TrainingError(
            f"the run in {folder} has ended after {saved['step']} steps, and its model is {folder / MODEL}: "
            "choose another folder with --to"
        )


def _read(path: Path) -> dict[str, Any]:
    try:
        saved = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged file fails in any way
        raise TrainingError(f"{path} is damaged ({type(error).__name__}): {_INSTEAD}") from error
    if not isinstance(saved, dict) or not isinstance(saved.get("step"), int):
        raise TrainingError(f"{path} is no checkpoint of a run: {_INSTEAD}")
    return saved


def _compare(path: Path, saved: Mapping[str, Any], mine: Mapping[str, Any]) -> None:
    theirs = {**_YOUNGER, **{key: value for key, value in saved.items() if key in mine}}
    recipe = in_full(theirs.get("recipe", {}))
    theirs["recipe"] = {name: value for name, value in recipe.items() if name not in _NO_MATTER}
    with suppress(ModelError, KeyError):
        theirs["architecture"] = ModelConfig.from_dict(theirs["architecture"]).as_dict()
    for key, wanted in mine.items():
        if theirs.get(key) != wanted and not (key in _YOUNGER and theirs[key] is None):
            what = f"{key} ({_differing(theirs[key], wanted)})" if key == "recipe" else key
            raise ModelError(
                f"{path} belongs to a run of another {what}: to go on with it, give what it was begun with; "
                "to begin another, choose another folder with --to"
            )


def _differing(theirs: Mapping[str, Any], mine: Mapping[str, Any]) -> str:
    names = [name for name in mine if theirs.get(name) != mine[name]]
    return ", ".join(f"{name} {theirs.get(name)}, not {mine[name]}" for name in names) or "other settings"


def save(folder: Path, state: Mapping[str, Any]) -> None:
    """Write the checkpoint, whole or not at all.

    Raises:
        TrainingError: it cannot be written; the one before stays.
    """
    draft = folder / f"{CHECKPOINT}.part"
    try:
        with draft.open("wb") as file:
            torch.save(dict(state), file)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(folder / CHECKPOINT)
    except (OSError, RuntimeError) as error:  # torch tells a full disk in either way
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise TrainingError(
            f"the checkpoint of step {state['step']} cannot be written to {folder}: {error}; the one before "
            "stays, so make room and run the same command again"
        ) from error


def trim_log(folder: Path, step: int) -> None:
    """Drop lines of steps that a killed run had measured but not saved: they will be made again."""
    log = folder / LOG
    if not log.is_file():
        return
    kept = []
    for line in log.read_text(encoding="utf-8").splitlines():
        with suppress(ValueError, KeyError, TypeError):  # a line torn by the kill
            if json.loads(line)["step"] <= step:
                kept.append(line + "\n")
    write_whole(log, "".join(kept).encode())


def write_log(folder: Path, told: Mapping[str, Any]) -> str:
    """Add a measurement to the log; the line."""
    line = json.dumps(told)
    with (folder / LOG).open("a", encoding="utf-8") as log:
        log.write(line + "\n")
    return line


def write_json(path: Path, told: Mapping[str, Any]) -> None:
    """Write settings or findings for people and programs, whole or not at all."""
    write_whole(path, (json.dumps(told, indent=2, ensure_ascii=False) + "\n").encode())


# --- Where a run stands: everything its next step depends on, and so what a checkpoint holds ---


class State:
    """The weights of a run, their running mean, the best so far, and how many steps were made.

    Nothing random is in it: every step is seeded by its number.

    Args:
        model: what is trained.
        tuned_share: how far the weights kept lie on the way from `before` to `average`.

    Attributes:
        model: the weights of the last step.
        average: their running mean.
        before: that mean as it was before the backbone was trained; None until then.
        best: the highest score so far, and the weights kept that reached it.
        step: steps made.
        cliques: numbers of places that looked alike when last looked at.
        momenta: the optimizer's memory as it was saved; None at a stage's start.
        scaler: the loss scale of half precision as it was saved.
    """

    def __init__(self, model: Describer, *, tuned_share: float = 1.0) -> None:
        self.model, self.average = model, copy.deepcopy(model)
        self.tuned_share = tuned_share
        self.before: dict[str, Tensor] | None = None
        self.best: dict[str, Any] = {"score": -1.0, "weights": self.average.state_dict()}
        self.step = 0
        self.cliques: list[list[int]] = []
        self.momenta: dict[str, Any] | None = None
        self.scaler: dict[str, Any] = {}
        self._before, self._began = 0.0, time.monotonic()

    @property
    def seconds(self) -> float:
        """How long the run has taken, interruptions left out."""
        return self._before + time.monotonic() - self._began

    def to(self, device: torch.device) -> None:
        """Move the weights to where they are trained."""
        self.model.to(device)
        self.average.to(device)

    def remember(self) -> None:
        """The backbone is about to be trained: keep the weights from before, if they are wanted later."""
        if self.tuned_share < 1:
            self.before = copy.deepcopy(self.average.state_dict())

    def kept(self) -> Describer:
        """The model as it would be kept if the run ended here: it is what is measured."""
        if self.before is None:
            return self.average
        kept = copy.deepcopy(self.average)
        for name, weight in kept.state_dict().items():
            if weight.is_floating_point():  # a batch norm counts its batches too
                weight.copy_(self.before[name].to(weight).lerp(weight, self.tuned_share))
        return kept

    def improved(self, score: float, kept: Describer) -> bool:
        """Take these weights for the best if none had so high a score; whether they are taken."""
        if score <= self.best["score"]:
            return False
        self.best = {"score": score, "weights": copy.deepcopy(kept.state_dict())}
        return True

    def as_saved(self, optimizer: torch.optim.Optimizer, scaler: Mapping[str, Any]) -> dict[str, Any]:
        """What `take_up` reads."""
        return {
            "step": self.step,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "before": self.before,
            "best": self.best,
            "cliques": self.cliques,
            "seconds": self.seconds,
            "optimizer": optimizer.state_dict(),
            "scaler": dict(scaler),
        }

    def take_up(self, saved: Mapping[str, Any]) -> None:
        """Stand where a run stood when it was saved."""
        self.model.load_state_dict(saved["model"])
        self.average.load_state_dict(saved["average"])
        self.best, self.step, self.momenta = saved["best"], saved["step"], saved["optimizer"]
        # what checkpoints of older versions do not hold
        self.before = saved.get("before")
        self.cliques, self.scaler = saved.get("cliques", []), saved.get("scaler", {})
        self._before, self._began = saved.get("seconds", 0.0), time.monotonic()
