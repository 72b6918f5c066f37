"""The trunk that `salad-lite` starts from, before our training: what ImageNet alone knows of places.

Two plain poolings, and both are shown, since neither wins everywhere: the generalised mean forgets where in
the photo things stand, the grid keeps it. Taking the photo's mean token off first made the grid weaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional as F

from salad.config import GemConfig, Preprocessing
from salad.model.describer import Describer, build
from salad.train.recipe import PRESETS
from salad.train.start import start_backbone


def untrained_gem() -> Describer:
    """Make the trunk with its tokens' generalised mean."""
    preset = PRESETS["salad-lite"]
    pooled = GemConfig(width=preset.model.aggregator.width)
    model = build(replace(preset.model, name="salad-lite-untrained", aggregator=pooled))
    start_backbone(model, preset.start)
    return model


class UntrainedGrid:
    """Keeps the seam `Describes`: the tokens' mean in each cell of a 4 x 4 grid."""

    name = "salad-lite-untrained-grid"
    grid = 4

    def __init__(self) -> None:
        self.model = untrained_gem()
        self.dim = self.grid**2 * self.model.dim
        self.fingerprint = f"{self.model.fingerprint}-grid{self.grid}"

    @property
    def preprocessing(self) -> Preprocessing:
        """How photos are prepared: as for `salad-lite`."""
        return self.model.preprocessing

    @torch.inference_mode()
    def describe(self, photos: Sequence[Any], *, batch_size: int = 16) -> NDArray[np.float32]:
        """Describe photos, float32 `[N, dim]`, rows of length 1."""
        batches = [photos[start : start + batch_size] for start in range(0, len(photos), batch_size)]
        return np.concatenate([self._batch(batch) for batch in batches])

    def _batch(self, photos: Sequence[Any]) -> NDArray[np.float32]:
        tokens = self.model.tokens(self.model.prepare(photos))
        patches = tokens.patches.transpose(1, 2).unflatten(2, tokens.grid)
        return F.normalize(F.adaptive_avg_pool2d(patches, self.grid).flatten(1), dim=1).numpy()
