"""ResNet-50 and ConvNeXt against plain functions over the published names, cuts, training, files, late imports."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from beartype import beartype
from jaxtyping import jaxtyped
from torch import Tensor
from torch.nn import functional as F

from salad.errors import MissingExtraError, ModelError
from salad.models.describer import Describer
from salad.models.model_folder import load, write_folder
from salad.network.backbones.base import build_backbone
from salad.network.backbones.resnet_convnext import ConvNext, ResNet, own_names
from salad.network.baseline_config import SceneConfig
from salad.network.config import ConvNextConfig, ModelConfig, Preprocessing, ResNetConfig
from salad.network.model_size import parameters
from salad.network.network import build

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("transformers") is None, reason="transformers is not installed"
)
BLOCKS = (3, 4, 6, 3)


def _images(batch: int, height: int, width: int) -> Tensor:
    return torch.randn(batch, 3, height, width, generator=torch.Generator().manual_seed(1))


# --- ResNet-50 -----------------------------------------------------------------------------


def _torchvision(stages: int) -> dict[str, Tensor]:
    """Random weights of ResNet-50 under torchvision's names, up to a stage, and its classifier."""
    made = torch.Generator().manual_seed(5)
    weights: dict[str, Tensor] = {"fc.weight": torch.zeros(10, 2048), "fc.bias": torch.zeros(10)}

    def norm(name: str, channels: int) -> None:
        for part, low, high in (("weight", 0.5, 1.5), ("bias", -0.3, 0.3), ("running_mean", -0.3, 0.3)):
            weights[f"{name}.{part}"] = torch.empty(channels).uniform_(low, high, generator=made)
        weights[f"{name}.running_var"] = torch.empty(channels).uniform_(0.3, 2, generator=made)
        weights[f"{name}.num_batches_tracked"] = torch.tensor(7)

    def convolution(name: str, inside: int, out: int, side: int) -> None:
        scale = (inside * side * side) ** -0.5
        weights[f"{name}.weight"] = scale * torch.randn(out, inside, side, side, generator=made)

    convolution("conv1", 3, 64, 7)
    norm("bn1", 64)
    inside = 64
    for stage in range(1, stages + 1):
        narrow, out = 64 * 2 ** (stage - 1), 256 * 2 ** (stage - 1)
        for block in range(BLOCKS[stage - 1]):
            name = f"layer{stage}.{block}"
            for number, (a, b, side) in enumerate(((inside, narrow, 1), (narrow, narrow, 3), (narrow, out, 1)), 1):
                convolution(f"{name}.conv{number}", a, b, side)
                norm(f"{name}.bn{number}", b)
            if block == 0:
                convolution(f"{name}.downsample.0", inside, out, 1)
                norm(f"{name}.downsample.1", out)
            inside = out
    return weights


