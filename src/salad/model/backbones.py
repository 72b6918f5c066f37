"""Every backbone but the vision transformer: pixels -> the same Tokens.

`Lite0` is EfficientNet-Lite0's trunk: small enough to ship, fast on any processor. Names and numbers follow the
published ImageNet weights, so they load key by key. Source: Tan and Le, "EfficientNet" (2019), and the Lite
variants of its authors (no squeeze-and-excite, ReLU6 instead of swish, TensorFlow's "same" padding).
"""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.config import BackboneConfig, LiteConfig
from salad.errors import ModelError
from salad.model.tokens import Tokens
from salad.model.vit import ViT


class Shape(NamedTuple):
    """One inverted residual block: kernel side, stride, expansion and output channels."""

    kernel: int
    stride: int
    expand: int
    out: int


STEM = 32
LITE0: tuple[Shape, ...] = (
    Shape(3, 1, 1, 16),
    *(Shape(3, stride, 6, 24) for stride in (2, 1)),
    *(Shape(5, stride, 6, 40) for stride in (2, 1)),
    *(Shape(3, stride, 6, 80) for stride in (2, 1, 1)),
    *(Shape(5, stride, 6, 112) for stride in (1, 1, 1)),
    *(Shape(5, stride, 6, 192) for stride in (2, 1, 1, 1)),
    Shape(3, 1, 6, 320),
)


class SamePadConv(nn.Conv2d):
    """A convolution padded as TensorFlow pads: the odd pixel goes to the right and below."""

    def forward(self, x: Float[Tensor, "batch c h w"]) -> Float[Tensor, "batch c2 h2 w2"]:
        """Pad, then convolve."""
        sides = [self._excess(x.shape[axis]) for axis in (3, 2)]
        return super().forward(F.pad(x, [edge for total in sides for edge in (total // 2, total - total // 2)]))

    def _excess(self, size: int) -> int:
        stride, kernel = self.stride[0], self.kernel_size[0]
        return max((-(-size // stride) - 1) * stride + kernel - size, 0)


def _conv(inside: int, out: int, *, kernel: int = 1, stride: int = 1, groups: int = 1) -> nn.Conv2d:
    return SamePadConv(inside, out, kernel, stride=stride, groups=groups, bias=False)


def _norm(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, eps=1e-3, momentum=0.01)


class InvertedResidual(nn.Module):
    """Widen, filter each channel by itself, narrow; add the input back where the shape allows."""

    def __init__(self, inside: int, shape: Shape) -> None:
        super().__init__()
        wide = inside * shape.expand
        self._expand_conv = _conv(inside, wide) if shape.expand > 1 else None
        self._bn0 = _norm(wide) if shape.expand > 1 else None
        self._depthwise_conv = _conv(wide, wide, kernel=shape.kernel, stride=shape.stride, groups=wide)
        self._bn1 = _norm(wide)
        self._project_conv = _conv(wide, shape.out)
        self._bn2 = _norm(shape.out)
        self.residual = shape.stride == 1 and inside == shape.out

    def forward(self, x: Float[Tensor, "batch c h w"]) -> Float[Tensor, "batch c2 h2 w2"]:
        """One block."""
        wide = x
        if self._expand_conv is not None and self._bn0 is not None:
            wide = F.relu6(self._bn0(self._expand_conv(wide)))
        wide = F.relu6(self._bn1(self._depthwise_conv(wide)))
        out: Tensor = self._bn2(self._project_conv(wide))
        return x + out if self.residual else out


class Lite0(nn.Module):
    """EfficientNet-Lite0's trunk up to a block; the mean token stands for the scene.

    Raises:
        ModelError: `blocks` is not 1 to 16.
    """

    def __init__(self, config: LiteConfig) -> None:
        super().__init__()
        if not 1 <= config.blocks <= len(LITE0):
            raise ModelError(f"blocks is {config.blocks}, but EfficientNet-Lite0 has 1 to {len(LITE0)}")
        shapes = LITE0[: config.blocks]
        inputs = (STEM, *(shape.out for shape in shapes))
        self.config, self.width, self.stride = config, shapes[-1].out, 2
        for shape in shapes:
            self.stride *= shape.stride
        self._conv_stem = _conv(3, STEM, kernel=3, stride=2)
        self._bn0 = _norm(STEM)
        self._blocks = nn.ModuleList(map(InvertedResidual, inputs, shapes))

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Tokens:
        """Cut normalised photos into tokens; both sides are multiples of the stride."""
        x = F.relu6(self._bn0(self._conv_stem(images)))
        for block in self._blocks:
            x = block(x)
        patches = x.flatten(2).transpose(1, 2)
        return Tokens(patches, patches.mean(dim=1), (x.shape[2], x.shape[3]), self.stride)


Backbone = ViT | Lite0


def build_backbone(config: BackboneConfig) -> Backbone:
    """The backbone a configuration describes, with untrained weights."""
    return Lite0(config) if isinstance(config, LiteConfig) else ViT(config)
