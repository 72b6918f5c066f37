"""Results of runs that nobody ran, for tests of what is made of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from salad.ablation.run_result import RunResult, run_folder, write_result

RECIPE = {
    "seed": 0,
    "head_steps": 1,
    "tune_steps": 3,
    "tuned_blocks": 4,
    "size": None,
    "places": 16,
    "views": 4,
    "held_out": 0.2,
}
PRESET = {
    "model": {"backbone": {"kind": "lite0"}, "preprocessing": {"height": 32, "width": 32}},
    "recipe": RECIPE,
}


def a_result(row: str, seed: int, percent: float, **change: Any) -> RunResult:
    recipe = RECIPE | {"seed": seed} | change.pop("recipe", {})
    made = RunResult(
        row=row,
        seed=seed,
        preset=PRESET | {"recipe": recipe},
        start={"name": "a.pth", "sha256": "f" * 64},
        data={"places": 20, "photos": 80, "cities": {"set": 20}, "digest": "d"},
        dim=544,
        parameters={"all": 20, "trained": 10},
        milliseconds=2.0 + seed,
        held_out={"set": 60.0 + seed, "mean": 60.0 + seed},
        benchmarks={"town": {"protocol": "frames ±0", "recall": {"1": percent, "5": 100.0}}},
        seconds={"training": 1.0, "measuring": 1.0},
        fingerprint="0",
        versions={"salad": "1", "torch": "2"},
        machine={"system": "Any", "cores": 2, "threads": 1, "device": "cpu"},
        finished="2026-01-02",
    )
    return replace(made, **change)


def put(to: Path, *results: RunResult) -> None:
    for one in results:
        folder = run_folder(to, one.row, one.seed)
        folder.mkdir(parents=True)
        write_result(one, folder)
