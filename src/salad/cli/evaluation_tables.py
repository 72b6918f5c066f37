"""An evaluation as people read it: its figures with how sure they are, and two of them side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from salad.cli import terminal
from salad.cli.arguments import Format

if TYPE_CHECKING:
    from rich.table import Table

    from salad.evaluation.bootstrap import Interval
    from salad.evaluation.result import Result
    from salad.evaluation.significance import Difference


# What the bootstrap draws, which decides how wide its intervals are: frames of one drive are not independent.
_DRAWN = {"query": "each query by itself", "group": "groups of queries", "block": "stretches of the drive"}


def summary(result: Result) -> dict[str, Any]:
    """What a reader must know before the figures."""
    rule = "left out" if result.unanswerable_rule == "drop" else "count as misses"
    fields: dict[str, Any] = {
        "set": result.benchmark,
        "protocol": result.protocol,
        "queries": result.queries,
        "references": result.references,
        # Published figures differ by this rule alone, so it stands beside the count.
        "unanswerable": f"{result.unanswerable}, {rule}" if result.unanswerable else "0",
        "model": result.model,
        "seconds": f"{result.seconds:.1f}",
    }
    if result.leaks is not None:  # None: nobody asked, which is not the same as none found
        fields["in_both_sides"] = len(result.leaks)
    return fields


def figures(result: Result) -> Table:
    """One line a figure, with the interval the truth lies in 95 times in 100."""
    from rich.table import Table

    drawn = result.drawn
    units = _DRAWN.get(str(drawn.get("by")), "")
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    table.add_column("", justify="right", no_wrap=True)
    table.add_column(f"95 % ({drawn.get('units')}: {units})", justify="right", no_wrap=True)
    for k, percent in result.recall.items():
        table.add_row(f"R@{k}", f"{percent:.1f} %", _range(result.intervals[k]))
    if (curve := result.precision_recall) is not None:
        table.add_row("area under precision-recall", f"{curve.area:.1f} %", _range(curve.area_interval))
        full = f"{curve.recall_at_full_precision:.1f} %"
        sure = _range(curve.recall_at_full_precision_interval)
        table.add_row("recall at 100 % precision", full, sure)
    if (distances := result.distances) is not None:
        table.add_row("median error", f"{distances.median:.1f} m", _range(distances.median_interval))
        for metres, percent in distances.within.items():
            interval = distances.within_intervals[metres]
            table.add_row(f"within {metres} m", f"{percent:.1f} %", _range(interval))
    return table


def _range(interval: Interval) -> str:
    return f"{interval.low:.1f} to {interval.high:.1f}"


def leak_sentences(result: Result) -> list[str]:
    """A sentence for each photo that is in both sides, the first of many."""
    leaks = result.leaks or ()
    sentences = [f"{leak.query_path} is the same {leak.kind} as {leak.reference_path}" for leak in leaks]
    return terminal.first_few(sentences, what="photos that are in both sides")


def compare_results(first: Path, other: Path, *, form: Format = "table", seed: int = 0) -> int:
    """Say how two results of `salad evaluate --save` differ, and whether that is more than chance.

    Args:
        first: One result's file.
        other: The other's; what it got more right counts up.
        form: For people or for programs.
        seed: Of the draws.

    Returns:
        The exit code.

    Raises:
        BenchmarkError: If a file is no result, or they are not of one set under one protocol.
    """
    from salad.evaluation.result import read_result
    from salad.evaluation.significance import differences

    one, two = read_result(first), read_result(other)
    found = differences(one, two, seed=seed)
    compared = {"set": one.benchmark, "protocol": one.protocol, "first": one.model, "other": two.model}
    if form == "json":
        terminal.write_json(compared | {"recall": {str(each.k): each.as_dict() for each in found}})
        return terminal.FOUND
    terminal.write_fields(compared)
    terminal.write_table(_side_by_side(found))
    # Which queries changed sides at R@1: there is no better lead to why.
    for name, queries in (("won", found[0].won), ("lost", found[0].lost)):
        for line in terminal.first_few([f"{name}: {query}" for query in queries], what=f"queries {name}"):
            terminal.write_line(line)
    return terminal.FOUND


def _side_by_side(found: Sequence[Difference]) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    for head in ("first", "other", "points", "95 %", "won", "lost", "by chance"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("real")  # by two tests at once, so it is a word and no column of numbers
    for one in found:
        table.add_row(
            *(f"R@{one.k}", f"{one.first:.1f} %", f"{one.other:.1f} %", f"{one.points:+.1f}"),
            *(f"{one.interval.low:+.1f} to {one.interval.high:+.1f}", str(len(one.won)), str(len(one.lost))),
            *(f"{one.chance:.3f}", "yes" if one.real else "no"),
        )
    return table
