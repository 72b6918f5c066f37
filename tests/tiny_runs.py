"""Six places of four tiny photos each, two tiny models, and a run of a few steps."""

from __future__ import annotations

import dataclasses
import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from salad.datasets.places import find_places
from salad.datasets.training_place import TrainingPlace
from salad.models.describer import Describer, PhotoLike
from salad.network.aggregator_config import SaladConfig
from salad.network.config import LiteConfig, ModelConfig, Preprocessing, ViTConfig
from salad.training.recipe import Preset, Recipe

if TYPE_CHECKING:
    from torch import Tensor

    from salad.network.network import Network

Teach = Callable[..., Path]


def images_of(network: Network, photos: Sequence[PhotoLike]) -> Tensor:
    """Photos, squeezed and normalised as the network takes them."""
    return network.normalise(Describer.of(network).squeezed(photos))


@pytest.fixture(scope="session")
def photo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Never written to by a test."""
    root, chance = tmp_path_factory.mktemp("places") / "set", np.random.default_rng(0)
    for name in "abcdef":
        (root / name).mkdir(parents=True)
        scene = chance.integers(0, 256, (4, 4, 3))
        for number in range(4):
            pixels = np.clip(scene + chance.normal(0, 20, scene.shape), 0, 255).astype(np.uint8)
            Image.fromarray(pixels).resize((32, 32)).save(root / name / f"{number}.png")
    return root


@pytest.fixture(scope="session")
def places(photo_folder: Path) -> list[TrainingPlace]:
    return find_places(photo_folder)


@pytest.fixture(scope="session")
def lite() -> ModelConfig:
    return ModelConfig(
        "tiny",
        LiteConfig(blocks=1),
        SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=4, hidden=8, dropout=0.1),
        Preprocessing(32, 32),
        provenance="a test",
        licence="CC0",
    )


@pytest.fixture(scope="session")
def vit(lite: ModelConfig) -> ModelConfig:
    return dataclasses.replace(lite, backbone=ViTConfig(16, 2, 2, grid=3), preprocessing=Preprocessing(42, 42))


@pytest.fixture(scope="session")
def recipe() -> Recipe:
    return Recipe(
        head_steps=2,
        tune_steps=2,
        places=3,
        views=2,
        warmup=1,
        tuned_blocks=1,
        measure_every=1,
        precision="32-true",
        held_out=0.34,
    )


@pytest.fixture(scope="session")
def teach(places: list[TrainingPlace], lite: ModelConfig, recipe: Recipe) -> Teach:
    """`teach(to, recipe={...}, ...)` trains on the six places, quietly, and gives the model's folder."""

    def call(to: Path, **change: Any) -> Path:
        from salad.training.trainer import train

        options: dict[str, Any] = {"say": lambda _: None, "places": places, "accelerator": "cpu"} | change
        settings = dataclasses.replace(recipe, **options.pop("recipe", {}))
        made = Preset(options.pop("model", lite), "", settings)
        return train(made, options.pop("places"), to=to, **options)

    return call


@pytest.fixture(scope="session")
def observed() -> Callable[..., list[dict[str, Any]]]:
    """`observed(photos, to, ...)` of observed_run.py, in this process."""
    spec = importlib.util.spec_from_file_location(
        "observed_run", Path(__file__).parent / "training" / "observed_run.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    run: Callable[..., list[dict[str, Any]]] = module.observed
    return run
