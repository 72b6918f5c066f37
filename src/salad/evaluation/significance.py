"""Two results of one set side by side: which queries changed, and whether the difference is more than chance.

Both answered the same queries, so their difference is far surer than either figure: it is drawn query by query,
both results' together. Chance alone would turn each change the other way as often as not; how often it then
comes to as much is told as well, since a handful of changes is too few for the draws.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from salad.errors import BenchmarkError
from salad.evaluation.bootstrap import LEVEL, TIMES, Interval, Resampling, SamplingDesign, percentile_interval
from salad.evaluation.result import Result, along


@dataclass(frozen=True, slots=True)
class Difference:
    """The other result's recall at k less the first one's, in points.

    Attributes:
        k: Matches looked at.
        first: Recall of the first result, in percent.
        other: Recall of the other.
        interval: Where the true difference lies 95 times in 100.
        chance: How often changes of this size and number, each this way or that, come to as much.
        won: Queries that only the other got right, by name.
        lost: Queries that only the first one got right.
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
        # Both: the draws alone call five changes of five real, and the flips alone know no interval.
        outside = self.interval.low > 0 or self.interval.high < 0
        return outside and self.chance < 1 - LEVEL

    def as_dict(self) -> dict[str, Any]:
        """The JSON form."""
        return {
            "first": self.first,
            "other": self.other,
            "difference": self.points,
            "interval": list(self.interval),
            "chance": self.chance,
            "real": self.real,
            "won": list(self.won),
            "lost": list(self.lost),
        }


def differences(first: Result, other: Result, *, seed: int = 0, times: int = TIMES) -> tuple[Difference, ...]:
    """Compare two results at every k that both have.

    Args:
        first: One result.
        other: The other; what it got more right counts up.
        seed: Of the draws.
        times: How many draws.

    Raises:
        BenchmarkError: If they are not of one set under one protocol, and the sentence says what differs.
    """
    check_comparable(first, other)
    # Both results keep to one rule, so that either says which queries count.
    counted = np.array([number for number, one in enumerate(first.per_query) if first.counts(one)])
    pairs = [(first.per_query[number], other.per_query[number]) for number in counted.tolist()]
    design = replace(design_of(first), seed=seed, times=times)
    found = []
    for k in (k for k in first.recall if k in other.recall):
        change = np.array([float(new.hit(k)) - float(old.hit(k)) for old, new in pairs])
        resampling = design.resampling(counted, change)
        draws = [100 * (weights @ change) / weights.sum(axis=1) for weights in resampling.weights()]
        found.append(
            Difference(
                k=k,
                first=first.recall[k],
                other=other.recall[k],
                interval=percentile_interval(np.concatenate(draws)),
                chance=sign_test(change, resampling),
                won=tuple(new.query for (_, new), by in zip(pairs, change, strict=True) if by > 0),
                lost=tuple(old.query for (old, _), by in zip(pairs, change, strict=True) if by < 0),
            )
        )
    return tuple(found)


def check_comparable(first: Result, other: Result) -> None:
    """Refuse what cannot stand side by side.

    Raises:
        BenchmarkError: If protocols, rules, queries, references or what is right differ.
    """
    if first.protocol != other.protocol:
        raise BenchmarkError(
            f"one result was judged by '{first.protocol}' and the other by '{other.protocol}': figures of two "
            "protocols do not compare; judge both by one"
        )
    ours, theirs = ([one.query for one in result.per_query] for result in (first, other))
    if odd := set(ours) ^ set(theirs):
        both = len(set(ours) & set(theirs))
        raise BenchmarkError(
            f"the results are of two sets of queries ({len(set(ours))} and {len(set(theirs))}, {both} of them in both; "
            f"{min(odd)} is in one only): judge both on the same queries"
        )
    if ours != theirs:
        raise BenchmarkError("the results have the same queries in another order: judge both on one copy of the set")
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


def design_of(result: Result) -> SamplingDesign:
    """Which queries hang together, as it was when the result was made."""
    by = result.drawn.get("by", "query")
    if by == "group":  # where some queries are of no group, each is one of its own
        return SamplingDesign("group", groups=tuple(one.group or one.query for one in result.per_query))
    if by == "block":
        return SamplingDesign("block", order=along([Path(one.query) for one in result.per_query]))
    return SamplingDesign("query")


def sign_test(change: Float64[np.ndarray, " queries"], resampling: Resampling) -> float:
    """How often the changes come to as much when each unit's turns this way or that by chance.

    A sign-flip (randomisation) test, whose units are what is drawn again together.

    Args:
        change: What each query gained, or lost.
        resampling: Which of them hang together, how often to flip them, and from which seed.
    """
    # Stretches of a drive, laid end to end: the starts that a bootstrap draws overlap, and would count queries twice.
    units = resampling.unit_of // resampling.length if resampling.by == "block" else resampling.unit_of
    sums = np.bincount(units, weights=change)
    sums = sums[sums != 0]
    if not sums.size:
        return 1.0
    rng, times = np.random.default_rng(resampling.seed), resampling.times
    turned = np.array([float((sums * rng.choice([-1.0, 1.0], len(sums))).sum()) for _ in range(times)])
    as_much = np.count_nonzero(np.abs(turned) >= abs(float(sums.sum())) - 1e-9)
    # What was found is one of all that could be, so it is counted too: no chance is ever 0.
    return float((1 + as_much) / (1 + times))
