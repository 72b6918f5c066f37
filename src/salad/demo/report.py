"""The demo's figures in words and as a table for the terminal."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text

from salad.demo.result import WITHIN_M, DemoResult
from salad.geo import told_metres


def distance(metres: float | None) -> str:
    """Metres for people: `3.2 m`, `48 m`, `1.3 km`, or a dash where unknown."""
    return "–" if metres is None else told_metres(metres)


def table(result: DemoResult) -> Table:
    """The result as a table: a row for each condition and one for all."""
    shown = Table(title=f"{result.queries} photos located by {result.model}", caption=_caption(result))
    shown.add_column("light and weather")
    for heading in ("photos", f"right within {WITHIN_M:.0f} m", "wrong", "unknown", "median error"):
        shown.add_column(heading, justify="right")
    for condition, photos in result.conditions.items():
        shown.add_row(*_row(result, condition, photos))
    shown.add_section()
    shown.add_row(*_row(result, None, result.queries), style="bold")
    return shown


def _row(result: DemoResult, condition: str | None, photos: int) -> list[Text]:
    counts = [result.count(verdict, condition=condition) for verdict in ("right", "wrong", "unknown")]
    share = f" ({100 * counts[0] / photos:.0f} %)" if condition is None and photos else ""
    cells = [condition or "all", str(photos), f"{counts[0]}{share}", str(counts[1]), str(counts[2])]
    return [Text(cell) for cell in (*cells, distance(result.median_error(condition)))]


def _caption(result: DemoResult) -> Text:
    return Text(
        f"{result.described} photos described in {result.seconds:.1f} s: {result.photos_a_second:.1f} a second. "
        "The median counts the answered ones."
    )
