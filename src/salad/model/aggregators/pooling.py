"""Aggregators without a weight: what a bare backbone is worth, to compare with."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.config import GemConfig, SceneConfig
from salad.model.tokens import Tokens


class Scene(nn.Module):
    """The scene token, L2-normalised."""

    def __init__(self, config: SceneConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        return F.normalize(tokens.scene, dim=1)


class Gem(nn.Module):
    """Generalised mean of the patches. Source: Radenović, Tolias and Chum (2018)."""

    def __init__(self, config: GemConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        power = self.config.power
        mean = tokens.patches.clamp(min=1e-6).pow(power).mean(dim=1)
        return F.normalize(mean.pow(1 / power), dim=1)
