"""Every aggregator there is: by kind, as JSON names them, and by name, as they are compared."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

from salad.config.aggregators import AverageConfig, GemConfig, RouteConfig, SaladConfig, SceneConfig
from salad.config.rivals import (
    BoqConfig,
    ConvApConfig,
    CosPlaceConfig,
    MixVprConfig,
    NetVladConfig,
    VladConfig,
)

AggregatorConfig = (
    SaladConfig
    | SceneConfig
    | GemConfig
    | AverageConfig
    | NetVladConfig
    | VladConfig
    | MixVprConfig
    | ConvApConfig
    | CosPlaceConfig
    | BoqConfig
    | RouteConfig
)

AGGREGATOR_KINDS: dict[str, Any] = {
    "salad": SaladConfig,
    "scene": SceneConfig,
    "gem": GemConfig,
    "average": AverageConfig,
    "netvlad": NetVladConfig,
    "vlad": VladConfig,
    "mixvpr": MixVprConfig,
    "conv-ap": ConvApConfig,
    "cosplace": CosPlaceConfig,
    "boq": BoqConfig,
    "salad-route": RouteConfig,
}

WIDE = (
    384  # numbers in a token from which on an aggregator has its paper's size; below, one near salad-lite's
)


def _salad(width: int, **change: Any) -> SaladConfig:
    paper = SaladConfig(width)
    fair = paper if width >= WIDE else dataclasses.replace(paper, cluster_dim=32, scene_dim=128, hidden=256)
    return dataclasses.replace(fair, **change)


def _netvlad_linear(width: int) -> NetVladConfig:
    return NetVladConfig(width, linear=8192 if width >= WIDE else 2048)


def _mixvpr(width: int) -> MixVprConfig:
    return MixVprConfig(width, grid=(23, 23)) if width >= WIDE else MixVprConfig(width, channels=512)


def _conv_ap(width: int) -> ConvApConfig:
    return ConvApConfig(width, channels=2048 if width >= WIDE else 512)


def _cosplace(width: int) -> CosPlaceConfig:
    return CosPlaceConfig(width, linear=2048 if width >= WIDE else 512)


def _boq(width: int) -> BoqConfig:
    return BoqConfig(width) if width >= WIDE else BoqConfig(width, channels=128, queries=32, rows=16, heads=2)


def _route(width: int) -> RouteConfig:
    return RouteConfig(width, salad=_salad(width), cell_dim=64 if width >= WIDE else 32)


AGGREGATORS: dict[str, Callable[[int], AggregatorConfig]] = {
    "salad": _salad,
    "salad-no-dustbin": partial(_salad, dustbin=False),
    "salad-no-scene": partial(_salad, scene_dim=0),
    "salad-softmax": partial(_salad, transport="softmax"),
    "salad-dual-softmax": partial(_salad, transport="dual-softmax"),
    "netvlad": NetVladConfig,
    "netvlad-linear": _netvlad_linear,
    "gem": partial(GemConfig, learned=True),
    "average": AverageConfig,
    "class-token": SceneConfig,
    "mixvpr": _mixvpr,
    "conv-ap": _conv_ap,
    "cosplace": _cosplace,
    "boq": _boq,
    "vlad": VladConfig,
    "salad-route": _route,
}
"""What is compared: from the width of a token to a configuration of a fair size."""

# Settings that came after the first models were published. At their default they are not written, so that a
# model's configuration, and with it its fingerprint, is what it was. Their defaults must never change.
LATER: dict[str, tuple[str, ...]] = {
    "salad": ("dustbin", "transport", "iterations", "dustbin_share"),
    "gem": ("learned",),
}


def for_grid(config: AggregatorConfig, grid: tuple[int, int]) -> AggregatorConfig:
    """The same aggregator for another grid of tokens, which few mind.

    Args:
        config: any aggregator's.
        grid: rows and columns of the tokens it will take: the photo's sides divided by the stride.
    """
    return dataclasses.replace(config, grid=grid) if isinstance(config, MixVprConfig) else config


def as_settings(config: AggregatorConfig) -> dict[str, Any]:
    """An aggregator's configuration as JSON holds it."""
    settings = dataclasses.asdict(config)
    defaults = {field.name: field.default for field in dataclasses.fields(config)}
    for name in LATER.get(config.kind, ()):
        if settings[name] == defaults[name]:
            del settings[name]
    if isinstance(config, RouteConfig) and config.salad.dustbin_share is None:
        del settings["salad"]["dustbin_share"]  # of the one inside, the first of them that came after it
    return settings


def from_settings(settings: dict[str, Any]) -> AggregatorConfig:
    """Read what `as_settings` wrote.

    Raises:
        ModelError: a setting makes no sense.
        ValueError: the kind is unknown.
        TypeError: a setting is missing or unknown.
    """
    config: AggregatorConfig
    kind = settings.get("kind")
    if kind not in AGGREGATOR_KINDS:
        raise ValueError(f"kind {kind!r} is unknown; known are {', '.join(AGGREGATOR_KINDS)}")
    if kind == "salad-route":
        settings = {**settings, "salad": SaladConfig(**settings["salad"])}
    config = AGGREGATOR_KINDS[kind](**settings)
    return config
