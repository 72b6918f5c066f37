"""How sure a figure is: 95 % intervals by drawing the queries again, those that hang together together.

Queries that share a sequence or a place, and neighbouring frames of one drive, succeed and fail together: a
hundred of them tell less than a hundred photos of a hundred places. So whole groups are drawn (cluster
bootstrap), or whole stretches of a drive (circular block bootstrap, Politis and Romano 1992).

Shares have an interval of Wilson's form (1927) with the spread of the draws in place of the binomial one, as
surveys do it (Korn and Graubard 1998): taken straight from the draws, it would be a point where every query is
right. Everything else has the draws' own percentiles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float64, Int64

LEVEL = 0.95
# From seed to seed the ends of 160 right of 200 then move by 0.06 points (with 200 draws by 0.23).
TIMES = 2000
_NUMBERS = 1 << 21  # weights held at once: 16 MiB

By: TypeAlias = Literal["query", "group", "block"]
Weights: TypeAlias = Float64[np.ndarray, "draws queries"]


class Interval(NamedTuple):
    """Where the truth lies, 95 times in 100; in JSON a list of its two ends."""

    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Resampling:
    """What is drawn again together.

    Attributes:
        by: Single queries, groups of them, or stretches of a drive.
        queries: How many there are.
        unit_of: `[queries]` the group of each query, or its place along the drive.
        length: Queries in a stretch; 1 where they are not drawn by stretches.
        seed: Of the draws.
        times: How many draws.
    """

    by: By
    queries: int
    unit_of: Int64[np.ndarray, " queries"]
    length: int = 1
    seed: int = 0
    times: int = TIMES

    @property
    def units(self) -> int:
        """How many things that do not hang together there are: so many are drawn each time."""
        if self.by == "group":
            return int(self.unit_of.max()) + 1
        return max(1, round(self.queries / self.length))

    def as_dict(self) -> dict[str, Any]:
        """What a reader of the figures should know of it."""
        how = {"by": self.by, "units": self.units, "length": self.length, "level": LEVEL}
        return {**how, "times": self.times, "seed": self.seed}

    def draws(
        self, statistic: Callable[[Weights], Float64[np.ndarray, "draws ..."]]
    ) -> Float64[np.ndarray, "draws ..."]:
        """A statistic of each draw, given how often each query is drawn."""
        return np.concatenate([statistic(weights) for weights in self.weights()])

    def weights(self) -> Iterator[Weights]:
        """How often each query is drawn, draw after draw, some draws `[n, queries]` at a time."""
        rng = np.random.default_rng(self.seed)
        starts = self.queries if self.by == "block" else self.units
        step = max(1, _NUMBERS // max(starts, self.queries))
        for low in range(0, self.times, step):
            count = min(step, self.times - low)
            drawn = rng.integers(0, starts, (count, self.units))
            drawn += starts * np.arange(count)[:, None]  # so that one bincount serves all draws
            counts = np.bincount(drawn.ravel(), minlength=count * starts).reshape(count, starts)
            counts = counts.astype(np.float64)
            if self.by == "block":  # a stretch goes round the end of the drive to its beginning
                length = min(self.length, self.queries)
                round_ = np.concatenate([counts[:, self.queries - length :], counts], axis=1)
                sums = np.cumsum(round_, axis=1)
                counts = sums[:, length:] - sums[:, : self.queries]
            yield counts[:, self.unit_of]


@dataclass(frozen=True, eq=False)
class SamplingDesign:
    """Which queries of a set hang together; a measure of some of them draws those by it.

    Attributes:
        by: Single queries, groups of them, or stretches of a drive.
        groups: The group of each query, where they are drawn by groups.
        order: The frame number of each query, where they are drawn by stretches.
        seed: Of the draws.
        times: How many draws.
    """

    by: By
    groups: tuple[str, ...] = ()
    order: tuple[int, ...] = ()
    seed: int = 0
    times: int = TIMES

    def resampling(self, those: Int64[np.ndarray, " some"], values: Float64[np.ndarray, " some"]) -> Resampling:
        """How to draw some of the queries again, given what each of them came to."""
        by, unit_of, length = self.by, np.arange(len(those)), 1
        if self.by == "group":
            names, unit_of = np.unique([self.groups[row] for row in those.tolist()], return_inverse=True)
            # One group alone has nothing to vary against: then its queries count as single ones.
            if len(names) < 2:
                by, unit_of = "query", np.arange(len(those))
        elif self.by == "block":
            along = np.argsort([self.order[row] for row in those.tolist()], kind="stable")
            unit_of, length = np.argsort(along), block_length(values[along])
        return Resampling(by, len(those), unit_of.astype(np.int64), length, self.seed, self.times)


def block_length(series: Float64[np.ndarray, " frames"]) -> int:
    """How many neighbouring frames are drawn together.

    Politis and White's (2004, with Patton's correction of 2009) length for the circular block bootstrap, from the
    autocorrelation of what the frames came to; no shorter than the cube root of their number, the order of length
    that is best for any short memory (Hall, Horowitz and Jing 1995), since a drive with few errors shows too little
    of its memory to be measured. That length makes the spread's mean square error least, and its error is to be
    too small; an interval must rather not be too short, so twice the length is taken, at most a sixth of the drive.
    """
    count = len(series)
    centred = series - series.mean()
    variance = float(centred @ centred) / count
    length = math.cbrt(count)
    if variance > 1e-12:  # else nothing varies, and there is no memory to measure
        # So many small ones in a row, and the memory has ended.
        significant = max(5, math.ceil(math.log10(count)))
        lags = min(count - 1, math.ceil(math.sqrt(count)) + significant)
        covariance = np.array([float(centred[: count - lag] @ centred[lag:]) / count for lag in range(lags + 1)])
        small = np.abs(covariance[1:] / variance) < 2 * math.sqrt(math.log10(max(count, 2)) / count)
        runs = (lag for lag in range(len(small) - significant + 1) if small[lag : lag + significant].all())
        reach = min(2 * max(1, next(runs, len(small))), lags)
        lag = np.arange(1, reach + 1)
        # A flat-top window: whole up to half the reach, then falling to 0.
        tapered = np.clip(2 * (1 - lag / max(reach, 1)), 0, 1) * covariance[1 : reach + 1]
        long_run, slope = variance + 2 * float(tapered.sum()), 2 * float((lag * tapered).sum())
        if long_run > 0:
            # (2 slope^2 / D)^(1/3) in their words, where D = 4/3 long_run^2 is the circular bootstrap's.
            length = max(length, (1.5 * slope**2 / long_run**2 * count) ** (1 / 3))
    return max(1, min(2 * math.ceil(length), count // 6))


def proportion_interval(percent: float, draws: Float64[np.ndarray, " draws"], *, units: int, counted: int) -> Interval:
    """The interval of a proportion, in percent: Wilson's, of as many queries as the draws say they are worth.

    Args:
        percent: What was found.
        draws: The same of each draw.
        units: How many things that do not hang together were drawn from.
        counted: How many queries it is of: it is never taken for surer than that many independent ones.
    """
    from scipy.special import stdtrit  # late: whoever only reads a saved result does without scipy

    part = percent / 100
    # Drawn from themselves, units vary too little: by n - 1 of n.
    spread = float(np.var(draws / 100)) * units / max(1, units - 1)
    worth = part * (1 - part) / spread if spread > 1e-15 else math.inf
    if part in (0, 1):  # nothing varies, so nothing tells how far queries hang together: take it that they do
        worth = float(units)
    worth = min(max(worth, 1.0), counted)
    # Student's t in place of the normal's 1.96: few units tell little of how far they vary themselves.
    wide = float(stdtrit(max(units - 1, 1), (1 + LEVEL) / 2)) ** 2
    middle = (part + wide / (2 * worth)) / (1 + wide / worth)
    half = math.sqrt(wide * (part * (1 - part) / worth + wide / (4 * worth**2))) / (1 + wide / worth)
    low, high = 0.0 if part == 0 else middle - half, 1.0 if part == 1 else middle + half
    return Interval(100 * max(0.0, low), 100 * min(1.0, high))


def nested(intervals: dict[int, Interval]) -> dict[int, Interval]:
    """Intervals of shares that cannot fall from one key to the next, so that neither can their ends.

    Where the truth of R@1 lies above its lower end, that of R@5 does too: worth knowing where every query has a right
    one among five and nothing else tells how far neighbours hang together.
    """
    keys = sorted(intervals)
    lows = np.maximum.accumulate([intervals[key].low for key in keys]).tolist()
    highs = np.minimum.accumulate([intervals[key].high for key in keys[::-1]]).tolist()[::-1]
    ends = {key: Interval(low, max(low, high)) for key, low, high in zip(keys, lows, highs, strict=True)}
    return {key: ends[key] for key in intervals}


def percentile_interval(draws: Float64[np.ndarray, " draws"]) -> Interval:
    """The middle 95 % of the draws."""
    ordered, last = np.sort(draws), len(draws) - 1  # nothing is interpolated: an end may be infinite
    low, high = math.floor(last * (1 - LEVEL) / 2), math.ceil(last * (1 + LEVEL) / 2)
    return Interval(float(ordered[low]), float(ordered[high]))
