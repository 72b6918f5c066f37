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
from salad.errors import ModelError, TrainingError, reason
from salad.files import parse_json, read_json, write_whole
from salad.network.config import ModelConfig
from salad.network.network import Network
from salad.network.weight_files import load_pickle
from salad.training.devices import versions
from salad.training.recipe import Preset, Recipe, with_defaults

CHECKPOINT, LOG, CONFIG, MODEL, LAST = "last.ckpt", "log.jsonl", "config.json", "model", "last"
STOPPED = "stopped.json"
_MAY_DIFFER = {"save_every"}  # settings that may differ when a run goes on: they change no weight
_UNKNOWN_TO_OLDER = {"data": None, "start": None, "judge": None}  # what checkpoints of older versions lack
_ADVICE = "choose another folder with --to, or remove the file to begin anew"


class TrainingState:
    """Where a run stands: the weights, their running mean, the best so far, and how many steps were made.

    It is everything the next step depends on, and so what a checkpoint holds. Nothing random is in it: every step
    is seeded by its number.

    Args:
        model: what is trained.
        tuned_share: how far the weights kept lie on the way from `before_tuning` to `average`.

    Attributes:
        model: the weights of the last step.
        average: their running mean.
        before_tuning: that mean as it was before the backbone was trained; None until then.
        best: the highest score so far, and the weights kept that reached it.
        step: steps made.
        cliques: numbers of places that looked alike when last looked at.
        optimizer: the optimizer's memory as it was saved; None at a stage's start.
        scaler: the loss scale of half precision as it was saved.
    """

    def __init__(self, model: Network, *, tuned_share: float = 1.0) -> None:
        self.model, self.average = model, copy.deepcopy(model)
        self.tuned_share = tuned_share
        self.before_tuning: dict[str, Tensor] | None = None
        self.best: dict[str, Any] = {"score": -1.0, "weights": self.average.state_dict()}
        self.step = 0
        self.cliques: list[list[int]] = []
        self.optimizer: dict[str, Any] | None = None
        self.scaler: dict[str, Any] = {}
        self._seconds_before, self._began = 0.0, time.monotonic()

    @property
    def seconds(self) -> float:
        """How long the run has taken, interruptions left out."""
        return self._seconds_before + time.monotonic() - self._began

    def to(self, device: torch.device) -> None:
        """Move the weights to where they are trained."""
        self.model.to(device)
        self.average.to(device)

    def remember_before_tuning(self) -> None:
        """The backbone is about to be trained: keep the weights from before, if they are wanted later."""
        if self.tuned_share < 1:
            self.before_tuning = copy.deepcopy(self.average.state_dict())

    def kept(self) -> Network:
        """The model as it would be kept if the run ended here: it is what is measured."""
        if self.before_tuning is None:
            return self.average
        kept = copy.deepcopy(self.average)
        for name, weight in kept.state_dict().items():
            if weight.is_floating_point():  # a batch norm counts its batches too, in whole numbers
                weight.copy_(self.before_tuning[name].to(weight).lerp(weight, self.tuned_share))
        return kept

    def remember_best(self, score: float, kept: Network) -> None:
        """Take these weights for the best if none had so high a score."""
        if score > self.best["score"]:
            self.best = {"score": score, "weights": copy.deepcopy(kept.state_dict())}

    def state_dict(self, optimizer: torch.optim.Optimizer, scaler: Mapping[str, Any]) -> dict[str, Any]:
        """What `load_state_dict` reads. Its keys are those of runs that others have begun, so they stay."""
        return {
            "step": self.step,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "before": self.before_tuning,
            "best": self.best,
            "cliques": self.cliques,
            "seconds": self.seconds,
            "optimizer": optimizer.state_dict(),
            "scaler": dict(scaler),
        }

    def load_state_dict(self, saved: Mapping[str, Any]) -> None:
        """Stand where a run stood when it was saved."""
        self.model.load_state_dict(saved["model"])
        self.average.load_state_dict(saved["average"])
        self.best, self.step, self.optimizer = saved["best"], saved["step"], saved["optimizer"]
        # what checkpoints of older versions do not hold
        self.before_tuning = saved.get("before")
        self.cliques, self.scaler = saved.get("cliques", []), saved.get("scaler", {})
        self._seconds_before, self._began = saved.get("seconds", 0.0), time.monotonic()


