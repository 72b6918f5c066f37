"""EfficientNet-Lite0 and Lite2, the small trunk that ships: pixels -> tokens, fast on any processor.

Names and numbers follow the published ImageNet weights, so they load key by key. Source: Tan and Le, "EfficientNet"
(2019), and the Lite variants of its authors (no squeeze-and-excite, ReLU6 instead of swish, TensorFlow's "same"
padding; the stem is as wide, and the first and the last stage as deep, in every size).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.errors import ModelError
from salad.network.backbones.base import Backbone
from salad.network.config import LiteConfig, LiteKind
from salad.network.tokens import Tokens


class Shape(NamedTuple):
    """One inverted residual block: kernel side, stride, expansion and output channels."""

    kernel: int
    stride: int
    expand: int
    out: int


STEM = 32
AT_ONCE = 8  # photos whose widest tensors still fit a processor's cache: twice as fast as 32 together
STAGES = tuple(zip((3, 3, 5, 3, 5, 5, 3), (1, 2, 2, 2, 1, 2, 1), (1, 6, 6, 6, 6, 6, 6), strict=True))
"""Kernel side, first block's stride and expansion of every stage."""


def _blocks(depths: tuple[int, ...], widths: tuple[int, ...]) -> tuple[Shape, ...]:
    return tuple(
        Shape(kernel, stride if number == 0 else 1, expand, width)
        for (kernel, stride, expand), depth, width in zip(STAGES, depths, widths, strict=True)
        for number in range(depth)
    )


LITES: dict[LiteKind, tuple[Shape, ...]] = {
    "lite0": _blocks((1, 2, 2, 3, 3, 4, 1), (16, 24, 40, 80, 112, 192, 320)),
    "lite2": _blocks((1, 3, 3, 4, 4, 5, 1), (16, 24, 48, 88, 120, 208, 352)),
}


class SamePadConv2d(nn.Conv2d):
    """A convolution padded as TensorFlow pads: an odd pixel goes to the right and below."""

    def __init__(self, inside: int, out: int, *, kernel: int = 1, stride: int = 1, groups: int = 1) -> None:
        super().__init__(inside, out, kernel, stride=stride, groups=groups, bias=False)

    def normalised(self, x: Float[Tensor, "batch c h w"], norm: nn.BatchNorm2d) -> Float[Tensor, "batch c2 h2 w2"]:
        """Convolve and normalise by `norm`'s own statistics, which are fixed: so both are one filter.

        Folding them spares two passes over the widest tensors, in use and in training; gradients reach the
        filter and the norm's weights as if they were apart.
        """
        assert norm.running_mean is not None
        assert norm.running_var is not None
        scale = norm.weight * torch.rsqrt(norm.running_var + norm.eps)
        weight, bias = self.weight * scale[:, None, None, None], norm.bias - norm.running_mean * scale
        # torch pads both sides alike, so only an odd excess costs a copy of the tensor.
        down, right = (self._excess(x.shape[axis]) for axis in (2, 3))
        if down % 2 or right % 2:
            x = F.pad(x, [right // 2, right - right // 2, down // 2, down - down // 2])
            down = right = 0
        return F.conv2d(x, weight, bias, self.stride, (down // 2, right // 2), groups=self.groups)

    def _excess(self, size: int) -> int:
        # TensorFlow gives ceil(size / stride) outputs; this is what the last window wants beyond the last pixel.
        stride, kernel = self.stride[0], self.kernel_size[0]
        return max((-(-size // stride) - 1) * stride + kernel - size, 0)


def _norm(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, eps=1e-3)  # TensorFlow's; torch's own is a hundredth of it


class InvertedResidual(nn.Module):
    """Widen, filter each channel by itself, narrow; add the input back where the shape allows."""

    def __init__(self, inside: int, shape: Shape) -> None:
        super().__init__()
        wide = inside * shape.expand
        self._expand_conv = SamePadConv2d(inside, wide) if shape.expand > 1 else None
        self._bn0 = _norm(wide) if shape.expand > 1 else None
        self._depthwise_conv = SamePadConv2d(wide, wide, kernel=shape.kernel, stride=shape.stride, groups=wide)
        self._bn1 = _norm(wide)
        self._project_conv = SamePadConv2d(wide, shape.out)
        self._bn2 = _norm(shape.out)
        self.residual = shape.stride == 1 and inside == shape.out

    def forward(self, x: Float[Tensor, "batch c h w"]) -> Float[Tensor, "batch c2 h2 w2"]:
        """One block."""
        wide = x
        # In place: these are the widest tensors, and a ReLU's gradient needs its output alone.
        if self._expand_conv is not None and self._bn0 is not None:
            wide = F.relu6(self._expand_conv.normalised(wide, self._bn0), inplace=True)
        wide = F.relu6(self._depthwise_conv.normalised(wide, self._bn1), inplace=True)
        out = self._project_conv.normalised(wide, self._bn2)
        return x + out if self.residual else out


class Lite(Backbone):
    """An EfficientNet-Lite's trunk up to a block; the mean token stands for the scene.

    Its normalisation keeps ImageNet's statistics, in training too: a batch of few places has poor ones.

    Raises:
        ModelError: If there are no so many blocks.
    """

    def __init__(self, config: LiteConfig) -> None:
        super().__init__()
        every = LITES[config.kind]
        if not 1 <= config.blocks <= len(every):
            name = config.kind.capitalize()
            raise ModelError(f"blocks is {config.blocks}, but EfficientNet-{name} has 1 to {len(every)}")
        shapes = every[: config.blocks]
        inputs = (STEM, *(shape.out for shape in shapes))
        self.config, self.width, self.stride = config, shapes[-1].out, 2  # the stem halves the grid once
        for shape in shapes:
            self.stride *= shape.stride
        # Names with underscores are those of the published files.
        self._conv_stem = SamePadConv2d(3, STEM, kernel=3, stride=2)
        self._bn0 = _norm(STEM)
        self._blocks = nn.ModuleList(map(InvertedResidual, inputs, shapes))

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Tokens:
        """Cut normalised photos into tokens; both sides are multiples of the stride."""
        # A photo's tokens are its own, since the statistics are fixed: a batch may be cut as the cache likes it.
        if images.device.type == "cpu" and images.shape[0] > AT_ONCE:
            parts = [self(some) for some in torch.split(images, AT_ONCE)]
            patches, cls = (torch.cat(same) for same in zip(*(part[:2] for part in parts), strict=True))
            return Tokens(patches, cls, parts[0].grid, self.stride)
        images = images.contiguous(memory_format=torch.channels_last)  # depthwise filters run twice as fast
        x = F.relu6(self._conv_stem.normalised(images, self._bn0), inplace=True)
        for block in self._blocks:
            x = block(x)
        return Tokens.of_maps(x, self.stride)

    def blocks_in_order(self) -> list[list[nn.Module]]:
        """The inverted residual blocks."""
        return [[block] for block in self._blocks]
