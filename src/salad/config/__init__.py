"""What a model is, as data: frozen dataclasses that JSON can hold, and the presets of the paper.

Nothing here imports torch, so a command line can read, print and check a configuration at once.

    backbones      what cuts a photo into tokens
    aggregators    SALAD and the plain ones; rivals: what it is compared with; tables: all of them by name
    whole          a whole model: both, the preprocessing, the calibration
"""

from salad.config.aggregators import (
    PRESETS,
    AverageConfig,
    GemConfig,
    RouteConfig,
    SaladConfig,
    SceneConfig,
    Transport,
)
from salad.config.backbones import (
    BACKBONE_KINDS,
    VITS,
    BackboneConfig,
    ConvNextConfig,
    ConvNextSize,
    LiteConfig,
    LiteKind,
    ResNetConfig,
    ViTConfig,
)
from salad.config.rivals import (
    BoqConfig,
    ConvApConfig,
    CosPlaceConfig,
    MixVprConfig,
    NetVladConfig,
    VladConfig,
)
from salad.config.tables import AGGREGATOR_KINDS, AGGREGATORS, AggregatorConfig, for_grid
from salad.config.whole import (
    IMAGENET_MEAN,
    IMAGENET_STD,
    Calibration,
    ModelConfig,
    Preprocessing,
    Resample,
)

__all__ = [
    "AGGREGATORS",
    "AGGREGATOR_KINDS",
    "BACKBONE_KINDS",
    "IMAGENET_MEAN",
    "IMAGENET_STD",
    "PRESETS",
    "VITS",
    "AggregatorConfig",
    "AverageConfig",
    "BackboneConfig",
    "BoqConfig",
    "Calibration",
    "ConvApConfig",
    "ConvNextConfig",
    "ConvNextSize",
    "CosPlaceConfig",
    "GemConfig",
    "LiteConfig",
    "LiteKind",
    "MixVprConfig",
    "ModelConfig",
    "NetVladConfig",
    "Preprocessing",
    "ResNetConfig",
    "Resample",
    "RouteConfig",
    "SaladConfig",
    "SceneConfig",
    "Transport",
    "ViTConfig",
    "VladConfig",
    "for_grid",
]
