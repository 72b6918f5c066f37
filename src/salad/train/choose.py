"""How models are chosen: by places held out of the training photos, never by an evaluation set."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from salad.data.places import TrainingPlace
from salad.model.describer import Describer
from salad.photos import open_rgb, squeeze

REFERENCES, QUERIES = 2, 8  # of each place: its oldest photos and its newest


class Shelf:
    """Photos squeezed to a model's size and kept, since every one is read many times in a run."""

    def __init__(self, model: Describer) -> None:
        self.preprocessing = model.preprocessing
        self._kept: dict[Path, UInt8[np.ndarray, "height width 3"]] = {}

    def array(self, path: Path) -> UInt8[np.ndarray, "height width 3"]:
        """One photo as bytes."""
        if path not in self._kept:
            size = self.preprocessing
            self._kept[path] = squeeze(open_rgb(path), size.height, size.width, size.resample)
        return self._kept[path]

    def photos(self, paths: Sequence[Path]) -> UInt8[Tensor, "photos 3 height width"]:
        """Several photos as one tensor."""
        return torch.from_numpy(np.stack([self.array(path) for path in paths])).permute(0, 3, 1, 2)


def recall_held_out(model: Describer, places: Sequence[TrainingPlace], shelf: Shelf) -> dict[str, float]:
    """R@1 in percent of each city's newest photos against the oldest of all places held out, and their mean."""
    references = [(path, place) for place in places for path in place.photos[:REFERENCES]]
    queries = [(path, place) for place in places for path in place.photos[REFERENCES:][-QUERIES:]]
    known, asked = (
        model.describe([shelf.array(path) for path, _ in side], batch_size=32)
        for side in (references, queries)
    )
    best = (asked @ known.T).argmax(axis=1)
    right: dict[str, list[bool]] = defaultdict(list)
    for (_, place), row in zip(queries, best, strict=True):
        right[place.city].append(references[row][1] == place)
    recall = {city: round(100 * float(np.mean(found)), 1) for city, found in sorted(right.items())}
    return {**recall, "mean": round(float(np.mean(list(recall.values()))), 2)}
