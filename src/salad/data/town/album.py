"""Draws many photos of a town, on several cores, and writes them with what a camera would know."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

from salad.data.town.camera import Shot
from salad.data.town.plan import Plan, plan_town
from salad.data.town.scene import Studio
from salad.data.town.visits import position_of, time_of
from salad.pixels import save_jpeg

QUALITY = 88
RUN = 8
"""Photos a worker takes at a time."""


def draw_all(
    plan: Plan,
    shots: list[Shot],
    folder: Path,
    *,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Draw every shot into ``references/`` and ``queries/`` of a folder, the same for any `workers`."""
    numbered = list(enumerate(shots))
    runs = [numbered[start : start + RUN] for start in range(0, len(numbered), RUN)]
    workers = min(workers or os.cpu_count() or 1, len(runs))
    done = 0
    try:
        for count in _in_parallel(plan, runs, folder, workers) if workers > 1 else ():
            done += count
            _tell(progress, done, len(shots))
    except (OSError, BrokenProcessPool):
        # Some places do not let a process start others; what is drawn by then is drawn again, the same.
        done = 0
    if done < len(shots):
        studio = Studio(plan)
        for number, shot in numbered:
            _draw_one(studio, shot, number, folder)
            _tell(progress, number + 1, len(shots))


def _in_parallel(plan: Plan, runs: list[list[tuple[int, Shot]]], folder: Path, workers: int) -> Iterator[int]:
    # Spawned, not forked: whoever calls may hold threads, torch's for one.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(_draw_run, plan.seed, plan.viewpoints, run, folder) for run in runs]
        try:
            for job in jobs:
                yield job.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@lru_cache(maxsize=1)
def _studio(seed: int, viewpoints: int) -> Studio:
    """A worker's own studio, kept from run to run because its painted walls are dear."""
    return Studio(plan_town(seed, viewpoints))


def _draw_run(seed: int, viewpoints: int, run: list[tuple[int, Shot]], folder: Path) -> int:
    for number, shot in run:
        _draw_one(_studio(seed, viewpoints), shot, number, folder)
    return len(run)


def _draw_one(studio: Studio, shot: Shot, number: int, folder: Path) -> None:
    """Queries carry no position: finding it is their point."""
    query = shot.visit > 0
    save_jpeg(
        studio.draw(shot),
        folder / ("queries" if query else "references") / shot.name,
        where=None if query else position_of(shot),
        heading=shot.camera.heading,
        time=time_of(shot, number),
        quality=QUALITY,
    )


def _tell(progress: Callable[[int, int], None] | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done, total)
