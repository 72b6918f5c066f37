"""The paper's RandAugment: each operation from its definition, and how they are drawn."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
import torch
from PIL import Image

from salad.training.rand_augment import OPERATIONS, RandAugment

SIDE = 40


def photo(seed: int = 0) -> Image.Image:
    coarse = np.random.default_rng(seed).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    return Image.fromarray(coarse).resize((SIDE, SIDE), Image.Resampling.BICUBIC)


def after(name: str, sign: int = 1, given: Image.Image | None = None) -> np.ndarray:
    return np.asarray(OPERATIONS[name](given or photo(), sign)).astype(np.float64)


BEFORE = np.asarray(photo()).astype(np.float64)
GREY = BEFORE @ [0.299, 0.587, 0.114]


def test_there_are_fourteen_and_identity_is_one() -> None:
    assert len(OPERATIONS) == 14
    assert np.array_equal(after("identity"), BEFORE)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_shearing_moves_each_line_by_nine_hundredths_of_its_distance(axis: str, sign: int) -> None:
    ramp = np.tile(np.arange(SIDE), (SIDE, 1))
    given = np.repeat((ramp if axis == "x" else ramp.T)[..., None], 3, axis=2).astype(np.uint8)
    seen = after(f"shear {axis}", sign, Image.fromarray(given * 4))[..., 0]
    lines = np.arange(SIDE)[:, None] + 0.5
    expected = 4 * (np.arange(SIDE)[None] + sign * 0.09 * lines)
    inside = (expected >= 4) & (expected <= 4 * (SIDE - 2))
    got = seen if axis == "x" else seen.T
    assert np.abs(got - expected)[inside].max() < 1.0
    assert (got[expected < -4] == 0).all()  # black outside


@pytest.mark.parametrize("sign", [1, -1])
def test_translating_moves_by_136_thousandths_of_the_side(sign: int) -> None:
    pixels = int(0.1359 * SIDE)
    seen = after("translate x", sign)
    expected = np.zeros_like(BEFORE)
    if sign > 0:
        expected[:, pixels:] = BEFORE[:, :-pixels]
    else:
        expected[:, :-pixels] = BEFORE[:, pixels:]
    assert np.array_equal(seen, expected)
    turned = Image.fromarray(np.asarray(photo()).transpose(1, 0, 2).copy())
    assert np.array_equal(after("translate y", sign, turned), expected.transpose(1, 0, 2))


@pytest.mark.parametrize("sign", [1, -1])
def test_rotating_turns_by_nine_degrees_about_the_middle(sign: int) -> None:
    dot = np.zeros((81, 81, 3), np.uint8)
    dot[39:42, 69:72] = 255  # 30 pixels to the right of the middle
    seen = after("rotate", sign, Image.fromarray(dot))[..., 0]
    rows, columns = np.mgrid[:81, :81]
    middle = (seen * rows).sum() / seen.sum() - 40, (seen * columns).sum() / seen.sum() - 40
    angle = np.radians(9) * sign
    assert middle == pytest.approx((-30 * np.sin(angle), 30 * np.cos(angle)), abs=0.2)  # rows count downwards


@pytest.mark.parametrize("factor", [1.27, 0.73])
def test_lights_go_both_ways_by_27_hundredths(factor: float) -> None:
    sign = 1 if factor > 1 else -1
    blended = {
        "brightness": np.zeros_like(BEFORE),
        "colour": np.repeat(GREY[..., None], 3, axis=2),
        "contrast": np.full_like(BEFORE, round(GREY.mean())),
    }
    for name, other in blended.items():
        expected = (other + factor * (BEFORE - other)).clip(0, 255)
        assert np.abs(after(name, sign) - expected).max() < 1.6, name
    around = np.stack([np.roll(BEFORE, (y, x), (0, 1)) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    smooth = (around.sum(axis=0) + 4 * BEFORE) / 13
    expected = (smooth + factor * (BEFORE - smooth)).clip(0, 255)[1:-1, 1:-1]
    assert np.abs(after("sharpness", sign)[1:-1, 1:-1] - expected).max() < 1.6


def test_posterizing_keeps_seven_bits_and_solarizing_turns_what_is_above_178() -> None:
    bytes_ = np.asarray(photo())
    assert np.array_equal(after("posterize"), bytes_ & 0b11111110)
    assert np.array_equal(after("solarize"), np.where(bytes_ >= 178.5, 255 - bytes_, bytes_))


def test_autocontrast_stretches_each_colour_and_equalizing_spreads_it() -> None:
    dull = Image.fromarray((np.asarray(photo()) // 4 + 60).astype(np.uint8))
    before, seen = np.asarray(dull).astype(np.float64), after("autocontrast", given=dull)
    low, high = before.min(axis=(0, 1)), before.max(axis=(0, 1))
    assert np.abs(seen - (before - low) * 255 / (high - low)).max() <= 1
    spread = np.sort(after("equalize", given=dull)[..., 0].ravel())
    assert np.abs(spread - np.linspace(0, 255, spread.size)).max() < 30


def test_three_are_drawn_for_each_photo_with_replacement() -> None:
    seen: list[tuple[int, str]] = []
    change = RandAugment()
    names = list(OPERATIONS)
    with pytest.MonkeyPatch.context() as patch:
        for name in names:
            patch.setitem(OPERATIONS, name, lambda photo, sign, name=name: seen.append((sign, name)) or photo)
        torch.manual_seed(4)
        change(torch.rand(2_000, 3, 8, 8))
    assert len(seen) == 6_000
    counts = Counter(name for _, name in seen)
    assert all(abs(counts[name] - 6_000 / 14) < 5 * (6_000 / 14) ** 0.5 for name in names)
    assert abs(sum(sign for sign, _ in seen)) < 5 * 6_000**0.5
    threes = [{name for _, name in seen[first : first + 3]} for first in range(0, 6_000, 3)]
    twice = sum(len(three) < 3 for three in threes)
    assert pytest.approx(twice, abs=100) == 2_000 * (1 - 13 * 12 / 14**2)


def test_bytes_stay_bytes() -> None:
    torch.manual_seed(0)
    given = torch.randint(256, (30, 3, 20, 30)) / 255
    seen = RandAugment()(given)
    assert (seen.shape, seen.dtype) == (given.shape, given.dtype)
    assert torch.equal((seen * 255).round() / 255, seen)
