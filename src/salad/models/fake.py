"""A describer without a network: for tests, and for trying an application before its weights are there."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from salad.errors import ModelError
from salad.images.decode import decode, squeeze
from salad.network.config import Preprocessing

_SIDE = 8  # the thumbnail's side in pixels


def _small() -> Preprocessing:
    return Preprocessing(height=64, width=64)


@dataclass(frozen=True)
class FakeDescriber:
    """Keeps the seam `DescriberLike` without torch: a photo's thumbnail, projected at random, at length 1.

    The same pixels always give the same descriptor, and photos that look alike from afar get descriptors
    close to each other. It recognises no place.

    Args:
        dim: Numbers in a descriptor.
        name: What it calls itself.
        preprocessing: How photos are prepared; 64 x 64 unless told.
        seed: Another seed is another model.
    """

    dim: int = 32
    name: str = "fake"
    preprocessing: Preprocessing = field(default_factory=_small)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.dim < 1:
            raise ModelError(f"a descriptor of {self.dim} numbers cannot be: give a dim of 1 or more")

    @property
    def fingerprint(self) -> str:
        """Changes with the dimension, the seed and every preprocessing setting."""
        settings = (self.dim, self.seed, self.preprocessing)
        return "fake-" + hashlib.blake2b(repr(settings).encode(), digest_size=8).hexdigest()

    def describe(
        self, photos: Sequence[str | Path | Image.Image | npt.NDArray[np.uint8]], *, batch_size: int = 16
    ) -> npt.NDArray[np.float32]:
        """Descriptors float32 `[len(photos), dim]`, rows of length 1.

        Raises:
            PhotoError: If a photo cannot be read.
            ModelError: If `batch_size` is below 1; it changes nothing else.
        """
        if batch_size < 1:
            raise ModelError(f"a batch of {batch_size} photos cannot be: give a batch_size of 1 or more")
        if not photos:
            return np.zeros((0, self.dim), dtype=np.float32)
        thumbnails = np.stack([self._thumbnail(photo) for photo in photos])
        projection = np.random.default_rng(self.seed).standard_normal((thumbnails.shape[1], self.dim))
        projected = thumbnails @ projection
        described: npt.NDArray[np.float64] = projected / np.linalg.norm(projected, axis=1, keepdims=True)
        return described.astype(np.float32)

    def _thumbnail(self, photo: str | Path | Image.Image | npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
        """`[8 * 8 * 3 + 1]`: colours around their mean, and a constant, so that a flat photo has one too."""
        to = self.preprocessing
        if isinstance(photo, str | Path):
            seen = decode(Path(photo), to.height, to.width, to.resample)
        else:
            image = Image.fromarray(photo) if isinstance(photo, np.ndarray) else photo.convert("RGB")
            seen = squeeze(image, to.height, to.width, to.resample)
        small = squeeze(Image.fromarray(seen), _SIDE, _SIDE).astype(np.float64).ravel() / 255
        return np.append(small - small.mean(), 0.1)