def run_identity(
    recipe: Recipe, config: ModelConfig, places: Sequence[TrainingPlace], *, start: str, judge: str
) -> dict[str, Any]:
    """What makes a run this one: the same seed gives the same weights only where all of this is the same."""
    digest = hashlib.blake2b(digest_size=16)
    for place in places:
        digest.update(json.dumps([place.city, place.name, [photo.name for photo in place.photos]]).encode())
    return {
        "recipe": {name: value for name, value in asdict(recipe).items() if name not in _MAY_DIFFER},
        "architecture": config.as_dict(),
        "data": digest.hexdigest(),
        "start": Path(start).name,  # its folder may be mounted elsewhere
        "judge": judge,
    }


def recipe_of_run(folder: Path) -> dict[str, Any]:
    """The recipe of the run that was begun in a folder, as it was written down; empty where there is none."""
    try:
        return with_defaults(read_json(folder / CONFIG)["recipe"])
    except (OSError, ValueError, KeyError, TypeError):  # whatever is wrong with it is said where the run is read
        return {}


def run_config(preset: Preset, places: Sequence[TrainingPlace], *, start: str, steps: int) -> dict[str, Any]:
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


def load_checkpoint(folder: Path, identity: Mapping[str, Any]) -> dict[str, Any] | None:
    """What the run in `folder` saved last; None where there is none.

    Args:
        folder: the run's.
        identity: the `run_identity` of the run to go on with.

    Raises:
        ModelError: If the run found there is another one.
        TrainingError: If its checkpoint cannot be read.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        return None
    try:
        saved = load_pickle(path)
    except Exception as error:  # a damaged file fails in any way
        raise TrainingError(f"{path} is damaged: {_ADVICE}") from error
    if not isinstance(saved, dict) or not isinstance(saved.get("step"), int):
        raise TrainingError(f"{path} is no checkpoint of a run: {_ADVICE}")
    differing = _other_run(saved, identity)
    if differing is not None:
        raise ModelError(
            f"{path} belongs to a run of another {differing}: to go on with it, give what it was begun with; "
            "to begin another, choose another folder with --to"
        )
    return saved


def _other_run(saved: Mapping[str, Any], identity: Mapping[str, Any]) -> str | None:
    """Where a saved run is another than that of `identity`; None where nowhere."""
    theirs = {**_UNKNOWN_TO_OLDER, **{key: value for key, value in saved.items() if key in identity}}
    recipe = with_defaults(theirs.get("recipe", {}))
    theirs["recipe"] = {name: value for name, value in recipe.items() if name not in _MAY_DIFFER}
    # An older version wrote a configuration without what came later: read and written again, it has that.
    with suppress(ModelError, KeyError):
        theirs["architecture"] = ModelConfig.from_dict(theirs["architecture"]).as_dict()
    for key, mine in identity.items():
        other = theirs.get(key)
        if other == mine or (key in _UNKNOWN_TO_OLDER and other is None):
            continue
        if key != "recipe":
            return key
        changed = [f"{name} {recipe[name]}, not {mine[name]}" for name in mine if recipe[name] != mine[name]]
        return f"recipe ({', '.join(changed) or 'other settings'})"
    return None


def require_unfinished(folder: Path, saved: Mapping[str, Any] | None, *, steps: int) -> None:
    """Refuse to begin a run where one was to be gone on with, up to `steps`.

    Raises:
        TrainingError: If nothing was saved, or all steps were made and the model is there.
    """
    if saved is None:
        raise TrainingError(f"there is no run in {folder} to go on with: leave --resume out to begin one")
    if saved["step"] >= steps and (folder / MODEL).is_dir():
        raise TrainingError(
            f"the run in {folder} has ended after {saved['step']} steps, and its model is {folder / MODEL}: "
            "choose another folder with --to"
        )


def save_checkpoint(folder: Path, state: Mapping[str, Any]) -> None:
    """Write the checkpoint, whole or not at all.

    Raises:
        TrainingError: If it cannot be written; the one before stays.
    """
    draft = folder / f"{CHECKPOINT}.part"
    try:
        with draft.open("wb") as file:
            torch.save(dict(state), file)
            file.flush()
            os.fsync(file.fileno())  # or a power cut may leave the new name on an empty file
        draft.replace(folder / CHECKPOINT)
    except (OSError, RuntimeError) as error:  # torch tells a full disk in either way
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise TrainingError(
            f"the checkpoint of step {state['step']} cannot be written to {folder}: {reason(error)}; the one before "
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
            if parse_json(line)["step"] <= step:
                kept.append(line + "\n")
    write_whole(log, "".join(kept).encode())


def append_to_log(folder: Path, measurement: Mapping[str, Any]) -> str:
    """Add a measurement to the log; the line."""
    line = json.dumps(measurement)
    with (folder / LOG).open("a", encoding="utf-8") as log:
        log.write(line + "\n")
    return line


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write settings or findings for people and programs, whole or not at all."""
    write_whole(path, (json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode())
