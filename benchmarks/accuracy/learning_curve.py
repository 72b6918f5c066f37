"""What `salad train --preset small` learns, step by step, in how many minutes.

    python -m benchmarks.accuracy.learning_curve [--to runs/curve] [--data ...] [--eval ...] [-- OPTIONS OF salad train]

Runs the command itself, as anybody would, and takes a copy of its checkpoint whenever it writes one. When the
command has ended, the untrained head on the same backbone, every copy and the model that was kept are measured on
streets that no training photo shows. Time is the command's own, so nothing of the measuring is in it. The
evaluation photos choose nothing: the command keeps what is best on places held out of its own data.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import torch

from benchmarks.machine import machine
from benchmarks.options import EVAL, RUNS, TRAIN, benchmark_parser
from salad.datasets.benchmark import Benchmark, from_radius
from salad.evaluation.evaluate_benchmark import evaluate
from salad.models.describer import Describer
from salad.models.model_folder import load
from salad.network.network import Network, build
from salad.training.checkpoint import CHECKPOINT, CONFIG
from salad.training.recipe import Preset, preset
from salad.training.start import start_backbone

GOAL_POINTS, GOAL_MINUTES = 10.0, 15.0
RADIUS = 25  # metres, as the data's own README says


def trained(asked: argparse.Namespace, copies: Path) -> float:
    """Run the command and take copies of its checkpoints, each as soon as it stands there; seconds it took."""
    copies.mkdir(parents=True)
    command = [
        sys.executable,
        "-m",
        "salad",
        "train",
        "--preset",
        asked.preset,
        "--seed",
        str(asked.seed),
    ]
    command += ["--data", str(asked.data), "--to", str(asked.to), "--accelerator", "cpu", *asked.train]
    print("$ salad", *command[3:], file=sys.stderr)
    began, seen = time.monotonic(), 0
    with subprocess.Popen(command) as running:
        while running.poll() is None:
            seen = _copied(asked.to / CHECKPOINT, copies, seen)
            time.sleep(0.5)
        seconds = time.monotonic() - began
    if running.returncode:
        raise SystemExit(running.returncode)
    _copied(asked.to / CHECKPOINT, copies, seen)
    return seconds


def _copied(checkpoint: Path, copies: Path, seen: int) -> int:
    """Copy a checkpoint that is newer than the one seen last; it is replaced whole, so no copy is torn."""
    if not checkpoint.is_file():
        return seen
    written = checkpoint.stat().st_mtime_ns
    if written != seen:
        shutil.copy(checkpoint, copies / f"{written}.ckpt")
    return written


def untrained(made: Preset) -> Network:
    """The backbone the run starts from under the head it starts with."""
    model = build(made.model, seed=made.recipe.seed)
    start_backbone(model, made.start)
    return model


def recall(model: Describer, benchmark: Benchmark) -> tuple[float, float]:
    """R@1 and R@5 in percent."""
    found = evaluate(benchmark, model).recall
    return found[1], found[5]


def curve(asked: argparse.Namespace, benchmark: Benchmark) -> dict[str, Any]:
    """Train, measure, and give what is needed to draw the curve and to repeat it."""
    made = preset(asked.preset)
    made = replace(made, recipe=replace(made.recipe, seed=asked.seed))
    copies = asked.to / "checkpoints"
    seconds = trained(asked, copies)
    network = untrained(made)
    model = Describer.of(network)
    points = [{"step": 0, "minutes": 0.0, "recall": recall(model, benchmark), "what": "untrained head"}]
    for copy in sorted(copies.iterdir()):
        saved = torch.load(copy, map_location="cpu", weights_only=True)
        network.load_state_dict(saved["average"])
        minutes = round(saved["seconds"] / 60, 2)
        point = {"step": saved["step"], "minutes": minutes, "recall": recall(model, benchmark)}
        points.append({**point, "what": "running mean of the weights"})
    kept = recall(load(asked.to / "model"), benchmark)
    points.append({"step": None, "minutes": round(seconds / 60, 2), "recall": kept, "what": "the model kept"})
    return {
        "points": points,
        "config": json.loads((asked.to / CONFIG).read_text(encoding="utf-8")),
        "benchmark": benchmark.name,
        "protocol": benchmark.protocol,
        "queries": len(benchmark.queries),
        "machine": machine(),
        "date": datetime.now(UTC).date().isoformat(),
        "seed": asked.seed,
    }


def table(told: dict[str, Any]) -> str:
    """The curve as Markdown, and whether the goal was met."""
    first, last = told["points"][0], told["points"][-1]
    lines = ["| step | minutes | R@1 | R@5 | what |", "|---:|---:|---:|---:|---|"]
    for point in told["points"]:
        one, five = point["recall"]
        step = "" if point["step"] is None else point["step"]
        lines.append(f"| {step} | {point['minutes']:.1f} | {one:.1f} | {five:.1f} | {point['what']} |")
    gain = last["recall"][0] - first["recall"][0]
    met = "met" if gain >= GOAL_POINTS and last["minutes"] < GOAL_MINUTES else "missed"
    return "\n".join(
        [
            *lines,
            "",
            f"{told['benchmark']}, {told['protocol']}, {told['queries']} queries. {told['machine']}, "
            f"{told['date']}, seed {told['seed']}.",
            f"R@1 {gain:+.1f} points over the untrained head in {last['minutes']:.1f} minutes, the start of the "
            f"command included (goal {GOAL_POINTS:.0f} points in {GOAL_MINUTES:.0f} minutes): {met}.",
        ]
    )


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--preset", default="small")
    parser.add_argument("--data", type=Path, default=TRAIN / "sfxl-240")
    parser.add_argument("--eval", type=Path, default=EVAL / "sfxl-30")
    parser.add_argument("--to", type=Path, default=RUNS / "curve")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("train", nargs="*", help="further options of `salad train`, after --")
    asked = parser.parse_args()
    if asked.to.exists():
        raise SystemExit(f"{asked.to} is there already: choose another folder with --to, so that all is timed")
    sides = (asked.eval / "images" / "test" / side for side in ("database", "queries"))
    told = curve(asked, from_radius(*sides, RADIUS, name=asked.eval.name))
    (asked.to / "curve.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    print(table(told))


if __name__ == "__main__":
    main()
