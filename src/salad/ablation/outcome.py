"""What one run of a grid came to, with everything needed to repeat it, as JSON beside its model. Imports no torch.

`benchmarks` holds, by the name a set was given, what `salad evaluate --format json` says of it: so two outcomes, or
an outcome and an evaluation of any other model, can be laid side by side set by set.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import statistics
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from salad.datasets.training_place import TrainingPlace
from salad.errors import ModelError
from salad.files import write_whole
from salad.models.describer import Describer
from salad.network.model_size import parameters
from salad.training.checkpoint import LOG
from salad.training.recipe import Preset, in_full

FILE, FORMAT = "result.json", 1
IDENTITY = ("row", "seed", "preset", "start", "data")
"""What makes a run another run, where it differs."""
OF_A_ROW = ("seed", "head_steps", "tune_steps", "tuned_blocks", "size")
"""Settings of a recipe that may differ from run to run of one table; the sum of the steps may not."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One row of a grid, trained with one seed and measured.

    Args:
        row: the row's name.
        seed: of everything random.
        preset: model, start and recipe in full.
        start: the file the backbone started from: its name and its SHA-256.
        data: how many places and photos there were, by city, and a digest of their names.
        dim: numbers in a descriptor.
        parameters: how many there are, `all` and `trained`.
        milliseconds: to describe a photo that is read already, eight at a time.
        held_out: precision on the places held out, by city and in the `mean`.
        benchmarks: what the model reached, by set; as `salad evaluate --format json` says it.
        seconds: how long `training` took, interruptions left out, and `measuring`.
        fingerprint: of the model that was measured.
        versions: of salad, Python and the libraries that count.
        machine: what it ran on.
        finished: the date.
    """

    row: str
    seed: int
    preset: dict[str, Any]
    start: dict[str, str]
    data: dict[str, Any]
    dim: int
    parameters: dict[str, int]
    milliseconds: float
    held_out: dict[str, float]
    benchmarks: dict[str, dict[str, Any]]
    seconds: dict[str, float]
    fingerprint: str
    versions: dict[str, str]
    machine: dict[str, Any]
    finished: str

    def with_benchmarks(self, more: dict[str, dict[str, Any]]) -> Outcome:
        """The same, measured on more sets."""
        return replace(self, benchmarks=self.benchmarks | more)

    def recall(self, benchmark: str, k: int) -> float:
        """Recall at k on a set, in percent.

        Raises:
            KeyError: it was not measured there, or not at k.
        """
        return float(self.benchmarks[benchmark]["recall"][str(k)])


def folder_of(to: Path, row: str, seed: int) -> Path:
    """Where a run lives: its checkpoint, its model, its outcome."""
    return to / row / f"seed{seed}"


def write(outcome: Outcome, folder: Path) -> None:
    """Write an outcome whole or not at all."""
    text = json.dumps({"format": FORMAT, **asdict(outcome)}, ensure_ascii=False, indent=1)
    write_whole(folder / FILE, f"{text}\n".encode())


def read(folder: Path) -> Outcome | None:
    """The outcome in a run's folder; None where the run has not come to one.

    Raises:
        ModelError: the file is damaged, or of another version.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        version = told.pop("format")
        if version == FORMAT and set(told) == {field.name for field in fields(Outcome)}:
            return Outcome(**told)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ModelError(
            f"{path} cannot be read ({error!r}): remove its folder to have it run again"
        ) from error
    raise ModelError(
        f"{path} was written by another version of salad: remove its folder to have it run again"
    )


def read_all(to: Path, rows: tuple[str, ...]) -> dict[str, list[Outcome]]:
    """Every outcome there is of these rows, by row; seeds ascending.

    Raises:
        ModelError: one of them cannot be read.
    """
    found = {row: [read(folder) for folder in (to / row).glob("seed*")] for row in rows}
    return {
        row: sorted((one for one in outcomes if one is not None), key=lambda one: one.seed)
        for row, outcomes in found.items()
    }


def terms_of(outcome: Outcome) -> dict[str, Any]:
    """What must be the same in all runs of one table; no steps where the run took none."""
    model, recipe = outcome.preset["model"], in_full(outcome.preset["recipe"])
    told = {
        "photos": model["preprocessing"],
        "backbone": model["backbone"],
        "start": outcome.start,
        "data": outcome.data["digest"],
        "recipe": {name: value for name, value in recipe.items() if name not in OF_A_ROW},
    }
    steps = recipe["head_steps"] + recipe["tune_steps"]
    return told | ({"steps": steps} if steps else {})


def difference(one: dict[str, Any], other: dict[str, Any]) -> str | None:
    """Where two descriptions of a run first differ, as `recipe.head_steps: 50, not 75`; None where nowhere.

    Both are compared as JSON holds them, where a tuple and a list are one.
    """
    return _difference(json.loads(json.dumps(one)), json.loads(json.dumps(other)), "")


def _difference(one: Any, other: Any, at: str) -> str | None:
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted(one.keys() | other.keys()):
            found = _difference(one.get(key), other.get(key), f"{at}.{key}" if at else key)
            if found:
                return found
        return None
    return None if one == other else f"{at}: {one}, not {other}"


# --- What is told of a run beside what it recalls: how large, how fast, learnt from what, on which machine ---


def counted(model: Describer, preset: Preset) -> dict[str, int]:
    """All parameters, and those that were trained."""
    recipe = preset.recipe
    every = parameters(model)
    if not recipe.head_steps + recipe.tune_steps:
        return {"all": every, "trained": 0}
    model.backbone.train_last(recipe.tuned_blocks if recipe.tune_steps else 0)
    return {"all": every, "trained": parameters(model, trained_only=True)}


def milliseconds(model: Describer, *, photos: int = 8, rounds: int = 5) -> float:
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


def summary(places: Sequence[TrainingPlace]) -> dict[str, Any]:
    """How much there is to learn from, and a digest of the names, wherever on a machine the photos lie."""
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
        "threads": torch.get_num_threads(),
        "device": device,
    }


def seconds_of(folder: Path, measured: float) -> float:
    """How long a run took, interruptions left out, as its log says; where it keeps none, as was measured now."""
    with suppress(OSError, ValueError, KeyError, IndexError, TypeError):
        return float(json.loads((folder / LOG).read_text(encoding="utf-8").splitlines()[-1])["seconds"])
    return round(measured, 1)
