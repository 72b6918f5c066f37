"""A whole model as data: a backbone, an aggregator, how photos are prepared for them, what its scores are worth.

Nothing here imports torch. Names of fields and kinds stand in files of others and in fingerprints: none ever changes.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, get_args

from salad.errors import ModelError
from salad.network.aggregator_config import AggregatorConfig, aggregator_kind

ConvNextSize = Literal["tiny", "base"]
LiteKind = Literal["lite0", "lite2"]


@dataclass(frozen=True, slots=True)
class ViTConfig:
    """A DINOv2 vision transformer.

    Args:
        width: Numbers in a token (d).
        depth: How many blocks.
        heads: Attention heads; DINOv2's own have width / 64.
        patch: Side of a patch in pixels.
        grid: Side of the square grid the position embeddings were learnt on.
        registers: Register tokens between the cls token and the patches (0 or 4).
        swiglu: Whether the blocks' perceptron is the giant model's SwiGLU.
    """

    width: int
    depth: int
    heads: int
    patch: int = 14
    grid: int = 37
    registers: int = 0
    swiglu: bool = False
    kind: Literal["vit"] = "vit"
    module: ClassVar[str] = "salad.network.backbones.dinov2:ViT"


@dataclass(frozen=True, slots=True)
class LiteConfig:
    """The trunk of EfficientNet-Lite0 or Lite2, cut after `blocks` of its 16 or 21 blocks.

    The last cut of stride 16 is after 11 blocks of Lite0 (112 channels) and after 15 of Lite2 (120 channels).
    """

    blocks: int = 11
    kind: LiteKind = "lite0"
    module: ClassVar[str] = "salad.network.backbones.efficientnet:Lite"


@dataclass(frozen=True, slots=True)
class ResNetConfig:
    """ResNet-50's trunk, cut after `stages` of its 4 stages (3 of them: stride 16, 1024 channels).

    Raises:
        ModelError: If there is no such stage.
    """

    stages: int = 3
    kind: Literal["resnet50"] = "resnet50"
    module: ClassVar[str] = "salad.network.backbones.resnet_convnext:ResNet"

    def __post_init__(self) -> None:
        _check_stages("ResNet-50", self.stages)


@dataclass(frozen=True, slots=True)
class ConvNextConfig:
    """ConvNeXt's trunk, cut after `stages` of its 4 stages (3 of them: stride 16; 384 channels, the base 512).

    Raises:
        ModelError: If there is no such size or stage.
    """

    size: ConvNextSize = "tiny"
    stages: int = 3
    kind: Literal["convnext"] = "convnext"
    module: ClassVar[str] = "salad.network.backbones.resnet_convnext:ConvNext"

    def __post_init__(self) -> None:
        _check_stages("ConvNeXt", self.stages)
        if self.size not in get_args(ConvNextSize):
            raise ModelError(f"size {self.size!r} of ConvNeXt is unknown: give {' or '.join(get_args(ConvNextSize))}")


def _check_stages(name: str, stages: object) -> None:
    if not isinstance(stages, int) or not 1 <= stages <= 4:
        raise ModelError(f"stages is {stages!r}, but {name} has 1 to 4")


BackboneConfig = ViTConfig | LiteConfig | ResNetConfig | ConvNextConfig

# By the kinds that stand in `config.json`; the two Lites are one class with different tables.
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


Output = Literal["descriptor", "patches", "cls", "plan"]
"""What a model gives: see `salad.models.engines`."""
Precision = Literal["float32", "bf16", "int8"]
"""What a model computes in; but for the first, such a model is one of its own, with a fingerprint of its own."""
# What an exported graph calls its input, and what it says its settings under: as long as there are graphs on disk.
PHOTOS, SETTINGS = "photos", "salad.settings"
# What every backbone here was trained with.
IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
Resample = Literal["bilinear", "bicubic"]

# What a model's file may ask for, whoever wrote it: well above every model there is, and far below a machine's memory.
MOST_PIXELS = 4096
"""Of a photo's side, as a model takes it."""
MOST_BLOCKS = 256
MOST_NUMBERS = 1 << 20
"""Of a descriptor."""
MOST_OF_WEIGHTS = 1 << 33
"""Bytes of a file of weights; DINOv2's giant in float32 has 4.5 billion."""
_MOST_OF_A_CALIBRATION = 1e6
_LONGEST_TEXT = 1 << 16


