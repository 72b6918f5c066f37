"""A comparison in writing: Markdown for people, CSV for programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from salad.ablation.comparison import (
    Column,
    Line,
    Published,
    Reversed,
    Spread,
    against,
    columns,
    leader,
    protocols,
)
from salad.tables import csv_line

NOTHING = "–"
OURS, THEIRS = "ours", "paper"
FIELDS = ("source", "model", "set", "protocol", "k", "percent", "deviation", "seeds", "aside")


def markdown(lines: Sequence[Line], *, notes: Sequence[str] = ()) -> str:
    """A table of R@1 with the published figures beside ours, and under it where the order is another.

    Args:
        lines: the models, in the order they are to stand in.
        notes: sentences for under the table, before those about the order.
    """
    if not lines:
        return "There is no result yet."
    facts = _facts(lines)
    sets, published = columns(lines), protocols(lines)
    heads = ["", *map(str, sets), *(f"paper: {name}" for name in published), *facts, "seeds"]
    marks = {column: leader(lines, column) for column in sets}
    rows = [
        [
            _shown(line.name),
            *(_cell(line.at(column), bold=marks[column] is line) for column in sets),
            *(_theirs(line.published.get(name)) for name in published),
            *(_fact(line.facts.get(fact)) for fact in facts),
            str(line.seeds),
        ]
        for line in lines
    ]
    table = [_row(heads), "|---" + "|---:" * (len(heads) - 1) + "|", *map(_row, rows)]
    under = [*_notes(lines, sets), *notes]
    return "\n".join([*table, "", "\n".join(under), "", *order(lines)]).rstrip()


def order(lines: Sequence[Line]) -> list[str]:
    """A sentence a set: which pairs of lines stand the other way round than published, and how surely."""
    return [sentence for column in columns(lines) if (sentence := _order(lines, column))]


def as_csv(lines: Sequence[Line]) -> str:
    """One line a figure, ours and published, with what else is known of the model at its end."""
    facts = _facts(lines)
    told: list[list[Any]] = [[*FIELDS, *facts]]
    for line in lines:
        known = [_exact(line.facts.get(fact)) for fact in facts]
        for column, by_k in line.recalls.items():
            for k in by_k:
                found = line.at(column, k)
                if found:
                    told.append([*_ours(line, column, k, found), *known])
        for protocol, one in line.published.items():
            figure = [THEIRS, line.name, protocol, protocol, 1, one.percent, "", "", one.aside]
            told.append([*figure, *([""] * len(facts))])
    return "".join(map(csv_line, told))


def _ours(line: Line, column: Column, k: int, found: Spread) -> list[Any]:
    deviation = "" if found.deviation is None else f"{found.deviation:.3f}"
    where = [column.benchmark, column.protocol]
    return [OURS, line.name, *where, k, f"{found.mean:.3f}", deviation, found.times, ""]


def _facts(lines: Sequence[Line]) -> list[str]:
    return list(dict.fromkeys(fact for line in lines for fact in line.facts))


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _shown(name: str) -> str:
    return name.replace("|", "\\|")


def _cell(found: Spread | None, *, bold: bool) -> str:
    if found is None:
        return NOTHING
    text = f"{found.mean:.1f}" + ("" if found.deviation is None else f" ± {found.deviation:.1f}")
    return f"**{text}**" if bold else text


def _theirs(one: Published | None) -> str:
    if one is None:
        return NOTHING
    return f"{one.percent:.1f}" + ("\\*" if one.aside else "")


def _fact(value: float | None) -> str:
    if value is None:
        return NOTHING
    return f"{value:,.0f}" if float(value).is_integer() else f"{value:.1f}"


def _exact(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if float(value).is_integer() else f"{value:.3f}"


def _notes(lines: Sequence[Line], sets: Sequence[Column]) -> list[str]:
    seeds = {line.seeds for line in lines}
    notes = ["R@1 in percent; mean ± standard deviation over the seeds."]
    if max(seeds) < 2:
        notes = ["R@1 in percent, of one seed: how far another seed would be off is not known."]
    elif any(leader(lines, column) for column in sets):
        notes.append("Bold: leads every other row by more than the spread of their difference.")
    else:
        notes.append("No row leads every other by more than the spread of their difference, so none is bold.")
    if any(line.published for line in lines):
        notes.append(
            "The paper's figures are R@1 by the protocol named, on its own data and backbone: compare the order "
            "of rows, not figures."
        )
    asides = dict.fromkeys(one.aside for line in lines for one in line.published.values() if one.aside)
    notes.extend(f"\\* {aside}; left out of the order." for aside in asides)
    return notes


def _order(lines: Sequence[Line], column: Column) -> str:
    looked, pairs = against(lines, column)
    if not looked:
        return ""
    kept = looked - len(pairs)
    said = f"- {column}: of {looked} pairs that the paper puts in an order, {kept} stand in it here"
    sure = [_pair(pair) for pair in pairs if pair.certain]
    unsure = [_pair(pair) for pair in pairs if not pair.certain]
    if sure:
        said += f"; the other way round by more than the spread: {', '.join(sure)}"
    if unsure:
        said += f"; the other way round, but within the spread or with none known: {', '.join(unsure)}"
    return f"{said}."


def _pair(pair: Reversed) -> str:
    width = "" if pair.spread is None else f" ± {pair.spread:.1f}"
    return f"{pair.better} before {pair.worse} by {pair.by:.1f}{width}"
