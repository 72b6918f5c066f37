"""The plainest aggregators, with one weight or none: what a bare backbone is worth, to compare with."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.network.baseline_config import AverageConfig, GemConfig, SceneConfig
from salad.network.tokens import Tokens

LEAST = 1e-6  # a power needs what is above 0


class Scene(nn.Module):
    """The scene token, L2-normalised."""

    def __init__(self, config: SceneConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        return F.normalize(tokens.cls, dim=1)


class Average(nn.Module):
    """The mean of the patches, L2-normalised."""

    def __init__(self, config: AverageConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        return F.normalize(tokens.patches.mean(dim=1), dim=1)


class Gem(nn.Module):
    """Generalised mean of the patches, its power fixed or learnt. Source: Radenović, Tolias and Chum (2018)."""

    def __init__(self, config: GemConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim
        # A plain number where it is fixed: then no file of weights holds it, and the configuration alone says it.
        self.power = nn.Parameter(torch.tensor(float(config.power))) if config.learned else config.power

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        return F.normalize(generalised_mean(tokens.patches, self.power), dim=1)


def generalised_mean(patches: Float[Tensor, "batch n d"], power: Float[Tensor, ""] | float) -> Float[Tensor, "batch d"]:
    """The mean of powers, brought back: 1 is the plain mean, a high power the maximum; below 0 counts as 0."""
    # Below 0 a broken power has no value, and at 0 its gradient has none.
    return patches.clamp(min=LEAST).pow(power).mean(dim=1).pow(1 / power)
