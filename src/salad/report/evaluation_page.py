"""The page of an evaluation: every figure with its interval, curves, where it was right and wrong, the mistakes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from salad.errors import BenchmarkError
from salad.evaluation.result import QueryResult, Result
from salad.report.charts import charts
from salad.report.map import MAPS, Drive, RegionMap, position, regions
from salad.report.mistakes import MistakeStrips, counts, sections
from salad.report.page import render, several, write_page
from salad.report.strips import Thumbnails

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike

LISTED = 20  # leaks and groups that are named

Folders = tuple[Path | None, Path | None]
"""Where references and queries lie; None where nobody has said."""


def write_report(
    result: Result, page: Path, model: DescriberLike | None = None, *, folders: Folders | None = None
) -> tuple[str, ...]:
    """Write a result as a page; an older one is replaced whole or not at all.

    A result that was read from a file may be anybody's, and name any file of this machine. So photos are shown from
    below folders that the caller names, and from nowhere else.

    Args:
        result: What to show.
        page: The file.
        model: Draws what its dustbin took over the photos; without it, or without a dustbin, they stand alone.
        folders: Where photos lie now. Not given: where they lay when they were judged, for a result that was judged in
            this process; nowhere for one that was read from a file.

    Returns:
        Sentences about photos that are not shown.

    Raises:
        BenchmarkError: If the page cannot be written, or the result has no recall to show.
    """
    text, missing = draw_report(result, page, model, folders=folders)
    write_page(page, text)
    return missing


def draw_report(
    result: Result, page: Path, model: DescriberLike | None = None, *, folders: Folders | None = None
) -> tuple[str, tuple[str, ...]]:
    """What `write_report` writes, whose links to photos begin at `page`, and what it returns.

    Raises:
        BenchmarkError: If the result has no recall to show.
    """
    if not result.recall or not result.per_query:
        raise BenchmarkError(f"the result of {result.model} on {result.benchmark} has no recall to show: judge it anew")
    shown = sections(result)
    linked = {number for section in shown for number in section.numbers}

    # An evaluation may know the places of none, all, or some of its queries.
    places = {n: where for n, one in enumerate(result.per_query) if (where := position(one.where))}
    unplaced = [number for number in range(len(result.per_query)) if number not in places]
    found = regions(places)
    maps = [RegionMap.of(result, {n: places[n] for n in some}, linked) for some in found[:MAPS]]
    marked = {*unplaced, *(n for some in found[:MAPS] for n in some)}

    thumbnails = Thumbnails(model)
    if folders is None:
        references, queries = result.folders
        folders = (None, None) if result.from_file else (Path(references), Path(queries))
    strips = MistakeStrips(result, page, thumbnails, folders)
    mistakes = [(one, [strips.strip(n, marked=n in marked) for n in one.numbers]) for one in shown]
    # Only now: the strips have opened the photos.
    missing = (*not_shown(folders), *thumbnails.missing_note) if mistakes else ()
    text = render(
        "evaluation.html.j2",
        result=result,
        notes=notes(result, missing),
        groups=groups(result),
        listed=LISTED,
        tallies=counts(result.per_query),
        maps=maps,
        not_drawn=[len(some) for some in found[MAPS:]],
        unplaced=Drive.of(result, unplaced, linked) if unplaced else None,
        charts=charts(result),
        dustbin=thumbnails.dustbin,
        mistakes=mistakes,
    )
    return text, missing


def not_shown(folders: Folders) -> tuple[str, ...]:
    """What to say of the sides whose photos are not shown, if there are any."""
    sides = [side for side, folder in zip(("references", "queries"), folders, strict=True) if folder is None]
    if not sides:
        return ()
    return (
        f"The photos of the {' and '.join(sides)} are not shown, since a saved result may name any file: "
        f"say where they lie with {' and '.join(f'--{side}' for side in sides)}.",
    )


def notes(result: Result, missing: tuple[str, ...]) -> list[str]:
    """Sentences a reader of the figures should see, and the photos that are in both sides."""
    notes = [*result.notes, *missing]
    if result.leaks is not None:
        notes.append(f"{several(len(result.leaks), 'photo is', 'photos are')} in both sides.")
        notes += [
            f"{leak.query_path} is the same {leak.kind} as {leak.reference_path}." for leak in result.leaks[:LISTED]
        ]
        if len(result.leaks) > LISTED:
            notes.append(f"So are {len(result.leaks) - LISTED:,} more.")
    return notes


def groups(result: Result) -> list[tuple[str, int, float]]:
    """Each group with its queries and R@1 in percent, the worst first; nothing where fewer than two are known."""
    members: dict[str, list[QueryResult]] = {}
    for one in result.per_query:
        if one.group is not None and result.counts(one):
            members.setdefault(one.group, []).append(one)
    rows = [(name, len(those), 100 * sum(one.hit(1) for one in those) / len(those)) for name, those in members.items()]
    # Of groups equally bad the largest first: it weighs most in the figure above.
    return sorted(rows, key=lambda row: (row[2], -row[1], row[0])) if len(rows) > 1 else []
