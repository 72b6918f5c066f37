"""The report: one HTML file that needs nothing else, without a script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from salad.errors import BenchmarkError
from salad.evaluation.result import Result
from salad.files import write_whole
from salad.report import figures, plots
from salad.report.choosing import UNANSWERABLE, surest, worst
from salad.report.drive import draw_drive
from salad.report.pictures import Pictures
from salad.report.sheet import draw_maps, position
from salad.report.strips import draw_strip
from salad.report.words import ends, exact, several, shown

if TYPE_CHECKING:
    from salad.models.describer import Describes

MAP_KEY = (
    '<p class="small">Dashed: from a wrong query to where it was thought to be. Grey: references that were found. '
    "A mark with an edge leads to its photos.</p>"
)
DRIVE_KEY = (
    '<p class="small">A cell a query, in order: low where right, high where wrong, hollow where no '
    "reference is right. Some lead to their photos.</p>"
)


def write_report(result: Result, page: Path, model: Describes | None = None) -> tuple[str, ...]:
    """Write a result as a page; an older one is replaced whole or not at all.

    Args:
        result: what to show; its folders say where the photos are.
        page: the file.
        model: draws what its dustbin took over the photos; without it, or without a dustbin, they stand alone.

    Returns:
        Sentences about photos that could not be shown.

    Raises:
        BenchmarkError: it cannot be written, or the result has no recall to show.
    """
    text, told = draw_report(result, page, model)
    try:
        write_whole(page, text.encode("utf-8"))
    except OSError as error:
        raise BenchmarkError(
            f"{page} cannot be written ({error.strerror}): name a file in a folder that is there"
        ) from error
    return told


def draw_report(result: Result, page: Path, model: Describes | None = None) -> tuple[str, tuple[str, ...]]:
    """The page as text, and sentences about photos that could not be shown.

    Args:
        result: what to show.
        page: where it will stand, since its links to photos begin there.
        model: as for `write_report`.

    Raises:
        BenchmarkError: the result has no recall to show.
    """
    if not result.recall or not result.per_query:
        raise BenchmarkError(
            f"the result of {result.model} on {result.benchmark} has no recall to show: judge it anew"
        )
    pictures = Pictures(result, page, model)
    chosen = _chosen(result)
    where = _map(result, {number for numbers in chosen.values() for number in numbers})
    mistakes, curves = _mistakes(chosen, pictures, where), _plots(result)
    gone = _gone(pictures)
    flat = not any(position(one.where) for one in result.per_query)  # a drive leaves room for the curves
    text = Template(_asset("page.html")).substitute(
        css=_asset("page.css"),
        title=shown(f"{result.model} on {result.benchmark}, {result.protocol}"),
        headline=_headline(result),
        facts=figures.facts(result),
        notes=figures.notes(result, gone),
        table=figures.table(result),
        drawn=figures.drawn(result),
        groups=figures.groups(result),
        tallies=figures.tallies(result),
        map=where,
        beside=curves if flat else "",
        below="" if flat else curves,
        mistakes=mistakes,
        colophon=figures.colophon(result),
    )
    return text, gone


def _asset(name: str) -> str:
    return files("salad.report").joinpath(name).read_text(encoding="utf-8")


def _headline(result: Result) -> str:
    k = min(result.recall)
    sure = f" <small>{ends(result.intervals[k])}, 95 times in 100</small>" if k in result.intervals else ""
    return (
        f"<span>{shown(result.model)} on {shown(result.benchmark)}</span> "
        f'<span class="nowrap">R@{k} <b>{exact(result.recall[k], " %")}</b></span>{sure}'
    )


def _map(result: Result, linked: set[int]) -> str:
    """A map of the queries whose places are known, and a strip of the others."""
    places = {
        number: where
        for number, one in enumerate(result.per_query)
        if (where := position(one.where)) is not None
    }
    others = [number for number in range(len(result.per_query)) if number not in places]
    parts = []
    if places:
        parts += [draw_maps(result, places, linked), MAP_KEY]
    if places and others:
        parts.append(f"<p>{several(len(others), 'query has', 'queries have')} no position:</p>")
    if others:
        parts += [draw_drive(result, others, linked), DRIVE_KEY]
    return "\n".join(parts)


def _plots(result: Result) -> str:
    drawn = {
        "Recall": plots.recall_plot(result),
        "Precision over recall": plots.precision_recall_plot(result),
        "Metres": plots.metres_plot(result),
    }
    figures_ = (f'<figure class="card"><h2>{name}</h2>{one}</figure>' for name, one in drawn.items() if one)
    return f'<div class="plots">{"".join(figures_)}</div>'


def _chosen(result: Result) -> dict[tuple[str, str], list[int]]:
    """The queries whose photos are shown, by what stands above them."""
    sure = surest(result.per_query)
    farthest = "farthest from where the photo was taken"
    last = "whose right reference was found last, or not at all"
    return {
        ("Surest mistakes", "Wrong answers with the highest scores: a threshold takes these out last."): sure,
        ("Worst mistakes", f"Answers {last if result.distances is None else farthest}."): worst(
            result.per_query, besides=sure
        ),
        ("Believed without reason", "The highest scores of queries that no reference is right for."): surest(
            result.per_query, "unanswerable", most=UNANSWERABLE
        ),
    }


def _mistakes(chosen: Mapping[tuple[str, str], Sequence[int]], pictures: Pictures, where: str) -> str:
    """Strips of photos, and the switch of what lies over them, where anything does."""
    parts = []
    for (name, lede), numbers in chosen.items():
        strips = "".join(
            draw_strip(number, pictures, marked=f'id="map-{number + 1}"' in where) for number in numbers
        )
        if strips:
            above = f'<h2>{name}</h2><p class="lede">{lede}</p>'
            parts.append(f'<section>{above}<div class="strips">{strips}</div></section>')
    if not parts:
        return (
            '<section><h2>Mistakes</h2><p class="lede">None: every query was answered rightly.</p></section>'
        )
    return (_switch(pictures) if pictures.shares else "") + "".join(parts)


def _switch(pictures: Pictures) -> str:
    share = sum(pictures.shares) / len(pictures.shares)
    return (
        '<fieldset class="views"><legend>Over each photo</legend>'
        '<label><input type="radio" name="view" id="view-heat" checked><span>Dustbin</span></label>'
        '<label><input type="radio" name="view" id="view-photo"><span>Photo</span></label></fieldset>'
        '<p class="key">kept <span class="ramp" aria-hidden="true"></span> thrown away, against '
        f"the photo’s mean; its dustbin takes {100 * share:.0f} % in all; point at a photo to see it bare</p>"
    )


def _gone(pictures: Pictures) -> tuple[str, ...]:
    if not pictures.gone:
        return ()
    number, all_ = len(pictures.gone), len(pictures.gone) + pictures.opened
    return (
        f"{number} of {several(all_, 'photo')} to show cannot be opened where the result says, the first "
        f"{pictures.gone[0]}: they were moved, or lie on another machine.",
    )
