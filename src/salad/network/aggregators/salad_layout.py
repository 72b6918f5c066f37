"""SALAD beside a coarse layout of the photo: for fixed viewpoints, where things stay where they are in the picture.

Ours, not the paper's. On routes, webcams and trains the layout tells places apart that hold the same things; where
people turn their cameras it misleads. So it is a variant with a name of its own, and never the default.
"""

from __future__ import annotations

from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.network.aggregator_config import RouteConfig
from salad.network.aggregators.convap import on_grid
from salad.network.aggregators.salad import Salad
from salad.network.tokens import Tokens


class Route(nn.Module):
    """[SALAD | weight * layout], both of length 1; the layout is [row, column, number]."""

    def __init__(self, config: RouteConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim
        self.salad = Salad(config.salad)
        self.cell = nn.Linear(config.width, config.cell_dim)

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        # A dot product of two such descriptors is the mean of both parts' cosines, the layout's weighted by weight².
        parts = self.salad(tokens), self.config.weight * self.layout(tokens)
        return F.normalize(torch.cat(parts, dim=1), dim=1)

    def train(self, mode: bool = True) -> Self:
        """Set the mode of what learns; a SALAD that is not to change describes as in use, dropout off."""
        super().train(mode)
        # Beside a model that ships, only the layout learns: with dropout, SALAD's part would be noise to it.
        self.salad.train(mode and any(weight.requires_grad for weight in self.salad.parameters()))
        return self

    def plan(self, tokens: Tokens) -> Float[Tensor, "batch rows n"]:
        """As the SALAD inside."""
        return self.salad.plan(tokens)

    def layout(self, tokens: Tokens) -> Float[Tensor, "batch cells"]:
        """What is where: a vector of length 1, in which every cell of the grid counts the same."""
        side = self.config.grid
        # Averaged first: a linear layer gives the same after the mean as before it, for a cell in place of each token.
        pooled = on_grid(tokens.patches, tokens.grid, (side, side)).flatten(2).transpose(1, 2)
        return F.normalize(F.normalize(self.cell(pooled), dim=2).flatten(1), dim=1)
