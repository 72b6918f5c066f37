"""MixVPR: each channel's map mixed by perceptrons across its cells.

Source: Ali-bey, Chaib-draa and Giguère, "MixVPR: Feature Mixing for Visual Place Recognition", WACV 2023.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.errors import ModelError
from salad.network.baseline_config import MixVprConfig
from salad.network.tokens import Tokens


class MixVpr(nn.Module):
    """Mixers over the grid, then fewer channels, then fewer cells; number c * rows + r is row r of channel c."""

    def __init__(self, config: MixVprConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim
        # Cells are the columns of its weights: here alone the size of a photo is part of the model.
        cells = config.grid[0] * config.grid[1]
        self.mixers = nn.Sequential(*(Mixer(cells, config.ratio * cells) for _ in range(config.depth)))
        self.channels = nn.Linear(config.width, config.channels)
        self.rows = nn.Linear(cells, config.rows)

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1.

        Raises:
            ModelError: If the photos give another grid than the mixers were made for.
        """
        self._check(tokens)
        mixed = self.mixers(tokens.patches.transpose(1, 2))
        # Layers work on the last axis: turned to mix channels, and turned back to mix what is left of the cells.
        kept = self.channels(mixed.transpose(1, 2)).transpose(1, 2)
        return F.normalize(self.rows(kept).flatten(1), dim=1)

    def _check(self, tokens: Tokens) -> None:
        if tokens.grid == self.config.grid:
            return
        (rows, columns), (high, wide) = tokens.grid, self.config.grid
        raise ModelError(
            f"the photo gives {rows} x {columns} tokens, but this MixVPR mixes {high} x {wide}; use images "
            f"{high * tokens.stride} pixels high and {wide * tokens.stride} wide"
        )


class Mixer(nn.Module):
    """A normalised perceptron across the cells of one channel, added on."""

    def __init__(self, cells: int, hidden: int) -> None:
        super().__init__()
        self.mix = nn.Sequential(nn.LayerNorm(cells), nn.Linear(cells, hidden), nn.ReLU(), nn.Linear(hidden, cells))

    def forward(self, x: Float[Tensor, "batch d n"]) -> Float[Tensor, "batch d n"]:
        """Let every cell of a channel see all its cells."""
        mixed: Tensor = x + self.mix(x)
        return mixed
