"""The trunk that `salad-lite` starts from, before our training: what ImageNet alone knows of places.

Plain poolings, and all are shown, since none wins everywhere: the means forget where in the photo things stand, the
grid keeps it, VLAD sums what is left of each token beside the nearest word of a vocabulary. Taking the photo's mean
token off first made the grid weaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional as F

from benchmarks.options import TRAIN
from salad.datasets.places import find_places
from salad.models.describer import Describer
from salad.network.aggregator_config import compared_aggregators
from salad.network.baseline_config import GemConfig
from salad.network.config import Preprocessing
from salad.network.network import build
from salad.training.recipe import PRESETS
from salad.training.start import start_backbone
from salad.training.vocabulary import fit, needs_fitting


def untrained(pooling: str = "gem") -> Describer:
    """Make the trunk with its tokens' generalised mean (`gem`), `average`, or `vlad` fitted to the training photos.

    Raises:
        SaladError: the training photos, which a vocabulary is taken from, are not beside the checkout.
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
