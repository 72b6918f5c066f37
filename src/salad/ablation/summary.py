"""A grid's rows and what their runs came to, put together as lines of one table. Loads no torch."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from salad.errors import ModelError
from salad.files import write_whole

if TYPE_CHECKING:
    from salad.ablation.comparison import Column, Line
    from salad.ablation.grids import Row
    from salad.ablation.outcome import Outcome


Outcomes = Mapping[str, Sequence["Outcome"]]


def write_tables(to: Path, grid: str, rows: Sequence[Row]) -> str:
    """Write `TO/<grid>.md`, `.csv` and `.svg` from the outcomes there are.

    Returns:
        The Markdown.

    Raises:
        ModelError: there is no outcome, one cannot be read, or they were not made on equal terms.
    """
    from salad.ablation.chart import picture
    from salad.ablation.outcome import read_all
    from salad.ablation.tables import as_csv, markdown

    outcomes = read_all(to, tuple(row.name for row in rows))
    if not any(outcomes.values()):
        raise ModelError(
            f"{to} holds no outcome of a run of the grid {grid}: run it first, without --table-only"
        )
    check_terms(outcomes)
    everywhere, partly = measured_sets(outcomes)
    lines = lines_of(rows, outcomes, everywhere)
    table = markdown(lines, notes=[*told(outcomes), *partly])
    files = {"md": table + "\n", "csv": as_csv(lines), "svg": picture(lines, f"salad compare --grid {grid}")}
    for suffix, text in files.items():
        write_whole(to / f"{grid}.{suffix}", text.encode())
    return table


def measured_sets(outcomes: Outcomes) -> tuple[set[str], list[str]]:
    """The sets that every run was measured on, and a sentence for each of the others: they are left out."""
    every = [one for some in outcomes.values() for one in some]
    runs = Counter(name for one in every for name in one.benchmarks)
    partly = [
        f"{name} is left out: {count} of {len(every)} runs were measured on it."
        for name, count in runs.items()
        if count < len(every)
    ]
    return {name for name, count in runs.items() if count == len(every)}, partly


def lines_of(rows: Sequence[Row], outcomes: Outcomes, sets: Collection[str]) -> list[Line]:
    """One line for each row that came to an outcome, in the grid's order, with what it reached on these sets."""
    from salad.ablation.comparison import Line, Published

    return [
        Line(
            name=row.title,
            recalls=_recalls(outcomes[row.name], sets),
            published={one.protocol: Published(one.percent, one.aside) for one in row.paper},
            seeds=len(outcomes[row.name]),
            facts=_facts(outcomes[row.name]),
        )
        for row in rows
        if outcomes[row.name]
    ]


def _recalls(outcomes: Sequence[Outcome], sets: Collection[str]) -> dict[Column, dict[int, list[float]]]:
    from salad.ablation.comparison import Column

    found: dict[Column, dict[int, list[float]]] = {}
    for outcome in outcomes:
        for name, result in outcome.benchmarks.items():
            if name not in sets:
                continue
            by_k = found.setdefault(Column(name, result["protocol"]), {})
            for k, percent in result["recall"].items():
                by_k.setdefault(int(k), []).append(float(percent))
    return found


def _facts(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """What the table says of a model beside its recall; the median where machines and seeds differ."""
    last = outcomes[-1]
    facts: dict[str, float] = {
        "trained parameters": last.parameters["trained"],
        "dimension": last.dim,
        "ms a photo": statistics.median(one.milliseconds for one in outcomes),
    }
    held_out = [one.held_out["mean"] for one in outcomes if "mean" in one.held_out]
    return facts | ({"precision held out": statistics.fmean(held_out)} if held_out else {})


def check_terms(outcomes: Outcomes) -> None:
    """Make sure that all runs had the same start, photos, budget and data.

    Raises:
        ModelError: two had not; the message says where they differ.
    """
    from salad.ablation.outcome import difference, folder_of, terms_of

    every = [(one, terms_of(one)) for some in outcomes.values() for one in some]
    every.sort(key=lambda pair: "steps" not in pair[1])  # a run of no steps is compared with all others
    (first, wanted), *others = every
    for one, terms in others:
        known = wanted if "steps" in terms else {key: wanted[key] for key in terms}
        found = difference(terms, known)
        if found:
            one_at, first_at = (folder_of(Path(), run.row, run.seed) for run in (one, first))
            raise ModelError(
                f"{one_at} was not run on the terms of {first_at} ({found}), and one table holds equal terms only: "
                "compare in another folder, or name the rows with --rows"
            )


def told(outcomes: Outcomes) -> list[str]:
    """What a reader needs to repeat the figures, as sentences."""
    every = [one for some in outcomes.values() for one in some]
    first, recipe = every[0], max((one.preset["recipe"] for one in every), key=_steps)
    size = first.preset["model"]["preprocessing"]
    data, seeds = first.data, sorted({one.seed for one in every})
    dates = sorted({one.finished for one in every})
    return [
        f"Every row starts from {first.start['name']} (SHA-256 {first.start['sha256'][:12]}) and takes "
        f"{_steps(recipe)} steps of {recipe['places']} places x {recipe['views']} photos at "
        f"{size['height']} x {size['width']} pixels{_frozen(recipe)}, unless its name says otherwise; a row with "
        f"nothing to train takes none. Seeds: {', '.join(map(str, seeds))}.",
        f"Learnt from {data['places']} places, {data['photos']} photos ({_cities(data['cities'])}; digest "
        f"{data['digest']}), {recipe['held_out']:.0%} of the places held out; the weights of the best measurement on "
        "those are kept.",
        f"Made {dates[0]}{f' to {dates[-1]}' if len(dates) > 1 else ''} with "
        + "; ".join(_distinct(_versions(one) for one in every))
        + " on "
        + "; ".join(_distinct(_machine(one) for one in every))
        + ".",
    ]


def _steps(recipe: Mapping[str, int]) -> int:
    return recipe["head_steps"] + recipe["tune_steps"]


def _frozen(recipe: Mapping[str, int]) -> str:
    if recipe["tune_steps"] or not recipe["cache_versions"]:
        return ""
    return f", the backbone frozen and {recipe['cache_versions']} versions of each photo kept as tokens"


def _cities(cities: Mapping[str, int]) -> str:
    return ", ".join(f"{city} {places}" for city, places in cities.items())


def _versions(outcome: Outcome) -> str:
    return ", ".join(f"{name} {number}" for name, number in outcome.versions.items())


def _machine(outcome: Outcome) -> str:
    known = outcome.machine
    return f"{known['system']}, {known['cores']} cores, {known['threads']} threads, measured on {known['device']}"


def _distinct(sentences: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(sentences))
