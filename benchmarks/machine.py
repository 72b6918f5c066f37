"""The machine a figure was measured on: what it is, and time and memory as all benchmarks take them."""

from __future__ import annotations

import datetime
import multiprocessing
import os
import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

Result = TypeVar("Result")


def machine() -> str:
    """Its processor, cores, system and Python, as in `AMD EPYC, 2 cores, Linux x86_64, Python 3.11.7`."""
    listed = Path("/proc/cpuinfo")  # elsewhere than on Linux, Python may know the name
    lines = listed.read_text().splitlines() if listed.is_file() else []
    name = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    system = f"{platform.system()} {platform.machine()}"
    named = f"{name or platform.processor() or 'unknown processor'}, {os.cpu_count()} cores"
    return f"{named}, {system}, Python {platform.python_version()}"


def conditions(*packages: str, seed: int | None = None, **settings: Any) -> dict[str, Any]:
    """What somebody needs who repeats a figure: the machine, versions, the date, the seed and the settings.

    Args:
        packages: Those whose version bears on the figure; one that is not installed is "none".
        seed: Of what is drawn at random; None where nothing is.
        settings: What else was chosen.
    """
    return {
        "machine": machine(),
        **{package: installed(package) or "none" for package in packages},
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        **({} if seed is None else {"seed": seed}),
        **settings,
    }


def in_a_line(conditions: Mapping[str, Any]) -> str:
    """The same for people."""
    machine, *others = conditions.items()
    return ", ".join([str(machine[1]), *(f"{name} {value}" for name, value in others)])


def installed(package: str) -> str | None:
    """The version of a package that is installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def turns(
    ways: Mapping[str, Callable[[int], object]],
    *,
    rounds: int,
    clock: Callable[[], float] = time.perf_counter,
    settle: float = 0.0,
) -> dict[str, list[float]]:
    """Seconds that each way took in each round.

    The ways take turns, so that whatever else the machine does falls on all of them; compare them within one call
    only. A round before the first warms up and is not counted.

    Args:
        ways: What to time; called with the round's number, by which it may ask something else each time.
        rounds: How often.
        clock: Seconds; `time.process_time` where a busy machine would stretch the wall clock's.
        settle: Seconds to wait before each, in which threads of the one before that still spin come to rest.
    """
    taken: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(rounds + 1):
        for name, way in ways.items():
            time.sleep(settle)
            begun = clock()
            way(turn)
            if turn:
                taken[name].append(clock() - begun)
    return taken


def medians(taken: Mapping[str, list[float]]) -> dict[str, float]:
    """The median of each way's rounds, in milliseconds."""
    return {name: 1000 * statistics.median(seconds) for name, seconds in taken.items()}


def peak_memory() -> float:
    """The most memory that this process has held so far, in bytes."""
    status = Path("/proc/self/status")
    if status.is_file():  # ru_maxrss is handed on to a child there: it would remember its parent's
        lines = status.read_text().splitlines()
        return 1024.0 * int(next(line.split()[1] for line in lines if line.startswith("VmHWM")))
    unit = 1 if sys.platform == "darwin" else 1024
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit)


def in_fresh_process(run: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function in a new process: a peak of memory never falls, and some libraries set threads once for all."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(run, arguments)
