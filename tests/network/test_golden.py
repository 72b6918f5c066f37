"""Every golden tensor, from every published layout, through the one door `load`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor
from torch.nn import functional as F

from salad.models.engines import EngineName
from salad.models.model_folder import load
from salad.models.openvino_engine import openvino
from salad.network.aggregators.salad import Salad
from salad.network.baseline_config import SceneConfig
from salad.network.config import ModelConfig, ViTConfig
from salad.network.export import export_file
from salad.network.network import Network, build
from salad.network.tokens import Tokens

pytestmark = pytest.mark.shared
ATOL = 1e-5
SALAD_SIZES = ("126x126", "224x224", "308x420", "322x322", "518x518")


def _close(found: Tensor, expected: Tensor) -> None:
    torch.testing.assert_close(found, expected, rtol=0, atol=ATOL)


@pytest.fixture(scope="module")
def golden(shared: Path) -> Path:
    return shared / "golden"


@pytest.fixture(scope="module")
def salad_io(golden: Path) -> dict[str, Tensor]:
    return load_file(golden / "salad_io.safetensors")


@pytest.fixture(scope="module")
def flat(golden: Path) -> Network:
    return load(golden / "salad_flat.ckpt", heads=2).network


def test_the_golden_sizes_are_the_ones_tested(salad_io: dict[str, Tensor]) -> None:
    assert {key.split(".")[0] for key in salad_io} == set(SALAD_SIZES)


@pytest.mark.parametrize("size", SALAD_SIZES)
@torch.no_grad()
def test_the_whole_model(flat: Network, salad_io: dict[str, Tensor], size: str) -> None:
    images = salad_io[f"{size}.image"].float()
    tokens = flat.tokens(images)
    descriptors, expected = flat(images), salad_io[f"{size}.descriptor"]
    _close(tokens.cls, salad_io[f"{size}.cls"])
    _close(tokens.patches.mean(dim=1), salad_io[f"{size}.patches_mean"])
    _close(descriptors, expected)
    assert float(F.cosine_similarity(descriptors, expected).min()) > 0.999999


@pytest.fixture(scope="module")
def exported(flat: Network, tmp_path_factory: pytest.TempPathFactory) -> Path:
    to = tmp_path_factory.mktemp("golden") / "model.onnx"
    export_file(flat, to, normalised=True)
    return to


@pytest.mark.parametrize("engine", ["onnxruntime", "openvino"])
def test_the_exported_model_in_other_engines(exported: Path, salad_io: dict[str, Tensor], engine: str) -> None:
    images, expected = (salad_io[f"322x322.{name}"].float().numpy() for name in ("image", "descriptor"))
    if engine == "onnxruntime":
        (found,) = pytest.importorskip("onnxruntime").InferenceSession(exported).run(None, {"images": images})
    else:
        core = openvino().Core()
        found = core.compile_model(exported, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})({"images": images})[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=ATOL)
    assert (found * expected).sum(axis=1).min() > 0.999999


@pytest.mark.parametrize("engine", ["onnx", "openvino"])
@pytest.mark.parametrize("name", ["salad-lite", "salad-lite-route", "salad-vits"])
def test_real_photos_in_other_engines(shared: Path, name: str, engine: EngineName) -> None:
    photos = sorted((shared / "data" / "train").rglob("*.jpg"))[::600][:10]
    assert len(photos) == 10
    due, found = (load(name, engine=each).describe(photos).astype("float64") for each in ("torch", engine))
    assert (due * found).sum(axis=1).min() >= 0.99999  # what leaves an index and its fingerprint valid


def test_a_lightning_checkpoint_is_the_same_model(golden: Path, flat: Network) -> None:
    other = load(golden / "salad_lightning.ckpt", heads=2)
    assert other.fingerprint == flat.fingerprint
    config = flat.config
    assert (config.backbone.kind, config.aggregator.dim) == ("vit", 8448)
    assert config.backbone == ViTConfig(width=64, depth=4, heads=2)


@torch.no_grad()
def test_the_bare_backbone(golden: Path, salad_io: dict[str, Tensor]) -> None:
    model = load(golden / "dinov2_hub.pth", heads=2).network
    for size in ("126x126", "308x420"):
        images = salad_io[f"{size}.image"].float()
        tokens = model.tokens(images)
        _close(tokens.cls, salad_io[f"{size}.cls"])
        _close(tokens.patches.mean(dim=1), salad_io[f"{size}.patches_mean"])
        _close(model(images), F.normalize(salad_io[f"{size}.cls"], dim=1))


@pytest.mark.parametrize(
    ("name", "sizes", "registers", "swiglu"),
    [("reg4", ("224x224", "308x420"), 4, False), ("swiglu", ("224x308",), 0, True)],
)
@torch.no_grad()
def test_registers_and_the_giants_perceptron(
    golden: Path, name: str, sizes: tuple[str, ...], registers: int, swiglu: bool
) -> None:
    model = load(golden / f"dinov2_{name}_hub.pth", heads=2).network
    assert isinstance(model.config.backbone, ViTConfig)
    assert (model.config.backbone.registers, model.config.backbone.swiglu) == (registers, swiglu)
    io = load_file(golden / f"dinov2_{name}_io.safetensors")
    assert {key.split(".")[0] for key in io} == set(sizes)
    for size in sizes:
        tokens = model.tokens(io[f"{size}.image"].float())
        _close(tokens.cls, io[f"{size}.cls"])
        _close(tokens.patches, io[f"{size}.patches"])


@torch.no_grad()
def test_megaloc(golden: Path) -> None:
    model = load(golden / "megaloc.safetensors", heads=2)
    io = load_file(golden / "megaloc_io.safetensors")
    sizes = {key.split(".")[0] for key in io}
    assert sizes == {"224x308", "322x322"}
    for size in sizes:
        _close(model(io[f"{size}.image"].float()), io[f"{size}.descriptor"])


@pytest.mark.parametrize("name", ["full", "medium", "small"])
@torch.no_grad()
def test_the_aggregator(golden: Path, tmp_path: Path, name: str) -> None:
    """These files hold no backbone: a fresh one is put before them, and the whole read as a flat layout."""
    io = load_file(golden / f"aggregator_{name}.safetensors")
    width = io["io.0.cls"].shape[1]
    vit = build(ModelConfig("x", ViTConfig(width, 1, 1, grid=2), SceneConfig(width))).backbone.state_dict()
    raw = {f"backbone.model.{key}": value for key, value in vit.items()}
    raw |= {key: value for key, value in io.items() if key.startswith("aggregator.")}
    torch.save(raw, tmp_path / "a.ckpt")
    aggregator = load(tmp_path / "a.ckpt", heads=1).network.aggregator
    assert isinstance(aggregator, Salad)
    for case in "012":
        cells = io[f"io.{case}.patches"]
        patches = cells.flatten(2).transpose(1, 2)
        tokens = Tokens(patches, io[f"io.{case}.cls"], (cells.shape[2], cells.shape[3]), 14)
        _close(aggregator.plan(tokens), io[f"io.{case}.plan"])  # stored with the dustbin as its last row
        _close(aggregator(tokens), io[f"io.{case}.descriptor"])
