"""The describer: photos of every kind, sizes of every kind, batches, fingerprints."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from torch.nn import functional as F

import salad
from salad.errors import ModelError, PhotoError, TooFewTokensError
from salad.models.describer import Describer
from salad.network.aggregator_config import RouteConfig, SaladConfig
from salad.network.aggregators.salad_layout import Route
from salad.network.baseline_config import SceneConfig
from salad.network.config import LiteConfig, ModelConfig, Preprocessing, ViTConfig
from salad.network.network import build
from salad.report import explain

PHOTO = Preprocessing(height=42, width=56)
VIT = ModelConfig(
    "tiny",
    ViTConfig(width=16, depth=1, heads=2, grid=4),
    SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=5, hidden=8),
    PHOTO,
)
LITE = dataclasses.replace(
    VIT,
    backbone=LiteConfig(blocks=3),
    aggregator=SaladConfig(24, 4, 3, 5, 8),
    preprocessing=Preprocessing(24, 36),
)


@pytest.fixture(scope="module", params=[VIT, LITE], ids=["vit", "lite0"])
def model(request: pytest.FixtureRequest) -> Describer:
    return made(request.param)


def made(config: ModelConfig, *, seed: int = 0) -> Describer:
    return Describer.of(build(config, seed=seed))


def _pixels(seed: int, height: int = 60, width: int = 80) -> np.ndarray:
    coarse = np.random.default_rng(seed).integers(0, 256, (5, 6, 3), dtype=np.uint8)
    return np.asarray(Image.fromarray(coarse).resize((width, height), Image.Resampling.BICUBIC))


def _images(batch: int, height: int, width: int) -> torch.Tensor:
    return torch.randn(batch, 3, height, width, generator=torch.Generator().manual_seed(2))


def test_rows_have_length_one_and_the_width_it_says(model: Describer) -> None:
    rows = model.describe([_pixels(0), _pixels(1), _pixels(2)], batch_size=2)
    assert rows.dtype == np.float32
    assert rows.shape == (3, model.dim)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-6)
    assert model.describe([]).shape == (0, model.dim)


@torch.no_grad()
def test_a_batch_of_one_is_the_same_row_of_a_batch(model: Describer) -> None:
    images = _images(11, 42, 56)
    together = model(images)
    for row in (0, 5, 10):
        torch.testing.assert_close(model(images[row : row + 1])[0], together[row], rtol=0, atol=1e-5)
    photos = [_pixels(seed) for seed in range(5)]
    np.testing.assert_allclose(model.describe(photos, batch_size=5), model.describe(photos, batch_size=1), atol=1e-5)


@pytest.mark.parametrize(("given_", "used"), [((50, 61), (56, 56)), ((42, 64), (42, 70)), ((48, 100), (42, 98))])
@torch.no_grad()
def test_a_side_that_is_no_multiple_is_rounded_to_the_nearest(given_: tuple[int, int], used: tuple[int, int]) -> None:
    model, images = made(VIT), _images(2, *given_)
    by_hand = F.interpolate(images, size=used, mode="bilinear", antialias=True)
    assert model.network.tokens(images).grid == (used[0] // 14, used[1] // 14)
    torch.testing.assert_close(model(images), model(by_hand), rtol=0, atol=0)


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 90), st.integers(1, 90))
@torch.no_grad()
def test_the_grid_is_the_nearest_there_is(height: int, width: int) -> None:
    model = made(dataclasses.replace(VIT, aggregator=SceneConfig(16)))
    grid = model.network.tokens(_images(1, height, width)).grid
    for cells, side in zip(grid, (height, width), strict=True):
        assert cells >= 1
        assert abs(cells * 14 - side) <= max(7, 14 - side)


@torch.no_grad()
def test_photos_need_not_be_square(model: Describer) -> None:
    upright, lying = model.network.tokens(_images(1, 168, 84)), model.network.tokens(_images(1, 84, 168))
    assert upright.grid == lying.grid[::-1]
    assert upright.grid[0] == 2 * upright.grid[1]


@torch.no_grad()
def test_images_too_small_for_the_clusters_name_the_side_that_works() -> None:
    config = dataclasses.replace(VIT, aggregator=SaladConfig(16, clusters=64, cluster_dim=2, scene_dim=2, hidden=4))
    model = made(config)
    with pytest.raises(TooFewTokensError, match=r"64 tokens, but 64 clusters .* at least 126 x 126"):
        model(_images(1, 112, 112))
    assert model(_images(1, 126, 126)).shape == (1, 130)


def test_paths_pictures_and_arrays_are_the_same_photo(model: Describer, tmp_path: Path) -> None:
    pixels = _pixels(3)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    rows = model.describe([tmp_path / "a.png", str(tmp_path / "a.png"), Image.fromarray(pixels), pixels])
    np.testing.assert_allclose(rows, np.repeat(rows[:1], 4, axis=0), atol=1e-6)


def test_whatever_names_a_file_is_a_path(tmp_path: Path) -> None:
    Image.fromarray(_pixels(3)).save(tmp_path / "a.png")
    with os.scandir(tmp_path) as entries:
        from_entry, from_path = made(VIT).describe([*entries, tmp_path / "a.png"])
    np.testing.assert_array_equal(from_entry, from_path)


@pytest.mark.parametrize("thing", [3, b"a.png", torch.zeros(3, 9, 9)])
def test_what_is_neither_path_nor_picture_nor_array_is_no_photo(thing: Any) -> None:
    with pytest.raises(TypeError, match=type(thing).__name__):
        made(VIT).describe([thing])


@pytest.mark.parametrize("mode", ["RGBA", "LA", "L", "P"])
def test_a_picture_in_hand_is_read_as_its_file_is(mode: str, tmp_path: Path) -> None:
    picture = Image.fromarray(_pixels(4)).convert(mode)
    if "A" in mode:  # half of it is transparent: over white, from the file and from the hand
        picture.putalpha(Image.linear_gradient("L").resize(picture.size))
    picture.save(tmp_path / "a.png")
    model = made(VIT)
    from_hand, from_file = model.describe([picture, tmp_path / "a.png"])
    np.testing.assert_allclose(from_hand, from_file, atol=1e-6)


def test_an_array_of_the_models_own_size_is_not_resampled() -> None:
    model, pixels = made(VIT), _pixels(5, 42, 56)
    mean, std = (np.array(values, np.float32) for values in (PHOTO.mean, PHOTO.std))
    expected = ((pixels.astype(np.float32) / 255 - mean) / std).transpose(2, 0, 1)
    normalised = model.network.normalise(model.squeezed([pixels]))
    np.testing.assert_allclose(normalised[0].numpy(), expected, atol=1e-5)


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((9, 9, 3), np.float32),
        np.zeros((9, 9), np.uint8),
        np.zeros((9, 9, 4), np.uint8),
        np.zeros((0, 9, 3), np.uint8),
    ],
)
def test_an_array_that_is_no_photo_is_refused(array: np.ndarray) -> None:
    with pytest.raises(PhotoError, match=r"is no photo: give uint8 \[height, width, 3\]"):
        made(VIT).describe([array])


def test_a_missing_photo_is_named(tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match=r"gone\.jpg"):
        made(VIT).describe([tmp_path / "gone.jpg"])


@pytest.mark.parametrize("size", [0, -1])
def test_batches_hold_at_least_one_photo(size: int) -> None:
    with pytest.raises(ModelError, match=f"batch_size is {size}"):
        made(VIT).describe([_pixels(0)], batch_size=size)


def test_describing_leaves_the_models_mode_as_it_was() -> None:
    model = made(VIT)
    expected = model.describe([_pixels(6)])
    model.network.train()
    np.testing.assert_array_equal(model.describe([_pixels(6)]), expected)  # no dropout
    model.token_assignment(_pixels(6))
    assert model.network.training
    with pytest.raises(PhotoError):
        model.describe([np.zeros(3, np.uint8)])
    assert model.network.training


def test_the_token_assignment_says_where_the_tokens_went() -> None:
    model = made(VIT)
    assigned = model.token_assignment(_pixels(7))
    assert assigned.dustbin.shape == assigned.cluster.shape == (3, 4)
    assert assigned.dustbin.min() >= 0
    assert assigned.dustbin.max() <= 1
    plan = model.engine.run(model.squeezed([_pixels(7)]), ("plan",))["plan"][0]
    np.testing.assert_allclose(assigned.dustbin.ravel(), plan[-1].ravel(), atol=1e-6)
    np.testing.assert_array_equal(assigned.cluster.ravel(), plan[:4].argmax(axis=0).ravel())


def test_a_model_without_a_dustbin_says_so() -> None:
    with pytest.raises(ModelError, match="tiny has no dustbin"):
        made(dataclasses.replace(VIT, aggregator=SceneConfig(16))).token_assignment(_pixels(0))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"dustbin": False}, "it was made without one"),
        ({"transport": "dual-softmax"}, "its dual softmax takes no share of a token"),
    ],
)
def test_a_variant_whose_dustbin_has_no_share_says_so(change: dict[str, Any], said: str) -> None:
    aggregator = dataclasses.replace(VIT.aggregator, **change)
    for part in (aggregator, RouteConfig(16, salad=aggregator)):
        model = made(dataclasses.replace(VIT, aggregator=part))
        with pytest.raises(ModelError, match=f"tiny has no dustbin to show: {said}"):
            model.token_assignment(_pixels(0))
        assert explain.share_of(model, Image.fromarray(_pixels(0))) is None
        assert model.describe([_pixels(0)]).shape == (1, model.dim)


def test_a_route_shares_as_its_salad_does() -> None:
    assert isinstance(VIT.aggregator, SaladConfig)
    model, route = (
        made(VIT),
        made(dataclasses.replace(VIT, aggregator=RouteConfig(16, salad=VIT.aggregator))),
    )
    weights = {
        key.replace("aggregator.", "aggregator.salad."): value for key, value in model.network.state_dict().items()
    }
    route.network.load_state_dict(weights, strict=False)
    for mine, theirs in zip(route.token_assignment(_pixels(7)), model.token_assignment(_pixels(7)), strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_models_that_ship_are_known_by_the_fingerprint_they_have_always_had() -> None:
    """Indexes in the field were made with it: change this only together with the weights."""
    assert salad.load("salad-lite").fingerprint == "ea968928572f4e59"
    assert salad.load("salad-vits").fingerprint == "34558a0e8c15db73"


def test_the_route_variant_is_the_same_model_beside_a_layout() -> None:
    route, lite = salad.load("salad-lite-route"), salad.load("salad-lite")
    assert (route.fingerprint, route.dim) == ("c9b2406dab760798", 8960)
    parts, whole = route.network, lite.network
    assert isinstance(parts.aggregator, Route)
    for mine, theirs in ((parts.backbone, whole.backbone), (parts.aggregator.salad, whole.aggregator)):
        for name, weight in theirs.state_dict().items():
            assert torch.equal(mine.state_dict()[name], weight), name
    photo = np.random.default_rng(0).integers(0, 256, (64, 96, 3), dtype=np.uint8)
    aside = np.roll(photo, 24, axis=1)  # the same things elsewhere in the picture
    near, far = (float(np.prod(model.describe([photo, aside]), axis=0).sum()) for model in (lite, route))
    assert far < near


def test_parts_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ModelError, match="takes tokens of 24 numbers, but the backbone makes them of 16"):
        made(dataclasses.replace(VIT, aggregator=SceneConfig(24)))


def test_the_same_seed_builds_the_same_weights_and_disturbs_nobody() -> None:
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    first, second, other = made(VIT, seed=1), made(VIT, seed=1), made(VIT, seed=2)
    assert torch.equal(torch.rand(1), expected)
    assert first.fingerprint == second.fingerprint != other.fingerprint


def test_the_fingerprint_changes_with_every_weight() -> None:
    model = made(VIT)
    seen = {model.fingerprint}
    weights = model.network.state_dict()
    for value in weights.values():
        old = value.clone()
        value.view(-1)[-1] += 1e-3
        seen.add(model.fingerprint)
        value.copy_(old)
    assert len(seen) == 1 + len(weights)
    assert model.fingerprint in seen


@pytest.mark.parametrize(
    "change",
    [
        {"height": 56},
        {"width": 42},
        {"mean": (0.485, 0.456, 0.407)},
        {"std": (0.229, 0.225, 0.225)},
        {"resample": "bicubic"},
    ],
    ids=str,
)
def test_the_fingerprint_changes_with_every_setting_of_preprocessing(change: dict[str, object]) -> None:
    other = dataclasses.replace(PHOTO, **change)
    config = dataclasses.replace(VIT, preprocessing=other)
    assert made(config).fingerprint != made(VIT).fingerprint
    assert {field.name for field in dataclasses.fields(Preprocessing)} == {
        "height",
        "width",
        "mean",
        "std",
        "resample",
    }


def test_names_and_origin_leave_the_fingerprint_alone() -> None:
    other = dataclasses.replace(VIT, name="another", provenance="a cellar", licence="MIT")
    assert made(other).fingerprint == made(VIT).fingerprint


def test_the_model_tells_what_it_is() -> None:
    model = made(VIT)
    assert (model.name, model.dim, model.preprocessing, model.device) == (
        "tiny",
        17,
        PHOTO,
        "cpu",
    )


def test_no_code_names_one_makers_accelerator() -> None:
    files = list(Path(salad.__file__).parent.rglob("*.py"))
    assert len(files) > 20
    assert [str(path) for path in files if "cuda" in path.read_text(encoding="utf-8").lower()] == []
