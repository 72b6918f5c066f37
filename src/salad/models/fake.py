"""An engine and a describer without a network: for tests, and for an application before its weights are there."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from PIL import Image

from salad.errors import ModelError
from salad.images.decode import squeeze
from salad.models.describer import PhotoLike, squeezed
from salad.models.engines import Outputs, Photos, Weights, check_request
from salad.network.config import Output, Preprocessing

_GRID = 8  # rows and columns of a photo's tokens, each the colour of its cell


@dataclass(frozen=True)
class FakeEngine:
    """Keeps the seam `Engine` without a model: tokens are the colours of a thumbnail, everything else is random.

    Args:
        dim: Numbers in a descriptor.
        size: Height and width in pixels of the photos it takes.
        clusters: Clusters of the plan, the dustbin not counted.
        seed: Another seed is another model.
    """

    dim: int = 32
    size: tuple[int, int] = (64, 64)
    clusters: int = 4
    seed: int = 0

    @property
    def outputs(self) -> tuple[Output, ...]:
        """What it can be asked for: everything."""
        return ("descriptor", "patches", "cls", "plan")

    @property
    def device(self) -> str:
        """Where it runs."""
        return "cpu"

    def weights(self) -> Weights:
        """Drawn anew: what projects a thumbnail, and what scores a token for each cluster and the dustbin."""
        chance = np.random.default_rng(self.seed)  # of its own: nobody else's numbers change
        return {
            "projection": chance.standard_normal((3 * _GRID**2 + 1, self.dim)),
            "score": chance.standard_normal((3, self.clusters + 1)),
        }

    def run(self, photos: Photos, outputs: Sequence[Output] = ("descriptor",)) -> Outputs:
        """Run a batch, which may be empty.

        Raises:
            ModelError: If the photos are of another shape or type, or an output is not there.
        """
        check_request(self, photos, outputs)
        weights = self.weights()
        small = [squeeze(Image.fromarray(photo), _GRID, _GRID) for photo in photos]
        patches = np.array(small, np.float64).reshape(-1, _GRID, _GRID, 3) / 255
        flat = patches.reshape(len(photos), 3 * _GRID**2)
        # Around its mean, for light is no place; and a constant, for a photo of one colour has a descriptor too.
        seen = np.column_stack([flat - flat.mean(axis=1, keepdims=True), np.full(len(photos), 0.1)])
        descriptor = seen @ weights["projection"]
        # A softmax over clusters and dustbin: not Sinkhorn's plan, but every token is shared out whole.
        odds = np.exp(patches @ weights["score"])
        made: dict[Output, np.ndarray] = {
            "descriptor": descriptor / np.linalg.norm(descriptor, axis=1, keepdims=True),
            "patches": patches,
            "cls": patches.mean(axis=(1, 2)),
            "plan": (odds / odds.sum(axis=3, keepdims=True)).transpose(0, 3, 1, 2),
        }
        return {name: made[name].astype(np.float32) for name in outputs}


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
    preprocessing: Preprocessing = field(default_factory=lambda: Preprocessing(height=64, width=64))
    seed: int = 0

    def __post_init__(self) -> None:
        if self.dim < 1:
            raise ModelError(f"a descriptor of {self.dim} numbers cannot be: give a dim of 1 or more")

    @property
    def fingerprint(self) -> str:
        """Changes with the dimension, the seed and every preprocessing setting."""
        # The name does not count, as with real models: what describes alike may search the same index.
        settings = (self.dim, self.seed, self.preprocessing)
        # With a prefix, so that no index of a fake is ever taken for one of a model's.
        return "fake-" + hashlib.blake2b(repr(settings).encode(), digest_size=8).hexdigest()

    def describe(self, photos: Sequence[PhotoLike], *, batch_size: int = 16) -> npt.NDArray[np.float32]:
        """One row of length 1 for each photo.

        Raises:
            PhotoError: If a photo cannot be read.
            ModelError: If `batch_size` is below 1; it changes nothing else.
        """
        if batch_size < 1:
            raise ModelError(f"a batch of {batch_size} photos cannot be: give a batch_size of 1 or more")
        to = self.preprocessing
        engine = FakeEngine(self.dim, (to.height, to.width), seed=self.seed)
        images = np.empty((len(photos), to.height, to.width, 3), np.uint8)
        for image, photo in zip(images, photos, strict=True):
            image[:] = squeezed(photo, to)
        return engine.run(images)["descriptor"]
