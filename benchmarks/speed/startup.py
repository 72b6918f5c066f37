"""How long short commands take from nothing, beside those of another installation: `salad --help`, `info`, `locate`.

    python -m benchmarks.speed.startup [--against PYTHON] [--rounds 9] [--clock processor|wall]

PYTHON is the interpreter of an environment where another version is installed. Both take turns, each command in a
process of its own, and the best of the rounds is shown: whatever else the machine does only adds. The processor's
time counts all threads, the wall's is what people wait, and is worth something on a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.machine import conditions, in_a_line, turns
from benchmarks.options import ROOT, benchmark_parser
from salad.demo.town.town import draw_town

SEED, REFERENCES = 7, 60


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--against", type=Path, metavar="PYTHON", help="of the other environment")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--clock", choices=("processor", "wall"), default="processor")
    with tempfile.TemporaryDirectory() as folder:
        measure(parser.parse_args(), Path(folder))


def measure(asked: argparse.Namespace, folder: Path) -> None:
    """Time every command in both installations."""
    town = draw_town(folder / "town", seed=SEED, references=REFERENCES, queries=1)
    index = folder / "town.index"
    here, there = Path(sys.executable), asked.against
    salad(here, "index", *map(str, town.references), "--to", str(index))
    commands = {
        "--help": ["--help"],
        "info": ["info", str(index)],
        "locate, one photo": ["locate", str(town.queries[0]), "--index", str(index)],
    }
    ways: dict[str, Callable[[int], object]] = {}
    for name, arguments in commands.items():
        for python in (here, there) if there else (here,):
            ways[f"{name} {python is there}"] = partial(salad, python, *arguments)
    clock = children if asked.clock == "processor" else time.perf_counter
    taken = turns({way: lambda _, run=run: run() for way, run in ways.items()}, rounds=asked.rounds, clock=clock)
    print(in_a_line(conditions("onnxruntime", seed=SEED, rounds=asked.rounds, clock=asked.clock)))
    for name in commands:
        ours = min(taken[f"{name} False"])
        told = f"salad {name:<20} {1000 * ours:6.0f} ms"
        if there:
            theirs = min(taken[f"{name} True"])
            told += f", the other {1000 * theirs:6.0f} ms, ratio {ours / theirs:.2f}"
        print(told)


def salad(python: Path, *arguments: str) -> None:
    """Run a command of this checkout, or of another environment as it is installed there."""
    settings = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    if python == Path(sys.executable):
        settings["PYTHONPATH"] = str(ROOT / "src")
    subprocess.run([python, "-m", "salad", *arguments], env=settings, check=True, capture_output=True)


def children() -> float:
    """Seconds of a processor that processes started from here have used, as far as they have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
