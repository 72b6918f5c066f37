"""The seam of aggregators: tokens -> one descriptor a photo. Their one table is in `aggregator_config`."""

from __future__ import annotations

from pkgutil import resolve_name
from typing import Any, Protocol, TypeGuard

from jaxtyping import Float
from torch import Tensor, nn

from salad.network.aggregator_config import AggregatorConfig


class Fitted(Protocol):
    """An aggregator that starts at the centroids of real tokens, as many as its configuration's `clusters`."""

    config: Any
    fitted: Tensor

    def start_from(self, centroids: Float[Tensor, "k d"], units: Float[Tensor, "t d"]) -> None:
        """Take centroids of tokens of length 1 for its start; `fitted` is true from then on."""
        ...


def is_fitted_to_photos(aggregator: object) -> TypeGuard[Fitted]:
    """Whether an aggregator is a `Fitted` one.

    `isinstance` of the protocol would not do: from Python 3.12 on it does not see the buffers of a module.
    """
    return all(hasattr(aggregator, name) for name in ("config", "fitted", "start_from"))


def build_aggregator(config: AggregatorConfig) -> nn.Module:
    """The aggregator a configuration describes, with untrained weights.

    It is called with `Tokens` and gives descriptors [batch, dim] of length 1; where `config.has_plan` says so, its
    method `plan` gives how much of every token each cluster takes.
    """
    aggregator: nn.Module = resolve_name(config.module)(config)
    return aggregator
