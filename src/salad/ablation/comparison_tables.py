"""The table of a grid from its runs' results: Markdown for people, CSV for programs, a picture. Imports no torch."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from salad.ablation.chart import comparison_chart
from salad.ablation.comparison import (
    BenchmarkColumn,
    ModelLine,
    benchmark_columns,
    leader,
    published_protocols,
    reversed_pairs,
)
from salad.ablation.grids import GridRow
from salad.ablation.run_result import RunResult, check_equal_terms, read_results
from salad.errors import ModelError
from salad.files import write_whole
from salad.tables import csv_line
from salad.training.recipe import with_defaults

Results = Mapping[str, Sequence[RunResult]]
EMPTY_CELL = "–"
# Programs read these, so they stay: `aside` is a figure's caveat.
CSV_FIELDS = ("source", "model", "set", "protocol", "k", "percent", "deviation", "seeds", "aside")


def write_tables(to: Path, grid: str, rows: Sequence[GridRow]) -> str:
    """Write `TO/<grid>.md`, `.csv` and `.svg` from the results there are.

    Returns:
        The Markdown.

    Raises:
        ModelError: If there is no result, one cannot be read, or they were not made on equal terms.
    """
    results = read_results(to, [row.name for row in rows])
    if not any(results.values()):
        raise ModelError(f"{to} holds no outcome of a run of the grid {grid}: run it first, without --table-only")
    check_equal_terms(results)
    runs = [each for of_row in results.values() for each in of_row]
    measured = Counter(name for run in runs for name in run.benchmarks)
    # A set that only some runs know would compare models of other seeds, or leave rows without a figure.
    left_out = [
        f"{name} is left out: {count} of {len(runs)} runs were measured on it."
        for name, count in measured.items()
        if count < len(runs)
    ]
    lines = model_lines(rows, results, {name for name, count in measured.items() if count == len(runs)})
    table = markdown_table(lines, notes=[*how_to_repeat(runs), *left_out])
    chart = comparison_chart(lines, f"salad compare --grid {grid}")
    for suffix, text in (("md", table + "\n"), ("csv", csv_table(lines)), ("svg", chart)):
        write_whole(to / f"{grid}.{suffix}", text.encode())
    return table


def model_lines(rows: Sequence[GridRow], results: Results, benchmarks: Collection[str]) -> list[ModelLine]:
    """One line for each row that has a result, in the grid's order, with what it reached on these benchmarks."""
    lines = []
    for row in rows:
        runs = results[row.name]
        if not runs:  # not trained yet
            continue
        # Whoever measures a set by another rule than before gets a column of its own: the two are not one figure.
        recalls: dict[BenchmarkColumn, dict[int, list[float]]] = {}
        for run in runs:
            for name, evaluation in run.benchmarks.items():
                if name in benchmarks:
                    by_k = recalls.setdefault(BenchmarkColumn(name, evaluation["protocol"]), {})
                    for k, percent in evaluation["recall"].items():
                        by_k.setdefault(int(k), []).append(float(percent))
        facts: dict[str, float] = {
            # The same for every seed.
            "trained parameters": runs[-1].parameters["trained"],
            "dimension": runs[-1].dim,
            # The median: a run that shared its machine with others is an outlier, not a slower model.
            "ms a photo": statistics.median(run.milliseconds for run in runs),
        }
        held_out = [run.held_out["mean"] for run in runs if "mean" in run.held_out]
        if held_out:
            facts["precision held out"] = statistics.fmean(held_out)
        published = {figure.protocol: figure for figure in row.paper}
        lines.append(ModelLine(row.title, recalls, published, len(runs), facts))
    return lines


def how_to_repeat(runs: Sequence[RunResult]) -> list[str]:
    """What a reader needs to repeat the figures, as sentences."""
    # Start, photos and data are those of any run: `check_equal_terms` has seen to it.
    first, data = runs[0], runs[0].data
    # A row with nothing to train took no step: the longest recipe is the one that the others were given.
    longest = max(runs, key=lambda run: run.preset["recipe"]["head_steps"] + run.preset["recipe"]["tune_steps"])
    recipe = with_defaults(longest.preset["recipe"])
    size = first.preset["model"]["preprocessing"]
    frozen = ""
    if recipe["cache_versions"] and not recipe["tune_steps"]:
        frozen = f", the backbone frozen and {recipe['cache_versions']} versions of each photo kept as tokens"
    seeds = sorted({run.seed for run in runs})
    dates = sorted({run.finished for run in runs})
    cities = ", ".join(f"{city} {places}" for city, places in data["cities"].items())
    versions = _distinct(", ".join(f"{name} {number}" for name, number in run.versions.items()) for run in runs)
    machines = _distinct(
        f"{run.machine['system']}, {run.machine['cores']} cores, {run.machine['threads']} threads, "
        f"measured on {run.machine['device']}"
        for run in runs
    )
    return [
        f"Every row starts from {first.start['name']} (SHA-256 {first.start['sha256'][:12]}) and takes "
        f"{recipe['head_steps'] + recipe['tune_steps']} steps of {recipe['places']} places x {recipe['views']} photos "
        f"at {size['height']} x {size['width']} pixels{frozen}, unless its name says otherwise; a row with "
        f"nothing to train takes none. Seeds: {', '.join(map(str, seeds))}.",
        f"Learnt from {data['places']} places, {data['photos']} photos ({cities}; digest {data['digest']}), "
        f"{recipe['held_out']:.0%} of the places held out; the weights of the best measurement on those are kept.",
        f"Made {dates[0]}{f' to {dates[-1]}' if len(dates) > 1 else ''} with {versions} on {machines}.",
    ]


