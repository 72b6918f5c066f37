"""Two results of one set side by side: which queries changed, and whether the difference is more than chance.

Both answered the same queries, so their difference is far surer than either figure: it is drawn query by query,
both results' together. Chance alone would turn each change the other way as often as not; how often it then
comes to as much is told as well, since a handful of changes is too few for the draws.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from salad.errors import BenchmarkError
from salad.evaluation.bootstrap import LEVEL, TIMES, Design, Interval, Plan, percentile_interval
from salad.evaluation.result import Result, along


@dataclass(frozen=True, slots=True)
class Difference:
    """The other result's recall at k less the first one's, in points.

    Attributes:
        k: matches looked at.
        first: recall of the first result, in percent.
        other: recall of the other.
        interval: where the true difference lies 95 times in 100.
        chance: how often changes of this size and number, each this way or that, come to as much.
        won: queries that only the other got right, by name.
        lost: queries that only the first one got right.
    """

    k: int
    first: float
    other: float
    interval: Interval
    chance: float
    won: tuple[str, ...]
    lost: tuple[str, ...]

    @property
    def points(self) -> float:
        """The difference."""
        return self.other - self.first

    @property
    def real(self) -> bool:
        """Whether it is more than chance: nothing is within the interval, and chance seldom does as much."""
        outside = self.interval.low > 0 or self.interval.high < 0
        return outside and self.chance < 1 - LEVEL

    def as_dict(self) -> dict[str, Any]:
        """The JSON form."""
        return {
            "first": self.first,
            "other": self.other,
            "difference": self.points,
            "interval": self.interval.as_list(),
            "chance": self.chance,
            "real": self.real,
            "won": list(self.won),
            "lost": list(self.lost),
        }


def differences(first: Result, other: Result, *, seed: int = 0, times: int = TIMES) -> tuple[Difference, ...]:
    """Compare two results at every k that both have.

    Args:
        first: one result.
        other: the other; what it got more right counts up.
        seed: of the draws.
        times: how many draws.

    Raises:
        BenchmarkError: they are not of one set under one protocol, and the sentence says what differs.
    """
    check_comparable(first, other)
    those = np.array([number for number, one in enumerate(first.per_query) if first.counts(one)])
    ks = [k for k in first.recall if k in other.recall]
    return tuple(_difference(first, other, k, those, seed=seed, times=times) for k in ks)


def check_comparable(first: Result, other: Result) -> None:
    """Refuse what cannot stand side by side.

    Raises:
        BenchmarkError: protocols, rules, queries, references or what is right differ.
    """
    if first.protocol != other.protocol:
        raise BenchmarkError(
            f"one result was judged by '{first.protocol}' and the other by '{other.protocol}': figures of two "
            "protocols do not compare; judge both by one"
        )
    _check_queries(first, other)
    for what, one, two in zip(("references", "right references"), first.digests, other.digests, strict=True):
        if one != two:
            raise BenchmarkError(
                f"both results are called {first.protocol}, but their {what} are not the same: judge both on one copy "
                "of the set"
            )
    if not set(first.recall) & set(other.recall):
        raise BenchmarkError(
            f"one result has recall at {list(first.recall)} and the other at {list(other.recall)}: there is no k in "
            "common"
        )


def _check_queries(first: Result, other: Result) -> None:
    one, two = ({verdict.query for verdict in result.per_query} for result in (first, other))
    if one != two:
        example = sorted(one ^ two)[0]
        raise BenchmarkError(
            f"the results are of two sets of queries ({len(one)} and {len(two)}, {len(one & two)} of them in both; "
            f"{example} is in one only): judge both on the same queries"
        )
    if [verdict.query for verdict in first.per_query] != [verdict.query for verdict in other.per_query]:
        raise BenchmarkError(
            "the results have the same queries in another order: judge both on one copy of the set"
        )


def _difference(
    first: Result, other: Result, k: int, those: np.ndarray, *, seed: int, times: int
) -> Difference:
    pairs = [(first.per_query[number], other.per_query[number]) for number in those.tolist()]
    change = np.array([float(new.hit(k)) - float(old.hit(k)) for old, new in pairs])
    plan = design_of(first).plan(those, change)
    draws = [100 * (some @ change) / some.sum(axis=1) for some in plan.weights(seed=seed, times=times)]
    return Difference(
        k=k,
        first=first.recall[k],
        other=other.recall[k],
        interval=percentile_interval(np.concatenate(draws)),
        chance=_chance(change, plan, seed=seed, times=times),
        won=tuple(new.query for (_, new), by in zip(pairs, change, strict=True) if by > 0),
        lost=tuple(old.query for (old, _), by in zip(pairs, change, strict=True) if by < 0),
    )


def design_of(result: Result) -> Design:
    """Which queries hang together, as it was when the result was made."""
    by = result.drawn.get("by", "query")
    if by == "group":
        return Design("group", groups=tuple(one.group or one.query for one in result.per_query))
    if by == "block":
        return Design("block", order=along([Path(one.query) for one in result.per_query]))
    return Design("query")


def _chance(change: Float64[np.ndarray, " queries"], plan: Plan, *, seed: int, times: int) -> float:
    """How often the changes come to as much when each unit's turn this way or that by chance."""
    units = plan.unit_of // plan.length if plan.by == "block" else plan.unit_of
    sums = np.bincount(units, weights=change)
    sums = sums[sums != 0]
    if not sums.size:
        return 1.0
    rng = np.random.default_rng(seed)
    turned = np.array([float((sums * rng.choice([-1.0, 1.0], len(sums))).sum()) for _ in range(times)])
    as_much = np.count_nonzero(np.abs(turned) >= abs(float(sums.sum())) - 1e-9)
    return float((1 + as_much) / (1 + times))
