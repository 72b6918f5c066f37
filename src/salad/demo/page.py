"""The demo's page: one HTML file that needs nothing else, with the figures, the map and the match strips."""

from __future__ import annotations

from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from salad._version import __version__
from salad.demo.report import distance
from salad.demo.result import VERDICTS, WITHIN_M, DemoResult
from salad.demo.strips import Pictures, draw_strip
from salad.demo.townmap import draw_map
from salad.errors import BenchmarkError
from salad.files import write_whole

if TYPE_CHECKING:
    from salad.models.describer import Describes


def write_page(result: DemoResult, model: Describes | None = None) -> Path:
    """Write the page to `result.page`; an older one is replaced whole or not at all.

    Args:
        result: what to show.
        model: draws the dustbin and the clusters over the photos; without it, or without a dustbin, the page
            shows the photos alone.

    Raises:
        BenchmarkError: it cannot be written.
        PhotoError: a photo of the town cannot be read.
    """
    text = draw_page(result, model)
    try:
        write_whole(result.page, text.encode())
    except OSError as error:
        raise BenchmarkError(
            f"the page {result.page} cannot be written ({error}): choose another folder"
        ) from error
    return result.page


def draw_page(result: DemoResult, model: Describes | None = None) -> str:
    """The page as text."""
    pictures = Pictures(model)
    strips = "\n".join(draw_strip(number, one, pictures) for number, one in enumerate(result.judged, 1))
    layered = bool(pictures.shares)
    return Template(_asset("page.html")).substitute(
        css=_asset("page.css"),
        script=_asset("page.js"),
        view="dustbin" if layered else "photo",
        title=f"{result.count('right')} of {result.queries} photos placed within {WITHIN_M:.0f} m",
        headline=_headline(result),
        lede=_lede(result),
        figures=_figures(result),
        map=draw_map(result),
        filters=_filters(result),
        views=_views(pictures) if layered else "",
        strips=strips or "<p>No photos were asked about.</p>",
        colophon=_colophon(result),
    )


def _asset(name: str) -> str:
    return files("salad.demo").joinpath(name).read_text(encoding="utf-8")


def _headline(result: DemoResult) -> str:
    return (
        f"<b>{result.count('right')}</b> of {result.queries} photos "
        f'<span class="nowrap">placed within {WITHIN_M:.0f} metres</span>'
    )


def _lede(result: DemoResult) -> str:
    conditions = [escape(condition) for condition in result.conditions]
    listed = ", ".join(conditions[:-1]) + " and " * (len(conditions) > 1) + "".join(conditions[-1:])
    return (
        f"A town that does not exist, photographed {len(result.town.references)} times on one day’s drive. "
        f"Later, {result.queries} more photos from other visits: other light and weather ({listed}), another "
        f"lens, other cars, other viewpoints. Where was each of them taken? {escape(result.model)} answers "
        "from their pixels alone."
    )


def _figures(result: DemoResult) -> str:
    figures = (
        (f"{100 * result.right_share:.0f} %", f"right within {WITHIN_M:.0f} m, of all queries"),
        (distance(result.median_error_m), "median error of the answered"),
        (f"{result.count('wrong')} <i>/</i> {result.count('unknown')}", "wrong / left unknown"),
        (f"{result.photos_a_second:.0f}" if result.photos_a_second >= 10 else f"{result.photos_a_second:.1f}",
         "photos described a second"),
    )  # fmt: skip
    return "".join(f"<div><dt>{label}</dt><dd>{figure}</dd></div>" for figure, label in figures)


def _filters(result: DemoResult) -> str:
    """A button for each condition, with its answers as a bar, and one for each verdict."""
    everything = {"": result.queries} | result.conditions
    light = "".join(
        _button(
            "condition",
            condition,
            condition or "all",
            count,
            bar=_bar(result, condition or None),
            on=not condition,
        )
        for condition, count in everything.items()
    )
    verdicts = "".join(
        _button("verdict", verdict, verdict, result.count(verdict), bar="", on=False) for verdict in VERDICTS
    )
    return (
        f'<div class="chips" role="group" aria-label="Light and weather">{light}</div>'
        f'<div class="chips legend" role="group" aria-label="Answers">{verdicts}</div>'
    )


def _button(group: str, value: str, label: str, count: int, *, bar: str, on: bool) -> str:
    glyph = '<span class="glyph" aria-hidden="true"></span>' if group == "verdict" else ""
    kind = f" {value}" if group == "verdict" else ""
    return (
        f'<button type="button" class="chip{kind}" data-{group}="{escape(value)}" aria-pressed="{str(on).lower()}">'
        f"{glyph}<span>{escape(label)}</span> <small>{count}</small>{bar}</button>"
    )


def _bar(result: DemoResult, condition: str | None) -> str:
    parts = "".join(
        f'<i class="{verdict}" style="flex-grow:{count}"></i>'
        for verdict in VERDICTS
        if (count := result.count(verdict, condition=condition))
    )
    return f'<span class="bar" aria-hidden="true">{parts}</span>'


def _views(pictures: Pictures) -> str:
    share = sum(pictures.shares) / len(pictures.shares)
    options = "".join(
        f'<label><input type="radio" name="view" value="{value}"{" checked" * (value == "dustbin")}>'
        f"<span>{label}</span></label>"
        for value, label in (("photo", "Photo"), ("dustbin", "Dustbin"), ("clusters", "Clusters"))
    )
    return (
        f'<fieldset class="views"><legend>Over each photo</legend>{options}</fieldset>'
        '<p class="key only-dustbin">kept <span class="ramp" aria-hidden="true"></span> thrown away '
        f"<small>against the photo’s mean; the dustbin takes {100 * share:.0f} % in all</small></p>"
        '<p class="key only-clusters">one colour a cluster, the same in every photo '
        "<small>faint where the dustbin took more</small></p>"
    )


def _colophon(result: DemoResult) -> str:
    return (
        f"salad {__version__}, model {escape(result.model)} <code>{escape(result.fingerprint)}</code>, "
        f"town drawn from seed {result.seed}. {result.described} photos read, described and searched in "
        f"{result.seconds:.1f} s. This page is one file and fetches nothing."
    )
