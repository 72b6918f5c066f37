"""What every backbone makes of a photo, and every aggregator takes."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor


class Tokens(NamedTuple):
    """A batch of photos cut into tokens.

    Args:
        patches: One token for each cell of the grid, row by row.
        cls: One token for the whole photo: the class token, or the mean of the patches where there is none.
        grid: Rows and columns of the patches.
        stride: Pixels from one patch to the next.
    """

    patches: Float[Tensor, "batch n d"]
    cls: Float[Tensor, "batch d"]
    grid: tuple[int, int]
    stride: int

    @classmethod
    def of_maps(cls, maps: Float[Tensor, "batch d rows columns"], stride: int) -> Tokens:
        """Of a convolutional trunk's maps: without a class token, the mean of the patches stands for the photo."""
        patches = maps.flatten(2).transpose(1, 2)
        return cls(patches, patches.mean(dim=1), (maps.shape[2], maps.shape[3]), stride)
