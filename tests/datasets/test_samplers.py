"""Samplers: each batch by its number alone, everybody's turn, and nobody beside a near one."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.datasets.samplers import CliqueSampler, MixedSampler, OneCitySampler, Sampler
from salad.datasets.training_place import TrainingPlace, View
from salad.errors import BenchmarkError
from salad.geo import GeoPoint, metres_between, shifted

HOME = GeoPoint(48.1, 11.9999)  # a few metres west of the edge between two UTM zones


def made(cities: dict[str, int], photos: int = 5, *, step_m: float | None = None) -> list[TrainingPlace]:
    """Places of each city; with `step_m`, along a street, so far from one another."""
    return [
        TrainingPlace(
            f"{number}",
            city,
            tuple(Path(f"{city}/{number}/{photo}") for photo in range(photos)),
            None if step_m is None else shifted(HOME, 0.0, number * step_m),
        )
        for city, count in cities.items()
        for number in range(count)
    ]


def shown(batch: Sequence[View]) -> list[TrainingPlace]:
    """The places of a batch in order of label."""
    labelled = {view.label: view.place for view in batch}
    assert list(labelled) == list(range(len(labelled)))
    return list(labelled.values())


def epoch(sampler: Any, number: int = 0) -> list[list[View]]:
    first = number * sampler.per_epoch
    return [sampler.batch(first + within) for within in range(sampler.per_epoch)]


def check_views(batch: Sequence[View], views: int) -> None:
    """Each place alike often, none of its photos twice before each was seen, all mirrored or none."""
    for label, place in enumerate(shown(batch)):
        of_place = [view for view in batch if view.label == label]
        assert {view.place for view in of_place} == {place}
        assert {view.path for view in of_place} <= set(place.photos)
        assert len({view.mirrored for view in of_place}) == 1
        counts = Counter(view.path for view in of_place)
        assert sum(counts.values()) == views
        assert max(counts.values()) == math.ceil(views / len(place.photos))


def before(
    places: Sequence[TrainingPlace], *, per_batch: int, views: int, seed: int
) -> Iterator[list[tuple[Path, int, bool]]]:
    """What drew the batches of the weights that ship, written out once more."""
    cities: dict[str, list[TrainingPlace]] = {}
    for place in places:
        cities.setdefault(place.city, []).append(place)
    shares = np.sqrt([len(city) for city in cities.values()])
    shares = shares / shares.sum()
    chances = [share / len(city) for city, share in zip(cities.values(), shares, strict=True) for _ in city]
    everyone = [place for city in cities.values() for place in city]
    for number in itertools.count():
        chance = np.random.default_rng((seed, number))
        batch = []
        for label, index in enumerate(chance.choice(len(everyone), per_batch, replace=False, p=chances)):
            photos = everyone[index].photos
            mirrored = bool(chance.random() < 0.5)
            order = [chance.permutation(len(photos)) for _ in range(math.ceil(views / len(photos)))]
            batch += [(photos[photo], label, mirrored) for photo in np.concatenate(order)[:views]]
        yield batch


@settings(max_examples=20)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(2, 6), st.integers(0, 999))
def test_mixed_batches_are_drawn_as_they_always_were(per_batch: int, views: int, photos: int, seed: int) -> None:
    places = [place for pair in zip(made({"a": 6}, photos), made({"b": 6}, photos), strict=True) for place in pair]
    sampler = MixedSampler(places, per_batch=per_batch, views=views, seed=seed)
    old = before(places, per_batch=per_batch, views=views, seed=seed)
    for number, batch in enumerate(itertools.islice(old, 3)):
        assert [(view.path, view.label, view.mirrored) for view in sampler.batch(number)] == batch
        check_views(sampler.batch(number), views)
        assert len(set(map(id, shown(sampler.batch(number))))) == per_batch


def test_a_city_takes_part_by_the_square_root_of_its_size() -> None:
    sampler = MixedSampler(made({"large": 90, "small": 10}), per_batch=1, views=1, seed=0)
    drawn = Counter(sampler.batch(number)[0].place.city for number in range(1000))
    assert drawn["large"] / drawn["small"] == pytest.approx(3, rel=0.3)


def _samplers(places: list[TrainingPlace], **options: Any) -> list[Sampler]:
    given_ = {"per_batch": 4, "views": 3, "seed": 1} | options
    return [
        MixedSampler(places, **given_),
        OneCitySampler(places, **given_),
        CliqueSampler(places, cliques=[[0, 3], [1, 5, 7]], **given_),
    ]


@pytest.mark.parametrize("which", range(3))
def test_the_nth_batch_depends_on_the_seed_and_n_alone(which: int) -> None:
    places = made({"a": 9, "b": 6}, step_m=60)
    numbers = list(range(12))
    one, again = _samplers(places)[which], _samplers(places)[which]
    forward = [one.batch(number) for number in numbers]
    assert [again.batch(number) for number in reversed(numbers)] == forward[::-1]
    assert [_samplers(places, seed=2)[which].batch(number) for number in numbers] != forward
    assert len({str(batch) for batch in forward}) == len(forward)


@pytest.mark.parametrize("which", range(3))
def test_mirrored_where_that_is_asked_for(which: int) -> None:
    places = made({"a": 8})
    for mirror in (True, False):
        sampler = _samplers(places, mirror=mirror)[which]
        mirrored = [view.mirrored for number in range(100) for view in sampler.batch(number)[::3]]
        assert (0.35 * len(mirrored) < sum(mirrored) < 0.65 * len(mirrored)) if mirror else not any(mirrored)


@pytest.mark.parametrize("which", range(3))
def test_too_few_places_for_a_batch_are_a_sentence(which: int) -> None:
    with pytest.raises(BenchmarkError, match="a batch needs 9 places, but there are 8"):
        _samplers(made({"a": 8}), per_batch=9)[which]


@settings(max_examples=30)
@given(
    st.dictionaries(st.sampled_from("abc"), st.integers(1, 30), min_size=1),
    st.integers(3, 8),
    st.integers(1, 6),
    st.sampled_from([None, 150.0, 60.0, 34.0, 12.0]),
    st.integers(0, 999),
)
def test_one_city_a_batch_and_every_place_once_an_epoch(
    cities: dict[str, int], per_batch: int, views: int, step_m: float | None, seed: int
) -> None:
    places = made(cities, step_m=step_m)
    # Within 100 m lie this many steps. A city that long has room for pairs of places that may stand together.
    reach = 0 if step_m is None else math.ceil(100 / step_m) - 1
    roomy = [city for city, count in cities.items() if count > reach + 1]
    if len(places) < per_batch or not roomy:
        with pytest.raises(BenchmarkError, match=r"a batch needs|no two of the"):
            OneCitySampler(places, per_batch=per_batch, views=views, seed=seed)
        return
    sampler = OneCitySampler(places, per_batch=per_batch, views=views, seed=seed)
    for number in (0, 1, 5):
        taken: Counter[TrainingPlace] = Counter()
        for batch in epoch(sampler, number):
            check_views(batch, views)
            together = shown(batch)
            taken.update(together)
            assert 2 <= len(together) <= per_batch
            assert len({place.city for place in together}) == 1
            assert_apart(together, 100)
        assert max(taken.values()) == 1
        if reach == 0:  # nobody is near to anybody
            alone = {city for city, count in cities.items() if count == 1}
            assert {place for place in places if place.city not in alone} == set(taken)


def assert_apart(places: Sequence[TrainingPlace], apart_m: float) -> None:
    for one, other in itertools.combinations(places, 2):
        if one.where and other.where:
            assert metres_between(one.where, other.where) >= apart_m


def test_near_places_take_their_turns_in_other_batches() -> None:
    places = made({"a": 60}, step_m=30)  # three others within 100 m on each side
    sampler = OneCitySampler(places, per_batch=10, views=2, seed=3)
    for number in range(4):
        taken = Counter(place for batch in epoch(sampler, number) for place in shown(batch))
        assert taken == Counter(places)
    assert sampler.per_epoch <= 7
    close = OneCitySampler(places, per_batch=10, views=2, seed=3, apart_m=0)
    assert any(
        metres_between(one.where, other.where) < 100
        for batch in epoch(close)
        for one, other in itertools.combinations(shown(batch), 2)
        if one.where and other.where
    )


@pytest.mark.parametrize("step_m", [None, 40.0])
def test_every_epoch_is_shuffled_anew(step_m: float | None) -> None:
    places = made({"a": 40, "b": 20}, step_m=step_m)
    sampler = OneCitySampler(places, per_batch=8, views=1, seed=0)
    together = [{frozenset(map(places.index, shown(batch))) for batch in epoch(sampler, n)} for n in range(4)]
    for one, other in itertools.combinations(together, 2):
        assert len(one & other) <= 2
    met = [Counter(pair for batch in one for pair in itertools.combinations(sorted(batch), 2)) for one in together]
    shared = sum((met[0] & met[1]).values()) / sum(met[0].values())
    assert shared < 0.5  # a pair that stood together seldom does so again at once


def test_batches_of_a_city_are_even() -> None:
    sampler = OneCitySampler(made({"a": 17}), per_batch=8, views=1, seed=0)
    assert sorted(map(len, epoch(sampler))) == [5, 6, 6]


@settings(max_examples=30)
@given(st.data(), st.integers(2, 8), st.sampled_from([None, 150.0, 45.0]), st.integers(0, 999))
def test_cliques_stay_together_and_near_places_apart(
    data: st.DataObject, per_batch: int, step_m: float | None, seed: int
) -> None:
    places = made({"a": 30, "b": 10}, step_m=step_m)
    order = data.draw(st.permutations(range(40)))
    sizes = data.draw(st.lists(st.integers(2, 5), max_size=8))
    cliques = [order[end - size : end] for size, end in zip(sizes, itertools.accumulate(sizes), strict=True)]
    sampler = CliqueSampler(places, per_batch=per_batch, views=2, seed=seed, cliques=cliques)
    for number in range(6):
        batch = sampler.batch(number)
        check_views(batch, 2)
        together = shown(batch)
        assert 2 <= len(together) <= per_batch
        assert_apart(together, 100)
        if step_m is None:  # nobody has to wait
            assert len(together) == per_batch
            met = [len({places.index(place) for place in together} & set(clique)) for clique in cliques]
            parts = [count for count, clique in zip(met, cliques, strict=True) if 0 < count < len(clique)]
            assert len(parts) <= 1  # the last one, cut


def test_cliques_leave_each_place_its_chance() -> None:
    places = made({"large": 90, "small": 10})
    cliques = [[0, 10, 20, 30], [1, 11], [90, 91, 92]]
    mixed = MixedSampler(places, per_batch=16, views=1, seed=0)
    sampler = CliqueSampler(places, per_batch=16, views=1, seed=0, cliques=cliques)
    drawn, asked = (
        Counter(place for number in range(2000) for place in shown(each.batch(number))) for each in (sampler, mixed)
    )
    for place in places:
        assert drawn[place] == pytest.approx(asked[place], rel=0.3)
    for number, clique in (
        (50, cliques[0]),
        (51, cliques[1]),
        (95, cliques[2]),
    ):  # nor for those they bring along
        for place in clique:
            assert drawn[places[place]] == pytest.approx(drawn[places[number]], rel=0.3)


def test_a_clique_longer_than_a_batch_is_cut_anywhere() -> None:
    sampler = CliqueSampler(made({"a": 12}), per_batch=4, views=1, seed=0, cliques=[list(range(10))])
    batches = [{int(view.place.name) for view in sampler.batch(number)} for number in range(60)]
    of_clique = [batch for batch in batches if batch <= set(range(10))]
    assert len(of_clique) > 10  # where it was drawn first
    assert set().union(*of_clique) == set(range(10))


@pytest.mark.parametrize("cliques", [[[0, 1], [1, 2]], [[0, 12]], [[-1, 3]]])
def test_cliques_of_other_places_are_refused(cliques: list[list[int]]) -> None:
    with pytest.raises(BenchmarkError, match="a clique names a place twice, or one that is not among the 12"):
        CliqueSampler(made({"a": 12}), per_batch=4, views=1, seed=0, cliques=cliques)


def test_near_places_of_a_clique_wait_for_another_batch() -> None:
    places = made({"a": 12}, step_m=60)
    sampler = CliqueSampler(places, per_batch=4, views=1, seed=0, cliques=[[0, 5], [3, 4]])
    taken: Counter[TrainingPlace] = Counter()
    for number in range(60):
        together = shown(sampler.batch(number))
        assert_apart(together, 100)
        taken.update(together)
    assert set(taken) == set(places)


@pytest.mark.parametrize("which", [1, 2])
def test_where_nobody_may_stand_beside_another_there_is_nothing_to_learn(which: int) -> None:
    with pytest.raises(BenchmarkError, match="no two of the 8 places may stand in one batch"):
        _samplers(made({"a": 8}, step_m=10), per_batch=2)[which]


def test_a_place_near_to_all_others_is_left_out_of_cliques() -> None:
    places = made({"a": 3}, step_m=60)  # the middle one has nobody to stand beside
    sampler = CliqueSampler(places, per_batch=2, views=1, seed=0, cliques=[[0, 1]])
    assert {frozenset(shown(sampler.batch(number))) for number in range(9)} == {frozenset({places[0], places[2]})}