def _distinct(sentences: Iterable[str]) -> str:
    return "; ".join(dict.fromkeys(sentences))


def markdown_table(lines: Sequence[ModelLine], *, notes: Sequence[str] = ()) -> str:
    """A table of R@1 with the published figures beside ours; under it the notes, and where the order is another."""
    if not lines:
        return "There is no result yet."
    columns, protocols, facts = benchmark_columns(lines), published_protocols(lines), _fact_titles(lines)
    leaders = {column: leader(lines, column) for column in columns}
    titles = ["", *map(str, columns), *(f"paper: {protocol}" for protocol in protocols), *facts, "seeds"]
    rows = [titles]
    for line in lines:
        cells = [line.name.replace("|", "\\|")]  # it would begin another cell
        for column in columns:
            found = line.recall(column)
            cells.append(EMPTY_CELL if found is None else f"**{found}**" if leaders[column] is line else str(found))
        for protocol in protocols:
            theirs = line.published.get(protocol)
            star = "\\*" if theirs and theirs.caveat else ""
            cells.append(f"{theirs.percent:.1f}{star}" if theirs else EMPTY_CELL)
        cells += [_number(line.facts.get(fact), ",.0f", ".1f") or EMPTY_CELL for fact in facts]
        rows.append([*cells, str(line.seeds)])
    head, *body = (f"| {' | '.join(row)} |" for row in rows)
    table = [head, f"|---{'|---:' * (len(titles) - 1)}|", *body]
    notes = [*_notes(lines, has_leader=any(leaders.values())), *notes]
    return "\n".join([*table, "", *notes, "", *order_sentences(lines)]).rstrip()


def _notes(lines: Sequence[ModelLine], *, has_leader: bool) -> list[str]:
    """How the table is to be read."""
    notes = ["R@1 in percent; mean ± standard deviation over the seeds."]
    if max(line.seeds for line in lines) < 2:
        notes = ["R@1 in percent, of one seed: how far another seed would be off is not known."]
    elif has_leader:
        notes.append("Bold: leads every other row by more than the spread of their difference.")
    else:
        notes.append("No row leads every other by more than the spread of their difference, so none is bold.")
    if any(line.published for line in lines):
        notes.append(
            "The paper's figures are R@1 by the protocol named, on its own data and backbone: compare the order "
            "of rows, not figures."
        )
    caveats = dict.fromkeys(each.caveat for line in lines for each in line.published.values() if each.caveat)
    return [*notes, *(f"\\* {caveat}; left out of the order." for caveat in caveats)]


def order_sentences(lines: Sequence[ModelLine]) -> list[str]:
    """A sentence a column: which pairs of lines stand the other way round than published, and how surely."""
    sentences = []
    for column in benchmark_columns(lines):
        compared, pairs = reversed_pairs(lines, column)
        if not compared:
            continue
        # How surely is told apart: within the spread of the seeds, another order may be chance.
        kept = compared - len(pairs)
        sentence = f"- {column}: of {compared} pairs that the paper puts in an order, {kept} stand in it here"
        certain = [str(pair) for pair in pairs if pair.certain]
        uncertain = [str(pair) for pair in pairs if not pair.certain]
        if certain:
            sentence += f"; the other way round by more than the spread: {', '.join(certain)}"
        if uncertain:
            sentence += f"; the other way round, but within the spread or with none known: {', '.join(uncertain)}"
        sentences.append(f"{sentence}.")
    return sentences


def csv_table(lines: Sequence[ModelLine]) -> str:
    """One line a figure, ours and published, with what else is known of the model at its end."""
    facts = _fact_titles(lines)
    table: list[list[Any]] = [[*CSV_FIELDS, *facts]]
    for line in lines:
        known = [_number(line.facts.get(fact), ".0f", ".3f") for fact in facts]
        for column, by_k in line.recalls.items():
            for k in by_k:  # all that were measured; the table for people has R@1 alone
                found = line.recall(column, k)
                if found:
                    deviation = "" if found.deviation is None else f"{found.deviation:.3f}"
                    figure = [k, f"{found.mean:.3f}", deviation, found.seeds, ""]
                    table.append(["ours", line.name, column.benchmark, column.protocol, *figure, *known])
        for protocol, theirs in line.published.items():
            figure = [1, theirs.percent, "", "", theirs.caveat]
            table.append(["paper", line.name, protocol, protocol, *figure, *([""] * len(facts))])
    return "".join(map(csv_line, table))


def _fact_titles(lines: Sequence[ModelLine]) -> list[str]:
    return list(dict.fromkeys(fact for line in lines for fact in line.facts))


def _number(value: float | None, integer_format: str, float_format: str) -> str:
    """A number without decimals where it is an integer, as a count of weights is; nothing where there is none."""
    if value is None:
        return ""
    return format(value, integer_format if float(value).is_integer() else float_format)
