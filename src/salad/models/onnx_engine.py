"""The engine that everybody has: it runs a model's `graph.onnx` by ONNX Runtime, and knows nothing of torch."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from salad.errors import ModelError, WeightsError
from salad.models.engines import Outputs, Photos, Weights, check_request, check_settings, photo_by_photo
from salad.network.config import PHOTOS, SETTINGS, ModelConfig, Output
from salad.processors import processors

if TYPE_CHECKING:
    from onnxruntime import InferenceSession


class OnnxEngine:
    """Runs an exported graph, in float32.

    Args:
        config: The model.
        graph: Its `graph.onnx`, beside the weights it points into.
        read: Gives these weights, for whoever asks for them; the graph reads the file by itself.
        device: `cpu`, or an accelerator that this ONNX Runtime was built for, with its number, as torch names it.
        threads: How many a batch is spread over; as many as there are processors where not given.
    """

    def __init__(
        self,
        config: ModelConfig,
        graph: Path,
        read: Callable[[], Weights],
        *,
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        self.config, self.threads = config, threads or processors()
        self.graph, self._read, self._device = graph, read, str(device)
        self._session: InferenceSession | None = None
        self._one_thread_a_photo = False
        self._loading = threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        """All but the lock and the session, which another process makes anew."""
        return {**vars(self), "_session": None, "_loading": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _loading=threading.Lock())

    @property
    def session(self) -> InferenceSession:
        """ONNX Runtime's session, made the first time.

        Raises:
            WeightsError: If the graph is damaged, or another model's than the configuration's.
            ModelError: If the device cannot be used.
        """
        return self._session_for(1)

    def _session_for(self, photos: int) -> InferenceSession:
        """The session: its threads share a photo until several come at once; from then on each has one of its own."""
        with self._loading:
            apart = photos > 1 and self.threads > 1 and self._device == "cpu"
            # In place of the other and never beside it, for each has its own copy of the weights.
            if self._session is None or (apart and not self._one_thread_a_photo):
                self._session = self._made(threads=1 if apart else self.threads)
                self._one_thread_a_photo = apart
            return self._session

    def _made(self, *, threads: int) -> InferenceSession:
        import onnxruntime

        onnxruntime.disable_telemetry_events()  # there are none but on Windows, and none of ours anywhere
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4  # not even errors, in colours on stderr: they are told as ours below
        options.intra_op_num_threads = threads
        # A thread that spins while it waits takes the core from the worker that reads the next photo.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        weights = self.graph.with_name("model.safetensors")
        if weights.is_symlink():
            # The runtime reads no file that lies outside the graph's folder, and this one may; its bytes it takes.
            held = weights.read_bytes()
            options.add_external_initializers_from_files_in_memory([weights.name], [held], [len(held)])
        provider = _provider(self._device, onnxruntime.get_available_providers())
        try:
            # Where a graph fails, the runtime would say so on stdout, where results go, and try it once more.
            session = onnxruntime.InferenceSession(self.graph, options, providers=[provider], enable_fallback=0)
        except Exception as error:  # the runtime's errors have no common ancestor
            raise WeightsError(f"{self.graph} cannot be run: {str(error).splitlines()[0]}") from error
        made_of = session.get_modelmeta().custom_metadata_map.get(SETTINGS, "null")
        check_settings(self.config, made_of, graph=self.graph, command="salad weights graph")
        gives = {output.name: output.shape for output in session.get_outputs()}
        takes = [given.name for given in session.get_inputs()]
        if takes != [PHOTOS] or not gives.keys() >= set(self.outputs):
            raise WeightsError(f"{self.graph} takes or gives something else than a model does: write it anew")
        if gives["descriptor"][-1:] != [self.config.aggregator.dim]:
            raise WeightsError(f"{self.graph} gives descriptors of another length than {self.config.name} has")
        return session

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
        """Where it runs."""
        return self._device

    def weights(self) -> Weights:
        """The weights in the file that the graph points into."""
        return self._read()

    def run(self, photos: Photos, outputs: Sequence[Output] = ("descriptor",)) -> Outputs:
        """Run a batch; threads that ask at once are served at once.

        Raises:
            ModelError: If the photos are of another shape or type, or an output is not there.
            WeightsError: If the graph is damaged.
        """
        check_request(self, photos, outputs)
        session = self._session_for(len(photos))

        def made(some: Photos) -> list[np.ndarray]:
            try:
                found: list[np.ndarray] = session.run(list(outputs), {PHOTOS: some})
            except Exception as error:  # the runtime's errors have no common ancestor
                raise WeightsError(f"{self.graph} cannot be run: {str(error).splitlines()[0]}") from error
            return found

        whole = photo_by_photo(made, photos, threads=self.threads, apart=self._device == "cpu")
        return dict(zip(outputs, whole, strict=True))


def _provider(device: str, available: Sequence[str]) -> Any:
    """What ONNX Runtime calls the device.

    Raises:
        ModelError: If it has no such device here.
    """
    kind, _, number = device.partition(":")
    name = f"{kind.upper()}ExecutionProvider"  # as it calls the processor, and every maker's cards
    if name not in available or not (number or "0").isdigit():
        raise ModelError(f"the device {device!r} cannot be used here: this ONNX Runtime has {', '.join(available)}")
    return name if kind == "cpu" else (name, {"device_id": int(number or 0)})
