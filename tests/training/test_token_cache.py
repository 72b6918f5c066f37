"""Tokens on disk: what a frozen backbone would have said, said once."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from salad.datasets.training_place import TrainingPlace, View
from salad.network.backbones.dinov2 import ViT
from salad.network.config import ModelConfig
from salad.network.network import Network, build
from salad.training.batches import BatchLoader, build_sampler
from salad.training.devices import launch_fabric
from salad.training.recipe import Recipe
from salad.training.token_cache import TokenCache
from tiny_runs import images_of

Teach = Callable[..., Path]
FROZEN: dict[str, Any] = {"tune_steps": 0, "head_steps": 4, "tuned_blocks": 0, "cache_versions": 2}


@pytest.fixture
def cache(vit: ModelConfig, places: list[TrainingPlace], recipe: Recipe, tmp_path: Path) -> Iterator[TokenCache]:
    model, settings = build(vit), dataclasses.replace(recipe, **FROZEN)
    model.backbone.train_last(0)
    sampler = build_sampler(settings, places)
    batches = BatchLoader(model, settings, places, sampler=sampler, fabric=launch_fabric("cpu", "32-true"))
    yield TokenCache(model, batches, folder=tmp_path)
    batches.close()


def _view(place: TrainingPlace, *, photo: int = 0, mirrored: bool = False) -> View:
    return View(place.photos[photo], 0, mirrored, place)


def _weights(run: Path) -> dict[str, torch.Tensor]:
    return load_file(run / "last" / "model.safetensors")


def _passes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many photos passed through the backbone, each time."""
    passed: list[int] = []
    forward = ViT.forward

    def counted(backbone: ViT, images: torch.Tensor) -> Any:
        passed.append(len(images))
        return forward(backbone, images)

    monkeypatch.setattr(ViT, "forward", counted)
    return passed


