"""Train every row of a grid with several seeds on equal terms, and measure each.

A run lives in `TO/<row>/seed<number>/`: its checkpoint while it lasts, then its model and its outcome. A run that
was interrupted goes on, one that has come to an outcome is never repeated; sets that are new to it are measured
with the model it left.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import torch

from salad.ablation.grids import Row
from salad.ablation.outcome import (
    IDENTITY,
    Outcome,
    counted,
    difference,
    folder_of,
    machine,
    milliseconds,
    read,
    seconds_of,
    summary,
    write,
)
from salad.ablation.setup import GridSetup, check, digest, preset
from salad.datasets.training_place import TrainingPlace
from salad.errors import ModelError
from salad.models.describer import Describer, build
from salad.models.model_folder import load, write_folder
from salad.training.batches import ImageCache
from salad.training.checkpoint import CHECKPOINT, MODEL
from salad.training.devices import versions
from salad.training.logger import Say
from salad.training.recipe import Preset, in_full
from salad.training.start import fit, needs_fitting, start_backbone
from salad.training.trainer import TOKENS, Progress, train
from salad.training.validation import precision_held_out

Teach = Callable[..., Path]


class Measure(NamedTuple):
    """How a model is measured on a set.

    Args:
        protocol: the rule that says what is right there.
        judge: what a model reaches, as `salad evaluate --format json` says it.
    """

    protocol: str
    judge: Callable[[Describer], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class _Run:
    """One row with one seed."""

    row: Row
    preset: Preset
    folder: Path
    identity: dict[str, Any]


@dataclass(frozen=True)
class Comparison:
    """What is trained on, where to, and how it is measured.

    Args:
        places: what to learn from; each recipe's share of them is held out.
        to: the folder of all runs.
        terms: what the rows have in common.
        measures: by the name of a set.
        accelerator: Fabric's word for where to train.
        device: where to measure, as torch names it.
        say: takes a line whenever there is something to tell.
        watch: opens a bar, by what is being done.
        teach: what trains.
    """

    places: Sequence[TrainingPlace]
    to: Path
    terms: GridSetup
    measures: Mapping[str, Measure]
    accelerator: str = "auto"
    device: str = "cpu"
    say: Say = print
    watch: Callable[[str], AbstractContextManager[Progress]] = lambda _: nullcontext(_no_progress)
    teach: Teach = train

    def run(self, rows: Sequence[Row], *, seeds: Sequence[int]) -> dict[str, list[Outcome]]:
        """Bring every row with every seed to its outcome; seed by seed, so that a part of it is a comparison too.

        Returns:
            The outcomes of each row, in the order of the seeds.

        Raises:
            ModelError: a row cannot be built, or a folder holds the run of something else.
        """
        start, data = digest(self.terms.start), summary(self.places)
        runs = [self._planned(row, seed, start, data) for seed in seeds for row in rows]
        left = [run for run in runs if self._found(run) is None]
        check([run.preset for run in left])
        outcomes: dict[str, list[Outcome]] = {row.name: [] for row in rows}
        began, made = time.monotonic(), 0
        for run in runs:
            found = self._found(run)
            if found is None:
                self.say(f"{run.row.name}, seed {run.preset.recipe.seed}: {made + 1} of {len(left)} runs")
                found, made = self._made(run), made + 1
                self.say(_left(time.monotonic() - began, made, len(left)))
            outcomes[run.row.name].append(self._measured_anew(run, found))
        return outcomes

    def _planned(self, row: Row, seed: int, start: dict[str, str], data: dict[str, Any]) -> _Run:
        made = preset(self.terms, row, seed=seed)
        told = {"model": made.model.as_dict(), "start": made.start, "recipe": asdict(made.recipe)}
        told["start"] = start["name"]  # not its folder, which differs from machine to machine
        identity = dict(zip(IDENTITY, (row.name, seed, told, start, data), strict=True))
        as_json_holds_it = json.loads(json.dumps(identity))  # no tuples
        return _Run(row, made, folder_of(self.to, row.name, seed), as_json_holds_it)

    def _found(self, run: _Run) -> Outcome | None:
        found = read(run.folder)
        if found is not None:
            theirs = {key: getattr(found, key) for key in IDENTITY}
            theirs["preset"] = {**found.preset, "recipe": in_full(found.preset["recipe"])}
            other = difference(theirs, run.identity)
            if other:
                raise ModelError(
                    f"{run.folder} holds the outcome of another run ({other}): choose another folder with --to"
                )
        return found

    def _made(self, run: _Run) -> Outcome:
        began = time.monotonic()
        if run.preset.recipe.head_steps + run.preset.recipe.tune_steps:
            self._taught(run)
        else:
            self._fitted(run)
        trained = time.monotonic()
        model = load(run.folder / MODEL, device=self.device)
        outcome = Outcome(
            **run.identity,
            dim=model.dim,
            parameters=counted(model, run.preset),
            milliseconds=milliseconds(model),
            held_out=self._held_out(model, run.preset),
            benchmarks={name: self._measured(name, model) for name in self.measures},
            seconds={
                "training": seconds_of(run.folder, trained - began),
                "measuring": round(time.monotonic() - trained, 1),
            },
            fingerprint=model.fingerprint,
            versions={"python": platform.python_version(), **versions()},
            machine=machine(self.device),
            finished=datetime.now(UTC).date().isoformat(),
        )
        write(outcome, run.folder)
        with suppress(OSError):
            (run.folder / CHECKPOINT).unlink(missing_ok=True)  # many times the model's size, and done with
        return outcome

    def _taught(self, run: _Run) -> None:
        with self.watch(f"{run.row.name}, seed {run.preset.recipe.seed}") as bar:
            self.teach(
                run.preset,
                self.places,
                to=run.folder,
                accelerator=self.accelerator,
                tokens=self.to / TOKENS,  # those of one backbone are the same in many runs
                progress=bar,
                say=self.say,
            )

    def _fitted(self, run: _Run) -> None:
        """A model that takes no step of training: its start, fitted to the photos where it must be."""
        recipe = run.preset.recipe
        learn, _ = recipe.split(self.places)
        model = build(run.preset.model, seed=recipe.seed)
        start_backbone(model, run.preset.start)
        if needs_fitting(model):
            photos = [photo for place in learn for photo in place.photos]
            fit(model, photos, seed=recipe.seed, passed_over=lambda error: self.say(str(error)))
        write_folder(model, run.folder / MODEL, dtype=torch.float16, overwrite=True)

    def _held_out(self, model: Describer, preset: Preset) -> dict[str, float]:
        _, choose = preset.recipe.split(self.places)
        if not choose:
            return {}
        with ImageCache(model.preprocessing) as shelf:
            return precision_held_out(model, choose, shelf)

    def _measured(self, name: str, model: Describer) -> dict[str, Any]:
        self.say(f"measuring on {name}")
        return self.measures[name].judge(model)

    def _measured_anew(self, run: _Run, found: Outcome) -> Outcome:
        """The outcome, with the sets that it was not measured on before.

        Raises:
            ModelError: a set of that name was measured by another protocol.
        """
        for name in self.measures.keys() & found.benchmarks.keys():
            was, now = found.benchmarks[name]["protocol"], self.measures[name].protocol
            if was != now:
                raise ModelError(
                    f"{run.folder} was measured on {name} by the protocol '{was}', not '{now}': "
                    "give the benchmark another name"
                )
        missing = [name for name in self.measures if name not in found.benchmarks]
        if missing:
            model = load(run.folder / MODEL, device=self.device)
            found = found.with_benchmarks({name: self._measured(name, model) for name in missing})
            write(found, run.folder)
        return found


def _no_progress(_: int, __: int | None) -> None:
    """Nobody watches."""


def _left(seconds: float, made: int, runs: int) -> str:
    minutes = seconds / made * (runs - made) / 60
    return f"{made} of {runs} runs made, about {minutes:.0f} minutes to go"
