"""Intervals cover the truth about 95 times in 100, also where queries hang together and the naive ones fail."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.evaluation.bootstrap import (
    Interval,
    Resampling,
    SamplingDesign,
    block_length,
    nested,
    percentile_interval,
    proportion_interval,
)

Sample = Callable[[np.random.Generator], tuple[np.ndarray, list[str]]]
Planned = Callable[[np.ndarray, list[str]], Resampling]
TIMES = 200


def covered(sample: Sample, truth: float, *planned: Planned, sets: int) -> list[float]:
    """In which share of made-up sets each plan's interval holds the truth."""
    rng, held = np.random.default_rng(5), [0] * len(planned)
    for number in range(sets):
        hits, groups = sample(rng)
        for which, plan_of in enumerate(planned):
            interval = of_share(hits, plan_of(hits, groups), seed=number)
            held[which] += interval.low <= 100 * truth <= interval.high
    return [count / sets for count in held]


def of_share(hits: np.ndarray, plan: Resampling, *, seed: int = 0) -> Interval:
    draws = [100 * (some @ hits) / some.sum(axis=1) for some in replace(plan, seed=seed, times=TIMES).weights()]
    share = 100 * float(hits.mean())
    return proportion_interval(share, np.concatenate(draws), units=plan.units, counted=len(hits))


def alone(hits: np.ndarray, _: list[str]) -> Resampling:
    return SamplingDesign("query").resampling(np.arange(len(hits)), hits)


def together(hits: np.ndarray, groups: list[str]) -> Resampling:
    return SamplingDesign("group", groups=tuple(groups)).resampling(np.arange(len(hits)), hits)


def along(hits: np.ndarray, _: list[str]) -> Resampling:
    return SamplingDesign("block", order=tuple(range(len(hits)))).resampling(np.arange(len(hits)), hits)


# 400 sets: a share of 0.95 scatters by 0.011, so 0.915 is over three times that below.
@pytest.mark.parametrize(("queries", "truth"), [(60, 0.97), (111, 0.5), (200, 0.8)])
def test_of_independent_queries(queries: int, truth: float) -> None:
    def sample(rng: np.random.Generator) -> tuple[np.ndarray, list[str]]:
        return (rng.random(queries) < truth).astype(float), []

    (share,) = covered(sample, truth, alone, sets=400)
    assert 0.915 <= share <= 0.985


def test_of_places_seen_many_times_where_the_naive_one_fails() -> None:
    def sample(rng: np.random.Generator) -> tuple[np.ndarray, list[str]]:
        sizes = rng.integers(3, 20, 40)
        chances = np.repeat(rng.beta(0.7, 0.3, 40), sizes)
        groups = np.repeat(np.arange(40), sizes).astype(str).tolist()
        return (rng.random(len(chances)) < chances).astype(float), groups

    naive, ours = covered(sample, 0.7, alone, together, sets=300)
    assert naive < 0.7
    assert 0.91 <= ours <= 0.985


def test_of_the_frames_of_a_drive_where_the_naive_one_fails() -> None:
    limit = statistics.NormalDist().inv_cdf(0.85)

    def sample(rng: np.random.Generator) -> tuple[np.ndarray, list[str]]:
        noise, state, hits = rng.standard_normal(300), 0.0, []
        state = float(noise[0])
        for step in noise:
            state = 0.7 * state + math.sqrt(1 - 0.7**2) * float(step)
            hits.append(state < limit)
        return np.array(hits, dtype=float), []

    naive, ours = covered(sample, 0.85, alone, along, sets=250)
    assert naive < 0.85
    assert 0.88 <= ours <= 0.985  # a memory that has to be guessed costs a little


