"""The demo: a town is drawn, indexed, and later photos of it are located; a table and a page show how well.

draw ──> index ──> locate ──> judge ──> page
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from salad.demo.demo_page import draw_demo_page
from salad.demo.demo_result import DemoResult, Judged
from salad.demo.town.town import Town, draw_town
from salad.errors import StoreError
from salad.index.build import index_photos
from salad.index.index import Index
from salad.localize.locate import Answer, locate_many
from salad.report.page import write_page

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike


MODEL = "salad-lite"  # it comes with the package: no download

Say = Callable[[str], None]
Progress = Callable[[int, int], None]


def run_demo(
    to: str | Path,
    *,
    seed: int = 7,
    references: int = 240,
    queries: int = 40,
    model: DescriberLike | None = None,
    say: Say = lambda _: None,
    progress: Progress | None = None,
) -> DemoResult:
    """Draw a town, index it, locate later photos of it, and write a page about it.

    Makes `town/` (kept and used again when it is complete), `town.index/` (made anew) and `town.html` in `to`.

    Args:
        to: The folder; made where it does not exist.
        seed: Decides the town.
        references: Photos of the drive by day.
        queries: Later photos, under other conditions.
        model: What describes photos; `salad-lite` where not given.
        say: Called with a sentence before each step.
        progress: Called with (done, of how many) within a step.

    Raises:
        BenchmarkError: If the town or the page cannot be written.
        StoreError: If the index cannot be written.
        WeightsError: If the model's weights are missing.
    """
    home = Path(to)
    if model is None:
        from salad.models.model_folder import load  # late: what is given needs no weights

        model = load(MODEL)
    say(f"Drawing a town: {references} photos by day, {queries} on later visits")
    town = draw_town(home / "town", seed=seed, references=references, queries=queries, progress=progress)
    say(f"Describing and indexing {references} photos with {model.name}")
    start = time.perf_counter()  # only now: drawing the town is no part of what the model takes
    # The index that a demo before left is made anew; a folder that is no index of ours stops `create` instead.
    folder = home / "town.index"
    with suppress(StoreError):
        Index.open(folder).close()
        shutil.rmtree(folder, ignore_errors=True)
    with Index.create(folder, dim=model.dim, fingerprint=model.fingerprint, model=model.name) as index:
        index_photos(town.references, index, model, progress=progress)
        say(f"Locating {queries} photos")
        answers = list(locate_many(town.queries, index=index, model=model))
    result = DemoResult(
        town=town,
        judged=judge(answers, town),
        model=model.name,
        fingerprint=model.fingerprint,
        described=len(town.references) + len(answers),
        seconds=time.perf_counter() - start,
        seed=seed,
        page=home / "town.html",
        index=folder,
    )
    say("Drawing the page")
    write_page(result.page, draw_demo_page(result, model))
    return result


def judge(answers: list[Answer], town: Town) -> tuple[Judged, ...]:
    """Put every answer beside the truth."""
    return tuple(
        Judged(answer, town.truth[answer.query.name], town.conditions[answer.query.name]) for answer in answers
    )
