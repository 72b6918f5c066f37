"""Augmentation: still photos, fresh every time, repeatable by seed."""

from __future__ import annotations

import sys

import pytest
import torch

from salad.errors import MissingExtraError
from salad.train.augment import LowResolution, augmentation


def _photos(batch: int = 4, side: int = 32) -> torch.Tensor:
    coarse = torch.rand(batch, 3, 4, 4, generator=torch.Generator().manual_seed(0))
    return torch.nn.functional.interpolate(coarse, size=(side, side), mode="bilinear")


def test_photos_stay_photos_of_the_models_size() -> None:
    torch.manual_seed(1)
    seen = augmentation(24, 36)(_photos(12))
    assert seen.shape == (12, 3, 24, 36)
    assert seen.dtype == torch.float32
    assert bool(seen.isfinite().all())
    assert float(seen.min()) > -0.5
    assert float(seen.max()) < 1.5  # only noise goes beyond


def test_the_seed_decides_and_every_call_is_fresh() -> None:
    change = augmentation(32, 32)
    torch.manual_seed(3)
    first, second = change(_photos()), change(_photos())
    torch.manual_seed(3)
    assert torch.equal(change(_photos()), first)
    assert not torch.equal(first, second)


def test_the_photos_given_are_left_alone() -> None:
    photos = _photos()
    torch.manual_seed(0)
    augmentation(32, 32)(photos)
    LowResolution(p=1.0)(photos)
    assert torch.equal(photos, _photos())


def test_low_resolution_loses_detail_and_keeps_light() -> None:
    torch.manual_seed(0)
    photos = torch.rand(6, 3, 40, 48)
    coarse = LowResolution(p=1.0)(photos)
    assert coarse.shape == photos.shape
    torch.testing.assert_close(coarse.mean(dim=(2, 3)), photos.mean(dim=(2, 3)), rtol=0, atol=0.03)
    assert bool((coarse.var(dim=(2, 3)) < 0.7 * photos.var(dim=(2, 3))).all())
    assert torch.equal(LowResolution(p=0.0)(photos), photos)


def test_low_resolution_takes_a_share_of_the_photos() -> None:
    torch.manual_seed(0)
    photos = torch.rand(200, 3, 12, 12)
    changed = (LowResolution(p=0.3)(photos) != photos).flatten(1).any(dim=1)
    assert 30 < int(changed.sum()) < 90


def test_without_the_extra_its_name_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kornia", None)
    with pytest.raises(MissingExtraError, match="training needs the 'train' extra"):
        augmentation(32, 32)
