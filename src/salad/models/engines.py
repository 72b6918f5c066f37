"""The Engine seam: what runs a model, images in and arrays out.

    photos, squeezed ──> Engine ──> descriptor [batch, dim]
                                    patches    [batch, rows, columns, d]
                                    cls        [batch, d]
                                    plan       [batch, clusters (and dustbin), rows, columns]

An engine takes photos as they are decoded, in bytes: normalisation is part of what it runs, so no caller can
normalise wrongly, and a quarter of the numbers travels to an accelerator. It knows one size of photo and any size of
batch, and is asked for its outputs by name, as runtimes of exported graphs want it. No array is a tensor: this is the
one module outside training that imports torch, and only once a network is needed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from jaxtyping import Float32, UInt8

from salad.errors import MissingExtraError, ModelError
from salad.network.config import ModelConfig, Output

if TYPE_CHECKING:
    from salad.network.network import Network as Network

Weights = Mapping[str, Any]
"""Arrays under the names they have in `model.safetensors`."""
Photos = UInt8[np.ndarray, "batch height width 3"]
Outputs = dict[Output, Float32[np.ndarray, "batch ..."]]


class Engine(Protocol):
    """What runs a model. `TorchEngine` is the first, `models.fake.FakeEngine` runs without any model.

    The same photos give the same numbers whatever batch they are in, up to rounding, and from any thread.
    """

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels of the photos it takes."""
        ...

    @property
    def outputs(self) -> tuple[Output, ...]:
        """What it can be asked for; `plan` only where tokens are shared out by one."""
        ...

    @property
    def device(self) -> str:
        """Where it runs, in its own words."""
        ...

    def weights(self) -> Weights:
        """The weights it runs with now: the model's fingerprint is made of them."""
        ...

    def run(self, photos: Photos, outputs: Sequence[Output] = ("descriptor",)) -> Outputs:
        """Run a batch, which may be empty.

        Args:
            photos: RGB of 0 to 255, all of the engine's size.
            outputs: What is wanted of `self.outputs`.

        Returns:
            One array for each output. Descriptors have length 1; where the plan has a dustbin it is the last row, and
            every token's column sums to 1.

        Raises:
            ModelError: If the photos are of another shape or type, or an output is not there.
            MissingExtraError: If what it runs on is not installed.
        """
        ...


def check_request(engine: Engine, photos: Photos, outputs: Sequence[Output]) -> None:
    """Refuse what an engine cannot run, in the same words for every engine.

    Raises:
        ModelError: If the photos are of another shape or type, or an output is not there.
    """
    # Exported graphs are made for one size; what a flexible engine would let pass must fail in the first one too.
    height, width = engine.size
    if photos.dtype != np.uint8 or photos.ndim != 4 or photos.shape[1:] != (height, width, 3):
        raise ModelError(
            f"photos of {photos.dtype} {list(photos.shape)} cannot be run: this model takes uint8 "
            f"[batch, {height}, {width}, 3]"
        )
    for name in outputs:
        if name not in engine.outputs:
            raise ModelError(f"this model has no output {name!r}: ask for {', '.join(engine.outputs)}")


class TorchEngine:
    """Runs SALAD by torch; network and torch are loaded when they are first needed.

    Args:
        config: The model.
        read: Gives its weights.
        source: The file they are from, for errors.
        device: Where to run, as torch names it.
    """

    def __init__(self, config: ModelConfig, read: Callable[[], Weights], *, source: Path, device: str = "cpu") -> None:
        self.config, self._read, self._source, self._device = config, read, source, str(device)
        self._network: Network | None = None
        self._loading = threading.Lock()  # eight threads that ask at once load it once

    @classmethod
    def of(cls, network: Network) -> Self:
        """Run a network that is there already; what changes its weights changes what the engine gives."""
        engine = cls(network.config, network.weights, source=Path(network.config.name))
        engine._network = network  # and `read` is the network's own, so that training shows in `weights`
        return engine

    def __getstate__(self) -> dict[str, Any]:
        """All but the lock, which can be neither copied nor pickled."""
        return {name: value for name, value in vars(self).items() if name != "_loading"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _loading=threading.Lock())

    @property
    def network(self) -> Network:
        """The torch module, loaded the first time.

        Raises:
            MissingExtraError: If torch is not installed.
            WeightsError: If the weights do not fit the configuration.
            ModelError: If the device cannot be used.
        """
        # The lock is held while loading, not only while asking: the second caller wants the result, not a second load.
        with self._loading:
            if self._network is None:
                self._network = self._loaded()
            return self._network

    def _loaded(self) -> Network:
        _insist_on_torch()
        from salad.network.network import load_weights

        return _moved(load_weights(self.config, self._read(), source=self._source), self._device)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels of the photos it takes."""
        return self.config.preprocessing.height, self.config.preprocessing.width

    @property
    def outputs(self) -> tuple[Output, ...]:
        """What it can be asked for."""
        return self.config.outputs

    @property
    def device(self) -> str:
        """Where the weights are, as torch names it."""
        return self._device if self._network is None else str(self._network.device)

    def weights(self) -> Weights:
        """The network's weights once it is loaded, so that training shows; before that, those of its file."""
        return self._read() if self._network is None else self._network.weights()

    def run(self, photos: Photos, outputs: Sequence[Output] = ("descriptor",)) -> Outputs:
        """Run a batch in evaluation mode, whatever mode the network is in.

        Raises:
            ModelError: If the photos are of another shape or type, or an output is not there.
            MissingExtraError: If torch is not installed.
        """
        check_request(self, photos, outputs)
        # torch takes no array that is mirrored, as BGR turned into RGB is, and warns of one that is read-only.
        photos = np.require(photos, requirements=("C", "W"))
        network = self.network
        import torch

        from salad.network.network import evaluating

        # Inference mode is the thread's own, but the module's mode is everybody's: nobody may train it meanwhile.
        with torch.inference_mode(), evaluating(network):
            made = network.outputs(photos, outputs)
        # Whatever precision it ran in, callers get float32 on the processor.
        return {name: value.float().cpu().numpy() for name, value in made.items()}


def published_network(path: Path, *, heads: int | None, name: str | None, device: str) -> Network:
    """A model from a file of one of the published layouts (`salad.network.checkpoints`).

    Raises:
        MissingExtraError: If torch, which such files are written with, is not installed.
        WeightsError: If the file is of no layout known, or lacks or adds a tensor.
        ModelError: If the device cannot be used.
    """
    _insist_on_torch()
    from salad.network.checkpoints import read_published

    return _moved(read_published(path, heads=heads, name=name), device)


def _moved(network: Network, device: str) -> Network:
    try:
        return network.to(device)
    except (RuntimeError, AssertionError) as error:  # torch's own words differ from device to device
        raise ModelError(f"the device {str(device)!r} cannot be used here: {error}") from error


def _insist_on_torch() -> None:
    try:
        import torch  # noqa: F401  # whether it can be
    except ImportError as error:
        raise MissingExtraError("running a model by torch", "torch") from error
