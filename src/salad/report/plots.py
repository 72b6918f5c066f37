"""Curves as SVG: recall over k, precision over recall, the share of queries within so many metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from salad.evaluation.bootstrap import Interval
from salad.evaluation.result import Result
from salad.geo import told_metres

WIDE, HIGH = 360, 230  # of what lies between the axes; the page scales it
LEFT, RIGHT, ABOVE, BELOW = 42, 22, 12, 40
POINTS = 600  # of a curve at most: more than it has pixels
SHARES = tuple((float(percent), f"{percent}") for percent in (0, 25, 50, 75, 100))
METRES = (1.0, 1e5)  # what the axis of metres begins with, and where it ends at the latest


@dataclass(frozen=True, slots=True)
class Axis:
    """One side of a plot.

    Attributes:
        name: what is along it.
        low: where it begins.
        high: where it ends.
        ticks: values with what stands at them.
        log: whether every factor is as long, rather than every step.
    """

    name: str
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]
    log: bool = False

    def at(self, value: float) -> float:
        """Where a value is along it, 0 to 1; what lies outside is put at its end."""
        value = min(max(value, self.low), self.high)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True, slots=True)
class Mark:
    """A figure on a curve: where, how sure, and in words."""

    x: float
    y: float
    said: str
    interval: Interval | None = None


PERCENT = Axis("of queries, %", 0, 100, SHARES)


def recall_plot(result: Result) -> str:
    """Recall over k, with the interval of every k that is reported."""
    counted = [one for one in result.per_query if result.counts(one)]
    deepest = max(result.recall)
    ranks = np.array([one.first_right or math.inf for one in counted])
    line = [(float(k), 100 * float(np.mean(ranks <= k))) for k in _some(deepest)]
    marks = [
        Mark(k, share, f"R@{k}: {share:.1f} %", result.intervals.get(k)) for k, share in result.recall.items()
    ]
    x = Axis("a right one among the first", 0, deepest, tuple((k, f"{k}") for k in result.recall))
    return plot("Recall", x, PERCENT, line, marks)


def precision_recall_plot(result: Result) -> str:
    """Precision over recall as the least score that is believed falls; empty where there are no scores."""
    told, short = result.answers(), result.precision_recall
    if told is None or short is None:
        return ""
    curve = told.curve()
    line = [(0.0, float(curve.precision[0]))]
    for recall, precision in zip(curve.recall.tolist(), curve.precision.tolist(), strict=True):
        line += [(line[-1][0], precision), (recall, precision)]  # steps, as the area counts them
    said = f"recall at 100 % precision: {short.recall_at_full_precision:.1f} %"
    marks = [Mark(short.recall_at_full_precision, 100, said)] if short.threshold is not None else []
    x = Axis("recall, %", 0, 100, SHARES)
    return plot("Precision over recall", x, Axis("precision, %", 0, 100, SHARES), line, marks)


def metres_plot(result: Result) -> str:
    """The share of queries whose best match is within so many metres; empty where positions are not known."""
    known = result.distances
    if known is None:
        return ""
    told = [one.metres for one in result.per_query if result.counts(one)]
    apart = sorted(metres for metres in told if metres is not None and math.isfinite(metres))
    reach = max([*known.within, *apart, 10])
    high = min(10.0 ** math.ceil(math.log10(reach)), METRES[1])
    low = METRES[0]
    line = [(low, 100 * float(np.searchsorted(apart, low, "right")) / known.known)]
    for number, far in enumerate(apart, 1):
        if low < far <= high:
            line += [(far, line[-1][1]), (far, 100 * number / known.known)]
    line.append((high, line[-1][1]))
    marks = [
        Mark(within, share, f"within {within} m: {share:.1f} %", known.within_intervals.get(within))
        for within, share in known.within.items()
    ]
    tens = (10.0**power for power in range(round(math.log10(high)) + 1))
    x = Axis(
        "metres from the best match",
        low,
        high,
        tuple((ten, told_metres(ten).replace(".0", "")) for ten in tens),
        log=True,
    )
    return plot("Metres", x, PERCENT, line, marks)


def plot(
    title: str, x: Axis, y: Axis, line: Sequence[tuple[float, float]], marks: Sequence[Mark] = ()
) -> str:
    """One curve between two axes, with figures marked on it.

    Args:
        title: what is plotted.
        x: along the bottom.
        y: along the left.
        line: its corners, from left to right.
        marks: figures, each with its interval where it has one.
    """
    width, height = LEFT + WIDE + RIGHT, ABOVE + HIGH + BELOW
    said = f"{title}: {y.name} over {x.name}. " + "; ".join(mark.said for mark in marks)
    return (
        f'<svg class="plot" viewBox="0 0 {width} {height}" role="img" aria-label="{said}">'
        + _grid(x, y)
        + _curve(x, y, line)
        + "".join(_mark(x, y, mark) for mark in marks)
        + "</svg>"
    )


def _grid(x: Axis, y: Axis) -> str:
    bottom, right = ABOVE + HIGH, LEFT + WIDE
    parts = []
    for value, told in y.ticks:
        at = _down(y, value)
        parts.append(f'<path class="grid" d="M{LEFT} {at:.1f}H{right}"/>')
        parts.append(f'<text class="end" x="{LEFT - 7}" y="{at + 4:.1f}">{told}</text>')
    for value, told in x.ticks:
        at = _across(x, value)
        parts.append(f'<path class="grid" d="M{at:.1f} {ABOVE}V{bottom}"/>')
        parts.append(f'<text class="middle" x="{at:.1f}" y="{bottom + 16}">{told}</text>')
    parts.append(f'<text class="middle axis" x="{LEFT + WIDE / 2:.0f}" y="{bottom + 34}">{x.name}</text>')
    parts.append(
        f'<text class="middle axis" transform="translate(11 {ABOVE + HIGH / 2:.0f}) rotate(-90)">{y.name}</text>'
    )
    return "".join(parts)


def _curve(x: Axis, y: Axis, line: Sequence[tuple[float, float]]) -> str:
    """The line; of a very long one only as many corners as can be seen."""
    few = [line[number] for number in np.unique(np.linspace(0, len(line) - 1, POINTS).astype(int))]
    corners = [(f"{_across(x, right):.1f}", f"{_down(y, up):.1f}") for right, up in few]
    new = [corners[0], *(corner for before, corner in pairwise(corners) if corner != before)]
    path = "L".join(" ".join(corner) for corner in new)
    return f'<path class="curve" d="M{path}"/>'


def _mark(x: Axis, y: Axis, mark: Mark) -> str:
    at, up = _across(x, mark.x), _down(y, mark.y)
    bar, said = "", mark.said
    if mark.interval is not None:
        low, high = _down(y, mark.interval.low), _down(y, mark.interval.high)
        caps = "".join(f"M{at - 4:.1f} {end:.1f}h8" for end in (low, high))
        bar = f'<path class="sure" d="M{at:.1f} {low:.1f}V{high:.1f}{caps}"/>'
        said += f", 95 %: {mark.interval.low:.1f} to {mark.interval.high:.1f}"
    return f'<g class="point">{bar}<circle cx="{at:.1f}" cy="{up:.1f}" r="4"/><title>{said}</title></g>'


def _across(x: Axis, value: float) -> float:
    return LEFT + WIDE * x.at(value)


def _down(y: Axis, value: float) -> float:
    return ABOVE + HIGH * (1 - y.at(value))


def _some(deepest: int) -> list[int]:
    """Every k from 1; of very many, as many as can be seen."""
    return sorted({round(k) for k in np.linspace(1, deepest, min(deepest, POINTS))})
