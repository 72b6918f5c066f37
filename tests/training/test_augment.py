"""Augmentation: still photos, fresh every time, repeatable by seed."""

from __future__ import annotations

import sys
from typing import Any, get_args

import pytest
import torch
from torch import nn

from salad.errors import MissingExtraError, ModelError
from salad.training.augment import Augmentation, Fog, LowResolution, Night, OneByOne, Sometimes, augmentation

NAMES = get_args(Augmentation)


def photos(batch: int = 4, height: int = 32, width: int = 32) -> torch.Tensor:
    coarse = torch.rand(batch, 3, 4, 4, generator=torch.Generator().manual_seed(0))
    return torch.nn.functional.interpolate(coarse, size=(height, width), mode="bilinear")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [(24, 36), (37, 31)])
def test_photos_stay_photos_of_their_size(name: Augmentation, size: tuple[int, int]) -> None:
    change = augmentation(name, *size)
    for seed in range(4):
        torch.manual_seed(seed)
        seen = change(photos(12, *size))
        assert seen.shape == (12, 3, *size)
        assert seen.dtype == torch.float32
        assert bool(seen.isfinite().all())
        assert 0 <= float(seen.min()) <= float(seen.max()) <= 1
    assert not any(weight.requires_grad for weight in change.parameters())


@pytest.mark.parametrize("name", ["lite", "paper", "kornia", "robust"])
def test_the_seed_decides_and_every_call_is_fresh(name: Augmentation) -> None:
    change = augmentation(name, 32, 32)
    torch.manual_seed(3)
    first, second = change(photos()), change(photos())
    torch.manual_seed(3)
    assert torch.equal(augmentation(name, 32, 32)(photos()), first)
    assert not torch.equal(first, second)


@pytest.mark.parametrize("name", NAMES)
def test_the_photos_given_are_left_alone(name: Augmentation) -> None:
    given = photos()
    torch.manual_seed(0)
    augmentation(name, 32, 32)(given)
    assert torch.equal(given, photos())


def test_none_changes_nothing() -> None:
    assert torch.equal(augmentation("none", 32, 32)(photos()), photos())


@pytest.mark.parametrize("name", ["paper", "kornia", "robust", "lite"])
def test_photos_of_a_batch_change_each_in_its_own_way(name: Augmentation) -> None:
    torch.manual_seed(5)
    same = photos(1).expand(16, -1, -1, -1)
    seen = augmentation(name, 32, 32)(same)
    assert len({tuple(photo.flatten().tolist()) for photo in seen}) >= 12


@pytest.mark.parametrize("name", ["paper", "kornia"])
def test_what_the_paper_does_to_a_photo_leaves_it_in_sight(name: Augmentation) -> None:
    """Three operations at 9 of 30 are mild: lights go both ways, and nothing is turned into its negative."""
    torch.manual_seed(0)
    given = photos(60, 48, 48)
    seen = augmentation(name, 48, 48)(given)
    inner = (slice(None), slice(None), slice(16, 32), slice(16, 32))
    lighter = (seen[inner] - given[inner]).mean(dim=(1, 2, 3))
    assert int((lighter > 0.01).sum()) > 8
    assert int((lighter < -0.01).sum()) > 8
    alike = torch.stack(
        [torch.corrcoef(torch.stack([a.flatten(), b.flatten()]))[0, 1] for a, b in zip(seen, given, strict=True)]
    )
    assert float(alike.median()) > 0.4


def test_lite_draws_what_it_has_always_drawn() -> None:
    """The same modules in the same order, and no draw besides theirs: the shipped weights depend on it."""
    change = augmentation("lite", 24, 36)
    names = [type(module).__name__ for module in change]
    assert names == [
        *("RandomResizedCrop", "RandomPerspective", "RandomAffine"),
        *("ColorJiggle", "RandomGamma", "RandomPlanckianJitter", "RandomGrayscale"),
        *("LowResolution", "RandomGaussianBlur", "RandomGaussianNoise", "RandomErasing", "Hardtanh"),
    ]
    torch.manual_seed(9)
    whole = change(photos(6, 24, 36))
    after = torch.rand(3)
    torch.manual_seed(9)
    seen = photos(6, 24, 36)
    for module in list(change)[:-1]:
        seen = module(seen)
    assert torch.equal(torch.rand(3), after)
    assert torch.equal(seen.clamp(0, 1), whole)


def test_robust_knows_night_weather_blur_compression_crops_and_perspective() -> None:
    kinds = {type(module).__name__ for module in augmentation("robust", 64, 64)}
    assert {
        *("Night", "Fog", "RandomSnow", "RandomRain", "RandomGaussianBlur", "RandomMotionBlur"),
        *("RandomJPEG", "RandomResizedCrop", "RandomPerspective"),
    } <= kinds
    assert "RandomRain" not in {type(module).__name__ for module in augmentation("robust", 16, 16)}


