"""NetVLAD: residuals to centroids, softly assigned, all of it trained.

Source: Arandjelović, Gronat, Torii, Pajdla and Sivic, "NetVLAD: CNN architecture for weakly supervised place
recognition", CVPR 2016.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.network.aggregators.vlad import joined, residuals
from salad.network.baseline_config import NetVladConfig
from salad.network.tokens import Tokens

RATIO = 100.0  # of a token's largest assignment to its second, on average, at the start: the paper's


class NetVlad(nn.Module):
    """Tokens of length 1 assigned by a softmax; number c * d + i is residual i of centroid c.

    It starts at random; `salad.training.start.fit` starts it at the centroids of real tokens, as the paper does.
    """

    fitted: Tensor

    def __init__(self, config: NetVladConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim
        self.score = nn.Linear(config.width, config.clusters)
        self.centroids = nn.Parameter(F.normalize(torch.randn(config.clusters, config.width), dim=1))
        self.linear = nn.Linear(config.clusters * config.width, config.linear) if config.linear else None
        # Kept with the weights: whoever reads the model knows that it has started already.
        self.register_buffer("fitted", torch.tensor(False))

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        # Of length 1, as the centroids are: an assignment is by direction, and no bright token outweighs the others.
        units = F.normalize(tokens.patches, dim=2)
        weights = self.score(units).softmax(dim=2).to(units.dtype)
        descriptor = joined(residuals(units, weights, self.centroids))
        return descriptor if self.linear is None else F.normalize(self.linear(descriptor), dim=1)

    @torch.no_grad()
    def start_from(self, centroids: Float[Tensor, "k d"], units: Float[Tensor, "t d"]) -> None:
        """Start at centroids, assigning softly by distance: weight ~ exp(-alpha |token - centroid|²).

        Args:
            centroids: of tokens of length 1.
            units: such tokens, to choose alpha by: so sharp that the nearest centroid has `RATIO` times the
                weight of the second.
        """
        nearest = torch.cdist(units, centroids).square().sort(dim=1).values
        lead = float((nearest[:, 1] - nearest[:, 0]).mean()) if len(centroids) > 1 else 1.0
        alpha = math.log(RATIO) / max(lead, 1e-6)
        self.centroids.copy_(centroids)
        # Less what all clusters have in common: a softmax does not see it, but float16 on disk would round it.
        self.score.weight.copy_(2 * alpha * (centroids - centroids.mean(dim=0)))
        lengths = centroids.square().sum(dim=1)
        self.score.bias.copy_(alpha * (lengths.mean() - lengths))
        self.fitted.fill_(True)
