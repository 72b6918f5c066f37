"""Train every row of a grid with several seeds on equal terms, and measure each.

A run lives in `TO/<row>/seed<number>/`: its checkpoint while it lasts, then its model and its result. A run that
was interrupted goes on, one that has come to a result is never repeated; sets that are new to it are measured
with the model it left.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import statistics
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from salad.ablation.grid_setup import GridSetup, check_presets, row_preset, start_digest
from salad.ablation.grids import GridRow
from salad.ablation.run_result import RUN_IDENTITY, RunResult, first_difference, read_result, run_folder, write_result
from salad.datasets.training_place import TrainingPlace
from salad.errors import ModelError
from salad.files import parse_json
from salad.models.describer import Describer
from salad.models.model_folder import load, write_folder
from salad.network.model_size import parameters
from salad.network.network import Network, build
from salad.training.batches import ImageCache
from salad.training.checkpoint import CHECKPOINT, LOG, MODEL
from salad.training.devices import versions
from salad.training.logger import Say
from salad.training.recipe import Preset, with_defaults
from salad.training.start import start_backbone
from salad.training.trainer import TOKENS, Progress, train
from salad.training.validation import precision_held_out
from salad.training.vocabulary import fit, needs_fitting


class GridBenchmark(NamedTuple):
    """A set that the models of a grid are measured on.

    Args:
        protocol: the rule that says what is right there.
        evaluate: what a model reaches, as `salad evaluate --format json` says it.
    """

    protocol: str
    evaluate: Callable[[Describer], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class _GridRun:
    """One row with one seed."""

    row: GridRow
    preset: Preset
    folder: Path
    identity: dict[str, Any]

    def __str__(self) -> str:
        return f"{self.row.name}, seed {self.preset.recipe.seed}"


@dataclass(frozen=True)
class GridRunner:
    """What is trained on, where to, and how it is measured.

    Args:
        places: what to learn from; each recipe's fraction of them is held out.
        to: the folder of all runs.
        setup: what the rows have in common.
        benchmarks: by the name of a set.
        accelerator: Fabric's word for where to train.
        device: where to measure, as torch names it.
        say: takes a line whenever there is something to tell.
        progress_bar: opens a bar, by what is being done.
        train_model: what trains.
    """

    places: Sequence[TrainingPlace]
    to: Path
    setup: GridSetup
    benchmarks: Mapping[str, GridBenchmark]
    accelerator: str = "auto"
    device: str = "cpu"
    say: Say = print
    progress_bar: Callable[[str], AbstractContextManager[Progress]] = lambda _: nullcontext(lambda *_: None)
    train_model: Callable[..., Path] = train

    def run(self, rows: Sequence[GridRow], *, seeds: Sequence[int]) -> dict[str, list[RunResult]]:
        """Bring every row with every seed to its result; seed by seed, so that a part of it is a comparison too.

        Returns:
            The results of each row, in the order of the seeds.

        Raises:
            ModelError: If a row cannot be built, or a folder holds the run of something else.
        """
        start, data = start_digest(self.setup.start), data_summary(self.places)
        runs = [self._planned(row, seed, start, data) for seed in seeds for row in rows]
        left = [run for run in runs if self._found(run) is None]
        # A row that cannot be built would otherwise be met after hours, when its turn comes.
        check_presets([run.preset for run in left])
        results: dict[str, list[RunResult]] = {row.name: [] for row in rows}
        began, made = time.monotonic(), 0
        for run in runs:
            result = self._found(run)
            if result is None:
                self.say(f"{run}: {made + 1} of {len(left)} runs")
                result, made = self._made(run), made + 1
                minutes = (time.monotonic() - began) / made * (len(left) - made) / 60
                self.say(f"{made} of {len(left)} runs made, about {minutes:.0f} minutes to go")
            results[run.row.name].append(self._measured_on_new_sets(run, result))
        return results

    def _planned(self, row: GridRow, seed: int, start: dict[str, str], data: dict[str, Any]) -> _GridRun:
        preset = row_preset(self.setup, row, seed=seed)
        in_words = {
            "model": preset.model.as_dict(),
            "start": start["name"],  # not its folder, which differs from machine to machine
            "recipe": asdict(preset.recipe),
        }
        identity = dict(zip(RUN_IDENTITY, (row.name, seed, in_words, start, data), strict=True))
        identity = json.loads(json.dumps(identity))  # a result read back has lists where this has tuples
        return _GridRun(row, preset, run_folder(self.to, row.name, seed), identity)

    def _found(self, run: _GridRun) -> RunResult | None:
        """The result that is there already.

        Raises:
            ModelError: If it is of another run.
        """
        found = read_result(run.folder)
        if found is not None:
            theirs = {key: getattr(found, key) for key in RUN_IDENTITY}
            # An older version wrote no settings that it did not know, and had them at their defaults.
            theirs["preset"] = {**found.preset, "recipe": with_defaults(found.preset["recipe"])}
            differing = first_difference(theirs, run.identity)
            if differing:
                raise ModelError(
                    f"{run.folder} holds the outcome of another run ({differing}): choose another folder with --to"
                )
        return found

    def _made(self, run: _GridRun) -> RunResult:
        """Train the run's model, or fit it, and measure it."""
        began, recipe = time.monotonic(), run.preset.recipe
        if recipe.head_steps + recipe.tune_steps:
            with self.progress_bar(str(run)) as bar:
                self.train_model(
                    run.preset,
                    self.places,
                    to=run.folder,
                    accelerator=self.accelerator,
                    tokens=self.to / TOKENS,  # those of one backbone are the same in many runs
                    progress=bar,
                    say=self.say,
                )
        else:
            self._fit(run)
        trained = time.monotonic()
        # From disk, as whoever uses it has it: in half precision, and with nothing left of the training.
        model = load(run.folder / MODEL, device=self.device)
        result = RunResult(
            **run.identity,
            dim=model.dim,
            parameters=count_parameters(model.network, run.preset),
            milliseconds=milliseconds_a_photo(model),
            held_out=self._precision_held_out(model, run.preset),
            benchmarks={name: self._evaluated(name, model) for name in self.benchmarks},
            seconds={
                "training": _logged_seconds(run.folder, otherwise=trained - began),
                "measuring": round(time.monotonic() - trained, 1),
            },
            fingerprint=model.fingerprint,
            versions={"python": platform.python_version(), **versions()},
            machine=machine(self.device),
            finished=datetime.now(UTC).date().isoformat(),
        )
        write_result(result, run.folder)
        with suppress(OSError):
            (run.folder / CHECKPOINT).unlink(missing_ok=True)  # many times the model's size, and done with
        return result

    def _fit(self, run: _GridRun) -> None:
        """Write a model that takes no step of training: its start, fitted to the photos where it must be."""
        recipe = run.preset.recipe
        learn_from, _ = recipe.split(self.places)
        model = build(run.preset.model, seed=recipe.seed)
        start_backbone(model, run.preset.start)
        if needs_fitting(model):
            photos = [photo for place in learn_from for photo in place.photos]
            fit(model, photos, seed=recipe.seed, passed_over=lambda error: self.say(str(error)))
        write_folder(model, run.folder / MODEL, dtype="float16", overwrite=True)

    def _precision_held_out(self, model: Describer, preset: Preset) -> dict[str, float]:
        _, choose_by = preset.recipe.split(self.places)
        if not choose_by:
            return {}
        with ImageCache(model.preprocessing) as images:
            return precision_held_out(model, choose_by, images)

    def _evaluated(self, name: str, model: Describer) -> dict[str, Any]:
        self.say(f"measuring on {name}")
        return self.benchmarks[name].evaluate(model)

    def _measured_on_new_sets(self, run: _GridRun, result: RunResult) -> RunResult:
        """The result, with the sets that it was not measured on before.

        Raises:
            ModelError: If a set of that name was measured by another protocol.
        """
        for name in self.benchmarks.keys() & result.benchmarks.keys():
            was, now = result.benchmarks[name]["protocol"], self.benchmarks[name].protocol
            if was != now:
                raise ModelError(
                    f"{run.folder} was measured on {name} by the protocol '{was}', not '{now}': "
                    "give the benchmark another name"
                )
        new = [name for name in self.benchmarks if name not in result.benchmarks]
        if new:
            model = load(run.folder / MODEL, device=self.device)
            measured = {name: self._evaluated(name, model) for name in new}
            result = replace(result, benchmarks=result.benchmarks | measured)
            write_result(result, run.folder)
        return result


