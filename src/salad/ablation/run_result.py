"""What one run of a grid came to, with everything needed to repeat it, as JSON beside its model. Imports no torch.

`benchmarks` holds, by the name a set was given, what `salad evaluate --format json` says of it: so two results, or
a result and an evaluation of any other model, can be laid side by side set by set.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from salad.errors import ModelError, reason
from salad.files import read_json, write_whole
from salad.training.recipe import with_defaults

RESULT_FILE = "result.json"
FORMAT = 1  # goes up where a reader of before would misread it
RUN_IDENTITY = ("row", "seed", "preset", "start", "data")
"""What makes a run another run, where it differs."""
SETTINGS_OF_A_ROW = ("seed", "head_steps", "tune_steps", "tuned_blocks", "size")
"""Settings of a recipe that may differ from run to run of one table; the sum of the steps may not."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """One row of a grid, trained with one seed and measured.

    The fields are the keys of `result.json`, so their names stay.

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


def run_folder(to: Path, row: str, seed: int) -> Path:
    """Where a run lives: its checkpoint, its model, its result."""
    return to / row / f"seed{seed}"


def write_result(result: RunResult, folder: Path) -> None:
    """Write a result whole or not at all."""
    text = json.dumps({"format": FORMAT, **asdict(result)}, ensure_ascii=False, indent=1)
    write_whole(folder / RESULT_FILE, f"{text}\n".encode())


def read_result(folder: Path) -> RunResult | None:
    """The result in a run's folder; None where the run has not come to one.

    Raises:
        ModelError: If the file is damaged, or of another version.
    """
    path = folder / RESULT_FILE
    if not path.is_file():
        return None
    try:
        stored = read_json(path)
        version = stored.pop("format")
        # Fields are not passed over nor made up: a table of half-known runs would say what nobody measured.
        if version == FORMAT and set(stored) == {field.name for field in fields(RunResult)}:
            return RunResult(**stored)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ModelError(f"{path} cannot be read ({reason(error)}): remove its folder to have it run again") from error
    raise ModelError(f"{path} was written by another version of salad: remove its folder to have it run again")


def read_results(to: Path, rows: Sequence[str]) -> dict[str, list[RunResult]]:
    """Every result there is of these rows, by row; seeds ascending.

    Raises:
        ModelError: If one of them cannot be read.
    """
    # What is there counts, not what was asked for: a table may be made while seeds are still being trained.
    found = {row: filter(None, map(read_result, (to / row).glob("seed*"))) for row in rows}
    # by number: as names, seed10 would stand before seed2
    return {row: sorted(results, key=lambda each: each.seed) for row, results in found.items()}


def equal_terms(result: RunResult) -> dict[str, Any]:
    """What must be the same in all runs of one table; no steps where the run took none."""
    model, recipe = result.preset["model"], with_defaults(result.preset["recipe"])
    terms = {
        "photos": model["preprocessing"],
        "backbone": model["backbone"],
        "start": result.start,
        "data": result.data["digest"],
        "recipe": {name: value for name, value in recipe.items() if name not in SETTINGS_OF_A_ROW},
    }
    # A head without weights spends the head's steps on the backbone: only their sum is the same.
    steps = recipe["head_steps"] + recipe["tune_steps"]
    return terms | ({"steps": steps} if steps else {})


def check_equal_terms(results: Mapping[str, Sequence[RunResult]]) -> None:
    """Make sure that all runs had the same start, photos, budget and data.

    Raises:
        ModelError: If two had not; the message says where they differ.
    """
    every = [(each, equal_terms(each)) for of_row in results.values() for each in of_row]
    # A run of no steps is compared with all others, but for the steps: so it must not be what they are held against.
    every.sort(key=lambda pair: "steps" not in pair[1])
    (first, wanted), *others = every
    for each, terms in others:
        known = wanted if "steps" in terms else {key: wanted[key] for key in terms}
        differing = first_difference(terms, known)
        if differing:
            this, that = (run_folder(Path(), run.row, run.seed) for run in (each, first))
            raise ModelError(
                f"{this} was not run on the terms of {that} ({differing}), and one table holds equal terms only: "
                "compare in another folder, or name the rows with --rows"
            )


def first_difference(mine: Mapping[str, Any], theirs: Mapping[str, Any]) -> str | None:
    """Where two descriptions of a run first differ, as `recipe.head_steps: 50, not 75`; None where nowhere.

    Both are compared as JSON holds them, where a tuple and a list are one.
    """
    return _first_difference(json.loads(json.dumps(mine)), json.loads(json.dumps(theirs)), "")


def _first_difference(mine: Any, theirs: Any, at: str) -> str | None:
    if isinstance(mine, dict) and isinstance(theirs, dict):
        for key in sorted(mine.keys() | theirs.keys()):
            differing = _first_difference(mine.get(key), theirs.get(key), f"{at}.{key}" if at else key)
            if differing:
                return differing
        return None
    return None if mine == theirs else f"{at}: {mine}, not {theirs}"
