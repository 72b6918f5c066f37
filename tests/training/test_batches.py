"""From places to images: mirrored, changed, normalised; only this process's share."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from salad.datasets.training_place import TrainingPlace, View
from salad.errors import ModelError
from salad.images.decode import decode
from salad.network.config import ModelConfig
from salad.network.network import build
from salad.training.batches import BatchLoader, build_sampler, check_processes, count_steps
from salad.training.recipe import Recipe
from tiny_runs import images_of


def _batches(
    config: ModelConfig, places: list[TrainingPlace], recipe: Recipe, *, rank: int = 0, ranks: int = 1
) -> BatchLoader:
    fabric: Any = SimpleNamespace(device=torch.device("cpu"), global_rank=rank, world_size=ranks)
    return BatchLoader(build(config), recipe, places, sampler=build_sampler(recipe, places), fabric=fabric)


def test_mirrored_places_are_mirrored_before_anything_else(
    lite: ModelConfig, places: list[TrainingPlace], recipe: Recipe
) -> None:
    batches = _batches(lite, places, dataclasses.replace(recipe, augment="none"))
    path = places[0].photos[0]
    views = [View(path, 0, mirrored, places[0]) for mirrored in (False, True)]
    plain, mirrored = batches.changed(views)
    torch.testing.assert_close(plain, images_of(batches.model, [path])[0])
    torch.testing.assert_close(mirrored, plain.flip(-1))
    batches.close()


def test_photos_may_be_smaller_in_training(lite: ModelConfig, places: list[TrainingPlace], recipe: Recipe) -> None:
    batches = _batches(lite, places, dataclasses.replace(recipe, size=24, at_once=4))
    parts = batches.parts(0, batches.batch(0))
    assert [tuple(part.shape) for part in parts] == [(4, 3, 24, 24), (2, 3, 24, 24)]
    batches.close()


@pytest.mark.parametrize("augment", ["lite", "none"])
def test_the_last_steps_may_see_photos_as_large_as_in_use(
    lite: ModelConfig, places: list[TrainingPlace], recipe: Recipe, augment: Any
) -> None:
    small = dataclasses.replace(recipe, size=24, full_steps=1, augment=augment)
    batches = _batches(lite, places, small)
    last = small.head_steps + small.tune_steps - 1
    sides = [batches.parts(step, batches.batch(step))[0].shape[-1] for step in range(last + 1)]
    assert sides == [24] * last + [lite.preprocessing.width]
    batches.close()


def test_broken_photos_are_told_once_by_whichever_size_met_them(
    lite: ModelConfig, places: list[TrainingPlace], recipe: Recipe, tmp_path: Path
) -> None:
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"no photo")
    batches = _batches(lite, places, dataclasses.replace(recipe, size=24, full_steps=1, augment="none"))
    place = dataclasses.replace(places[0], photos=(broken, *places[0].photos))
    for full in (False, True):
        batches.changed([View(broken, 0, False, place)], full=full)
    assert len(batches.newly_unreadable()) == 2
    assert batches.newly_unreadable() == []
    batches.close()


def test_every_process_reads_its_share_alone(
    lite: ModelConfig, places: list[TrainingPlace], recipe: Recipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = dataclasses.replace(recipe, augment="none")
    whole = _batches(lite, places, plain)
    (images,) = whole.parts(0, whole.batch(0))
    opened: list[Path] = []
    monkeypatch.setattr("salad.training.batches.decode", _noting(opened))
    shares = []
    for rank in range(4):
        opened.clear()
        batches = _batches(lite, places, plain, rank=rank, ranks=4)
        batches.images.prefetch = lambda _: None  # not the next batch too
        batch = batches.batch(0)
        shares += batches.parts(0, batch)
        assert set(opened) == {view.path for view in batches.rank_slice(batch)}
        assert torch.equal(batches.labels(batch), whole.labels(whole.batch(0)))
        batches.close()
    assert [len(share) for share in shares] == [1, 2, 1, 2]
    torch.testing.assert_close(torch.cat(shares), images)
    whole.close()


def _noting(opened: list[Path]) -> Any:
    def noted(path: Path, *size: Any) -> Any:
        opened.append(path)
        return decode(path, *size)

    return noted


def test_steps_are_counted_or_follow_from_epochs(places: list[TrainingPlace]) -> None:
    plain = Recipe(places=2, views=2, head_steps=3, tune_steps=5)
    assert count_steps(plain, build_sampler(plain, places)) == (3, 8)
    epochs = dataclasses.replace(plain, epochs=4, sampler="one-city", mirror=False)
    assert count_steps(epochs, build_sampler(epochs, places)) == (3, 3 + 4 * 3)  # six places, two a batch


def test_a_batch_must_reach_every_process() -> None:
    check_processes(Recipe(places=2, views=2), 4)
    with pytest.raises(ModelError, match="2 places x 2 photos leaves some of 5 processes without any"):
        check_processes(Recipe(places=2, views=2), 5)
