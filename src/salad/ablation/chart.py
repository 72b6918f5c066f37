"""A comparison as a picture: one panel a column, one disc a model, a bar for the deviation. SVG, for light and dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from salad.ablation.comparison import MeanOverSeeds, ModelLine, benchmark_columns, leader, published_protocols

# All in pixels.
PLOT_WIDTH, LINE_HEIGHT, NAMES_WIDTH = 230, 22, 190
PANELS_A_ROW = 3
GAP, HEADING, ABOVE_PLOT, BELOW_PLOT, MARGIN = 44, 44, 40, 34, 18
LEGEND = (
    "R@1 in percent, each panel with an axis of its own; disc: ours, large where it leads by more than the spread; "
    "bar: ± one standard deviation; ring: the paper's"
)
NOTHING = "there is no figure yet"
MOST_STEPS = 4  # on an axis

# Colours follow the reader's setting: the file stands in pages of either kind, as an <img> that no page can style.
STYLE = """
  .paper { fill: #fffefb } .ink { fill: #23272b } .soft { fill: #5c6063 }
  .hair { stroke: #dedacf } .ours { fill: #0b7480; stroke: #0b7480 } .theirs { fill: none; stroke: #a8431f }
  @media (prefers-color-scheme: dark) {
    .paper { fill: #15191c } .ink { fill: #e9e6dd } .soft { fill: #a9aba7 }
    .hair { stroke: #394044 } .ours { fill: #4cc3cd; stroke: #4cc3cd } .theirs { fill: none; stroke: #ff825c }
  }
"""


@dataclass(frozen=True, slots=True)
class _ChartMark:
    """One model's figure in a panel: why it stands apart from the others, and whether it leads them all for sure."""

    name: str
    figure: MeanOverSeeds
    caveat: str = ""
    leads: bool = False

    @property
    def bar(self) -> tuple[float, float]:
        """Where its bar begins and ends, in percent."""
        deviation = self.figure.deviation or 0.0
        return self.figure.mean - deviation, self.figure.mean + deviation


@dataclass(frozen=True, slots=True)
class _ChartPanel:
    """One axis, in percent, with a mark or none for each line of the table; `ours`, or the paper's."""

    title: str
    marks: tuple[_ChartMark | None, ...]
    ours: bool

    @property
    def axis(self) -> tuple[float, float]:
        """From a round number below every bar's end to one above, within 0 and 100."""
        ends = [end for mark in self.marks if mark for end in mark.bar]
        step = _round_step(max(ends) - min(ends))
        # An axis from 0 to 100 would hide what sets rows apart, so each panel has its own, and the legend says so.
        low = max(0.0, step * math.floor(min(ends) / step))
        high = min(100.0, step * math.ceil(max(ends) / step))
        # all bars may end on one round number
        return (low, high) if high > low else (max(0.0, low - step), min(100.0, high + step))

    @property
    def ticks(self) -> list[float]:
        """Round numbers on the axis."""
        low, high = self.axis
        step = _round_step(high - low)
        # 1e-9: a quotient that rounding left just under a whole number is that number
        return [number * step for number in range(math.ceil(low / step), math.floor(high / step + 1e-9) + 1)]

    def x(self, percent: float) -> float:
        """Pixels from the plot's left side; what is beyond the axis lies on its end."""
        low, high = self.axis
        return PLOT_WIDTH * (min(max(percent, low), high) - low) / (high - low)

    def svg(self, left: float, top: float) -> list[str]:
        """Title, axis and marks, with the plot's upper left corner at these pixels."""
        bottom = top + LINE_HEIGHT * len(self.marks)
        parts = [f'<text class="ink" x="{left}" y="{top - 14}" font-weight="600">{escape(self.title)}</text>']
        for tick in self.ticks:
            x = left + self.x(tick)
            parts.append(f'<path class="hair" d="M{x:.1f} {top}V{bottom}"/>')
            parts.append(f'<text class="soft" x="{x:.1f}" y="{bottom + 17}" text-anchor="middle">{tick:g}</text>')
        for number, mark in enumerate(self.marks):
            if mark:
                parts += self._mark_svg(mark, left, _middle(top, number))
        return parts

    def _mark_svg(self, mark: _ChartMark, left: float, y: float) -> list[str]:
        """A disc or a ring, the bar of its deviation, and a tooltip."""
        x, tooltip, parts = left + self.x(mark.figure.mean), f"{mark.name}: {mark.figure}", []
        if mark.figure.deviation is not None:  # neither one seed alone nor a published figure has a bar
            tooltip += f", {mark.figure.seeds} seeds"
            begin, end = (left + self.x(percent) for percent in mark.bar)
            caps = "".join(f"M{at:.1f} {y - 4:g}V{y + 4:g}" for at in (begin, end))
            parts.append(f'<path class="ours" stroke-width="1.6" d="M{begin:.1f} {y:g}H{end:.1f}{caps}"/>')
        if mark.caveat:
            tooltip += f", {mark.caveat}"
            parts.append(f'<text class="soft" x="{x + 8:.1f}" y="{y + 4:g}">*</text>')
        kind, radius = "ours" if self.ours else "theirs", 6.5 if mark.leads else 4.2
        parts.append(
            f'<circle class="{kind}" stroke-width="1.8" cx="{x:.1f}" cy="{y:g}" r="{radius}">'
            f"<title>{escape(tooltip)}</title></circle>"
        )
        return parts


def comparison_chart(lines: Sequence[ModelLine], title: str) -> str:
    """R@1 of every line in every column, ours as discs with bars, the published as rings, as one SVG file.

    With no figure to show it is a picture that says so.
    """
    panels = _panels(lines)
    # The paper's panels begin a row of their own, so that nobody reads its figures as ours.
    rows = [
        side[start : start + PANELS_A_ROW]
        for side in ([panel for panel in panels if panel.ours], [panel for panel in panels if not panel.ours])
        for start in range(0, len(side), PANELS_A_ROW)
    ]
    row_height = ABOVE_PLOT + LINE_HEIGHT * len(lines) + BELOW_PLOT
    width = 2 * MARGIN + NAMES_WIDTH + PANELS_A_ROW * (PLOT_WIDTH + GAP)
    height = 2 * MARGIN + HEADING + len(rows) * row_height
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" font-family="system-ui, sans-serif" font-size="12.5" role="img">',
        f"<title>{escape(title)}</title>",
        f"<style>{STYLE}</style>",
        f'<rect class="paper" width="{width}" height="{height}"/>',
        f'<text class="ink" x="{MARGIN}" y="{MARGIN + 14}" font-size="15">{escape(title)}</text>',
        f'<text class="soft" x="{MARGIN}" y="{MARGIN + 34}">{LEGEND if rows else NOTHING}</text>',
    ]
    for number, row in enumerate(rows):
        top = MARGIN + HEADING + number * row_height + ABOVE_PLOT
        parts += [
            f'<text class="ink" x="{MARGIN + NAMES_WIDTH - 14}" y="{_middle(top, place) + 4:g}" '
            f'text-anchor="end">{escape(line.name)}</text>'
            for place, line in enumerate(lines)
        ]
        for place, panel in enumerate(row):
            parts += panel.svg(MARGIN + NAMES_WIDTH + place * (PLOT_WIDTH + GAP), top)
    return "\n".join([*parts, "</svg>", ""])


def _panels(lines: Sequence[ModelLine]) -> list[_ChartPanel]:
    """A panel for each of our columns, then one for each protocol of the paper."""
    panels = []
    for column in benchmark_columns(lines):
        first = leader(lines, column)
        marks = tuple(
            _ChartMark(line.name, figure, leads=line is first) if (figure := line.recall(column)) else None
            for line in lines
        )
        panels.append(_ChartPanel(str(column), marks, ours=True))
    for protocol in published_protocols(lines):
        rings = tuple(
            _ChartMark(line.name, MeanOverSeeds.of([theirs.percent]), theirs.caveat)
            if (theirs := line.published.get(protocol))
            else None
            for line in lines
        )
        panels.append(_ChartPanel(f"paper: {protocol}", rings, ours=False))
    return [panel for panel in panels if any(panel.marks)]  # a column may have no R@1


def _middle(top: float, line: int) -> float:
    """The height of a line's middle."""
    return top + LINE_HEIGHT * (line + 0.5)


def _round_step(reach: float) -> float:
    """A round step, of 0.5 at least, that cuts `reach` into a few: 1, 2 or 5 times a power of ten."""
    rough = max(reach, 1.0) / MOST_STEPS  # figures within a point of one another are not drawn far apart
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
