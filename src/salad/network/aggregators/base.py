"""Tokens -> descriptor: one file for each way to do it, and one table."""

from __future__ import annotations

from typing import Any

from salad.network.aggregator_config import (
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
from salad.network.aggregators.boq import Boq
from salad.network.aggregators.convap import ConvAp
from salad.network.aggregators.cosplace import CosPlace
from salad.network.aggregators.mixvpr import MixVpr
from salad.network.aggregators.netvlad import NetVlad
from salad.network.aggregators.pooling import Average, Gem, Scene
from salad.network.aggregators.route import Route
from salad.network.aggregators.salad import Salad
from salad.network.aggregators.vlad import Vlad

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