def _resnet_by_hand(weights: dict[str, Tensor], images: Tensor, stages: int) -> Tensor:
    """Maps `[batch, channels, rows, columns]` of the paper's network, its strides in the 3 x 3 filters."""

    def norm(x: Tensor, name: str) -> Tensor:
        mean, var, weight, bias = (
            weights[f"{name}.{part}"] for part in ("running_mean", "running_var", "weight", "bias")
        )
        return F.batch_norm(x, mean, var, weight, bias, training=False)

    def filtered(x: Tensor, name: str, stride: int = 1) -> Tensor:
        weight = weights[f"{name}.weight"]
        return F.conv2d(x, weight, stride=stride, padding=weight.shape[-1] // 2)

    x = F.relu(norm(filtered(images, "conv1", 2), "bn1"))
    x = F.max_pool2d(x, 3, stride=2, padding=1)
    for stage in range(1, stages + 1):
        for block in range(BLOCKS[stage - 1]):
            name, stride = f"layer{stage}.{block}", 2 if stage > 1 and block == 0 else 1
            y = F.relu(norm(filtered(x, f"{name}.conv1"), f"{name}.bn1"))
            y = F.relu(norm(filtered(y, f"{name}.conv2", stride), f"{name}.bn2"))
            y = norm(filtered(y, f"{name}.conv3"), f"{name}.bn3")
            if block == 0:
                x = norm(filtered(x, f"{name}.downsample.0", stride), f"{name}.downsample.1")
            x = F.relu(x + y)
    return x


@pytest.fixture(scope="module")
def resnet() -> tuple[ResNet, dict[str, Tensor]]:
    model, weights = ResNet(ResNetConfig(stages=2)), _torchvision(4)
    model.load_state_dict(own_names(model, weights))  # strict: every name is filled, none is left
    return model.eval(), weights


@torch.no_grad()
def test_torchvisions_weights_give_the_papers_network(resnet: tuple[ResNet, dict[str, Tensor]]) -> None:
    model, weights = resnet
    images = _images(2, 64, 48)
    tokens = jaxtyped(typechecker=beartype)(model.forward)(images)
    expected = _resnet_by_hand(weights, images, 2)
    assert tokens.grid == tuple(expected.shape[2:]) == (8, 6)
    torch.testing.assert_close(tokens.patches, expected.flatten(2).transpose(1, 2), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(tokens.cls, expected.mean(dim=(2, 3)), rtol=1e-4, atol=1e-4)


def test_training_keeps_the_statistics(resnet: tuple[ResNet, dict[str, Tensor]]) -> None:
    model, _ = resnet
    before = {key: value.clone() for key, value in model.state_dict().items()}
    with torch.no_grad():
        expected = model(_images(2, 32, 32)).patches
        model.train()
        assert model.training
        torch.testing.assert_close(model(_images(2, 32, 32)).patches, expected, rtol=0, atol=0)
    torch.testing.assert_close(model.state_dict(), before, rtol=0, atol=0)
    model.eval()


@pytest.mark.parametrize("before", ["", "resnet."])
def test_its_own_names_fill_it_with_and_without_what_stands_before_them(
    before: str, resnet: tuple[ResNet, dict[str, Tensor]]
) -> None:
    model, _ = resnet
    theirs = {before + key: value for key, value in model.state_dict().items()} | {"classifier.1.bias": torch.zeros(3)}
    torch.testing.assert_close(own_names(model, theirs), dict(model.state_dict()))


# --- ConvNeXt ------------------------------------------------------------------------------


def _convnext_by_hand(weights: dict[str, Tensor], images: Tensor, depths: list[int]) -> Tensor:
    """Tokens `[batch, n, channels]` of the paper's network, cells last but one."""

    def norm(x: Tensor, name: str) -> Tensor:
        level = (x - x.mean(dim=-1, keepdim=True)) / (x.var(dim=-1, unbiased=False, keepdim=True) + 1e-6).sqrt()
        return level * weights[f"{name}.weight"] + weights[f"{name}.bias"]

    def filtered(x: Tensor, name: str, **how: Any) -> Tensor:
        """A convolution of `[batch, rows, columns, channels]`."""
        maps = F.conv2d(x.permute(0, 3, 1, 2), weights[f"{name}.weight"], weights[f"{name}.bias"], **how)
        return maps.permute(0, 2, 3, 1)

    x = norm(filtered(images.permute(0, 2, 3, 1), "embeddings.patch_embeddings", stride=4), "embeddings.layernorm")
    for stage, depth in enumerate(depths):
        name = f"encoder.stages.{stage}"
        if stage:
            x = filtered(norm(x, f"{name}.downsampling_layer.0"), f"{name}.downsampling_layer.1", stride=2)
        for block in range(depth):
            at = f"{name}.layers.{block}"
            y = norm(filtered(x, f"{at}.dwconv", padding=3, groups=x.shape[3]), f"{at}.layernorm")
            y = F.gelu(y @ weights[f"{at}.pwconv1.weight"].T + weights[f"{at}.pwconv1.bias"])
            y = y @ weights[f"{at}.pwconv2.weight"].T + weights[f"{at}.pwconv2.bias"]
            x = x + weights[f"{at}.layer_scale_parameter"] * y
    return norm(x, "norm").flatten(1, 2)


@torch.no_grad()
def test_convnext_is_the_papers_network() -> None:
    model, made = ConvNext(ConvNextConfig(stages=2)).eval(), torch.Generator().manual_seed(2)
    for weight in model.parameters():  # a fresh one scales its blocks by a millionth
        weight.add_(torch.randn(weight.shape, generator=made), alpha=0.2)
    images = _images(2, 32, 48)
    tokens = jaxtyped(typechecker=beartype)(model.forward)(images)
    expected = _convnext_by_hand(dict(model.state_dict()), images, [3, 3])
    assert tokens.grid == (4, 6)
    torch.testing.assert_close(tokens.patches, expected, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(tokens.cls, expected.mean(dim=1), rtol=1e-3, atol=1e-3)


def test_a_whole_convnexts_norm_is_not_that_of_a_cut_one() -> None:
    cut = ConvNext(ConvNextConfig(stages=1))
    theirs = {f"convnext.{key}": value for key, value in cut.state_dict().items() if not key.startswith("norm.")}
    theirs |= {"classifier.bias": torch.zeros(3)}
    own = {f"convnext.layernorm.{part}": torch.full((96,), 3.0) for part in ("weight", "bias")}
    others = {key: torch.zeros(768) for key in own}
    assert own_names(cut, theirs | others).keys() == cut.state_dict().keys() - {"norm.weight", "norm.bias"}
    assert float(own_names(cut, theirs | own)["norm.bias"][0]) == 3
    assert own_names(cut, theirs | own).keys() == cut.state_dict().keys()


def test_files_of_other_backbones_have_their_names_already() -> None:
    theirs = {"layernorm.weight": torch.zeros(1), "conv1.weight": torch.zeros(2)}
    assert own_names(torch.nn.Identity(), theirs) == theirs


# --- both ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("config", "width", "stride"),
    [
        (ResNetConfig(stages=1), 256, 4),
        (ResNetConfig(), 1024, 16),
        (ResNetConfig(stages=4), 2048, 32),
        (ConvNextConfig(), 384, 16),
        (ConvNextConfig("base"), 512, 16),
        (ConvNextConfig("base", stages=4), 1024, 32),
    ],
    ids=str,
)
def test_width_and_stride_follow_the_cut(config: Any, width: int, stride: int) -> None:
    with torch.device("meta"):
        model = build_backbone(config)
        tokens = model(torch.empty(1, 3, 64, 96))
    assert (model.width, model.stride, tokens.stride) == (width, stride, stride)
    assert tokens.grid == (64 // stride, 96 // stride)
    assert tokens.patches.shape == (1, (64 // stride) * (96 // stride), width)


@pytest.mark.parametrize(
    ("config", "whole", "classifier"),  # of ImageNet's 1000 classes, as published
    [
        (ResNetConfig(stages=4), 25_557_032, 2048 * 1000 + 1000),
        (ConvNextConfig("tiny", stages=4), 28_589_128, 768 * 1000 + 1000),
        (ConvNextConfig("base", stages=4), 88_591_464, 1024 * 1000 + 1000),
    ],
    ids=str,
)
def test_whole_trunks_have_as_many_weights_as_published(config: Any, whole: int, classifier: int) -> None:
    with torch.device("meta"):
        assert parameters(build_backbone(config)) == whole - classifier


@pytest.mark.parametrize("blocks", [0, 1, 4, 6, 7])
def test_a_resnet_trains_its_last_blocks_and_with_all_the_stem(blocks: int) -> None:
    with torch.device("meta"):
        model = ResNet(ResNetConfig(stages=2))
    model.train_last(blocks)
    order = [f"encoder.stages.0.layers.{at}." for at in range(3)] + [
        f"encoder.stages.1.layers.{at}." for at in range(4)
    ]
    wanted = tuple(order[7 - blocks :]) + (("embedder.",) if blocks == 7 else ())
    for name, weight in model.named_parameters():
        assert weight.requires_grad == name.startswith(wanted), name


@pytest.mark.parametrize("blocks", [0, 1, 3, 5, 6])
def test_a_convnext_trains_what_narrows_its_grid_with_the_block_after_it(blocks: int) -> None:
    with torch.device("meta"):
        model = ConvNext(ConvNextConfig(stages=2))
    model.train_last(blocks)
    order = [("encoder.stages.0.layers.0.",), *((f"encoder.stages.0.layers.{at}.",) for at in (1, 2))]
    order += [("encoder.stages.1.layers.0.", "encoder.stages.1.downsampling_layer.")]
    order += [(f"encoder.stages.1.layers.{at}.",) for at in (1, 2)]
    wanted = tuple(name for part in order[6 - blocks :] for name in part)
    wanted += (("norm.",) if blocks else ()) + (("embeddings.",) if blocks == 6 else ())
    for name, weight in model.named_parameters():
        assert weight.requires_grad == name.startswith(wanted), name


@pytest.mark.parametrize("config", [ResNetConfig(stages=1), ConvNextConfig(stages=1)], ids=str)
def test_no_more_blocks_can_be_trained_than_there_are(config: Any) -> None:
    with torch.device("meta"):
        model = build_backbone(config)
    for blocks in (-1, 4):
        with pytest.raises(ModelError, match=f"trained_blocks is {blocks}, but this backbone has 3 blocks"):
            model.train_last(blocks)


@pytest.mark.parametrize(
    "config", [ModelConfig("r", ResNetConfig(stages=1), SceneConfig(256), Preprocessing(32, 48)),
               ModelConfig("c", ConvNextConfig(stages=1), SceneConfig(96), Preprocessing(32, 48))], ids=str
)  # fmt: skip
def test_a_describer_over_it_is_made_kept_and_read_back(
    config: ModelConfig, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    torch.manual_seed(9)
    expected = torch.rand(1)
    torch.manual_seed(9)
    model, again, other = build(config), build(config), build(config, seed=1)
    assert torch.equal(torch.rand(1), expected)  # nobody else's chance is disturbed
    assert model.fingerprint == again.fingerprint != other.fingerprint
    assert load(write_folder(model, tmp_path / "own")).fingerprint == model.fingerprint
    photo = np.random.default_rng(0).integers(0, 256, (40, 40, 3), dtype=np.uint8)
    row = Describer.of(model).describe([photo])
    assert row.shape == (1, config.aggregator.dim)
    assert np.linalg.norm(row) == pytest.approx(1, abs=1e-5)
    assert capfd.readouterr() == ("", "")  # the library beneath says nothing


def test_without_the_extra_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "transformers", None)
    for config, what in ((ResNetConfig(), "a ResNet"), (ConvNextConfig(), "a ConvNeXt")):
        with pytest.raises(MissingExtraError, match=rf"{what} needs the 'train' extra"):
            build_backbone(config)


def test_whoever_builds_none_does_not_wait_for_the_library() -> None:
    code = (
        "import sys, salad.models.model_folder, salad.training.start, salad.network.model_size as counting\n"
        "from salad.network.baseline_config import SceneConfig\n"
        "from salad.network.config import LiteConfig, ModelConfig\n"
        "from salad.network.network import build\n"
        "build(ModelConfig('a', LiteConfig(blocks=1), SceneConfig(16)))\n"
        "counting.table(112)\n"
        "sys.exit(bool({'transformers', 'sklearn'} & sys.modules.keys()))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
