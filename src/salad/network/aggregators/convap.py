"""Conv-AP: a 1 x 1 convolution, then averages over the cells of a coarse grid.

Source: Ali-bey, Chaib-draa and Giguère, "GSV-Cities: Toward Appropriate Supervised Visual Place Recognition",
Neurocomputing 2022.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.network.baseline_config import ConvApConfig
from salad.network.tokens import Tokens


class ConvAp(nn.Module):
    """Channels mixed token by token and averaged where they are; a descriptor is [channel, row, column]."""

    def __init__(self, config: ConvApConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim
        self.channels = nn.Linear(config.width, config.channels)  # a 1 x 1 convolution, token by token

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1."""
        averages = on_grid(self.channels(tokens.patches), tokens.grid, self.config.grid)
        return F.normalize(averages.flatten(1), dim=1)


def on_grid(
    patches: Float[Tensor, "batch n d"], grid: tuple[int, int], cells: tuple[int, int]
) -> Float[Tensor, "batch d rows columns"]:
    """Average the tokens of a grid over the cells of another, which may overlap by a token."""
    # Cells overlap where the grid does not divide: every cell has a token, however few there are.
    maps = patches.transpose(1, 2)
    return F.adaptive_avg_pool2d(maps.reshape(*maps.shape[:2], *grid), cells)
