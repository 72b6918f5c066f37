"""HOG, the baseline without learning: where edges point, in a grid of cells over the squeezed grey photo.

Source: Dalal and Triggs, "Histograms of oriented gradients for human detection", CVPR 2005. Numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from salad.images.decode import decode, squeeze
from salad.network.config import Preprocessing


@dataclass(frozen=True)
class Hog:
    """Keeps the seam `DescriberLike`; by default 7 x 7 blocks of 2 x 2 cells of 9 orientations: 1,764 numbers."""

    side: int = 128
    cell: int = 16
    orientations: int = 9
    name: str = field(default="hog")

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return (self.side // self.cell - 1) ** 2 * 4 * self.orientations

    @property
    def fingerprint(self) -> str:
        """Changes with every setting."""
        return f"hog-{self.side}-{self.cell}-{self.orientations}"

    @property
    def preprocessing(self) -> Preprocessing:
        """How photos are prepared: squeezed to a small square (it is made grey afterwards)."""
        return Preprocessing(height=self.side, width=self.side)

    def describe(self, photos: Sequence[Any], *, batch_size: int = 16) -> NDArray[np.float32]:
        """Describe photos, float32 `[N, dim]`, rows of length 1."""
        del batch_size  # one photo at a time
        return np.stack([self._one(photo) for photo in photos])

    def _one(self, photo: str | Path | Image.Image | NDArray[np.uint8]) -> NDArray[np.float32]:
        if isinstance(photo, str | Path):
            seen = decode(Path(photo), self.side, self.side)
        else:
            image = Image.fromarray(photo) if isinstance(photo, np.ndarray) else photo
            seen = squeeze(image, self.side, self.side)
        grey = seen @ np.array([0.299, 0.587, 0.114])
        return _normalised_blocks(self._cells(grey))

    def _cells(self, grey: NDArray[np.float64]) -> NDArray[np.float64]:
        """Directions in each cell, `[cells, cells, orientations]`, weighted by gradient length."""
        down, right = np.gradient(grey)
        length = np.hypot(down, right)
        turn = (
            np.arctan2(down, right) % np.pi / np.pi * self.orientations
        )  # light on dark counts as dark on light
        low = np.floor(turn)
        cells = self.side // self.cell
        histogram = np.zeros((cells, cells, self.orientations))
        rows, columns = np.indices(grey.shape) // self.cell
        for bin_, share in ((low, 1 - (turn - low)), (low + 1, turn - low)):
            np.add.at(histogram, (rows, columns, bin_.astype(int) % self.orientations), length * share)
        return histogram


def _normalised_blocks(cells: NDArray[np.float64]) -> NDArray[np.float32]:
    """Chain overlapping blocks of 2 x 2 cells, normalised, clipped at 0.2, normalised again (L2-Hys)."""
    blocks = np.concatenate([cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]], axis=2)
    for _ in range(2):
        blocks = np.minimum(blocks / (np.linalg.norm(blocks, axis=2, keepdims=True) + 1e-3), 0.2)
    flat = blocks.ravel() + 1e-9  # a photo without an edge still has a direction
    return (flat / np.linalg.norm(flat)).astype(np.float32)