@dataclass(frozen=True, slots=True)
class Preprocessing:
    """How a photo becomes the model's input: squeezed (never cropped) to one size, then normalised.

    Args:
        height: Pixels.
        width: Pixels.
        mean: Of each channel, of values in 0..1.
        std: Of each channel, of values in 0..1.
        resample: `bilinear` or `bicubic`, both antialiased.
    """

    height: int = 322
    width: int = 322
    mean: tuple[float, float, float] = IMAGENET_MEAN
    std: tuple[float, float, float] = IMAGENET_STD
    resample: Resample = "bilinear"

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Preprocessing:
        """Read what JSON holds of it.

        Raises:
            ValueError: If a number makes no sense.
            TypeError: If a setting is missing or unknown.
        """
        plain = dict(data)
        mean, std = (tuple(plain.pop(key)) for key in ("mean", "std"))
        # A std of 0 or a NaN would pass silently and make every descriptor one that nothing is near to.
        if len(mean) != 3 or len(std) != 3 or not min(std) > 0 or not all(map(math.isfinite, mean + std)):
            raise ValueError("mean and std need three numbers each, std above 0")
        if max(map(abs, mean + std)) > 1e6 or min(std) < 1e-6:  # 0 or infinite as a network computes with it
            raise ValueError("mean and std are those of values in 0..1")
        found = cls(mean=mean, std=std, **plain)
        # By their very type: JSON's true is an int to Python, and no size of an array.
        if not all(type(side) is int and 0 < side <= MOST_PIXELS for side in (found.height, found.width)):
            raise ValueError(f"height and width are whole pixels, at least 1 and at most {MOST_PIXELS}")
        if found.resample not in get_args(Resample):
            raise ValueError(f"resample is one of {', '.join(get_args(Resample))}")
        return found


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a model's scores are worth, learnt on photos of places that the model never saw.

    The confidence in a place is 1 / (1 + exp(-z)), where
    z = bias + top * its best score + gap * that score's lead on the best elsewhere
    - spread * how far all matches scatter + share * its share of all matches' weight.
    No weight is negative, so better evidence never lowers it. docs/calibration.md tells more.

    The defaults stand in for a model nobody has calibrated: they order places sensibly, but are no probabilities.

    Args:
        sharpness: A match weighs exp(sharpness * score).
        bias: Z of no evidence at all.
        top: Weight of the best score.
        gap: Weight of the lead.
        spread: Weight of the scatter, which lowers the confidence.
        share: Weight of the share.
        radius: Factor on the radius of a place, so that it holds the truth in 90 of 100 answers.
        min_confidence: A place of less is unknown.
        provenance: Which photos these numbers were fitted on.
        centred: Whether the scores are those that leave out what all photos of the index have in common; photos are
            searched for by such scores then.

    Raises:
        ModelError: If a number is not finite, or out of its range.
    """

    sharpness: float = 20.0
    bias: float = -6.0
    top: float = 6.0
    gap: float = 10.0
    spread: float = 2.0
    share: float = 4.0
    radius: float = 1.0
    min_confidence: float = 0.5
    provenance: str = ""
    centred: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.centred, bool):
            raise ModelError(f"centred of the calibration is {self.centred!r}: give true or false")
        for name, value in self.as_dict().items():
            if name in ("centred", "provenance"):
                continue
            # JSON has NaN and infinity in Python's dialect, and true counts as 1: none of them is a weight.
            real = isinstance(value, int | float) and not isinstance(value, bool)
            if not real or not abs(value) <= _MOST_OF_A_CALIBRATION or (value < 0 and name != "bias"):
                raise ModelError(
                    f"{name} of the calibration is {str(value)[:60]!r}: give a finite number, none below 0 and none "
                    f"over {_MOST_OF_A_CALIBRATION:,.0f}"
                )
        if self.radius == 0 or self.min_confidence > 1:
            raise ModelError(
                f"the calibration's radius {self.radius} must be above 0, its min_confidence "
                f"{self.min_confidence} at most 1"
            )

    def as_dict(self) -> dict[str, Any]:
        """This calibration as JSON holds it; `centred`, which came after the others, only where it is so."""
        settings = dataclasses.asdict(self)
        # Models that were calibrated before the setting was there read and write as they did.
        if not self.centred:
            del settings["centred"]
        return settings

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Calibration:
        """Read what `as_dict` wrote.

        Raises:
            ModelError: If a number is missing, unknown or out of its range.
        """
        known = {field.name for field in dataclasses.fields(cls)}
        # Nothing less either: a default in place of a number that was lost would pass for a measured one.
        if not isinstance(data, dict) or {"centred", *data} != known:
            raise ModelError(f"a calibration holds {', '.join(sorted(known))}, nothing else and nothing less")
        return cls(**data)


@dataclass(frozen=True, slots=True)
class ModelConfig:
    """A whole model: what it is made of, how photos are prepared for it, where it comes from, how sure it is.

    Raises:
        ModelError: If there is no such precision.
    """

    name: str
    backbone: BackboneConfig
    aggregator: AggregatorConfig
    preprocessing: Preprocessing = field(default_factory=Preprocessing)
    provenance: str = ""
    licence: str = ""
    calibration: Calibration | None = None
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        if self.precision not in get_args(Precision):
            raise ModelError(f"precision {self.precision!r} is unknown: give one of {', '.join(get_args(Precision))}")

    @property
    def outputs(self) -> tuple[Output, ...]:
        """What an engine of this model can be asked for."""
        # From the configuration and not from the weights: who exports or runs a model asks before loading it.
        return ("descriptor", "patches", "cls", *(("plan",) if self.aggregator.has_plan else ()))

    @property
    def counted(self) -> dict[str, Any]:
        """The settings that say what is computed, as JSON holds them: a change of one makes another model."""
        settings, parts = self.as_dict(), ("backbone", "aggregator", "preprocessing", "precision")
        return {part: settings[part] for part in parts if part in settings}

    def fingerprint(self, weights: Mapping[str, Any]) -> str:
        """What tells this model with these weights from every other, as indexes keep it: 16 hexadecimal digits.

        Weights count in float32, whatever they are stored as, and integers in 64 bits; names, licence and calibration
        do not count.

        Args:
            weights: Arrays under their serialised names.
        """
        # Indexes of the field hold such fingerprints: a change of one byte below would make strangers of all of them.
        digest = hashlib.sha256(json.dumps(self.counted, sort_keys=True).encode())
        for key, value in sorted(weights.items()):
            digest.update(f"{key}{tuple(value.shape)}".encode())
            # Little-endian on every machine, and one precision: a copy of a model in float16 is told by what it rounds.
            digest.update(value.astype("<f4" if value.dtype.kind == "f" else "<i8").tobytes())
        return digest.hexdigest()[:16]

    def as_dict(self) -> dict[str, Any]:
        """This configuration as JSON holds it.

        A model nobody has calibrated says nothing of that, and one that computes in float32 nothing of its precision.
        """
        settings = {**dataclasses.asdict(self), "aggregator": self.aggregator.as_settings()}
        if self.precision == "float32":
            del settings["precision"]
        if self.calibration is None:
            del settings["calibration"]
        else:
            settings["calibration"] = self.calibration.as_dict()
        return settings

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> ModelConfig:
        """Read what `as_dict` wrote.

        Raises:
            ModelError: If a part is missing, of an unknown kind, or has settings this version does not know.
        """
        try:
            rest = dict(data)
            backbone, settings = _backbone(rest.pop("backbone")), dict(rest.pop("aggregator"))
            aggregator = aggregator_kind(settings.get("kind")).from_settings(settings)
            preprocessing = Preprocessing.from_dict(rest.pop("preprocessing"))
            if rest.get("calibration") is not None:
                rest["calibration"] = Calibration.from_dict(rest["calibration"])
            for name in ("name", "provenance", "licence"):
                _check_text(rest.get(name, ""))
            return cls(backbone=backbone, aggregator=aggregator, preprocessing=preprocessing, **rest)
        # A file of any shape may lie there: a list in place of an object, a number in place of a text.
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise ModelError(
                f"the model's configuration cannot be read ({error}); "
                "it may be damaged or written by a newer version of salad"
            ) from error


def check_sizes(config: ModelConfig) -> None:
    """Refuse a model that no machine could build or run; its parts are compared with its weights elsewhere.

    Raises:
        ModelError: If it has more blocks than any model, or a descriptor has none or too many numbers.
        TypeError: If what should be a number is none.
    """
    for part in (config.backbone, config.aggregator):
        blocks = max(getattr(part, "depth", 1), getattr(part, "blocks", 1))
        if blocks > MOST_BLOCKS:
            raise ModelError(f"{blocks} blocks are more than any model has: {MOST_BLOCKS} at most")
    for name in ("clusters", "cluster_dim"):  # torch would build what is empty, and warn of it
        if getattr(config.aggregator, name, 1) == 0:
            raise ModelError(f"{name} of the {config.aggregator.kind} aggregator is 0: give 1 or more")
    if not 1 <= config.aggregator.dim <= MOST_NUMBERS:
        raise ModelError(f"a descriptor of {config.aggregator.dim} numbers cannot be: 1 to {MOST_NUMBERS:,} can")


def _check_text(text: Any) -> None:
    """What people read of a model; an index keeps its name, so its letters must be those that there are."""
    if not isinstance(text, str) or len(text) > _LONGEST_TEXT:
        raise TypeError("name, provenance and licence are texts")
    text.encode()


def _backbone(settings: dict[str, Any]) -> BackboneConfig:
    kind = settings.get("kind")
    if kind not in BACKBONE_KINDS:
        raise ValueError(f"kind {kind!r} is unknown; known are {', '.join(BACKBONE_KINDS)}")
    config: BackboneConfig = BACKBONE_KINDS[kind](**settings)
    return config