# What a result says of a run besides what it recalls: how large, how fast, learnt from what, on which machine.


def count_parameters(model: Network, preset: Preset) -> dict[str, int]:
    """All parameters, and those that were trained."""
    recipe, every = preset.recipe, parameters(model)
    if not recipe.head_steps + recipe.tune_steps:
        return {"all": every, "trained": 0}
    model.backbone.train_last(recipe.tuned_blocks if recipe.tune_steps else 0)
    return {"all": every, "trained": parameters(model, trained_only=True)}


def milliseconds_a_photo(model: Describer, *, photos: int = 8, rounds: int = 5) -> float:
    """Milliseconds to describe a photo that is read and squeezed already, several at a time; the median round."""
    size, chance = model.preprocessing, np.random.default_rng(0)
    noise = list(chance.integers(0, 256, (photos, size.height, size.width, 3), dtype=np.uint8))
    model.describe(noise, batch_size=photos)  # the first call prepares what the others find ready
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        model.describe(noise, batch_size=photos)
        times.append(time.perf_counter() - began)
    return round(1000 * statistics.median(times) / photos, 2)


def data_summary(places: Sequence[TrainingPlace]) -> dict[str, Any]:
    """How much there is to learn from, and a digest of the names, wherever on a machine the photos lie."""
    # Sorted, and by names without folders: the same data on another machine are the same data.
    names = sorted((place.city, place.name, [photo.name for photo in place.photos]) for place in places)
    return {
        "places": len(places),
        "photos": sum(len(place.photos) for place in places),
        "cities": dict(sorted(Counter(place.city for place in places).items())),
        "digest": hashlib.sha256(json.dumps(names).encode()).hexdigest()[:16],
    }


def machine(device: str) -> dict[str, Any]:
    """What bears on how fast it was, and on the last bits."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),  # sums over more threads round differently
        "device": device,
    }


def _logged_seconds(folder: Path, *, otherwise: float) -> float:
    """How long a run took, interruptions left out, as its log says; a model that was only fitted keeps none."""
    with suppress(OSError, ValueError, KeyError, IndexError, TypeError):
        return float(parse_json((folder / LOG).read_text(encoding="utf-8").splitlines()[-1])["seconds"])
    return round(otherwise, 1)
