"""Several models side by side: means and deviations over seeds, who leads, and whose order the paper's figures reverse.

A column is one set under one protocol; figures of two protocols are never in one. Nothing here knows how a model
was trained.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Self

from salad.ablation.grids import PaperFigure


@dataclass(frozen=True, slots=True, order=True)
class BenchmarkColumn:
    """One set under one protocol."""

    benchmark: str
    protocol: str

    def __str__(self) -> str:
        return f"{self.benchmark}, {self.protocol}"


@dataclass(frozen=True, slots=True)
class MeanOverSeeds:
    """A figure measured with one seed or more.

    Args:
        mean: over all seeds.
        deviation: the standard deviation of a single training; None where there was only one.
        seeds: how many there were.
    """

    mean: float
    deviation: float | None
    seeds: int

    @classmethod
    def of(cls, figures: Sequence[float]) -> Self:
        """From one figure a seed."""
        # Divided by n - 1: few seeds stand for all that might have been drawn.
        deviation = statistics.stdev(figures) if len(figures) > 1 else None
        return cls(statistics.fmean(figures), deviation, len(figures))

    def __str__(self) -> str:
        return f"{self.mean:.1f}" + ("" if self.deviation is None else f" ± {self.deviation:.1f}")

    def deviation_of_difference(self, other: MeanOverSeeds) -> float | None:
        """The standard deviation of the difference of two single trainings; None where one of them stands alone."""
        if self.deviation is None or other.deviation is None:
            return None
        return math.hypot(self.deviation, other.deviation)  # trainings are independent, so variances add


@dataclass(frozen=True)
class ModelLine:
    """One model, as a line of a table.

    Args:
        name: what it is called.
        recalls: for every column, one figure a seed for each k, in percent.
        published: the paper's figures for it, by protocol.
        seeds: how many times it was trained.
        facts: what else stands in its line, by the column's title: `trained parameters`, `dimension` and so on.
    """

    name: str
    recalls: Mapping[BenchmarkColumn, Mapping[int, Sequence[float]]]
    published: Mapping[str, PaperFigure] = field(default_factory=dict)
    seeds: int = 0
    facts: Mapping[str, float] = field(default_factory=dict)

    def recall(self, column: BenchmarkColumn, k: int = 1) -> MeanOverSeeds | None:
        """Recall at k in a column; None where it was not measured."""
        figures = self.recalls.get(column, {}).get(k, ())
        return MeanOverSeeds.of(figures) if figures else None


@dataclass(frozen=True, slots=True)
class ReversedPair:
    """Two models whose order is the other way round than published.

    Args:
        better: who leads here.
        worse: who leads as published.
        lead: how many points of recall the better one leads by.
        deviation: the standard deviation of that difference for single trainings; None where a seed stands alone.
    """

    better: str
    worse: str
    lead: float
    deviation: float | None

    @property
    def certain(self) -> bool:
        """Whether the lead is more than the deviation."""
        return self.deviation is not None and self.lead > self.deviation

    def __str__(self) -> str:
        deviation = "" if self.deviation is None else f" ± {self.deviation:.1f}"
        return f"{self.better} before {self.worse} by {self.lead:.1f}{deviation}"


def benchmark_columns(lines: Sequence[ModelLine]) -> list[BenchmarkColumn]:
    """Every column that any line has figures in, in the order of their first mention."""
    return list(dict.fromkeys(column for line in lines for column in line.recalls))


def published_protocols(lines: Sequence[ModelLine]) -> list[str]:
    """Every protocol that there is a published figure for, in the order of their first mention."""
    return list(dict.fromkeys(protocol for line in lines for protocol in line.published))


def leader(lines: Sequence[ModelLine], column: BenchmarkColumn) -> ModelLine | None:
    """The line whose R@1 leads all others in a column by more than the deviation; None where none does."""
    measured = [(found, line) for line in lines if (found := line.recall(column))]
    if len(measured) < 2:  # nobody is led
        return None
    # Two that are equally good are within any spread of one another, so it does not matter which of them is first.
    best, first = max(measured, key=lambda pair: pair[0].mean)
    for other, line in measured:
        deviation = best.deviation_of_difference(other)
        if line is not first and (deviation is None or best.mean - other.mean <= deviation):
            return None
    return first


def published_order(lines: Sequence[ModelLine]) -> Iterator[tuple[ModelLine, ModelLine]]:
    """Pairs that the published figures put in one order: the better one first.

    Where they agree on none, because protocols contradict each other or both are equal, there is no order to keep.
    """
    for one, other in combinations(lines, 2):
        # Figures with a caveat stand on another backbone, and differ for that reason too.
        differences = [
            mine.percent - theirs.percent
            for protocol, mine in one.published.items()
            if (theirs := other.published.get(protocol)) and not mine.caveat and not theirs.caveat
        ]
        if any(differences) and min(differences) >= 0:
            yield one, other
        elif any(differences) and max(differences) <= 0:
            yield other, one


def reversed_pairs(lines: Sequence[ModelLine], column: BenchmarkColumn) -> tuple[int, list[ReversedPair]]:
    """How the order in a column keeps to the published one.

    Returns:
        How many pairs could be looked at, and those of them whose order is reversed, the widest apart first.
    """
    compared, found = 0, []
    for better, worse in published_order(lines):
        theirs, ours = better.recall(column), worse.recall(column)
        if theirs is None or ours is None:
            continue
        compared += 1
        lead = ours.mean - theirs.mean
        if lead > 0:
            found.append(ReversedPair(worse.name, better.name, lead, ours.deviation_of_difference(theirs)))
    return compared, sorted(found, key=lambda pair: -pair.lead)
