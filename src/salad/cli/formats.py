"""What `salad locate` writes: a table for people, JSON for programs, CSV for spreadsheets; maps are in `maps`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from salad.csvtext import csv_line

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from salad.place import Answer, Place

COLUMNS = ("query", "lat", "lon", "radius_m", "confidence", "support", "best_match", "best_score")


def as_json(answers: Sequence[Answer]) -> str:
    """One object a query."""
    return json.dumps([answer.as_dict() for answer in answers], ensure_ascii=False, indent=2)


def as_csv(answers: Sequence[Answer]) -> str:
    """One line a query; an unknown place leaves its fields empty."""
    lines = [csv_line(COLUMNS)]
    for answer in answers:
        place, best = answer.place, answer.matches[0] if answer.matches else None
        found: list[Any] = [""] * 5
        if place:
            found = [*_degrees(place), f"{place.radius_m:.1f}", f"{place.confidence:.3f}", place.support]
        matched = [best.photo.path, f"{best.score:.4f}"] if best else ["", ""]
        lines.append(csv_line([answer.query, *found, *matched]))
    return "".join(lines).removesuffix("\n")


def as_table(answers: Sequence[Answer]) -> Table:
    """One line a query, for a terminal."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("photo")  # where room is short, names give way to the place
    table.add_column("place", no_wrap=True)
    table.add_column("within", justify="right", no_wrap=True)
    table.add_column("confidence", justify="right", no_wrap=True)
    table.add_column("looks like")
    for answer in answers:
        place, best = answer.place, answer.matches[0] if answer.matches else None
        cells = ("unknown", "", "")
        if place:
            cells = (", ".join(_degrees(place)), f"{place.radius_m:.0f} m", f"{place.confidence:.2f}")
        like = f"{best.photo.path.name} ({best.score:.2f})" if best else "no match"
        table.add_row(_cell(answer.query.name), *cells, _cell(like))
    return table


def _cell(name: str) -> Text:
    """A name as it is, brackets and all, but for what a terminal would obey or cannot show."""
    from rich.text import Text

    shown = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name)
    return Text(shown, no_wrap=True, overflow="ellipsis")


def _degrees(place: Place) -> list[str]:
    return [f"{place.where.lat:.6f}", f"{place.where.lon:.6f}"]  # 0.1 m
