"""Two results side by side: what changed, whether it is more than chance, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from salad.datasets.benchmark import Benchmark
from salad.errors import BenchmarkError
from salad.evaluation.evaluate_benchmark import EvalSettings, judge
from salad.evaluation.result import Ranked, Result
from salad.evaluation.significance import design_of, differences
from salad.images.photo import Photo

PHOTOS = [Photo(Path(f"r{number}.jpg")) for number in range(3)]


def result(hits: list[bool], *, protocol: str = "radius 25 m", groups: list[str] | None = None, **more: Any) -> Result:
    """Queries that find the right reference, row 0, or another one."""
    ranked = Ranked(np.array([[0 if hit else 1] for hit in hits]))
    benchmark = Benchmark(
        "set",
        protocol,
        more.pop("references", PHOTOS),
        [Photo(Path(f"q{number}.jpg")) for number in range(len(hits))],
        more.pop("positives", [np.array([0])] * len(hits)),
        groups=None if groups is None else tuple(groups),
    )
    return judge(benchmark, ranked, EvalSettings((1,), times=20, **more), model="m")


def test_who_won_and_lost() -> None:
    (found,) = differences(result([True, True, False, False]), result([True, False, True, True]))
    assert (found.k, found.first, found.other, found.points) == (1, 50.0, 75.0, 25.0)
    assert (found.won, found.lost) == (("q2.jpg", "q3.jpg"), ("q1.jpg",))
    assert not found.real
    assert found.interval.low <= 25 <= found.interval.high
    told = found.as_dict()
    assert (told["difference"], told["real"], told["won"]) == (25.0, False, ["q2.jpg", "q3.jpg"])


def test_the_same_result_differs_by_nothing() -> None:
    one = result([True, False] * 20)
    (found,) = differences(one, one)
    assert (found.points, found.chance, found.real) == (0.0, 1.0, False)
    assert found.interval == (0.0, 0.0)


def test_a_great_difference_is_real_and_five_changes_are_not() -> None:
    before = result([False] * 50 + [True] * 50)
    (great,) = differences(before, result([False] * 25 + [True] * 75))
    assert great.real
    assert great.interval.low > 0
    assert great.chance < 0.01
    (back,) = differences(result([False] * 25 + [True] * 75), before)
    assert back.real
    assert back.interval.high < 0
    (few,) = differences(before, result([False] * 45 + [True] * 55))
    assert few.interval.low > 0  # the draws alone would call it real
    assert few.chance > 0.05  # five of five heads
    assert not few.real


def test_one_place_that_turned_is_one_change() -> None:
    groups = [str(number // 20) for number in range(200)]
    before, after = [False] * 200, [number < 20 for number in range(200)]
    (alone,) = differences(result(before), result(after))
    assert alone.real
    (grouped,) = differences(result(before, groups=groups), result(after, groups=groups))
    assert not grouped.real
    assert grouped.chance == pytest.approx(1.0)


def test_chance_finds_nothing_where_there_is_nothing() -> None:
    rng = np.random.default_rng(0)
    real = 0
    for _ in range(60):
        pair = [result((rng.random(80) < 0.7).tolist()) for _ in range(2)]
        real += differences(*pair, times=200)[0].real
    assert real <= 9  # 3 expected


def test_what_cannot_stand_side_by_side() -> None:
    one = result([True, False])
    with pytest.raises(BenchmarkError, match="'radius 25 m' and the other by 'frames ±1'"):
        differences(one, result([True, False], protocol="frames ±1"))
    with pytest.raises(BenchmarkError, match=r"two sets of queries \(2 and 3, 2 of them in both; q2\.jpg"):
        differences(one, result([True, False, True]))
    with pytest.raises(BenchmarkError, match="their references are not the same"):
        differences(one, result([True, False], references=[*PHOTOS, Photo(Path("more.jpg"))]))
    with pytest.raises(BenchmarkError, match="their right references are not the same"):
        differences(one, result([True, False], positives=[np.array([0]), np.array([0, 2])]))
    with pytest.raises(BenchmarkError, match="queries in another order"):
        differences(one, replace(one, per_query=one.per_query[::-1]))
    with pytest.raises(BenchmarkError, match=r"recall at \[1\] and the other at \[5\]"):
        differences(one, replace(one, recall={5: 1.0}))
    with pytest.raises(BenchmarkError, match="unanswerable queries count as misses"):
        differences(one, result([True, False], unanswerable="miss"))


def test_queries_hang_together_as_they_did() -> None:
    grouped = design_of(result([True] * 4, groups=list("aabb")))
    assert (grouped.by, grouped.groups) == ("group", ("a", "a", "b", "b"))
    drive = design_of(result([True, False] * 6, protocol="frames ±1"))
    assert (drive.by, drive.order) == ("block", tuple(range(12)))
    (found,) = differences(*[result([True, False] * 6, protocol="frames ±1")] * 2)
    assert found.chance == 1.0
