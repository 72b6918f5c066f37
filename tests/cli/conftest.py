"""A small town of photos, a model without weights, and the command line called as a function."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from canary import Canary, seen
from salad.cli.main import run
from salad.geo import GeoPoint, shifted
from salad.images.exif import save_jpeg
from salad.models.fake import FakeDescriber

HOME = GeoPoint(48.1, 11.5)
NAMES = (  # what people call their photos, one every 200 m
    "a [red] wall 1.jpg",
    "東京駅 2.jpg",
    "me@home 3.jpg",
    "[bold]é[oops] 4.jpg",
    "-dash 5.jpg",
    "شارع 6.jpg",
)


@dataclass(frozen=True)
class Ran:
    """What a command did: its exit code, what it wrote to stdout, what to stderr."""

    code: int
    out: str
    err: str

    def json(self) -> Any:
        return json.loads(self.out)


@dataclass(frozen=True)
class Photos:
    """Folders of photos: `references` know their places, the same streets in `queries` do not."""

    references: Path
    queries: Path

    @property
    def reference(self) -> list[Path]:
        return [self.references / name for name in NAMES]

    @property
    def query(self) -> list[Path]:
        return [self.queries / name for name in NAMES]


def street(number: int, side: int = 96) -> np.ndarray:
    """uint8 `[side, side, 3]`: coloured squares that no other number has."""
    squares = np.random.default_rng(number).integers(0, 256, (6, 6, 3), dtype=np.uint8)
    return np.kron(squares, np.ones((side // 6, side // 6, 1), dtype=np.uint8))


def place(number: int) -> GeoPoint:
    """Where the street with that number is."""
    return shifted(HOME, 200.0 * number, 0.0)


@pytest.fixture
def tmp_path(tmp_path: Path) -> Path:
    """Where a test works: empty, and beside it lies the canary."""
    room = tmp_path / "room"
    room.mkdir()
    return room


@pytest.fixture(autouse=True)
def canary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No command touches what lies beside the folder it runs in, nor makes anything there."""
    watched = Canary.beside(tmp_path)
    monkeypatch.chdir(tmp_path)
    yield
    assert watched.changes() == []


@pytest.fixture(scope="session")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Photos]:
    """Never written to by a command."""
    made = Photos(tmp_path_factory.mktemp("references"), tmp_path_factory.mktemp("queries"))
    for number, name in enumerate(NAMES):
        save_jpeg(
            street(number),
            made.references / name,
            where=place(number),
            heading=30.0 * number,
            time=datetime(2024, 5, 1 + number, 12),
        )
        save_jpeg(street(number, side=120), made.queries / name)
    before = [seen(folder) for folder in (made.references, made.queries)]
    yield made
    assert [seen(folder) for folder in (made.references, made.queries)] == before


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Ran]:
    """`cli("info", folder)` runs `salad info FOLDER` in this process; `stdin=` is what it reads."""

    def call(*arguments: object, stdin: str = "") -> Ran:
        monkeypatch.setattr(sys, "stdin", io.StringIO(stdin))
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        return Ran(code, *capsys.readouterr())

    return call


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Every model is a fake one; the list is of what was asked for."""
    specs: list[str] = []

    def load(spec: str | Path, **settings: object) -> FakeDescriber:
        specs.append(str(spec))
        return FakeDescriber(dim=256, name="salad-lite")

    monkeypatch.setattr("salad.models.model_folder.load", load)
    return specs


@pytest.fixture
def city(photos: Photos, cli: Callable[..., Ran], asked: list[str], tmp_path: Path) -> Path:
    """An index of the references."""
    folder = tmp_path / "city.index"
    assert cli("index", photos.references, "--to", folder).code == 0
    asked.clear()
    return folder


@pytest.fixture(scope="session")
def training_photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four places of four photos each."""
    root, chance = tmp_path_factory.mktemp("training") / "set", np.random.default_rng(0)
    for name in "abcd":
        (root / name).mkdir(parents=True)
        scene = chance.integers(20, 236, (8, 8, 3))
        for number in range(4):
            pixels = scene + chance.integers(-20, 20, scene.shape)
            Image.fromarray(pixels.astype(np.uint8)).resize((64, 64)).save(root / name / f"{number}.png")
    return root
