"""The engine that needs torch: it runs the network itself, so it trains, and takes every model that can be built.

The one module outside training that imports torch, and only once a network is needed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from salad.errors import ModelError, needs_extra
from salad.models.engines import Outputs, Photos, Weights, check_request
from salad.network.config import ModelConfig, Output

if TYPE_CHECKING:
    from salad.network.network import Network as Network


class TorchEngine:
    """Runs SALAD by torch; network and torch are loaded when they are first needed.

    Args:
        config: The model.
        read: Gives its weights.
        source: The file they are from, for errors.
        device: Where to run, as torch names it.
        threads: How many a batch is spread over, by everything that torch does in this process; its own choice where
            not given.
    """

    def __init__(
        self,
        config: ModelConfig,
        read: Callable[[], Weights],
        *,
        source: Path,
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        self.config, self.threads = config, threads
        self._read, self._source, self._device = read, source, str(device)
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
        with needs_extra("running a model by torch", "torch"):
            import torch

            from salad.network.network import load_weights

        if self.threads is not None:
            torch.set_num_threads(self.threads)
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
    check_published()
    from salad.network.checkpoints import read_published

    return _moved(read_published(path, heads=heads, name=name), device)


def check_published() -> None:
    """Make sure that published files can be read here, before somebody fetches one.

    Raises:
        MissingExtraError: If torch is not installed.
    """
    with needs_extra("reading a published file of weights", "torch"):
        import torch  # noqa: F401  # whether it can be


def write_file(network: Network, to: Path, photos: Sequence[np.ndarray] = (), *, normalised: bool = False) -> None:
    """Write a network as one file by COLMAP's contract and check it; what is wrong does not stay.

    Raises:
        MissingExtraError: If torch or its exporter is not installed.
        ModelError: If the network cannot be exported, or the file computes anything else.
        OSError: If it cannot be written.
    """
    from salad.network.export import check_file, export_file, made_pictures

    draft = to.with_name(f".{to.name}.part")
    try:
        export_file(network, draft, normalised=normalised)
        checked_on = np.stack([*photos, *made_pictures(network.config.preprocessing)])
        check_file(network, draft, checked_on, normalised=normalised)
        draft.replace(to)
    finally:
        draft.unlink(missing_ok=True)


def write_graph(network: Network, weights: Path, to: Path, photos: Sequence[np.ndarray] = ()) -> None:
    """Write a network's graph and check it, on made pictures where photos are too few; what is wrong does not stay.

    Raises:
        MissingExtraError: If torch's exporter is not installed.
        ModelError: If the network cannot be exported, or the graph computes anything else.
    """
    from salad.network.export import check_graph, export_graph, made_pictures

    try:
        export_graph(network, weights, to)
        check_graph(network, to, np.stack([*photos, *made_pictures(network.config.preprocessing)]))
    except BaseException:
        to.unlink(missing_ok=True)
        raise


def _moved(network: Network, device: str) -> Network:
    try:
        return network.to(device)
    except (RuntimeError, AssertionError) as error:  # torch's own words differ from device to device
        raise ModelError(f"the device {str(device)!r} cannot be used here: {error}") from error
