"""The seam of backbones: pixels -> tokens. The one table of them is `config.BACKBONE_KINDS`."""

from __future__ import annotations

from itertools import chain
from pkgutil import resolve_name

from torch import nn

from salad.errors import ModelError
from salad.network.config import BackboneConfig


class Backbone(nn.Module):
    """What every backbone is: called with normalised images [batch, 3, height, width], it gives `Tokens`.

    Both sides of the images are multiples of its stride.

    Attributes:
        width: Numbers in a token.
        stride: Pixels from one token to the next.
    """

    width: int
    stride: int

    def blocks_in_order(self) -> list[list[nn.Module]]:
        """What is trained together as one block, from the first to the last."""
        raise NotImplementedError

    def train_last(self, blocks: int) -> None:
        """Leave only the last `blocks` blocks to be trained, and the stem with all of them; 0 trains nothing.

        Raises:
            ModelError: If there are no so many blocks.
        """
        parts = self.blocks_in_order()
        if not 0 <= blocks <= len(parts):
            raise ModelError(f"trained_blocks is {blocks}, but this backbone has {len(parts)} blocks")
        # The first blocks see edges, which no place changes, at the widest grids: half of a step's time.
        self.requires_grad_(blocks == len(parts))
        for module in chain(*parts[len(parts) - blocks :]):
            module.requires_grad_(True)


def build_backbone(config: BackboneConfig) -> Backbone:
    """The backbone a configuration describes, with untrained weights.

    Raises:
        ModelError: If a setting of it cannot be.
        MissingExtraError: If it needs a package that is not installed.
    """
    backbone: Backbone = resolve_name(config.module)(config)
    return backbone
