"""Means and spreads by hand, who leads, and whose order is the paper's."""

from __future__ import annotations

import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.ablation.comparison import (
    BenchmarkColumn,
    MeanOverSeeds,
    ModelLine,
    ReversedPair,
    benchmark_columns,
    leader,
    published_order,
    published_protocols,
    reversed_pairs,
)
from salad.ablation.grids import PaperFigure

TOWN, STREET = BenchmarkColumn("town", "frames ±1"), BenchmarkColumn("street", "radius 25 m")
PERCENTS = st.floats(0, 100, allow_nan=False)


def line(name: str, *town: float, **paper: float | PaperFigure) -> ModelLine:
    published = {
        protocol: one if isinstance(one, PaperFigure) else PaperFigure(protocol, one) for protocol, one in paper.items()
    }
    return ModelLine(name, {TOWN: {1: town, 5: [99.0] * len(town)}} if town else {}, published, len(town))


def test_a_column_is_a_set_under_one_protocol() -> None:
    first = ModelLine("a", {TOWN: {1: [1.0]}})
    second = ModelLine("b", {STREET: {1: [1.0]}, TOWN: {1: [2.0]}})
    third = ModelLine("c", {BenchmarkColumn("town", "frames ±2"): {1: [3.0]}})
    assert [str(column) for column in benchmark_columns([first, second, third])] == [
        *("town, frames ±1", "street, radius 25 m", "town, frames ±2")
    ]
    assert first.recall(STREET) is None
    assert first.recall(TOWN, 5) is None
    assert published_protocols([line("a", x=1.0), line("b", y=2.0, x=1.0)]) == ["x", "y"]


@given(st.lists(PERCENTS, min_size=2, max_size=6))
def test_a_spread_is_mean_and_standard_deviation(times: list[float]) -> None:
    found = MeanOverSeeds.of(times)
    assert found.mean == pytest.approx(statistics.mean(times))
    mean = sum(times) / len(times)
    variance = sum((time - mean) ** 2 for time in times) / (len(times) - 1)
    assert found.deviation == pytest.approx(variance**0.5, abs=1e-6)
    assert found.seeds == len(times)


def test_one_seed_has_no_spread() -> None:
    assert MeanOverSeeds.of([5.0]).deviation is None
    assert MeanOverSeeds.of([5.0]).deviation_of_difference(MeanOverSeeds.of([1.0, 2.0])) is None
    width = MeanOverSeeds.of([0.0, 2.0]).deviation_of_difference(MeanOverSeeds.of([0.0, 4.0]))
    assert width == pytest.approx((2 + 8) ** 0.5)


def test_who_leads_leads_every_other_by_more_than_the_spread() -> None:
    clear = [line("a", 70, 72), line("b", 60, 62), line("c", 30, 90)]
    assert leader(clear, TOWN) is None  # c scatters too much to say
    assert leader(clear[:2], TOWN) is clear[0]
    assert leader([*clear[:2], line("none")], TOWN) is clear[0]
    near = [line("a", 70, 72), line("b", 69, 71)]
    assert leader(near, TOWN) is None
    assert leader(clear[:1], TOWN) is None  # there is nobody to lead
    assert leader([line("a", 90), line("b", 10, 12)], TOWN) is None  # one seed tells no spread
    assert leader(clear, STREET) is None


@given(st.lists(st.tuples(PERCENTS, PERCENTS), min_size=2, max_size=5))
def test_a_leader_has_the_highest_mean_and_is_alone(pairs: list[tuple[float, float]]) -> None:
    lines = [line(str(number), *pair) for number, pair in enumerate(pairs)]
    found = leader(lines, TOWN)
    if found is not None:
        mine = found.recall(TOWN)
        others = [other for each in lines if each is not found and (other := each.recall(TOWN))]
        assert mine is not None
        assert all(mine.mean > other.mean for other in others)


def test_published_figures_order_a_pair_only_where_they_agree() -> None:
    best, middle = line("best", x=90.0, y=80.0), line("middle", x=80.0, y=80.0)
    torn, alone = line("torn", x=85.0, y=20.0), line("alone")
    aside = line("aside", x=PaperFigure("x", 99.0, "another backbone"))
    found = [(one.name, other.name) for one, other in published_order([torn, middle, best, alone, aside])]
    assert found == [("best", "torn"), ("best", "middle")]  # torn and middle: x says one thing, y another
    assert list(published_order([line("a", x=5.0), line("b", x=5.0)])) == []
    assert list(published_order([line("a", x=5.0), line("b", y=1.0)])) == []


def test_reversed_pairs_come_widest_first_and_say_whether_they_are_certain() -> None:
    lines = [
        line("a", 50, 52, x=90.0),
        line("b", 60, 64, x=80.0),
        line("c", 51, 53, x=70.0),
        line("d", x=60.0),  # never measured: no pair of it is looked at
    ]
    looked, pairs = reversed_pairs(lines, TOWN)
    assert looked == 3
    assert [(pair.better, pair.worse, pair.lead) for pair in pairs] == [("b", "a", 11.0), ("c", "a", 1.0)]
    assert [pair.certain for pair in pairs] == [True, False]
    assert pairs[0].deviation == pytest.approx((2 + 8) ** 0.5)
    assert reversed_pairs(lines, STREET) == (0, [])


def test_a_lead_of_one_seed_is_never_certain() -> None:
    assert not ReversedPair("a", "b", 50.0, None).certain
    looked, pairs = reversed_pairs([line("a", 10, x=2.0), line("b", 90, x=1.0)], TOWN)
    assert (looked, pairs) == (1, [ReversedPair("b", "a", 80.0, None)])


@given(st.lists(st.tuples(PERCENTS, PERCENTS), min_size=2, max_size=5))
def test_the_same_order_as_published_reverses_nothing(pairs: list[tuple[float, float]]) -> None:
    same = [line(str(number), mean, mean, x=mean) for number, (mean, _) in enumerate(pairs)]
    assert reversed_pairs(same, TOWN)[1] == []
    upside_down = [line(str(number), mean, mean, x=-mean) for number, (mean, _) in enumerate(pairs)]
    looked, found = reversed_pairs(upside_down, TOWN)
    assert looked == len(found)
