"""Tokens -> descriptor: one file for each way to do it, and one table."""

from __future__ import annotations

from typing import Any

from salad.config import (
    AggregatorConfig,
    AverageConfig,
    BoqConfig,
    ConvApConfig,
    CosPlaceConfig,
    GemConfig,
    MixVprConfig,
    NetVladConfig,
    RouteConfig,
    SaladConfig,
    SceneConfig,
    VladConfig,
)
from salad.model.aggregators.boq import Boq
from salad.model.aggregators.convap import ConvAp
from salad.model.aggregators.cosplace import CosPlace
from salad.model.aggregators.mixvpr import MixVpr
from salad.model.aggregators.netvlad import NetVlad
from salad.model.aggregators.pooling import Average, Gem, Scene
from salad.model.aggregators.route import Route
from salad.model.aggregators.salad import Salad
from salad.model.aggregators.vlad import Vlad

Aggregator = Salad | Scene | Gem | Average | NetVlad | Vlad | MixVpr | ConvAp | CosPlace | Boq | Route

_MADE_BY: dict[type, Any] = {
    SaladConfig: Salad,
    SceneConfig: Scene,
    GemConfig: Gem,
    AverageConfig: Average,
    NetVladConfig: NetVlad,
    VladConfig: Vlad,
    MixVprConfig: MixVpr,
    ConvApConfig: ConvAp,
    CosPlaceConfig: CosPlace,
    BoqConfig: Boq,
    RouteConfig: Route,
}


def build_aggregator(config: AggregatorConfig) -> Aggregator:
    """The aggregator a configuration describes, with untrained weights."""
    made: Aggregator = _MADE_BY[type(config)](config)
    return made


__all__ = [
    "Aggregator",
    "Average",
    "Boq",
    "ConvAp",
    "CosPlace",
    "Gem",
    "MixVpr",
    "NetVlad",
    "Route",
    "Salad",
    "Scene",
    "Vlad",
    "build_aggregator",
]
