"""How models are chosen: by places held out of the training photos, never by an evaluation set."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from jaxtyping import Bool, Float32, Int64

from salad.datasets.training_place import TrainingPlace
from salad.errors import BenchmarkError, PhotoError
from salad.models.describer import Describer, DescriberLike
from salad.training.batches import ImageCache

QUERIES = 8  # of each place: its newest photos


Judge = Callable[[Describer], dict[str, float]]
"""A model -> figures, higher ones better; `mean` is the score it is chosen by."""


def precision_held_out(model: DescriberLike, places: Sequence[TrainingPlace], images: ImageCache) -> dict[str, float]:
    """How well each city's newest photos find all others of their place: mean average precision in percent.

    Every photo of the places held out is searched but the query itself. R@1 is too coarse to choose by: one photo of
    the same day is enough for it, while this asks for those of every season, hour and viewpoint.

    Photos that cannot be read are left out.

    Returns:
        One figure a city, and their mean.

    Raises:
        BenchmarkError: If not one photo can be read.
    """
    shows, photos = [], []
    for number, place in enumerate(places):
        for path in place.photos:
            with suppress(PhotoError):
                photos.append(images.array(path))
                shows.append(number)
    if not photos:
        raise BenchmarkError(
            f"none of the photos of {len(places)} places held out can be read, so there is nothing to choose by: "
            "check the data, or hold out none"
        )
    described = model.describe(photos, batch_size=32)
    return precision_of(described, np.array(shows), [place.city for place in places])


def precision_of(
    described: Float32[np.ndarray, "photos dim"], shows: Int64[np.ndarray, " photos"], cities: Sequence[str]
) -> dict[str, float]:
    """The same of descriptors there are.

    Args:
        described: one row of length 1 for each photo, those of a place from its oldest to its newest.
        shows: the number of the place that each photo shows.
        cities: of each place.
    """
    scores = described @ described.T
    found: dict[str, list[float]] = defaultdict(list)
    for number, city in enumerate(cities):
        for query in np.flatnonzero(shows == number)[-QUERIES:]:
            order = np.argsort(-scores[query], kind="stable")
            order = order[order != query]  # a photo finds itself first
            found[city].append(average_precision(shows[order] == number))
    precision = {city: round(100 * float(np.mean(each)), 2) for city, each in sorted(found.items())}
    return {**precision, "mean": round(float(np.mean(list(precision.values()))), 2)}


def average_precision(right: Bool[np.ndarray, " ranked"]) -> float:
    """Mean, over the right ones of a ranking, of the fraction of right ones down to each; 0 where none is right."""
    ranks = np.flatnonzero(right) + 1
    return float(np.mean(np.arange(1, len(ranks) + 1) / ranks)) if len(ranks) else 0.0