def test_what_is_kept_are_the_backbones_tokens(cache: TokenCache, places: list[TrainingPlace]) -> None:
    cache.batches.augment = torch.nn.Identity()
    kept = cache.kept(_view(places[0]), 0)
    with torch.no_grad():
        tokens = cache.model.tokens(images_of(cache.model, [places[0].photos[0]]))
    assert {value.dtype for value in kept.values()} == {torch.float16}
    torch.testing.assert_close(kept["patches"].flatten(0, 1).float(), tokens.patches[0], rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(kept["scene"].float(), tokens.cls[0], rtol=1e-3, atol=1e-3)
    (part,) = cache.parts(0, [_view(places[0])] * 3)
    assert (part.patches.shape, part.cls.shape) == ((3, 9, 16), (3, 16))
    assert (part.grid, part.stride) == (tokens.grid, tokens.stride)


def test_a_version_is_described_once_and_is_its_own(
    cache: TokenCache, places: list[TrainingPlace], monkeypatch: pytest.MonkeyPatch
) -> None:
    passed = _passes(monkeypatch)
    asked = [(_view(places[0]), 0), (_view(places[0]), 1), (_view(places[0], mirrored=True), 0)]
    asked.append((_view(places[1]), 0))
    first = [cache.kept(view, version) for view, version in asked]
    assert passed == [1] * 4
    for number, (view, version) in enumerate(asked):
        again = cache.kept(view, version)
        for other, kept in enumerate(first):
            assert torch.equal(again["patches"], kept["patches"]) == (number == other)
    assert passed == [1] * 4


def test_describing_disturbs_no_chance(cache: TokenCache, places: list[TrainingPlace]) -> None:
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    cache.kept(_view(places[2]), 1)
    assert torch.equal(torch.rand(3), expected)


def test_a_damaged_file_is_made_again(cache: TokenCache, places: list[TrainingPlace]) -> None:
    kept = cache.kept(_view(places[0]), 0)
    (file,) = cache.folder.rglob("*.safetensors")
    for content in (b"", b"\x08\x00\x00\x00\x00\x00\x00\x00garbage!"):
        file.write_bytes(content)
        assert torch.equal(cache.kept(_view(places[0]), 0)["patches"], kept["patches"])
        assert torch.equal(load_file(file)["patches"], kept["patches"])


def test_another_content_is_another_photo(cache: TokenCache, places: list[TrainingPlace], tmp_path: Path) -> None:
    photo = tmp_path / "photo.png"
    photo.write_bytes(places[0].photos[0].read_bytes())
    place = dataclasses.replace(places[0], photos=(photo, *places[0].photos))
    name = cache._name(_view(place), 0)
    assert cache._name(_view(place), 0) == name
    os.utime(photo, ns=(1, 1))
    assert cache._name(_view(place), 0) != name
    photo.unlink()
    assert cache._name(_view(place), 0) != name


def test_what_else_decides_tokens_has_a_folder_of_its_own(
    cache: TokenCache, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def folder(model: Network, **settings: Any) -> Path:
        recipe = dataclasses.replace(cache.batches.recipe, **settings)
        batches = BatchLoader(model, recipe, cache.batches.places, sampler=cache.batches.sampler, fabric=cache.fabric)
        batches.close()
        return TokenCache(model, batches, folder=tmp_path).folder

    same = build(cache.model.config)
    assert folder(same, seed=9, head_rate=0.5, places=2) == cache.folder
    others = {
        folder(same, augment="none"),
        folder(same, size=28),
        folder(same, precision="bf16-mixed"),
        folder(build(cache.model.config, seed=1)),
    }
    monkeypatch.setattr("salad.training.token_cache.DECODER", 99)
    assert len(others | {cache.folder, folder(same)}) == 6


def test_a_run_on_cached_tokens_is_the_run_that_describes_every_time(
    teach: Teach, vit: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    teach(tmp_path / "cached", model=vit, recipe=FROZEN)

    def fresh(cache: TokenCache, view: View, version: int) -> Any:
        return cache._made(view, int(cache._name(view, version)[:12], 16))

    monkeypatch.setattr(TokenCache, "kept", fresh)
    teach(tmp_path / "fresh", model=vit, recipe=FROZEN)
    assert not (tmp_path / "fresh" / "tokens").exists()
    torch.testing.assert_close(_weights(tmp_path / "cached"), _weights(tmp_path / "fresh"), rtol=0, atol=0)


def test_where_nothing_is_changed_it_is_the_run_without_a_cache(teach: Teach, vit: ModelConfig, tmp_path: Path) -> None:
    """But for tokens rounded to float16."""
    model = dataclasses.replace(vit, aggregator=dataclasses.replace(vit.aggregator, dropout=0.0))
    plain = {"tune_steps": 0, "head_steps": 4, "tuned_blocks": 0, "augment": "none", "average": 0.0}
    teach(tmp_path / "plain", model=model, recipe=plain)
    teach(tmp_path / "cached", model=model, recipe=plain | {"cache_versions": 1})
    start = build(model, seed=0).state_dict()
    for key, wanted in _weights(tmp_path / "plain").items():
        torch.testing.assert_close(_weights(tmp_path / "cached")[key], wanted, rtol=0, atol=2e-3, msg=key)
    moved = _weights(tmp_path / "plain")["aggregator.feature.0.weight"].float()
    assert float((moved - start["aggregator.feature.0.weight"]).abs().max()) > 2e-3


def test_another_run_on_the_same_tokens_runs_no_backbone(
    teach: Teach, vit: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    passed = _passes(monkeypatch)
    settings = FROZEN | {"held_out": 0.0, "head_steps": 30}  # no judge, who describes too
    teach(tmp_path / "one", model=vit, recipe=settings, tokens=tmp_path / "tokens")
    files = len(list((tmp_path / "tokens").rglob("*.safetensors")))
    assert len(passed) == files <= 24 * 2 * 2  # photos, versions, mirrored or not
    passed.clear()
    teach(
        tmp_path / "two",
        model=vit,
        recipe=settings | {"seed": 0, "head_rate": 0.01},
        tokens=tmp_path / "tokens",
    )
    assert passed == []
    teach(
        tmp_path / "three",
        model=vit,
        recipe=FROZEN | {"held_out": 0.0, "seed": 1},
        tokens=tmp_path / "tokens",
    )
    assert len(passed) < 4 * 6  # another seed draws others, most of them known


class Interrupted(Exception):
    """Somebody pulled the plug."""


def test_an_interrupted_run_on_cached_tokens_ends_as_it_would_have(
    teach: Teach, vit: ModelConfig, tmp_path: Path
) -> None:
    def stop(line: str) -> None:
        if '"step": 3,' in line:
            raise Interrupted

    teach(tmp_path / "whole", model=vit, recipe=FROZEN)
    with pytest.raises(Interrupted):
        teach(tmp_path / "cut", model=vit, recipe=FROZEN, say=stop)
    for number, file in enumerate(sorted((tmp_path / "cut" / "tokens").rglob("*.safetensors"))):
        if number % 2:  # whatever is missing is made alike
            file.unlink()
    teach(tmp_path / "cut", model=vit, recipe=FROZEN)
    torch.testing.assert_close(_weights(tmp_path / "cut"), _weights(tmp_path / "whole"), rtol=0, atol=0)


def test_parts_are_as_small_as_asked_for(cache: TokenCache, places: list[TrainingPlace]) -> None:
    batch = cache.batches.batch(0)
    whole = cache.parts(0, batch)
    cache.batches.recipe = dataclasses.replace(cache.batches.recipe, at_once=4)
    parts = cache.parts(0, batch)
    assert [len(part.cls) for part in parts] == [4, 2]
    np.testing.assert_array_equal(torch.cat([part.patches for part in parts]), whole[0].patches)