@pytest.mark.parametrize("size", [(30, 50), (64, 64), (224, 160)])
def test_rain_falls_on_photos_of_any_size(size: tuple[int, int]) -> None:
    (rain,) = [module for module in augmentation("robust", *size) if type(module).__name__ == "RandomRain"]
    always: Any = rain
    always.p = 1.0
    torch.manual_seed(0)
    wet = always(photos(3, *size))
    share = (wet != photos(3, *size)).any(dim=1).float().mean()
    assert 0.001 < float(share) < 0.5


def test_night_is_dark_warm_and_noisy() -> None:
    torch.manual_seed(0)
    given = photos(64, 48, 48)
    seen = Night(p=1.0)(given)
    assert float(seen.mean()) < 0.6 * float(given.mean())
    red, _, blue = seen.mean(dim=(0, 2, 3)).tolist()
    assert red > 1.1 * blue
    assert bool((seen != given).flatten(1).any(dim=1).all())
    assert float(seen.min()) >= 0
    assert float(seen.max()) <= 1


def test_night_does_not_turn_dark_photos_black() -> None:
    torch.manual_seed(0)
    given = photos(64, 48, 48) * 0.15
    seen = Night(p=1.0)(given)
    assert float(seen.mean(dim=(1, 2, 3)).min()) > 0.02
    assert bool(Night(p=1.0)(torch.zeros(4, 3, 8, 8)).isfinite().all())


def test_fog_takes_contrast_and_gives_light() -> None:
    torch.manual_seed(0)
    given = photos(64, 48, 48) * 0.5
    seen = Fog(p=1.0)(given)
    assert bool((seen.mean(dim=(1, 2, 3)) > given.mean(dim=(1, 2, 3))).all())
    assert bool((seen[..., 24, :].std(dim=-1) < given[..., 24, :].std(dim=-1)).all())
    assert float(seen.max()) <= 1


@pytest.mark.parametrize("kind", [Night, Fog])
def test_weather_takes_a_share_of_the_photos(kind: type[Sometimes]) -> None:
    torch.manual_seed(0)
    given = torch.rand(200, 3, 12, 12)
    changed = (kind(p=0.3)(given) != given).flatten(1).any(dim=1)
    assert 30 < int(changed.sum()) < 90
    assert torch.equal(kind(p=0.0)(given), given)


def test_one_by_one_draws_for_each_photo() -> None:
    class Shift(nn.Module):
        def forward(self, given: torch.Tensor) -> torch.Tensor:
            assert len(given) == 1
            return given * 0 + torch.rand(1)

    class Ones(nn.Module):
        def forward(self, given: torch.Tensor) -> torch.Tensor:
            return torch.ones_like(given)

    torch.manual_seed(0)
    seen = OneByOne(Shift(), Ones())(torch.zeros(40, 3, 2, 2))
    values = seen[:, 0, 0, 0]
    assert 8 < int((values == 1).sum()) < 32
    assert len(set(values.tolist())) > 8
    assert OneByOne(Ones())(torch.zeros(0, 3, 2, 2)).shape == (0, 3, 2, 2)


def test_low_resolution_loses_detail_and_keeps_light() -> None:
    torch.manual_seed(0)
    given = torch.rand(6, 3, 40, 48)
    coarse = LowResolution(p=1.0)(given)
    assert coarse.shape == given.shape
    torch.testing.assert_close(coarse.mean(dim=(2, 3)), given.mean(dim=(2, 3)), rtol=0, atol=0.03)
    assert bool((coarse.var(dim=(2, 3)) < 0.7 * given.var(dim=(2, 3))).all())
    assert torch.equal(LowResolution(p=0.0)(given), given)


def test_low_resolution_takes_a_share_of_the_photos() -> None:
    torch.manual_seed(0)
    given = torch.rand(200, 3, 12, 12)
    changed = (LowResolution(p=0.3)(given) != given).flatten(1).any(dim=1)
    assert 30 < int(changed.sum()) < 90


@pytest.mark.parametrize("name", ["lite", "kornia", "robust"])
def test_without_the_extra_its_name_is_told(name: Augmentation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kornia", None)
    with pytest.raises(MissingExtraError, match="training needs the 'train' extra"):
        augmentation(name, 32, 32)


def test_an_augmentation_there_is_not_lists_those_there_are() -> None:
    unknown: Any = "wild"
    with pytest.raises(ModelError, match="no augmentation 'wild': choose one of lite, paper, kornia, robust, none"):
        augmentation(unknown, 32, 32)
