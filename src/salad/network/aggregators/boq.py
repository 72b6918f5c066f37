"""BoQ: a bag of learnt queries looks at the tokens, after each of a few encoder layers.

Source: Ali-bey, Chaib-draa and Giguère, "BoQ: A Place is Worth a Bag of Learnable Queries", CVPR 2024. Tokens are
narrowed by a linear layer, each by itself, so their order does not matter: whatever knows of positions is the backbone.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.network.baseline_config import BoqConfig
from salad.network.tokens import Tokens


class Boq(nn.Module):
    """The answers of every block's queries, mixed into a few rows; number c * rows + r is row r of channel c."""

    def __init__(self, config: BoqConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim
        self.narrow = nn.Sequential(nn.Linear(config.width, config.channels), nn.LayerNorm(config.channels))
        self.blocks = nn.ModuleList(
            QueryBlock(config.channels, config.queries, config.heads) for _ in range(config.blocks)
        )
        self.rows = nn.Linear(config.blocks * config.queries, config.rows)

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        x, answers = self.narrow(tokens.patches), []
        for block in self.blocks:
            x, answer = block(x)
            answers.append(answer)
        # Turned round, so that the linear layer mixes the answers of queries and leaves channels apart.
        kept = self.rows(torch.cat(answers, dim=1).transpose(1, 2))
        return F.normalize(kept.flatten(1), dim=1)


class QueryBlock(nn.Module):
    """One encoder layer, and the queries that ask what it made of the tokens."""

    def __init__(self, channels: int, queries: int, heads: int) -> None:
        super().__init__()
        self.encoder = nn.TransformerEncoderLayer(
            channels, heads, dim_feedforward=4 * channels, dropout=0.0, batch_first=True
        )
        self.queries = nn.Parameter(torch.randn(1, queries, channels))
        self.among = nn.MultiheadAttention(channels, heads, batch_first=True)
        self.norm_queries = nn.LayerNorm(channels)
        self.across = nn.MultiheadAttention(channels, heads, batch_first=True)
        self.norm_answers = nn.LayerNorm(channels)

    def forward(
        self, x: Float[Tensor, "batch n c"]
    ) -> tuple[Float[Tensor, "batch n c"], Float[Tensor, "batch queries c"]]:
        """The tokens for the next block, and this one's answers."""
        x = self.encoder(x)
        # Queries see each other first: that knows nothing of the photo, so once for the whole batch.
        seen, _ = self.among(self.queries, self.queries, self.queries, need_weights=False)
        asked = self.norm_queries(self.queries + seen).expand(x.shape[0], -1, -1)
        answers, _ = self.across(asked, x, x, need_weights=False)
        return x, self.norm_answers(answers)
