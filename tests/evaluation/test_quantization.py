"""A quantized model is kept only if it still recognises; by places where photos have them, by themselves where not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from salad.errors import ModelError
from salad.evaluation import quantization
from salad.evaluation.quantization import quantize
from salad.geo import GeoPoint, shifted
from salad.images.exif import save_jpeg
from salad.images.finding import find_photos
from salad.models.describer import Describer
from salad.models.fake import FakeEngine
from salad.network.aggregator_config import SaladConfig
from salad.network.config import ModelConfig, Preprocessing, ViTConfig

CONFIG = ModelConfig("m", ViTConfig(3, 1, 1), SaladConfig(3, 4, 7, 4, 8), Preprocessing(64, 64), provenance="here")
HOME = GeoPoint(48.1, 11.5)


def scene(number: int) -> np.ndarray:
    squares = np.random.default_rng(number).integers(0, 256, (6, 6, 3), dtype=np.uint8)
    return np.asarray(Image.fromarray(squares).resize((96, 96), Image.Resampling.BICUBIC))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """120 places 200 m apart, each seen twice, in another light."""
    made = tmp_path_factory.mktemp("photos")
    for number in range(120):
        for look, light in enumerate((1.0, 0.8)):
            picture = (scene(number) * light).astype(np.uint8)
            save_jpeg(picture, made / f"{number}-{look}.jpg", where=shifted(HOME, 200.0 * number, 0.0))
    return made


@dataclass(frozen=True)
class Spoilt(FakeEngine):
    """Describes all photos nearly alike."""

    def run(self, photos: np.ndarray, outputs: Sequence[str] = ("descriptor",)) -> dict[str, np.ndarray]:
        made = super().run(photos, outputs)  # type: ignore[arg-type]  # names as texts
        made["descriptor"] = np.random.default_rng(len(photos)).standard_normal(made["descriptor"].shape)
        made["descriptor"] /= np.linalg.norm(made["descriptor"], axis=1, keepdims=True)
        return made  # type: ignore[return-value]


@pytest.fixture
def model() -> Describer:
    return Describer(CONFIG, FakeEngine(CONFIG.aggregator.dim))


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Quantizing by hand: how many photos were learnt on, and a model that is as good as before."""
    found: list[int] = []

    def as_good(model: Describer, photos: np.ndarray, *, precision: str) -> Describer:
        found.append(len(photos))
        return Describer(replace(model.config, name=f"m-{precision}"), model.engine)

    monkeypatch.setattr(quantization, "quantized", as_good)
    return found


def test_photos_are_learnt_on_or_judged_by_and_never_both(model: Describer, folder: Path, seen: list[int]) -> None:
    made, kept = quantize(model, find_photos([folder]))
    assert seen == [120]
    assert kept.before == kept.after
    assert kept.queries == 120
    assert kept.rule == "each by a window of itself"  # of 120 held out, 60 would be asked, and fewer have another near
    assert made.config.provenance == f"here; {kept}"
    quantize(model, find_photos([folder]), precision="bf16")
    assert seen[1] == 0


def test_positions_are_what_counts_where_enough_have_them(
    model: Describer, folder: Path, seen: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quantization, "FEWEST", 20)
    _, kept = quantize(model, find_photos([folder]), precision="bf16")
    assert kept.rule == "right within 25 m"
    assert 20 <= kept.queries <= 120
    assert kept.before > 80  # the fake sees colours, and each place has its own


def test_what_is_spoilt_is_refused(model: Describer, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spoilt = Describer(replace(CONFIG, name="m-int8"), Spoilt(CONFIG.aggregator.dim))
    monkeypatch.setattr(quantization, "quantized", lambda *_, **__: spoilt)
    monkeypatch.setattr(quantization, "FEWEST", 5)  # so that places count, which the fake knows by their colours
    with pytest.raises(ModelError, match=r"more than a point is lost.*or take --precision bf16"):
        quantize(model, find_photos([folder]))


def test_the_same_seed_draws_the_same_photos(model: Describer, folder: Path, seen: list[int]) -> None:
    photos = find_photos([folder])
    first, again, other = (quantize(model, photos, seed=seed)[1] for seed in (0, 0, 1))
    assert first == again
    assert (first.before, first.after) != (other.before, other.after) or first.queries == other.queries


def test_too_few_photos_are_a_sentence_and_broken_ones_are_named(
    model: Describer, folder: Path, seen: list[int], tmp_path: Path
) -> None:
    photos = find_photos([folder])
    with pytest.raises(ModelError, match=r"30 photos are too few, 0 of them cannot be read: .* give 200 or more"):
        quantize(model, photos[:30])
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(photos[0].read_bytes()[:500])
    _, kept = quantize(model, [broken, *photos])
    assert len(kept.unreadable) == 1
    assert "broken.jpg" in kept.unreadable[0]


def test_progress_ends_where_it_is_told_to(model: Describer, folder: Path, seen: list[int]) -> None:
    told: list[tuple[int, int]] = []
    quantize(model, find_photos([folder]), progress=lambda done, total: told.append((done, total)))
    assert told == sorted(told)
    assert told[-1][0] == told[-1][1]
