"""A backbone, an aggregator and the preprocessing they were trained with: photos -> descriptors."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64, UInt8
from PIL import Image
from torch import Tensor, nn
from torch.nn import functional as F

from salad.errors import ModelError, PhotoError
from salad.images.decode import decode, squeeze
from salad.network.aggregators.base import Aggregator, build_aggregator
from salad.network.aggregators.route import Route
from salad.network.aggregators.salad import Salad
from salad.network.backbones.efficientnet import build_backbone
from salad.network.config import Calibration, ModelConfig, Preprocessing
from salad.network.tokens import Tokens

PhotoLike = str | Path | Image.Image | UInt8[np.ndarray, "height width 3"]


class Describes(Protocol):
    """The seam between a model and everything that only needs descriptors; `FakeDescriber` keeps it too."""

    @property
    def name(self) -> str:
        """What people call the model."""
        ...

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        ...

    @property
    def fingerprint(self) -> str:
        """Changes with any weight and with any preprocessing setting."""
        ...

    @property
    def preprocessing(self) -> Preprocessing:
        """How photos are prepared."""
        ...

    def describe(
        self, photos: Sequence[PhotoLike], *, batch_size: int = 16
    ) -> Float32[np.ndarray, "photos dim"]:
        """One row of length 1 for each photo."""
        ...


class Share(NamedTuple):
    """Where a photo's tokens went.

    Args:
        dustbin: share of each token that the dustbin took, 0..1.
        cluster: the cluster that took most of what was left of each token.
    """

    dustbin: Float32[np.ndarray, "rows columns"]
    cluster: Int64[np.ndarray, "rows columns"]


class Describer(nn.Module):
    """The model as its users know it.

    Call it with normalised images to get descriptors that can be trained; use `describe` for photos.

    Raises:
        ModelError: backbone and aggregator do not fit together.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.backbone = build_backbone(config.backbone)
        self.aggregator = build_aggregator(config.aggregator)
        if config.aggregator.width != self.backbone.width:
            raise ModelError(
                f"the aggregator takes tokens of {config.aggregator.width} numbers, but the backbone makes them of "
                f"{self.backbone.width}"
            )
        for name in ("mean", "std"):  # with the model, so that no caller normalises wrongly
            values = torch.tensor(getattr(config.preprocessing, name)).view(3, 1, 1)
            self.register_buffer(name, values, persistent=False)

    @property
    def name(self) -> str:
        """What people call the model."""
        return self.config.name

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.config.aggregator.dim

    @property
    def preprocessing(self) -> Preprocessing:
        """How photos are prepared."""
        return self.config.preprocessing

    @property
    def calibration(self) -> Calibration | None:
        """What its scores are worth; None where nobody has measured that."""
        return self.config.calibration

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self.mean.device

    @property
    def fingerprint(self) -> str:
        """Changes with any weight and with any setting of architecture or preprocessing; nothing else counts.

        Computed at every call (half a second for a ViT-B), so it can never be out of date.
        """
        settings = self.config.as_dict()
        counted = {part: settings[part] for part in ("backbone", "aggregator", "preprocessing")}
        digest = hashlib.sha256(json.dumps(counted, sort_keys=True).encode())
        for key, value in sorted(self.state_dict().items()):
            digest.update(f"{key}{tuple(value.shape)}".encode())
            plain = value.detach().to("cpu", torch.float32 if value.is_floating_point() else torch.int64)
            digest.update(plain.contiguous().numpy().tobytes())
        return digest.hexdigest()[:16]

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch dim"]:
        """Describe normalised images; a side that is no multiple of the stride is rounded to the nearest one.

        Raises:
            TooFewTokensError: the images are too small for the model's clusters.
        """
        descriptors: Tensor = self.aggregator(self.tokens(images))
        return descriptors

    def tokens(self, images: Float[Tensor, "batch 3 height width"]) -> Tokens:
        """Cut normalised images into tokens."""
        stride = self.backbone.stride
        size = [max(1, round(side / stride)) * stride for side in images.shape[-2:]]
        if size != list(images.shape[-2:]):
            images = F.interpolate(images, size=size, mode="bilinear", antialias=True)
        tokens: Tokens = self.backbone(images)
        return tokens

    def describe(
        self, photos: Sequence[PhotoLike], *, batch_size: int = 16
    ) -> Float32[np.ndarray, "photos dim"]:
        """Describe photos given as paths, Pillow images or arrays of bytes [height, width, 3].

        Returns:
            One row of length 1 for each photo.

        Raises:
            PhotoError: a path cannot be read, and the message names it; or an array is no photo.
            ModelError: `batch_size` is below 1.
        """
        if batch_size < 1:
            raise ModelError(f"batch_size is {batch_size}; give at least 1")
        rows = np.empty((len(photos), self.dim), dtype=np.float32)
        for start in range(0, len(photos), batch_size):
            batch = photos[start : start + batch_size]
            with torch.inference_mode(), evaluating(self):
                rows[start : start + len(batch)] = self(self.prepare(batch)).float().cpu().numpy()
        return rows

    def prepare(self, photos: Sequence[PhotoLike]) -> Float[Tensor, "batch 3 height width"]:
        """Squeeze and normalise photos for `forward`."""
        squeezed = np.stack([self._squeeze(photo) for photo in photos])
        images = torch.from_numpy(squeezed).to(self.device).permute(0, 3, 1, 2)
        return (images.float() / 255 - self.mean) / self.std

    def share(self, photo: PhotoLike) -> Share:
        """Where one photo's tokens went: what the dustbin took and which cluster has the most of the rest.

        Raises:
            ModelError: the model has no dustbin, or nothing says what that took of a token.
        """
        salad = _with_dustbin(self.aggregator, self.name)
        with torch.inference_mode(), evaluating(self):
            tokens = self.tokens(self.prepare([photo]))
            plan = salad.plan(tokens)[0].float().cpu().numpy()
        return Share(plan[-1].reshape(tokens.grid), plan[:-1].argmax(axis=0).reshape(tokens.grid))

    def _squeeze(self, photo: PhotoLike) -> UInt8[np.ndarray, "height width 3"]:
        to = self.preprocessing
        height, width, resample = to.height, to.width, to.resample
        if isinstance(photo, str | Path):
            return decode(Path(photo), height, width, resample)
        if isinstance(photo, np.ndarray):
            if photo.dtype != np.uint8 or photo.ndim != 3 or photo.shape[2] != 3 or not photo.size:
                raise PhotoError(
                    f"an array of {photo.dtype} {photo.shape} is no photo: give uint8 [height, width, 3]"
                )
            if photo.shape == (height, width, 3):
                return photo
            photo = Image.fromarray(photo)
        return squeeze(photo, height, width, resample)


def _with_dustbin(aggregator: Aggregator, name: str) -> Salad:
    """The part of an aggregator that has a dustbin, whose share of a token can be told."""
    salad = aggregator.salad if isinstance(aggregator, Route) else aggregator
    if not isinstance(salad, Salad):
        raise ModelError(f"the model {name} has no dustbin to show: its aggregator is not SALAD")
    if not salad.config.dustbin:
        raise ModelError(f"the model {name} has no dustbin to show: it was made without one")
    if salad.config.transport == "dual-softmax":
        raise ModelError(
            f"the model {name} has no dustbin to show: its dual softmax takes no share of a token"
        )
    return salad


class evaluating:  # noqa: N801  # reads as a verb
    """Evaluation mode inside, whatever mode the model was in before."""

    def __init__(self, model: nn.Module) -> None:
        self.model, self.before = model, model.training

    def __enter__(self) -> None:
        self.model.eval()

    def __exit__(self, *_: object) -> None:
        self.model.train(self.before)


def build(config: ModelConfig, *, seed: int = 0) -> Describer:
    """A describer with untrained weights, the same for the same seed.

    Raises:
        ModelError: the configuration's parts do not fit together.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Describer(config).eval()
