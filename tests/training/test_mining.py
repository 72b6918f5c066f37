"""Mining: places planted alike are found, near ones never meet, and everybody is taken once."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from salad.datasets.samplers import CliqueSampler
from salad.datasets.training_place import TrainingPlace
from salad.errors import BenchmarkError
from salad.geo import GeoPoint, metres_between, shifted
from salad.models.fake import FakeDescriber
from salad.training.batches import ImageCache
from salad.training.mining import mine

HOME = GeoPoint(48.1, 11.9999)
MODEL = FakeDescriber(dim=64)


@pytest.fixture
def images() -> Iterator[ImageCache]:
    with ImageCache(MODEL.preprocessing) as made:
        yield made


def places(root: Path, looks: list[int], *, step_m: float | None = 1000.0) -> list[TrainingPlace]:
    """One place a number; equal numbers look alike but for some noise. With `step_m`, along a street."""
    made = []
    for number, look in enumerate(looks):
        folder = root / f"{number:02d}"
        folder.mkdir(parents=True)
        scene = np.random.default_rng(look).integers(0, 256, (8, 8, 3))
        for shot in range(4):
            noise = np.random.default_rng((number, shot)).normal(0, 6, scene.shape)
            pixels = np.clip(scene + noise, 0, 255).astype(np.uint8)
            Image.fromarray(pixels).resize((64, 64), Image.Resampling.NEAREST).save(folder / f"{shot}.png")
        where = None if step_m is None else shifted(HOME, 0.0, number * step_m)
        made.append(TrainingPlace(f"{number}", "city", tuple(sorted(folder.iterdir())), where))
    return made


def check(cliques: list[list[int]], count: int, size: int) -> None:
    taken = list(itertools.chain.from_iterable(cliques))
    assert len(set(taken)) == len(taken)
    assert set(taken) <= set(range(count))
    assert all(2 <= len(clique) <= size for clique in cliques)


@pytest.mark.parametrize("step_m", [1000.0, None])
def test_places_planted_alike_come_out_together(tmp_path: Path, images: ImageCache, step_m: float | None) -> None:
    planted = places(tmp_path / "data", [0, 1, 2, 3, 4, 5, 0, 1, 2, 3, 4, 5], step_m=step_m)
    cliques = mine(MODEL, planted, images, folder=tmp_path / "run", size=2)
    check(cliques, 12, 2)
    assert {frozenset(clique) for clique in cliques} == {frozenset((n, n + 6)) for n in range(6)}


def test_larger_cliques_hold_all_that_is_alike(tmp_path: Path, images: ImageCache) -> None:
    planted = places(tmp_path / "data", [0, 1, 2, 0, 1, 2, 0, 1, 2, 7])
    cliques = mine(MODEL, planted, images, folder=tmp_path / "run", size=3)
    check(cliques, 10, 3)
    assert {frozenset(clique) for clique in cliques} == {frozenset((n, n + 3, n + 6)) for n in range(3)}
    whole = mine(MODEL, planted, images, folder=tmp_path / "run", size=10)
    assert len(whole) == 1
    assert sorted(whole[0]) == list(range(10))


def test_near_places_never_share_a_clique_however_alike(tmp_path: Path, images: ImageCache) -> None:
    """Five near each other look the same, and so does one far off: it goes with one of the five alone."""
    planted = places(tmp_path / "data", [0, 0, 0, 0, 0, *range(10, 60), 0], step_m=20.0)
    cliques = mine(MODEL, planted, images, folder=tmp_path / "run", size=4, apart_m=100)
    check(cliques, len(planted), 4)
    for clique in cliques:
        for one, other in itertools.combinations(clique, 2):
            a, b = planted[one].where, planted[other].where
            assert a
            assert b
            assert metres_between(a, b) >= 100
    (of_last,) = [clique for clique in cliques if 55 in clique]
    assert len(set(of_last) & set(range(5))) == 1
    CliqueSampler(planted, per_batch=8, views=2, seed=0, cliques=cliques).batch(0)  # what they are for
    close = mine(MODEL, planted, images, folder=tmp_path / "run", size=6, apart_m=0)
    assert {0, 1, 2, 3, 4, 55} in map(set, close)


def test_the_same_model_finds_the_same_cliques_and_leaves_nothing(tmp_path: Path, images: ImageCache) -> None:
    planted = places(tmp_path / "data", [0, 1, 2, 0, 1, 5])
    first = mine(MODEL, planted, images, folder=tmp_path / "run", size=3)
    assert mine(MODEL, planted, images, folder=tmp_path / "run", size=3) == first
    assert list((tmp_path / "run").iterdir()) == []


def test_a_broken_photo_is_no_reason_to_stop(tmp_path: Path, images: ImageCache) -> None:
    planted = places(tmp_path / "data", [0, 1, 0, 1])
    planted[2].photos[2].write_bytes(b"no photo")  # the one that stands for its place
    cliques = mine(MODEL, planted, images, folder=tmp_path / "run", size=2)
    assert {frozenset(clique) for clique in cliques} == {frozenset((0, 2)), frozenset((1, 3))}
    assert list(images.broken) == [planted[2].photos[2]]
    for photo in planted[2].photos:
        photo.write_bytes(b"no photo")
    with (
        ImageCache(MODEL.preprocessing) as fresh,
        pytest.raises(BenchmarkError, match="no photo of the place 2"),
    ):
        mine(MODEL, planted, fresh, folder=tmp_path / "run", size=2)
    assert list((tmp_path / "run").iterdir()) == []


def test_places_may_share_a_photo(tmp_path: Path, images: ImageCache) -> None:
    one, two = places(tmp_path / "data", [0, 1])
    twin = TrainingPlace("twin", "city", one.photos, shifted(HOME, 9000.0, 0.0))
    assert mine(MODEL, [one, two, twin], images, folder=tmp_path / "run", size=2) == [[0, 2]]


def test_many_places_are_described_and_asked_for_some_at_a_time(
    tmp_path: Path, images: ImageCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("salad.training.mining._AT_ONCE", 4)
    monkeypatch.setattr("salad.training.mining._ASKED", 3 * MODEL.dim)
    planted = places(tmp_path / "data", [0, 1, 2, 3, 4, 0, 1, 2, 3, 4])
    cliques = mine(MODEL, planted, images, folder=tmp_path / "run", size=2)
    assert {frozenset(clique) for clique in cliques} == {frozenset((n, n + 5)) for n in range(5)}


def test_nothing_alike_makes_no_clique(tmp_path: Path, images: ImageCache) -> None:
    alone = places(tmp_path / "data", [0, 0, 0], step_m=10.0)
    assert mine(MODEL, alone, images, folder=tmp_path / "run", size=3) == []
