"""A drawn town with true coordinates: photos for the demo, the docs and the tests, without a download.

    plan ──> scene ──> raster ──> light ──> photo
    streets   faces    what the    sun, sky,
    houses    near     rays meet   weather
              a camera

The town is invented and so is its place: open steppe, where no such town stands. References are one drive by
day; queries are later visits with other light, weather, cars, viewpoint and lens. `seed` decides everything.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from salad.demo.town.camera import Shot
from salad.demo.town.plan import TownPlan, plan_town
from salad.demo.town.scene import Studio
from salad.demo.town.visits import ORIGIN, position_of, take_queries, take_references, time_of
from salad.errors import BenchmarkError, reason
from salad.files import write_whole
from salad.geo import GeoPoint, shifted
from salad.images.exif import save_jpeg
from salad.tables import csv_line

Progress = Callable[[int, int], None]
QUALITY = 88
RUN = 8  # photos a worker takes at a time
VERSION = 2  # raised when the same seed draws other photos, so that older folders are drawn anew


@dataclass(frozen=True)
class Town:
    """A drawn town.

    Attributes:
        references: Photos with their position, heading and time as EXIF.
        queries: Photos with heading and time, but no position.
        truth: Where each query was taken, by file name.
        conditions: The light and weather of each query, by file name.
        streets: Middle lines.
        blocks: Footprints of the houses, four corners each.
    """

    references: tuple[Path, ...]
    queries: tuple[Path, ...]
    truth: dict[str, GeoPoint]
    conditions: dict[str, str]
    streets: tuple[tuple[GeoPoint, ...], ...]
    blocks: tuple[tuple[GeoPoint, ...], ...]


def draw_town(
    to: str | Path,
    *,
    seed: int = 7,
    references: int = 240,
    queries: int = 40,
    size: tuple[int, int] = (480, 360),
    workers: int | None = None,
    progress: Progress | None = None,
) -> Town:
    """Draw a town into a folder: ``references/``, ``queries/``, ``truth.csv`` and ``town.json``.

    A folder that already holds this very town is left as it is; one that was begun is drawn again. The photos
    do not depend on the number of workers.

    Args:
        to: The folder; made where it does not exist.
        seed: Decides everything; not negative.
        references: Photos of the drive by day, two from each place; the town is as large as they need.
        queries: Later photos, each within 10 m of a reference.
        size: Width and height of the photos in pixels.
        workers: Processes to draw with; by default one a core. Without leave to start any, draws without.
        progress: Called with how many photos are done and how many there are.

    Raises:
        BenchmarkError: If a number is out of range, or the folder holds something else.
    """
    folder = Path(to)
    if references < 1 or queries < 0 or min(size) < 16 or seed < 0:
        raise BenchmarkError(
            f"a town of {references} references and {queries} queries at {size[0]} x {size[1]} pixels "
            f"with seed {seed} cannot be drawn: ask for a reference, 16 pixels and seed 0 at least"
        )
    wanted = {
        "version": VERSION,
        "seed": seed,
        "references": references,
        "queries": queries,
        "size": list(size),
    }
    with suppress(BenchmarkError):  # no town, or not the whole of it
        town = read_town(folder)
        if _read_json(folder).items() >= wanted.items():
            return town
    plan = plan_town(seed, (references + 1) // 2)
    drive = take_references(plan, references, size)
    later = take_queries(plan, drive, queries)
    _clear(folder)
    draw_all(plan, drive + later, folder, workers=workers, progress=progress or (lambda *_: None))
    with (folder / "truth.csv").open("w", newline="", encoding="utf-8") as file:
        file.write(csv_line(["query", "lat", "lon", "heading", "condition"]))
        for shot in later:
            where = position_of(shot)
            at = [f"{where.lat:.8f}", f"{where.lon:.8f}", f"{shot.camera.heading:.2f}"]
            file.write(csv_line([shot.name, *at, shot.light]))
    # The description comes last: a folder with one holds a whole town.
    described = wanted | _described(plan, later)
    write_whole(folder / "town.json", json.dumps(described, indent=1).encode())
    return read_town(folder)


def read_town(folder: str | Path) -> Town:
    """Open a town that `draw_town` has finished.

    Raises:
        BenchmarkError: If there is none, or some of it is missing.
    """
    folder = Path(folder)
    described = _read_json(folder)
    truth = {name: GeoPoint(*entry["where"]) for name, entry in described["truth"].items()}
    photos = tuple(folder / "references" / f"ref_{n + 1:04d}.jpg" for n in range(described["references"]))
    asked = tuple(folder / "queries" / name for name in truth)
    missing = [path for path in photos + asked if not path.is_file()]
    if missing:
        raise BenchmarkError(f"the town in {folder} lacks {missing[0].name}: draw it again into an empty folder")
    # JSON has lists, a town holds tuples.
    lines, corners = (
        tuple(tuple(GeoPoint(*point) for point in shape) for shape in described[key]) for key in ("streets", "blocks")
    )
    conditions = {name: str(entry["condition"]) for name, entry in described["truth"].items()}
    return Town(photos, asked, truth, conditions, lines, corners)


def draw_all(
    plan: TownPlan,
    shots: list[Shot],
    folder: Path,
    *,
    workers: int | None,
    progress: Progress,
) -> None:
    """Draw every shot into ``references/`` and ``queries/`` of a folder, the same for any `workers`."""
    numbered = list(enumerate(shots))
    runs = [numbered[start : start + RUN] for start in range(0, len(numbered), RUN)]
    workers = min(workers or os.cpu_count() or 1, len(runs))
    done = 0
    if workers > 1:
        try:
            # Spawned, not forked: whoever calls may hold threads, torch's for one.
            with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
                jobs = [pool.submit(_draw_run, plan.seed, plan.viewpoints, run, folder) for run in runs]
                try:
                    for job in jobs:
                        done += job.result()
                        progress(done, len(shots))
                finally:
                    pool.shutdown(wait=True, cancel_futures=True)
        except (OSError, BrokenProcessPool):
            # Some places do not let a process start others; what is drawn by then is drawn again, the same.
            done = 0
    if done < len(shots):
        for number, shot in numbered:
            _draw_run(plan.seed, plan.viewpoints, [(number, shot)], folder)
            progress(number + 1, len(shots))
        Studio.of.cache_clear()  # its painted walls are large, and this process has other work to do


def _draw_run(seed: int, viewpoints: int, run: list[tuple[int, Shot]], folder: Path) -> int:
    """Draw some photos, here or in a worker, with what a camera would know; say how many."""
    for number, shot in run:
        query = shot.visit > 0
        save_jpeg(
            Studio.of(seed, viewpoints).draw(shot),
            folder / ("queries" if query else "references") / shot.name,
            where=None if query else position_of(shot),  # finding it is a query's point
            heading=shot.camera.heading,
            time=time_of(shot, number),
            quality=QUALITY,
        )
    return len(run)


def _clear(folder: Path) -> None:
    """Make room for a town; whatever else lies in the folder is not ours to delete."""
    ours = {"references", "queries", "truth.csv", "town.json"}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # The folder may be somebody's own: only what a town consists of is ever deleted.
        foreign = sorted(path.name for path in folder.iterdir() if path.name not in ours)
        if foreign:
            raise BenchmarkError(f"{folder} holds {foreign[0]}, which no town does: draw into an empty folder")
        # The description goes first, so that no stop on the way leaves a town that seems whole.
        (folder / "town.json").unlink(missing_ok=True)
        for part in ("references", "queries"):
            shutil.rmtree(folder / part, ignore_errors=True)
            (folder / part).mkdir()
    except OSError as error:
        raise BenchmarkError(f"no town can be drawn into {folder} ({reason(error)}): choose another folder") from error


def _described(plan: TownPlan, shots: list[Shot]) -> dict[str, Any]:
    """The town in words: streets, footprints, and the truth about each query."""
    truth = {
        shot.name: {
            "where": _pair(position_of(shot)),
            "heading": shot.camera.heading,
            "condition": shot.light,
        }
        for shot in shots
    }
    # A point every eight metres shows a street's bend.
    streets = [_on_earth(np.concatenate([street.line[:-1:8], street.line[-1:]])) for street in plan.streets]
    return {"truth": truth, "streets": streets, "blocks": [_on_earth(house.corners) for house in plan.houses]}


def _on_earth(points: NDArray[np.float64]) -> list[list[float]]:
    return [_pair(shifted(ORIGIN, float(north), float(east))) for east, north in points]


def _pair(point: GeoPoint) -> list[float]:
    return [round(point.lat, 8), round(point.lon, 8)]


def _read_json(folder: Path) -> dict[str, Any]:
    try:
        content = json.loads((folder / "town.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BenchmarkError(
            f"{folder} holds no finished town ({reason(error)}): draw one there with draw_town"
        ) from error
    if not isinstance(content, dict) or content.get("version") != VERSION:
        raise BenchmarkError(f"{folder}/town.json is not of version {VERSION}: draw the town again with draw_town")
    return content
