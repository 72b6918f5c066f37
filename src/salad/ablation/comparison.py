"""Several models beside one another: means and spreads over seeds, who leads, and whose order is another's.

A column is one set under one protocol; figures of two protocols are never in one. Nothing here knows how a model
was trained.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations


@dataclass(frozen=True, slots=True, order=True)
class Column:
    """One set under one protocol."""

    benchmark: str
    protocol: str

    def __str__(self) -> str:
        return f"{self.benchmark}, {self.protocol}"


@dataclass(frozen=True, slots=True)
class Spread:
    """A figure measured several times.

    Args:
        mean: of all times.
        deviation: the standard deviation of a single time; None where there was only one.
        times: how many there were.
    """

    mean: float
    deviation: float | None
    times: int


@dataclass(frozen=True, slots=True)
class Published:
    """A figure that somebody else published.

    Args:
        percent: R@1.
        aside: why it takes no part in the order of the lines; nothing where it does.
    """

    percent: float
    aside: str = ""


@dataclass(frozen=True)
class Line:
    """One model.

    Args:
        name: what it is called.
        recalls: for every column, one figure a seed for each k, in percent.
        published: the figures that somebody else published for it, by protocol.
        seeds: how many times it was trained.
        facts: what else stands in its line, by the column's title: `trained parameters`, `numbers` and so on.
    """

    name: str
    recalls: Mapping[Column, Mapping[int, Sequence[float]]]
    published: Mapping[str, Published] = field(default_factory=dict)
    seeds: int = 0
    facts: Mapping[str, float] = field(default_factory=dict)

    def at(self, column: Column, k: int = 1) -> Spread | None:
        """Recall at k in a column; None where it was not measured."""
        times = self.recalls.get(column, {}).get(k, ())
        return spread(times) if times else None


@dataclass(frozen=True, slots=True)
class Reversed:
    """Two lines whose order is the other way round than published.

    Args:
        better: who leads here.
        worse: who leads as published.
        by: how many points of recall the better one leads by.
        spread: the standard deviation of that difference for single trainings; None where a seed stands alone.
    """

    better: str
    worse: str
    by: float
    spread: float | None

    @property
    def certain(self) -> bool:
        """Whether the lead is more than the spread."""
        return self.spread is not None and self.by > self.spread


def spread(times: Sequence[float]) -> Spread:
    """Mean and standard deviation of a figure measured once or more."""
    deviation = statistics.stdev(times) if len(times) > 1 else None
    return Spread(statistics.fmean(times), deviation, len(times))


def between(one: Spread, other: Spread) -> float | None:
    """The standard deviation of the difference of two single trainings; None where one of them stands alone."""
    if one.deviation is None or other.deviation is None:
        return None
    return math.hypot(one.deviation, other.deviation)


def columns(lines: Sequence[Line]) -> list[Column]:
    """Every column that any line has figures in, in the order of their first mention."""
    return list(dict.fromkeys(column for line in lines for column in line.recalls))


def protocols(lines: Sequence[Line]) -> list[str]:
    """Every protocol that there is a published figure for, in the order of their first mention."""
    return list(dict.fromkeys(protocol for line in lines for protocol in line.published))


def leader(lines: Sequence[Line], column: Column, k: int = 1) -> Line | None:
    """The line that leads all others in a column by more than the spread; None where no line does."""
    ranked = [(found.mean, number) for number, line in enumerate(lines) if (found := line.at(column, k))]
    if len(ranked) < 2:
        return None
    first = lines[max(ranked)[1]]
    best = first.at(column, k)
    assert best is not None
    for line in lines:
        other = line.at(column, k)
        if line is first or other is None:
            continue
        width = between(best, other)
        if width is None or best.mean - other.mean <= width:
            return None
    return first


def ordered(lines: Sequence[Line]) -> Iterator[tuple[Line, Line]]:
    """Pairs that the published figures put in one order: the better one first.

    Where they agree on none, because protocols contradict each other or both are equal, there is no order to keep.
    """
    for one, other in combinations(lines, 2):
        differences = [
            mine.percent - theirs.percent
            for protocol, mine in one.published.items()
            if (theirs := other.published.get(protocol)) and not mine.aside and not theirs.aside
        ]
        if any(differences) and min(differences) >= 0:
            yield one, other
        elif any(differences) and max(differences) <= 0:
            yield other, one


def against(lines: Sequence[Line], column: Column) -> tuple[int, list[Reversed]]:
    """How the order in a column keeps to the published one.

    Returns:
        How many pairs could be looked at, and those of them whose order is reversed, the widest apart first.
    """
    looked, found = 0, []
    for better, worse in ordered(lines):
        theirs, ours = better.at(column), worse.at(column)
        if theirs is None or ours is None:
            continue
        looked += 1
        if ours.mean > theirs.mean:
            by, width = ours.mean - theirs.mean, between(ours, theirs)
            found.append(Reversed(worse.name, better.name, by, width))
    return looked, sorted(found, key=lambda pair: -pair.by)
