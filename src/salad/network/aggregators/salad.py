"""SALAD: tokens shared among clusters by optimal transport, summed per cluster.

Source: Izquierdo and Civera, "Optimal Transport Aggregation for Visual Place Recognition", CVPR 2024; the variants
are those of its ablation: no dustbin, no scene token, a softmax or a dual softmax in Sinkhorn's place.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.network.aggregator_config import SaladConfig
from salad.network.sinkhorn import dual_softmax, sinkhorn_assign, softmax
from salad.network.tokens import Tokens


class Salad(nn.Module):
    """The aggregator of the paper.

    A descriptor is [scene | clusters]: number g + k * m + j is feature k of cluster j. Published weights, PCAs
    and indexes depend on that order.
    """

    def __init__(self, config: SaladConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim
        d, hidden = config.width, config.hidden
        self.score = _perceptron(d, hidden, config.clusters, dropout=config.dropout)
        self.feature = _perceptron(d, hidden, config.cluster_dim, dropout=config.dropout)
        self.scene = (  # without dropout: the paper drops numbers of the two token perceptrons alone
            nn.Sequential(nn.Linear(d, hidden), nn.ReLU(), nn.Linear(hidden, config.scene_dim))
            if config.scene_dim
            else None
        )
        # One score for all tokens alike. Sinkhorn's plan does not depend on it: its gradient is 0.
        self.dustbin = nn.Parameter(torch.tensor(1.0)) if config.dustbin else None
        pooled = config.scene_dim + config.clusters * config.cluster_dim
        self.linear = nn.Linear(pooled, config.linear) if config.linear else None

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        plan = self.plan(tokens)[:, : self.config.clusters]  # what went to the dustbin is forgotten
        features = self.feature(tokens.patches)
        # Summed as it is multiplied: a tensor [batch, l, m, n] of every token's part would be a thousand times larger.
        clusters = torch.einsum("bnl,bmn->blm", features, plan.to(features.dtype))
        # Each cluster at length 1, or the ones that took the most tokens would decide alone.
        descriptor = F.normalize(clusters, dim=1).flatten(1)
        if self.scene is not None:
            descriptor = torch.cat([F.normalize(self.scene(tokens.cls), dim=1), descriptor], dim=1)
        if self.linear is not None:  # MegaLoc's last layer takes a vector of length 1 too
            descriptor = self.linear(F.normalize(descriptor, dim=1))
        return F.normalize(descriptor, dim=1)

    def plan(self, tokens: Tokens) -> Float[Tensor, "batch rows n"]:
        """How much of every token each cluster takes; the last row is the dustbin's, where there is one.

        Raises:
            TooFewTokensError: If the photos give no more tokens than there are clusters, and the dustbin nothing.
        """
        scores = self.score(tokens.patches).transpose(1, 2)
        if self.config.transport == "softmax":
            return softmax(scores, self.dustbin)
        if self.config.transport == "dual-softmax":
            return dual_softmax(scores, self.dustbin)
        return sinkhorn_assign(
            scores,
            self.dustbin,
            wants=self.config.dustbin_share,
            stride=tokens.stride,
            iterations=self.config.iterations,
        )


def _perceptron(inside: int, hidden: int, out: int, *, dropout: float) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inside, hidden), nn.Dropout(dropout), nn.ReLU(), nn.Linear(hidden, out))
