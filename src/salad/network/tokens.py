"""What every backbone makes of a photo, and every aggregator takes."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor


class Tokens(NamedTuple):
    """A batch of photos cut into tokens.

    Args:
        patches: one token for each cell of the grid, row by row.
        scene: one token for the whole photo: the class token, or the mean of the patches where there is none.
        grid: rows and columns of the patches.
        stride: pixels from one patch to the next.
    """

    patches: Float[Tensor, "batch n d"]
    scene: Float[Tensor, "batch d"]
    grid: tuple[int, int]
    stride: int
