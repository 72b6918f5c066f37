"""Figures and names as the page writes them."""

from __future__ import annotations

from html import escape

from salad.evaluation.bootstrap import Interval


def shown(text: str) -> str:
    """A name as HTML: nothing in it is markup, and letters that no page can hold become a question mark."""
    return escape(text.encode("utf-8", "replace").decode("utf-8"))


def exact(value: float, unit: str = "") -> str:
    """A figure to one decimal, with all of it in the markup for programs."""
    return f'<data value="{value!r}">{value:,.1f}{unit}</data>'


def whole(number: int) -> str:
    """A count, with the plain number for programs."""
    return f'<data value="{number}">{number:,}</data>'


def ends(interval: Interval) -> str:
    """An interval's two ends."""
    return f"{exact(interval.low)} to {exact(interval.high)}"


def ordinal(number: int) -> str:
    """`1st`, `2nd`, `13th`."""
    teen = number % 100 in (11, 12, 13)
    return f"{number}{'th' if teen else {1: 'st', 2: 'nd', 3: 'rd'}.get(number % 10, 'th')}"


def several(number: int, one: str, many: str = "") -> str:
    """`1 query`, `2 queries`."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"
