"""A model in use: photos in, descriptors out, whatever engine runs it. Everything here is an array."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np
import numpy.typing as npt
from PIL import Image

from salad.errors import ModelError, PhotoError
from salad.images.decode import Pixels, squeeze
from salad.images.named import HeldPhoto, NamedPhoto, PhotoBelow
from salad.images.workers import Workers
from salad.models.engines import Engine
from salad.models.torch_engine import TorchEngine
from salad.network.config import Calibration, ModelConfig, Preprocessing

if TYPE_CHECKING:
    from salad.models.engines import Choice, Outputs, Photos, Weights
    from salad.models.torch_engine import Network
    from salad.network.config import Output

PhotoLike = str | Path | Image.Image | Pixels | NamedPhoto
"""A photo to describe: its file, one that an index or a result names, or its pixels."""


class DescriberLike(Protocol):
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

    def describe(self, photos: Sequence[PhotoLike], *, batch_size: int = 16) -> npt.NDArray[np.float32]:
        """One row of length 1 for each photo: `[photos, dim]`."""
        ...


class TokenAssignment(NamedTuple):
    """Where a photo's tokens went.

    Args:
        dustbin: How much of each token the dustbin took, 0..1: `[rows, columns]`.
        cluster: The cluster that took most of what was left of each token: `[rows, columns]`.
    """

    dustbin: npt.NDArray[np.float32]
    cluster: npt.NDArray[np.int64]


class Describer:
    """The model as its users know it: a configuration, the preprocessing it tells of, and an engine.

    Args:
        config: What the model is.
        engine: What runs it.
        engine_choice: Which engine that is and why, where it was chosen among several.
    """

    def __init__(self, config: ModelConfig, engine: Engine, *, engine_choice: Choice | None = None) -> None:
        self.config, self.engine, self.engine_choice = config, engine, engine_choice
        self._told: tuple[ModelConfig, Engine, str] | None = None  # the fingerprint, and of what

    @classmethod
    def of(cls, network: Network) -> Self:
        """Describe with a torch module, as it is now and as it will be trained."""
        return cls(network.config, TorchEngine.of(network))

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
    def device(self) -> str:
        """Where it runs, in the engine's words."""
        return self.engine.device

    @property
    def fingerprint(self) -> str:
        """Changes with any weight and with any setting of architecture or preprocessing; nothing else counts.

        Half a second for a ViT-B; of a torch module, which may be trained, at every call, so it is never out of date.
        """
        if isinstance(self.engine, TorchEngine):
            return self.config.fingerprint(self.weights())
        # Every other engine runs the weights it was opened with, whatever becomes of their file meanwhile.
        if self._told is None or self._told[0] is not self.config or self._told[1] is not self.engine:
            self._told = self.config, self.engine, self.config.fingerprint(self.weights())
        return self._told[2]

    @property
    def network(self) -> Network:
        """SALAD as a torch module, to train or to look into; loaded when it is first asked for.

        From then on it is what describes photos, whatever engine did before: it may be trained.

        Raises:
            WeightsError: If the weights do not fit the configuration.
            ModelError: If the model does not compute in float32.
            MissingExtraError: If torch is not installed.
        """
        if self.config.precision != "float32":
            raise ModelError(
                f"the model {self.name} computes in {self.config.precision} and has no torch module: take the model it "
                "was made of"
            )
        if not isinstance(self.engine, TorchEngine):
            given = self.engine
            engine = TorchEngine(self.config, given.weights, source=Path(self.name), device=given.device)
            _ = engine.network  # before the engine is changed: without torch, everything stays as it was
            self.engine = engine
        return self.engine.network

    def __call__(self, images: Any) -> Any:
        """Describe normalised images `[batch, 3, height, width]`, torch tensors, with gradients."""
        return self.network(images)

    def weights(self) -> Weights:
        """The weights it runs with, under the names they have on disk."""
        return self.engine.weights()

    def describe(self, photos: Sequence[PhotoLike], *, batch_size: int = 16) -> npt.NDArray[np.float32]:
        """Describe photos given as paths, Pillow images or arrays of bytes [height, width, 3].

        Returns:
            One row of length 1 for each photo: `[photos, dim]`.

        Raises:
            PhotoError: If a path cannot be read, and the message names it; or an array is no photo.
            ModelError: If `batch_size` is below 1.
            MissingExtraError: If what runs the model is not installed.
        """
        if batch_size < 1:
            raise ModelError(f"batch_size is {batch_size}; give at least 1")
        # Batch after batch, squeezed photos too: a million of them would not fit into memory.
        rows = np.empty((len(photos), self.dim), dtype=np.float32)
        for start in range(0, len(photos), batch_size):
            images = self.squeezed(photos[start : start + batch_size])
            rows[start : start + len(images)] = self.engine.run(images)["descriptor"]
        return rows

    def squeezed(self, photos: Sequence[PhotoLike]) -> Photos:
        """Photos as the engine takes them: squeezed, never cropped, to the model's size.

        Raises:
            PhotoError: If a path cannot be read, or an array is no photo.
        """
        to = self.preprocessing
        made = np.empty((len(photos), to.height, to.width, 3), dtype=np.uint8)
        for row, photo in zip(made, photos, strict=True):
            row[:] = squeezed(photo, to)
        return made

    def outputs(self, photos: Sequence[PhotoLike], *names: Output) -> Outputs:
        """What the engine makes of photos besides descriptors, all in one batch: `patches`, `cls`, `plan`.

        Returns:
            For each name an array, as `salad.models.engines` shapes it.

        Raises:
            PhotoError: If a path cannot be read, or an array is no photo.
            ModelError: If the model has no such output.
            MissingExtraError: If what runs the model is not installed.
        """
        return self.engine.run(self.squeezed(photos), names)

    def token_assignment(self, photo: PhotoLike) -> TokenAssignment:
        """Where one photo's tokens went: what the dustbin took and which cluster has the most of the rest.

        Raises:
            ModelError: If the model has no dustbin, or nothing says what that took of a token.
        """
        # Asked of the configuration: the answer must not wait for weights to be loaded.
        reason = self.config.aggregator.no_dustbin
        if reason:
            raise ModelError(f"the model {self.name} has no dustbin to show: {reason}")
        # The dustbin is the plan's last row in every engine.
        plan = self.outputs([photo], "plan")["plan"][0]
        return TokenAssignment(dustbin=plan[-1], cluster=plan[:-1].argmax(axis=0))

    def share(self, photo: PhotoLike) -> TokenAssignment:
        """The old name of `token_assignment`, which goes with the next release."""
        warnings.warn("Describer.share is called Describer.token_assignment now", DeprecationWarning, stacklevel=2)
        return self.token_assignment(photo)


def squeezed(photo: PhotoLike, to: Preprocessing) -> Pixels:
    """One photo as bytes of the size that `to` says; an array of that size already is taken as it is.

    Raises:
        PhotoError: If a path cannot be read, or an array is no photo.
    """
    if isinstance(photo, np.ndarray):
        if photo.dtype != np.uint8 or photo.ndim != 3 or photo.shape[2] != 3 or not photo.size:
            raise PhotoError(f"an array of {photo.dtype} {photo.shape} is no photo: give uint8 [height, width, 3]")
        # As workers and caches hand photos over: decoded and squeezed for this very model.
        if photo.shape == (to.height, to.width, 3):
            return photo
        photo = Image.fromarray(photo)
    if isinstance(photo, Image.Image):
        return squeeze(photo, to.height, to.width, to.resample)
    # Files are decoded and squeezed in one go: a large JPEG is reduced while it is decoded, everywhere alike. Whatever
    # `Path` takes names a file, entries of `os.scandir` too; it refuses the rest by a TypeError of its own.
    file = photo if isinstance(photo, HeldPhoto | PhotoBelow) else Path(photo)
    with Workers(1) as workers:
        return workers.decode(file, to.height, to.width, to.resample)
