"""What cuts a photo into tokens, as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

from salad.errors import ModelError

ConvNextSize = Literal["tiny", "base"]
LiteKind = Literal["lite0", "lite2"]


@dataclass(frozen=True, slots=True)
class ViTConfig:
    """A DINOv2 vision transformer.

    Args:
        width: numbers in a token (d).
        depth: how many blocks.
        heads: attention heads; DINOv2's own have width / 64.
        patch: side of a patch in pixels.
        grid: side of the square grid the position embeddings were learnt on.
        registers: register tokens between the class token and the patches (0 or 4).
        swiglu: whether the blocks' perceptron is the giant model's SwiGLU.
    """

    width: int
    depth: int
    heads: int
    patch: int = 14
    grid: int = 37
    registers: int = 0
    swiglu: bool = False
    kind: Literal["vit"] = "vit"


@dataclass(frozen=True, slots=True)
class LiteConfig:
    """The trunk of EfficientNet-Lite0 or Lite2, cut after `blocks` of its 16 or 21 blocks.

    The last cut of stride 16 is after 11 blocks of Lite0 (112 channels) and after 15 of Lite2 (120 channels).
    """

    blocks: int = 11
    kind: LiteKind = "lite0"


@dataclass(frozen=True, slots=True)
class ResNetConfig:
    """ResNet-50's trunk, cut after `stages` of its 4 stages (3 of them: stride 16, 1024 channels).

    Raises:
        ModelError: there is no such stage.
    """

    stages: int = 3
    kind: Literal["resnet50"] = "resnet50"

    def __post_init__(self) -> None:
        _check_stages("ResNet-50", self.stages)


@dataclass(frozen=True, slots=True)
class ConvNextConfig:
    """ConvNeXt's trunk, cut after `stages` of its 4 stages (3 of them: stride 16; 384 channels, the base 512).

    Raises:
        ModelError: there is no such size or stage.
    """

    size: ConvNextSize = "tiny"
    stages: int = 3
    kind: Literal["convnext"] = "convnext"

    def __post_init__(self) -> None:
        _check_stages("ConvNeXt", self.stages)
        if self.size not in get_args(ConvNextSize):
            raise ModelError(
                f"size {self.size!r} of ConvNeXt is unknown: give {' or '.join(get_args(ConvNextSize))}"
            )


def _check_stages(name: str, stages: object) -> None:
    if not isinstance(stages, int) or not 1 <= stages <= 4:
        raise ModelError(f"stages is {stages!r}, but {name} has 1 to 4")


BackboneConfig = ViTConfig | LiteConfig | ResNetConfig | ConvNextConfig

BACKBONE_KINDS: dict[str, Any] = {
    "vit": ViTConfig,
    "lite0": LiteConfig,
    "lite2": LiteConfig,
    "resnet50": ResNetConfig,
    "convnext": ConvNextConfig,
}

VITS: dict[str, ViTConfig] = {
    "vits14": ViTConfig(width=384, depth=12, heads=6),
    "vitb14": ViTConfig(width=768, depth=12, heads=12),
    "vitl14": ViTConfig(width=1024, depth=24, heads=16),
    "vitg14": ViTConfig(width=1536, depth=40, heads=24, swiglu=True),
}
"""DINOv2's four sizes."""
