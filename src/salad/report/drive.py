"""Queries whose places nobody knows, as a strip along the drive: one cell a frame, a row or more a group."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

from salad.evaluation.result import Result, along
from salad.report.choosing import OUTCOMES, Outcome, outcome
from salad.report.sheet import SINGLE, WIDE, named
from salad.report.words import shown

NAMES = 150.0  # units that rows' names take at the left
ROW, CELLS = 26.0, 120  # units of a row's height, cells in a row at most
GROUPS = 40  # so many have rows of their own; more only stand one after another
LETTERS = 20  # of a row's name
CELL = (3.0, 18.0)  # the least and the most width of a cell in units
HEIGHTS = {"right": 9.0, "wrong": 20.0, "unanswerable": 14.0}


def draw_drive(result: Result, numbers: Sequence[int], linked: Collection[int]) -> str:
    """The strip of some queries, in the order of the drive.

    Args:
        result: what to draw.
        numbers: of the queries, from 0.
        linked: numbers of the queries that have a strip of photos.
    """
    rows = list(_rows(result, numbers))
    wide = min(max((WIDE - NAMES) / max(len(cells) for _, cells in rows), CELL[0]), CELL[1])
    single = len(numbers) <= SINGLE
    parts = []
    for place, (name, cells) in enumerate(rows):
        middle = ROW * (place + 0.5) + 6
        parts.append(f'<text x="{NAMES - 14:.0f}" y="{middle + 4.5:.1f}">{shown(name)}</text>')
        parts.append(f'<path class="rail" d="M{NAMES:.0f} {middle:.1f}h{wide * len(cells):.1f}"/>')
        parts += _cells(result, cells, middle, wide, linked if not single else None, set(linked))
    height = ROW * len(rows) + 12
    return (
        f'<svg class="map drive" viewBox="0 0 {WIDE:.0f} {height:.0f}" role="group" '
        f'aria-label="{len(numbers):,} queries along the drive">' + "\n".join(parts) + "</svg>"
    )


def _rows(result: Result, numbers: Sequence[int]) -> Iterable[tuple[str, Sequence[int]]]:
    """Queries in rows of one length as far as they go, each with a name."""
    verdicts = result.per_query
    frames = along([Path(verdicts[number].query) for number in numbers])
    order = [number for _, number in sorted(zip(frames, numbers, strict=True))]
    groups: dict[str | None, list[int]] = {}
    for number in order:
        groups.setdefault(verdicts[number].group, []).append(number)
    if len(groups) > GROUPS:
        groups = {None: [number for _, some in sorted(groups.items(), key=str) for number in some]}
    longest = max(map(len, groups.values()))
    row = math.ceil(longest / math.ceil(longest / CELLS))
    for group, some in groups.items():
        for start in range(0, len(some), row):
            name = verdicts[some[start]].query if group is None else group if not start else ""
            yield name if len(name) <= LETTERS else f"…{name[1 - LETTERS :]}", some[start : start + row]


def _cells(
    result: Result,
    cells: Sequence[int],
    middle: float,
    wide: float,
    only: Collection[int] | None,
    linked: Collection[int],
) -> Iterable[str]:
    """A cell for each query; where `only` is given, the others are drawn as one shape a kind."""
    crowds = dict.fromkeys(OUTCOMES, "")
    for place, number in enumerate(cells):
        one = result.per_query[number]
        shape = _shape(outcome(one), NAMES + wide * place, middle, wide)
        if only is None or number in only:
            yield named(one, number, f'<path class="mark" d="{shape}"/>', linked=number in linked)
        else:
            crowds[outcome(one)] += shape
    for kind, shapes in crowds.items():
        if shapes:
            yield f'<path class="mark query {kind}" d="{shapes}"/>'


def _shape(kind: Outcome, left: float, middle: float, wide: float) -> str:
    """Low where right, high where wrong, hollow where no reference is: colour alone tells nothing to some."""
    high, gap = HEIGHTS[kind], min(1.6, wide / 4)
    inner = wide - gap
    outer = f"M{left:.1f} {middle - high / 2:.1f}h{inner:.1f}v{high:g}h{-inner:.1f}Z"
    if kind != "unanswerable":
        return outer
    edge = min(1.6, inner / 4)  # the hole is drawn the other way round, so that it stays empty
    hole, down = inner - 2 * edge, high - 2 * edge
    return f"{outer}M{left + edge:.1f} {middle - high / 2 + edge:.1f}v{down:.1f}h{hole:.1f}v{-down:.1f}Z"
