"""Tokens -> descriptor: one file for each way to do it, and one table."""

from __future__ import annotations

from salad.config import AggregatorConfig, GemConfig, SaladConfig
from salad.model.aggregators.pooling import Gem, Scene
from salad.model.aggregators.salad import Salad

Aggregator = Salad | Scene | Gem


def build_aggregator(config: AggregatorConfig) -> Aggregator:
    """The aggregator a configuration describes, with untrained weights."""
    if isinstance(config, SaladConfig):
        return Salad(config)
    return Gem(config) if isinstance(config, GemConfig) else Scene(config)


__all__ = ["Aggregator", "Gem", "Salad", "Scene", "build_aggregator"]
