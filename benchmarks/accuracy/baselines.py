"""What places can be told by without any training of ours: the floor that a figure stands on.

HOG learns nothing at all: it says where edges point, in a grid of cells over the squeezed grey photo (Dalal and Triggs,
"Histograms of oriented gradients for human detection", CVPR 2005).

The untrained trunk is the one that `salad-lite` starts from, which ImageNet alone has taught. Plain poolings, and all
are shown, since none wins everywhere: the means forget where in the photo things stand, the grid keeps it, VLAD sums
what is left of each token beside the nearest word of a vocabulary. Taking the photo's mean token off first made the
grid weaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch.nn import functional as F

from benchmarks.options import TRAIN
from salad.datasets.places import find_places
from salad.images.decode import decode, squeeze
from salad.models.describer import Describer
from salad.network.aggregator_config import compared_aggregators
from salad.network.baseline_config import GemConfig
from salad.network.config import Preprocessing
from salad.network.network import build
from salad.training.recipe import PRESETS
from salad.training.start import start_backbone
from salad.training.vocabulary import fit, needs_fitting


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
        turn = np.arctan2(down, right) % np.pi / np.pi * self.orientations  # light on dark counts as dark on light
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


def untrained(pooling: str = "gem") -> Describer:
    """Make the trunk with its tokens' generalised mean (`gem`), `average`, or `vlad` fitted to the training photos.

    Raises:
        SaladError: If the training photos, which a vocabulary is taken from, are not beside the checkout.
    """
    preset = PRESETS["salad-lite"]
    width = preset.model.aggregator.width
    pooled = GemConfig(width=width) if pooling == "gem" else compared_aggregators(width)[pooling]
    model = build(replace(preset.model, name=f"salad-lite-untrained-{pooling}", aggregator=pooled))
    start_backbone(model, preset.start)
    if needs_fitting(model):
        photos = [photo for place in find_places(TRAIN) for photo in place.photos]
        fit(model, photos, seed=0)
    return Describer.of(model)


class UntrainedGrid:
    """Keeps the seam `DescriberLike`: the tokens' mean in each cell of a 4 x 4 grid."""

    name = "salad-lite-untrained-grid"
    grid = 4

    def __init__(self) -> None:
        self.model = untrained()
        self.dim = self.grid**2 * self.model.dim
        self.fingerprint = f"{self.model.fingerprint}-grid{self.grid}"

    @property
    def preprocessing(self) -> Preprocessing:
        """How photos are prepared: as for `salad-lite`."""
        return self.model.preprocessing

    def describe(self, photos: Sequence[Any], *, batch_size: int = 16) -> NDArray[np.float32]:
        """Describe photos, float32 `[N, dim]`, rows of length 1."""
        batches = [photos[start : start + batch_size] for start in range(0, len(photos), batch_size)]
        return np.concatenate([self._batch(batch) for batch in batches])

    def _batch(self, photos: Sequence[Any]) -> NDArray[np.float32]:
        tokens = self.model.engine.run(self.model.squeezed(photos), ("patches",))["patches"]
        patches = torch.from_numpy(tokens).permute(0, 3, 1, 2)
        return F.normalize(F.adaptive_avg_pool2d(patches, self.grid).flatten(1), dim=1).numpy()
