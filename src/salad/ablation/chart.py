"""A comparison as a picture: one panel a set, one disc a model, a bar for the spread. SVG, for light and dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from salad.ablation.comparison import Line, Spread, columns, leader, protocols

WIDE, LINE, NAMES = 230, 22, 190  # pixels: of a panel's plot, of a model's line, of the models' names
ACROSS = 3  # panels beside one another
GAP, HEAD, ABOVE, BELOW, EDGE = 44, 44, 40, 34, 18
LEGEND = (
    "R@1 in percent, each panel with an axis of its own; disc: ours, large where it leads by more than the spread; "
    "bar: ± one standard deviation; ring: the paper's"
)
NOTHING = "there is no figure yet"
TICKS = 4  # at most so many steps on an axis

STYLE = """
  .paper { fill: #fffefb } .ink { fill: #23272b } .soft { fill: #5c6063 }
  .hair { stroke: #dedacf } .ours { fill: #0b7480; stroke: #0b7480 } .theirs { fill: none; stroke: #a8431f }
  @media (prefers-color-scheme: dark) {
    .paper { fill: #15191c } .ink { fill: #e9e6dd } .soft { fill: #a9aba7 }
    .hair { stroke: #394044 } .ours { fill: #4cc3cd; stroke: #4cc3cd } .theirs { fill: none; stroke: #ff825c }
  }
"""


@dataclass(frozen=True, slots=True)
class _Mark:
    """One line's figure in a panel.

    Args:
        name: the line's.
        figure: what was measured.
        aside: why it stands apart from the others; nothing where it does not.
        leads: whether it leads all others by more than the spread.
    """

    name: str
    figure: Spread
    aside: str = ""
    leads: bool = False

    def ends(self) -> tuple[float, float]:
        """Where its bar begins and ends."""
        deviation = self.figure.deviation or 0.0
        return self.figure.mean - deviation, self.figure.mean + deviation


@dataclass(frozen=True, slots=True)
class _Panel:
    """One axis.

    Args:
        title: what was measured.
        marks: one a line, or none.
        ours: whether we measured it.
    """

    title: str
    marks: tuple[_Mark | None, ...]
    ours: bool

    def reach(self) -> tuple[float, float]:
        """The axis: from a round number below every bar's end to one above, within 0 and 100."""
        ends = [end for mark in self.marks if mark for end in mark.ends()]
        step = _step(max(ends) - min(ends))
        low = max(0.0, step * math.floor(min(ends) / step))
        high = min(100.0, step * math.ceil(max(ends) / step))
        return (low, high) if high > low else (max(0.0, low - step), min(100.0, high + step))


def picture(lines: Sequence[Line], title: str) -> str:
    """R@1 of every line on every set, ours as discs with bars, the published as rings, as one SVG.

    Args:
        lines: the models, the first on top.
        title: stands above the picture.

    Returns:
        A whole file; with no figure to show, a picture that says so.
    """
    shelves = _shelves(_panels(lines))
    high = ABOVE + LINE * len(lines) + BELOW
    width = 2 * EDGE + NAMES + ACROSS * (WIDE + GAP)
    height = 2 * EDGE + HEAD + len(shelves) * high
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" font-family="system-ui, sans-serif" font-size="12.5" role="img">',
        f"<title>{escape(title)}</title>",
        f"<style>{STYLE}</style>",
        f'<rect class="paper" width="{width}" height="{height}"/>',
        f'<text class="ink" x="{EDGE}" y="{EDGE + 14}" font-size="15">{escape(title)}</text>',
        f'<text class="soft" x="{EDGE}" y="{EDGE + 34}">{LEGEND if shelves else NOTHING}</text>',
    ]
    for row, shelf in enumerate(shelves):
        top = EDGE + HEAD + row * high
        parts += _names(lines, top + ABOVE)
        for place, panel in enumerate(shelf):
            parts += _drawn(panel, lines, EDGE + NAMES + place * (WIDE + GAP), top)
    return "\n".join([*parts, "</svg>", ""])


def _shelves(panels: Sequence[_Panel]) -> list[list[_Panel]]:
    """Panels in rows, the published ones in rows of their own."""
    sides = [[panel for panel in panels if panel.ours == ours] for ours in (True, False)]
    return [side[start : start + ACROSS] for side in sides for start in range(0, len(side), ACROSS)]


def _panels(lines: Sequence[Line]) -> list[_Panel]:
    panels = []
    for column in columns(lines):
        first = leader(lines, column)
        found = [(line, line.at(column)) for line in lines]
        marks = (_Mark(line.name, at, leads=line is first) if at else None for line, at in found)
        panels.append(_Panel(str(column), tuple(marks), ours=True))
    for name in protocols(lines):
        told = [(line, line.published.get(name)) for line in lines]
        rings = (
            _Mark(line.name, Spread(one.percent, None, 1), one.aside) if one else None for line, one in told
        )
        panels.append(_Panel(f"paper: {name}", tuple(rings), ours=False))
    return [panel for panel in panels if any(panel.marks)]


def _names(lines: Sequence[Line], top: float) -> list[str]:
    x = EDGE + NAMES - 14
    return [
        f'<text class="ink" x="{x}" y="{top + LINE * (number + 0.5) + 4:g}" text-anchor="end">'
        f"{escape(line.name)}</text>"
        for number, line in enumerate(lines)
    ]


def _drawn(panel: _Panel, lines: Sequence[Line], left: float, top: float) -> list[str]:
    low, high = panel.reach()
    first, last = top + ABOVE, top + ABOVE + LINE * len(lines)
    parts = [
        f'<text class="ink" x="{left}" y="{top + ABOVE - 14}" font-weight="600">{escape(panel.title)}</text>'
    ]
    for tick in _ticks(low, high):
        x = left + WIDE * (tick - low) / (high - low)
        parts.append(f'<path class="hair" d="M{x:.1f} {first}V{last}"/>')
        parts.append(f'<text class="soft" x="{x:.1f}" y="{last + 17}" text-anchor="middle">{tick:g}</text>')
    for number, mark in enumerate(panel.marks):
        if mark:
            parts += _marked(panel, mark, left, first + LINE * (number + 0.5))
    return parts


def _marked(panel: _Panel, mark: _Mark, left: float, y: float) -> list[str]:
    """A disc or a ring, the bar of its spread, and a tooltip."""
    low, high = panel.reach()

    def across(percent: float) -> float:
        return left + WIDE * (min(max(percent, low), high) - low) / (high - low)

    told, x, parts = f"{mark.name}: {mark.figure.mean:.1f}", across(mark.figure.mean), []
    if mark.figure.deviation is not None:
        told += f" ± {mark.figure.deviation:.1f}, {mark.figure.times} seeds"
        begins, ends = map(across, mark.ends())
        caps = "".join(f"M{end:.1f} {y - 4:g}V{y + 4:g}" for end in (begins, ends))
        parts.append(f'<path class="ours" stroke-width="1.6" d="M{begins:.1f} {y:g}H{ends:.1f}{caps}"/>')
    if mark.aside:
        told += f", {mark.aside}"
        parts.append(f'<text class="soft" x="{x + 8:.1f}" y="{y + 4:g}">*</text>')
    kind, size = "ours" if panel.ours else "theirs", 6.5 if mark.leads else 4.2
    parts.append(
        f'<circle class="{kind}" stroke-width="1.8" cx="{x:.1f}" cy="{y:g}" r="{size}">'
        f"<title>{escape(told)}</title></circle>"
    )
    return parts


def _step(reach: float) -> float:
    """A round step that cuts `reach` into a few."""
    rough = max(reach, 1.0) / TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)


def _ticks(low: float, high: float) -> list[float]:
    step = _step(high - low)
    first = math.ceil(low / step)
    return [number * step for number in range(first, math.floor(high / step + 1e-9) + 1)]
