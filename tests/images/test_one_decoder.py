"""Whoever has a photo's path sees the same bytes: the library, the index, its queries, evaluation, training."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from salad.datasets.benchmark import Benchmark
from salad.evaluation.evaluate_benchmark import evaluate
from salad.evaluation.leaks import SIDE, thumbnail
from salad.images import workers
from salad.images.decode import decode
from salad.images.photo import Photo
from salad.index.build import index_photos
from salad.index.index import Index
from salad.localize.locate import locate_many
from salad.models.describer import Describer
from salad.models.fake import FakeDescriber
from salad.network.aggregator_config import SaladConfig
from salad.network.config import ModelConfig, Preprocessing, ViTConfig
from salad.network.network import build
from salad.training.batches import ImageCache

SIZE = Preprocessing(56, 70)
TINY = ModelConfig("tiny", ViTConfig(width=16, depth=1, heads=2, grid=4), SaladConfig(16, 4, 3, 5, 8), SIZE)

# From 0.1 to 24 million pixels: how large, in which mode, and how they are saved.
MADE: dict[str, tuple[tuple[int, int], str, dict[str, Any]]] = {
    "small.jpg": ((360, 280), "RGB", {}),
    "plain.jpg": ((1920, 1440), "RGB", {}),
    "progressive.jpg": ((3000, 2000), "RGB", {"progressive": True}),
    "cmyk.jpg": ((2400, 1600), "CMYK", {}),
    "turned.jpg": ((4000, 3000), "RGB", {"exif": 6}),
    "grey.jpg": ((6000, 4000), "L", {}),
    "plain.png": ((1600, 1200), "RGB", {"compress_level": 1}),
    "turned.png": ((1200, 900), "RGB", {"compress_level": 1, "exif": 8}),
}


class Watched:
    """A model that remembers what it made of each photo, in order, by whatever road the photo came."""

    def __init__(self, model: Describer) -> None:
        self.model, self.rows = model, []

    def __getattr__(self, name: str) -> Any:
        return getattr(self.model, name)

    def describe(self, photos: Sequence[Any], *, batch_size: int = 16) -> Any:
        rows = self.model.describe(photos, batch_size=batch_size)
        self.rows += list(rows)
        return rows


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("photos")
    for seed, (name, (size, mode, how)) in enumerate(MADE.items()):
        chance = np.random.default_rng(seed)
        coarse = chance.integers(0, 256, (30, 40, 3), dtype=np.uint8)
        smooth = np.asarray(Image.fromarray(coarse).resize(size, Image.Resampling.BICUBIC))
        tile = chance.integers(0, 60, (500, 500, 1), dtype=np.uint8)  # what is lost where a JPEG is reduced
        fine = np.tile(tile, (9, 13, 1))[: size[1], : size[0]]
        image = Image.fromarray(np.clip(smooth, 60, 195) + fine - 30).convert(mode)
        if orientation := how.get("exif"):
            how = how | {"exif": Image.Exif()}
            how["exif"][0x0112] = orientation
        image.save(folder / name, **how)
    return sorted(folder.iterdir())


@pytest.fixture(scope="module")
def seen(paths: list[Path]) -> list[np.ndarray]:
    """The bytes that all should see."""
    return [decode(path, SIZE.height, SIZE.width, SIZE.resample) for path in paths]


@pytest.fixture
def watched() -> Watched:
    return Watched(Describer.of(build(TINY)))


@pytest.fixture
def index(tmp_path: Path, watched: Watched) -> Iterator[Index]:
    with Index.create(tmp_path / "i", dim=watched.dim, fingerprint=watched.fingerprint, model="tiny") as made:
        yield made


def test_photos_are_large_enough_to_tell(paths: list[Path], seen: list[np.ndarray]) -> None:
    """Decoded in full, the large ones look different: else the tests below would hold nothing."""
    for path, pixels in zip(paths, seen, strict=True):
        with Image.open(path) as image:
            plain = path.name in ("plain.jpg", "progressive.jpg")
            if plain:
                whole = np.asarray(image.resize((SIZE.width, SIZE.height), Image.Resampling.BILINEAR))
                assert not np.array_equal(whole, pixels)


def test_a_model_given_paths(paths: list[Path], seen: list[np.ndarray]) -> None:
    model = Describer.of(build(TINY))
    assert np.array_equal(model.squeezed(paths), model.squeezed(seen))
    assert np.array_equal(model.describe(paths, batch_size=1), model.describe(seen, batch_size=1))
    assert np.array_equal(model.token_assignment(paths[0]).dustbin, model.token_assignment(seen[0]).dustbin)


def test_the_model_for_tests_given_paths(paths: list[Path], seen: list[np.ndarray]) -> None:
    model = FakeDescriber(preprocessing=SIZE)
    assert np.array_equal(model.describe(paths), model.describe(seen))


@pytest.mark.parametrize("starter", [workers._STARTER, "no Python"], ids=["by processes", "by this process"])
def test_the_index_and_its_queries(
    paths: list[Path], seen: list[np.ndarray], index: Index, watched: Watched, starter: str, monkeypatch: Any
) -> None:
    monkeypatch.setattr(workers, "SHARED", workers.Pool(starter))
    due = list(watched.model.describe(seen, batch_size=1))
    index_photos(paths, index, watched, batch_size=1)
    assert np.array_equal(watched.rows, due)
    answers = locate_many(paths, index=index, model=watched, k=1, batch_size=1)
    assert [answer.matches[0].photo.path for answer in answers] == paths
    assert np.array_equal(watched.rows, due + due)
    workers.SHARED.close()


@pytest.mark.parametrize("cached", [False, True])
def test_evaluation(paths: list[Path], seen: list[np.ndarray], watched: Watched, cached: bool, tmp_path: Path) -> None:
    photos = [Photo(path) for path in paths]
    benchmark = Benchmark("made", "itself", photos, photos[:1], [np.array([0])])
    evaluate(benchmark, watched, batch_size=1, cache=tmp_path / "cache" if cached else None)
    due = list(watched.model.describe(seen, batch_size=1))
    assert np.array_equal(watched.rows[: len(due)], due)


def test_training(paths: list[Path], seen: list[np.ndarray]) -> None:
    with ImageCache(SIZE) as cache:
        for path, pixels in zip(paths, seen, strict=True):
            assert np.array_equal(cache.array(path), pixels)


def test_thumbnails_of_leaks(paths: list[Path]) -> None:
    for path in paths:
        assert np.array_equal(thumbnail(path), decode(path, SIDE, SIDE, "box").astype(np.float64).mean(axis=2))
