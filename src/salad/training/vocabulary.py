"""What an aggregator takes from photos before any training: NetVLAD's start, and AnyLoc's vocabulary.

photos ──> some tokens of each, of length 1 ──> k-means ──> the aggregator
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module

import numpy as np
import torch
from jaxtyping import Float32
from torch import nn
from torch.nn import functional as F

from salad.errors import ModelError, PhotoError, needs_extra
from salad.models.describer import Describer, PhotoLike
from salad.network.aggregators.base import is_fitted_to_photos
from salad.network.baseline_config import VladConfig
from salad.network.network import Network, build

PER_PHOTO = 100  # tokens taken of a photo where there are photos enough: neighbours say nearly the same
Passed = Callable[[PhotoError], None]
Progress = Callable[[int, int | None], None]


def needs_fitting(model: nn.Module) -> bool:
    """Whether a model, or an aggregator, is to be fitted to photos and was not yet."""
    part = getattr(model, "aggregator", model)
    return is_fitted_to_photos(part) and not bool(part.fitted)


def fit(
    model: Network,
    photos: Sequence[PhotoLike],
    *,
    seed: int,
    tokens: int = 50_000,
    passed_over: Passed | None = None,
    progress: Progress | None = None,
) -> None:
    """Start NetVLAD, or make VLAD's vocabulary, from the tokens of photos; other aggregators need nothing.

    Args:
        model: it is changed in place.
        photos: of the kind it will meet; where there are many, some are drawn.
        seed: of what is drawn, and of k-means.
        tokens: how many tokens to gather.
        passed_over: told of each photo that cannot be read, and another takes its place; without it, an error.
        progress: told how many tokens there are, and how many there are to be.

    Raises:
        ModelError: If the photos give fewer different tokens than there are clusters.
        PhotoError: If a photo cannot be read, and nobody is told.
        MissingExtraError: If the `train` extra is not installed.
    """
    aggregator = model.aggregator
    if not is_fitted_to_photos(aggregator):
        return
    clusters = aggregator.config.clusters
    with needs_extra("fitting an aggregator to photos", "train"):  # before the work, which would be lost without it
        kmeans = import_module("sklearn.cluster").KMeans(clusters, n_init=1, random_state=seed)
    units = _drawn_tokens(model, photos, seed=seed, tokens=tokens, passed_over=passed_over, progress=progress)
    different = len(np.unique(units, axis=0))
    if different < clusters:
        raise ModelError(
            f"the photos give {different} different tokens, but {clusters} clusters need as many at least: "
            "give more photos, or ask for fewer clusters"
        )
    with warnings.catch_warnings():  # tokens that hardly differ may share a centroid: no harm is done
        warnings.simplefilter("ignore", UserWarning)
        centroids = kmeans.fit(units).cluster_centers_.astype(np.float32)
    aggregator.start_from(*(torch.from_numpy(each).to(model.device) for each in (centroids, units)))


def with_vocabulary(
    model: Describer,
    photos: Sequence[PhotoLike],
    *,
    seed: int = 0,
    clusters: int = 32,
    passed_over: Passed | None = None,
    progress: Progress | None = None,
) -> Network:
    """AnyLoc's model: the backbone of another under a VLAD whose vocabulary is of these photos.

    Args:
        model: whose backbone and preprocessing to take; it shares its weights and stays as it is.
        photos: of the domain it is for.
        seed: as `fit` takes it.
        clusters: words of the vocabulary.
        passed_over: as `fit` takes it.
        progress: as `fit` takes it.

    Raises:
        ModelError: If the photos give too few tokens.
        PhotoError: If a photo cannot be read, and nobody is told.
        MissingExtraError: If the `train` extra is not installed.
    """
    config = dataclasses.replace(
        model.config,
        name=f"{model.name}-vlad",
        aggregator=VladConfig(model.network.backbone.width, clusters),
        provenance=f"the backbone of {model.name} ({model.fingerprint}), a vocabulary of {clusters} words",
        calibration=None,  # it is of other scores
    )
    made = build(config)
    made.backbone = model.network.backbone
    made.to(model.device)
    fit(made, photos, seed=seed, passed_over=passed_over, progress=progress)
    return made


def _drawn_tokens(
    model: Network,
    photos: Sequence[PhotoLike],
    *,
    seed: int,
    tokens: int,
    passed_over: Passed | None,
    progress: Progress | None,
) -> Float32[np.ndarray, "t d"]:
    """Tokens of length 1 from photo after photo, both in an order drawn by the seed, until there are enough."""
    chance, describer = np.random.default_rng(seed), Describer.of(model)
    each = max(PER_PHOTO, math.ceil(tokens / max(1, len(photos))))
    taken: list[Float32[np.ndarray, "n d"]] = []
    have = 0
    for number in chance.permutation(len(photos)):
        try:
            photo = describer.squeezed([photos[number]])
        except PhotoError as error:
            if passed_over is None:
                raise
            passed_over(error)
            continue
        patches = torch.from_numpy(describer.engine.run(photo, ("patches",))["patches"][0]).flatten(0, 1)
        units = F.normalize(patches, dim=1).numpy()
        # Which of its tokens are taken is drawn too: the first rows of all photos would be of the sky alone.
        taken.append(units[chance.permutation(len(units))][: min(each, tokens - have)])
        have += len(taken[-1])
        if progress is not None:
            progress(have, tokens)
        if have >= tokens:
            break
    return np.concatenate(taken) if taken else np.zeros((0, 1), np.float32)
