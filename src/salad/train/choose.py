"""How models are chosen: by places held out of the training photos, never by an evaluation set."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from salad.data.places import TrainingPlace
from salad.model.describer import Describer
from salad.photos import open_rgb, squeeze

QUERIES = 8  # of each place: its newest photos


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


def precision_held_out(model: Describer, places: Sequence[TrainingPlace], shelf: Shelf) -> dict[str, float]:
    """How well each city's newest photos find all others of their place: mean average precision in percent.

    Every photo of the places held out is searched but the query itself. R@1 is too coarse to choose by: one photo of
    the same day is enough for it, while this asks for those of every season, hour and viewpoint.

    Returns:
        One figure a city, and their mean.
    """
    photos = [path for place in places for path in place.photos]
    shows = np.repeat(np.arange(len(places)), [len(place.photos) for place in places])
    described = model.describe([shelf.array(path) for path in photos], batch_size=32)
    scores = described @ described.T
    found: dict[str, list[float]] = defaultdict(list)
    for number, place in enumerate(places):
        for query in np.flatnonzero(shows == number)[-QUERIES:]:
            order = np.argsort(-scores[query], kind="stable")
            order = order[order != query]
            found[place.city].append(average_precision(shows[order] == number))
    precision = {city: round(100 * float(np.mean(each)), 2) for city, each in sorted(found.items())}
    return {**precision, "mean": round(float(np.mean(list(precision.values()))), 2)}


def average_precision(right: Bool[np.ndarray, " ranked"]) -> float:
    """Mean, over the right ones of a ranking, of the share of right ones down to each; 0 where none is right."""
    ranks = np.flatnonzero(right) + 1
    return float(np.mean(np.arange(1, len(ranks) + 1) / ranks)) if len(ranks) else 0.0
