"""Fitting to photos: k-means against its own conditions, draws by seed, broken photos, and what is kept."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from salad.errors import MissingExtraError, ModelError, PhotoError
from salad.models.describer import Describer, PhotoLike
from salad.models.model_folder import load, write_folder
from salad.network.aggregators.netvlad import NetVlad
from salad.network.aggregators.vlad import Vlad
from salad.network.baseline_config import NetVladConfig, SceneConfig, VladConfig
from salad.network.config import LiteConfig, ModelConfig, Preprocessing
from salad.network.network import Network, build
from salad.training import vocabulary
from salad.training.vocabulary import fit, needs_fitting, with_vocabulary
from tiny_runs import images_of

VLAD = ModelConfig("tiny", LiteConfig(blocks=3), VladConfig(24, clusters=4), Preprocessing(24, 32))
NETVLAD = dataclasses.replace(VLAD, aggregator=NetVladConfig(24, clusters=4))


def _photo(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (24, 32, 3), dtype=np.uint8)


PHOTOS = [_photo(seed) for seed in range(6)]  # 6 x 8 tokens each


def _units(model: Network, photos: Sequence[PhotoLike]) -> np.ndarray:
    """Every token of the photos, at length 1."""
    with torch.no_grad():
        patches = model.tokens(images_of(model, photos)).patches.flatten(0, 1).double().numpy()
    return patches / np.linalg.norm(patches, axis=1, keepdims=True)


def _vocabulary(model: Network) -> np.ndarray:
    assert isinstance(model.aggregator, Vlad)
    return model.aggregator.vocabulary.numpy()


def test_every_word_is_the_mean_of_the_tokens_nearest_to_it() -> None:
    model = build(VLAD)
    fit(model, PHOTOS, seed=0, tokens=10_000)  # more than there are: all are taken
    words, units = _vocabulary(model), _units(model, PHOTOS)
    nearest = np.linalg.norm(units[:, None] - words, axis=2).argmin(axis=1)
    for word in range(4):
        np.testing.assert_allclose(units[nearest == word].mean(axis=0), words[word], atol=2e-3)


def test_as_many_words_as_different_tokens_are_the_tokens() -> None:
    model = build(dataclasses.replace(VLAD, aggregator=VladConfig(24, clusters=48)))
    fit(model, PHOTOS[:1], seed=0)
    order = [np.lexsort(rows.T.round(4)) for rows in (_vocabulary(model), _units(model, PHOTOS[:1]))]
    np.testing.assert_allclose(_vocabulary(model)[order[0]], _units(model, PHOTOS[:1])[order[1]], atol=1e-4)


def test_netvlad_starts_at_centroids() -> None:
    model, vlad = build(NETVLAD), build(VLAD)
    fit(model, PHOTOS, seed=3)
    fit(vlad, PHOTOS, seed=3)
    assert isinstance(model.aggregator, NetVlad)
    np.testing.assert_allclose(model.aggregator.centroids.detach().numpy(), _vocabulary(vlad), atol=1e-6)
    shares = model.aggregator.score(torch.from_numpy(_units(model, PHOTOS)).float()).softmax(dim=1)
    nearest = np.linalg.norm(_units(model, PHOTOS)[:, None] - _vocabulary(vlad), axis=2).argmin(axis=1)
    np.testing.assert_array_equal(shares.argmax(dim=1).numpy(), nearest)


def test_the_same_seed_fits_the_same_and_disturbs_nobody() -> None:
    models = [build(VLAD) for _ in range(3)]
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    for model, seed in zip(models, (1, 1, 2), strict=True):
        fit(model, PHOTOS, seed=seed, tokens=200)
    assert torch.equal(torch.rand(1), expected)
    first, second, other = map(_vocabulary, models)
    np.testing.assert_array_equal(first, second)
    assert np.abs(first - other).max() > 1e-4


def test_no_more_photos_are_read_than_the_tokens_take(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vocabulary, "PER_PHOTO", 10)
    model, read, told = build(VLAD), list[int](), list[tuple[int, int | None]]()

    def squeezed(photo: int, _: Preprocessing) -> np.ndarray:
        read.append(photo)
        return _photo(photo)

    monkeypatch.setattr("salad.models.describer.squeezed", squeezed)
    fit(model, list(range(50)), seed=0, tokens=35, progress=lambda *both: told.append(both))
    assert len(set(read)) == len(read) == 4
    assert told == [(10, 35), (20, 35), (30, 35), (35, 35)]


def test_a_broken_photo_is_told_and_passed_over(tmp_path: Path) -> None:
    told: list[str] = []
    model, sound = build(VLAD), build(VLAD)
    fit(model, [*PHOTOS, tmp_path / "gone.jpg"], seed=0, passed_over=lambda error: told.append(str(error)))
    assert len(told) == 1
    assert "gone.jpg" in told[0]
    assert not needs_fitting(model)
    with pytest.raises(PhotoError, match=r"gone\.jpg"):
        fit(sound, [*PHOTOS, tmp_path / "gone.jpg"], seed=0)
    assert needs_fitting(sound)


@pytest.mark.parametrize(("photos", "different"), [([], 0), ([np.zeros((24, 32, 3), np.uint8)], 12)])
def test_too_few_different_tokens_are_a_sentence(photos: list[np.ndarray], different: int) -> None:
    model = build(dataclasses.replace(VLAD, aggregator=VladConfig(24, clusters=60)))
    with pytest.raises(ModelError, match=r"give \d+ different tokens, but 60 clusters need as many"):
        fit(model, photos, seed=0)
    assert needs_fitting(model)


def test_tokens_that_hardly_differ_are_no_reason_to_warn(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.ones((40, 24), np.float32)
    rows[:20] = -1
    rows[7, 0] = np.nextafter(np.float32(-1), np.float32(0))  # a third token, and no third place for a centroid
    monkeypatch.setattr(vocabulary, "_drawn_tokens", lambda *_, **__: rows)
    model = build(dataclasses.replace(VLAD, aggregator=VladConfig(24, clusters=3)))
    fit(model, PHOTOS, seed=0)
    assert not needs_fitting(model)


def test_fitting_leaves_the_mode_as_it_was() -> None:
    for mode in (True, False):
        model = build(VLAD).train(mode)
        fit(model, PHOTOS, seed=0)
        assert model.training is mode


def test_what_needs_no_fitting_is_left_alone() -> None:
    model = build(dataclasses.replace(VLAD, aggregator=SceneConfig(24)))
    before = model.fingerprint
    assert not needs_fitting(model)
    assert not needs_fitting(model.aggregator)
    fit(model, PHOTOS, seed=0)
    assert model.fingerprint == before


@pytest.mark.parametrize("config", [VLAD, NETVLAD], ids=["vlad", "netvlad"])
def test_a_fitted_model_stays_so_on_disk(config: ModelConfig, tmp_path: Path) -> None:
    model = build(config)
    assert needs_fitting(model)
    assert needs_fitting(model.aggregator)
    fit(model, PHOTOS, seed=0)
    again = load(write_folder(model, tmp_path / "own"))
    assert not needs_fitting(again.network)
    assert again.fingerprint == model.fingerprint
    np.testing.assert_allclose(again.describe(PHOTOS), Describer.of(model).describe(PHOTOS), atol=1e-6)


def test_anylocs_model_has_the_backbone_of_another_and_a_vocabulary() -> None:
    base = build(dataclasses.replace(VLAD, aggregator=SceneConfig(24), licence="CC0"))
    before = base.fingerprint
    made = with_vocabulary(Describer.of(base), PHOTOS, clusters=3, seed=1)
    assert made.config.aggregator == VladConfig(24, clusters=3)
    assert (made.config.name, made.config.licence, made.config.calibration) == ("tiny-vlad", "CC0", None)
    assert made.config.preprocessing == base.config.preprocessing
    assert before in made.config.provenance
    assert base.fingerprint == before
    np.testing.assert_allclose(_units(made, PHOTOS), _units(base, PHOTOS), atol=1e-7)
    rows = Describer.of(made).describe(PHOTOS)
    assert rows.shape == (6, 72)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-5)


def test_without_the_extra_it_is_named_before_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sklearn.cluster", None)
    model = build(VLAD)
    monkeypatch.setattr("salad.models.describer.squeezed", lambda *_: pytest.fail("a photo was read"))
    with pytest.raises(MissingExtraError, match="fitting an aggregator to photos needs the 'train' extra"):
        fit(model, PHOTOS, seed=0)
