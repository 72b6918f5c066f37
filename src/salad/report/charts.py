"""Charts of an evaluation: recall over k, precision over recall, the share of queries within so many metres.

`templates/charts.html.j2` writes them as SVG.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from salad.evaluation.bootstrap import Interval
from salad.evaluation.result import Result
from salad.geo import told_metres

WIDE, HIGH = 360, 230  # units between the axes; the page scales them
LEFT, RIGHT, ABOVE, BELOW = 42, 22, 12, 40  # units around them, for what stands at the axes
POINTS = 600  # corners of a curve at most: more than it has pixels
TICKS = tuple((float(percent), f"{percent}") for percent in (0, 25, 50, 75, 100))
METRES = (1.0, 1e5)  # what the axis of metres begins with, and where it ends at the latest


@dataclass(frozen=True, slots=True)
class Axis:
    """One side of a chart.

    Attributes:
        name: What is along it.
        low: Where it begins.
        high: Where it ends.
        ticks: Values with what stands at them.
        log: Whether every factor is as long, rather than every step.
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
class ChartPoint:
    """A figure on a curve: where, how sure, and in words."""

    x: float
    y: float
    text: str
    interval: Interval | None = None

    @property
    def label(self) -> str:
        """The figure with its interval."""
        if self.interval is None:
            return self.text
        return f"{self.text}, 95 %: {self.interval.low:.1f} to {self.interval.high:.1f}"


@dataclass(frozen=True, slots=True)
class Chart:
    """One curve between two axes, with figures marked on it.

    Attributes:
        title: What is drawn.
        x: Along the bottom.
        y: Along the left.
        line: Its corners, from left to right.
        points: The figures.
    """

    title: str
    x: Axis
    y: Axis
    line: Sequence[tuple[float, float]]
    points: Sequence[ChartPoint] = ()

    left, right, top, bottom = LEFT, LEFT + WIDE, ABOVE, ABOVE + HIGH
    width, height = LEFT + WIDE + RIGHT, ABOVE + HIGH + BELOW

    @property
    def label(self) -> str:
        """All of it in words."""
        return f"{self.title}: {self.y.name} over {self.x.name}. " + "; ".join(p.text for p in self.points)

    def across(self, value: float) -> float:
        """Where a value of the lower axis is, in units from the left."""
        return LEFT + WIDE * self.x.at(value)

    def down(self, value: float) -> float:
        """Where a value of the left axis is, in units from the top."""
        return ABOVE + HIGH * (1 - self.y.at(value))

    @property
    def curve(self) -> str:
        """The line as the data of an SVG path; of a very long one only as many corners as can be seen."""
        few = [self.line[n] for n in np.unique(np.linspace(0, len(self.line) - 1, POINTS).astype(int))]
        corners = [f"{self.across(x):.1f} {self.down(y):.1f}" for x, y in few]
        return "M" + "L".join([corners[0], *(corner for before, corner in pairwise(corners) if corner != before)])


PERCENT = Axis("of queries, %", 0, 100, TICKS)


def charts(result: Result) -> list[Chart]:
    """The charts that a result has figures for."""
    drawn = (recall_chart(result), precision_recall_chart(result), metres_chart(result))
    return [chart for chart in drawn if chart is not None]


def recall_chart(result: Result) -> Chart:
    """Recall over k, with the interval of every k that is reported."""
    counted = [one for one in result.per_query if result.counts(one)]
    deepest = max(result.recall)
    # What was not found at all is found at no k.
    ranks = np.array([one.first_right or math.inf for one in counted])
    # Every k from 1; of very many, as many as can be seen.
    some = sorted({round(k) for k in np.linspace(1, deepest, min(deepest, POINTS))})
    line = [(float(k), 100 * float(np.mean(ranks <= k))) for k in some]
    marks = [
        ChartPoint(k, percent, f"R@{k}: {percent:.1f} %", result.intervals.get(k))
        for k, percent in result.recall.items()
    ]
    x = Axis("a right one among the first", 0, deepest, tuple((k, f"{k}") for k in result.recall))
    return Chart("Recall", x, PERCENT, line, marks)


def precision_recall_chart(result: Result) -> Chart | None:
    """Precision over recall as the least score that is believed falls; None where there are no scores."""
    answers, short = result.answers(), result.precision_recall
    if answers is None or short is None:
        return None
    curve = answers.curve()
    line = [(0.0, float(curve.precision[0]))]
    for recall, precision in zip(curve.recall.tolist(), curve.precision.tolist(), strict=True):
        line += [(line[-1][0], precision), (recall, precision)]  # steps, as the area counts them
    text = f"recall at 100 % precision: {short.recall_at_full_precision:.1f} %"
    marks = [ChartPoint(short.recall_at_full_precision, 100, text)] if short.threshold is not None else []
    x = Axis("recall, %", 0, 100, TICKS)
    return Chart("Precision over recall", x, Axis("precision, %", 0, 100, TICKS), line, marks)


def metres_chart(result: Result) -> Chart | None:
    """The share of queries whose best match is within so many metres; None where positions are not known."""
    known = result.distances
    if known is None:
        return None
    counted = [one.metres for one in result.per_query if result.counts(one)]
    apart = sorted(metres for metres in counted if metres is not None and math.isfinite(metres))
    reach = max([*known.within, *apart, 10])
    high = min(10.0 ** math.ceil(math.log10(reach)), METRES[1])
    # Below a metre nobody knows positions so well.
    low = METRES[0]
    line = [(low, 100 * float(np.searchsorted(apart, low, "right")) / known.known)]
    for number, far in enumerate(apart, 1):
        if low < far <= high:
            line += [(far, line[-1][1]), (far, 100 * number / known.known)]
    line.append((high, line[-1][1]))
    marks = [
        ChartPoint(within, percent, f"within {within} m: {percent:.1f} %", known.within_intervals.get(within))
        for within, percent in known.within.items()
    ]
    tens = (10.0**power for power in range(round(math.log10(high)) + 1))
    x = Axis(
        "metres from the best match",
        low,
        high,
        tuple((ten, told_metres(ten).replace(".0", "")) for ten in tens),
        log=True,
    )
    return Chart("Metres", x, PERCENT, line, marks)
