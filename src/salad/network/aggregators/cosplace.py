"""CosPlace: a generalised mean with a learnt power, and a linear layer.

Source: Berton, Masone and Caputo, "Rethinking Visual Geo-localization for Large-Scale Applications", CVPR 2022 (its
aggregator alone: what it says of training by classes is not here).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.network.aggregators.pooling import generalised_mean
from salad.network.baseline_config import CosPlaceConfig
from salad.network.tokens import Tokens


class CosPlace(nn.Module):
    """GeM, then a fully connected layer."""

    def __init__(self, config: CosPlaceConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim
        self.power = nn.Parameter(torch.tensor(float(config.power)))
        self.linear = nn.Linear(config.width, config.linear)

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        return F.normalize(self.linear(generalised_mean(tokens.patches, self.power)), dim=1)