@given(st.integers(1, 40), st.sampled_from(["query", "group", "block"]), st.integers(0, 5))
def test_every_draw_is_of_whole_units(queries: int, by: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    groups = rng.integers(0, 4, queries).astype(str).tolist()
    order = rng.permutation(queries)
    plan = {
        "query": alone(np.zeros(queries), []),
        "group": Resampling("group", queries, np.unique(groups, return_inverse=True)[1]),
        "block": Resampling("block", queries, np.argsort(np.argsort(order)), min(5, queries)),
    }[by]
    weights = np.concatenate(list(replace(plan, seed=seed, times=7).weights()))
    assert weights.shape == (7, queries)
    assert (weights >= 0).all()
    if by == "group":
        assert weights.sum(axis=1).min() > 0
        for group in set(groups):  # all of a group or none of it
            assert (np.ptp(weights[:, np.array(groups) == group], axis=1) == 0).all()
    else:
        assert (weights.sum(axis=1) == plan.units * plan.length).all()
    assert (weights == np.concatenate(list(replace(plan, seed=seed, times=7).weights()))).all()


def test_a_stretch_is_of_neighbours_and_goes_round() -> None:
    plan = Resampling("block", 6, np.array([5, 4, 3, 2, 1, 0]), 3)
    for row in np.concatenate(list(replace(plan, seed=0, times=50).weights()))[:, ::-1]:  # along the drive
        starts = [np.roll([1, 1, 1, 0, 0, 0], start) for start in range(6)]
        assert any((row == one + two).all() for one in starts for two in starts)


def test_the_length_of_a_stretch_follows_the_memory() -> None:
    rng = np.random.default_rng(0)
    short = (rng.random(900) < 0.8).astype(float)
    long = np.repeat(rng.random(18) < 0.8, 50).astype(float)
    assert block_length(short) == 20  # twice the cube root
    assert 40 < block_length(long) <= 150
    assert block_length(np.ones(900)) == 20
    assert [block_length(np.ones(count)) for count in (1, 3, 30)] == [1, 1, 5]
    assert block_length(np.array([0.0, 1.0] * 50)) >= 1  # its long-run spread is nothing


def test_all_right_is_not_certain() -> None:
    one = of_share(np.ones(100), alone(np.ones(100), []))
    assert one.high == 100
    assert 95 < one.low < 97.5  # Wilson's of 100 out of 100 is 96.3
    few = of_share(np.ones(100), together(np.ones(100), ["a", "b", "c", "d"] * 25))
    assert few.low < 50  # four places tell little
    none = of_share(np.zeros(100), alone(np.zeros(100), []))
    assert none.low == 0
    assert none.high == pytest.approx(100 - one.low)


def test_many_queries_of_one_kind_are_never_surer_than_independent_ones() -> None:
    hits = np.array([1.0, 0.0] * 50)
    paired = of_share(hits, together(hits, [str(number // 2) for number in range(100)]))  # each group: one of each
    assert paired.high - paired.low == pytest.approx(2 * 9.6, abs=0.8)


def test_few_units_are_believed_as_student_has_it() -> None:
    # Half of the queries right, drawn as far apart as independent ones: against a table of Student's quantiles.
    for units, quantile in {4: 3.182, 6: 2.571, 31: 2.042, 1001: 1.962, 2: 12.706, 1: 12.706}.items():
        spread = 100 * math.sqrt(0.25 / 400 * max(1, units - 1) / units)  # what makes 400 queries worth 400
        one = proportion_interval(50.0, np.array([50 - spread, 50 + spread]), units=units, counted=400)
        half = math.sqrt(quantile**2 / 1600 + quantile**4 / 640_000) / (1 + quantile**2 / 400)
        assert list(one) == pytest.approx([50 - 100 * half, 50 + 100 * half], abs=0.01)


def test_percentiles() -> None:
    assert percentile_interval(np.arange(1000.0)) == Interval(24, 975)
    assert percentile_interval(np.array([1.0, np.inf])) == (1.0, np.inf)


@given(st.dictionaries(st.sampled_from([1, 5, 10, 20]), st.tuples(st.floats(0, 50), st.floats(50, 100)), min_size=1))
def test_intervals_of_growing_shares_grow(ends: dict[int, tuple[float, float]]) -> None:
    found = nested({key: Interval(*pair) for key, pair in ends.items()})
    assert list(found) == list(ends)
    lows = [found[key].low for key in sorted(found)]
    highs = [found[key].high for key in sorted(found)]
    assert lows == sorted(lows)
    assert highs == sorted(highs)
    assert all(one.low <= one.high for one in found.values())


def test_designs() -> None:
    values = np.array([1.0, 0.0, 1.0])
    some = np.array([0, 2, 3])
    grouped = SamplingDesign("group", groups=("a", "b", "a", "b"))
    assert grouped.resampling(some, values).unit_of.tolist() == [0, 0, 1]
    assert grouped.resampling(some[:2], values[:2]).by == "query"  # one group alone tells no spread
    block = SamplingDesign("block", order=(9, 1, 5, 7)).resampling(some, values)
    assert (block.by, block.unit_of.tolist()) == ("block", [2, 0, 1])
    assert SamplingDesign("query").resampling(some, values).units == 3
