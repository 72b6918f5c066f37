"""The engine of the extra `fast`: OpenVINO, which has kernels for what a processor can do besides float32.

It runs the same `graph.onnx` as ONNX Runtime does, in float32. Models in bfloat16 or int8 (`salad.models.quantize`)
are its alone: theirs is a graph of its own form, which lies with its numbers in `model.safetensors`.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

import numpy as np

from salad.errors import MissingExtraError, ModelError, WeightsError
from salad.models.engines import Outputs, Photos, Weights, check_request, check_settings, photo_by_photo
from salad.network.config import PHOTOS, SETTINGS, ModelConfig, Output, Precision
from salad.processors import processors

GRAPH, NUMBERS = "graph.xml", "graph.bin"
"""What `model.safetensors` of a quantized model holds: OpenVINO's two files, as bytes."""
BITS = "salad.weight_bits"
"""What a graph in int8 says the bits of its weights under."""
# OpenVINO's words for how a model computes where its graph does not say. It would take bfloat16 by itself.
_HINTS: dict[Precision, str] = {"float32": "f32", "bf16": "bf16", "int8": "f32"}
_NEEDS: dict[Precision, str] = {"float32": "FP32", "bf16": "BF16", "int8": "INT8"}
# NumKong's names for processors that multiply bytes and add the products in 32 bits, Intel's VNNI and the like.
_ADD_IN_32_BITS = ("icelake", "alder", "sierra", "neonsdot")
_TELEMETRY = "openvino_telemetry"


class OpenVinoEngine:
    """Runs an exported graph in float32, or a quantized one in the precision it was made for; on the processor.

    Args:
        config: The model; its precision says which of the two.
        graph: Its `graph.onnx`, beside the weights it points into; of a quantized model the file that `read` reads.
        read: Gives these weights.
        threads: How many a batch is spread over; as many as there are processors where not given.
    """

    def __init__(
        self, config: ModelConfig, graph: Path, read: Callable[[], Weights], *, threads: int | None = None
    ) -> None:
        self.config, self.threads = config, threads or processors()
        self.graph, self._read = graph, read
        self._compiled: _Compiled | None = None
        self._loading = threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        """All but the lock and what OpenVINO made, which another process makes anew."""
        return {**vars(self), "_compiled": None, "_loading": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _loading=threading.Lock())

    @property
    def compiled(self) -> Any:
        """The model as OpenVINO compiled it, the first time it is asked for.

        Raises:
            MissingExtraError: If OpenVINO is not installed.
            WeightsError: If the graph is damaged, or another model's than the configuration's.
            ModelError: If this processor lacks the instructions.
        """
        return self._compiled_for(1).model

    def _compiled_for(self, photos: int) -> _Compiled:
        """The compiled model: its threads share a photo until several come at once; from then on each has its own."""
        with self._loading:
            streams = self.threads if photos > 1 else 1
            if self._compiled is None or streams > self._compiled.streams:
                self._compiled = _Compiled(self._made(streams), streams, SimpleQueue())
            return self._compiled

    def _made(self, streams: int) -> Any:
        core = openvino().Core()
        precision = self.config.precision
        if _NEEDS[precision] not in core.get_property("CPU", "OPTIMIZATION_CAPABILITIES"):
            raise ModelError(
                f"the model {self.config.name} computes in {precision}, for which this processor "
                f"({core.get_property('CPU', 'FULL_DEVICE_NAME')}) has no instructions: take the model it was made of"
            )
        settings: dict[str, Any] = {
            "INFERENCE_PRECISION_HINT": _HINTS[precision],
            "INFERENCE_NUM_THREADS": self.threads,
            "NUM_STREAMS": streams,
            # Bound to cores, threads would stay beside those of the workers that read photos.
            "ENABLE_CPU_PINNING": False,
        }
        model = self.model()
        if model.has_rt_info([BITS]) and model.get_rt_info([BITS]).astype(str) == "8" and not adds_in_32_bits():
            raise ModelError(
                f"the model {self.config.name} was made int8 for processors with VNNI, and would overflow on this one: "
                "take the model it was made of, or quantize that here"
            )
        try:
            return core.compile_model(model, "CPU", settings)
        except RuntimeError as error:
            raise WeightsError(f"{self.graph} cannot be run: {_last_line(error)}") from error

    def model(self) -> Any:
        """The graph as OpenVINO reads it, an `openvino.Model`.

        Raises:
            MissingExtraError: If OpenVINO is not installed.
            WeightsError: If the graph is damaged, or another model's than the configuration's.
        """
        core, quantized = openvino().Core(), self.config.precision != "float32"
        try:
            if quantized:
                files = self._read()
                model = core.read_model(files[GRAPH].tobytes(), files[NUMBERS].tobytes())
            else:
                model = _read_graph(core, self.graph)
            told = model.get_rt_info([SETTINGS] if quantized else ["framework", SETTINGS])
            made_of = told.astype(str)
        except (RuntimeError, KeyError, OSError) as error:
            raise WeightsError(f"{self.graph} cannot be run: {_last_line(error)}") from error
        command = "salad quantize" if quantized else "salad weights graph"
        check_settings(self.config, made_of, graph=self.graph, command=command)
        _resize_once(model)
        return model

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
        return "cpu"

    def weights(self) -> Weights:
        """The weights in the file that the graph points into; of a quantized model, the graph too."""
        return self._read()

    def run(self, photos: Photos, outputs: Sequence[Output] = ("descriptor",)) -> Outputs:
        """Run a batch; threads that ask at once are served at once, as far as there are threads.

        Raises:
            ModelError: If the photos are of another shape or type, an output is not there, or the processor lacks the
                instructions.
            MissingExtraError: If OpenVINO is not installed.
            WeightsError: If the graph is damaged.
        """
        check_request(self, photos, outputs)
        compiled = self._compiled_for(len(photos))
        whole = photo_by_photo(lambda some: compiled.run(some, outputs), photos, threads=self.threads)
        return dict(zip(outputs, whole, strict=True))


class _Compiled(NamedTuple):
    """A compiled model, and the requests for it that no thread runs just now."""

    model: Any
    streams: int
    idle: SimpleQueue[Any]

    def run(self, photos: Photos, outputs: Sequence[Output]) -> list[np.ndarray]:
        """One array for each output; from any thread."""
        try:
            request = self.idle.get_nowait()
        except Empty:
            request = self.model.create_infer_request()
        # Looked at and not copied, all outputs come for nothing; what is given away is copied before the next photo.
        made = request.infer({PHOTOS: photos}, share_outputs=True)
        found = [np.array(made[name], np.float32) for name in outputs]
        self.idle.put(request)
        return found


def adds_in_32_bits() -> bool:
    """Whether this processor adds products of bytes without overflow."""
    import numkong

    return any(numkong.get_capabilities().get(name) for name in _ADD_IN_32_BITS)


def openvino() -> Any:
    """The package, which neither writes nor sends anything of its use.

    Raises:
        MissingExtraError: If it is not installed.
    """
    try:
        with no_telemetry():
            import openvino
    except ImportError as error:
        raise MissingExtraError("running a model by OpenVINO", "fast") from error
    return openvino


@contextmanager
def no_telemetry() -> Iterator[None]:
    """Whatever is imported inside finds no `openvino_telemetry`, and does without.

    OpenVINO asks nobody: when it is imported it writes an identity into the home folder and reports to a server. Where
    the package that does so is missing, it and NNCF put something in its place that does nothing.
    """
    if _TELEMETRY in sys.modules:  # imported by somebody else's will, whose affair it is
        yield
        return
    sys.modules[_TELEMETRY] = None  # type: ignore[assignment]  # Python's own way to say: there is none
    try:
        yield
    finally:
        sys.modules.pop(_TELEMETRY, None)


def _read_graph(core: Any, graph: Path) -> Any:
    weights = graph.with_name("model.safetensors")
    if not weights.is_symlink():
        return core.read_model(graph)
    # OpenVINO reads no file that lies outside the graph's folder, as one may that is a link, so both are copied.
    with tempfile.TemporaryDirectory(prefix="salad-") as scratch:
        for file in (graph, weights):
            shutil.copyfile(file, Path(scratch) / file.name)
        core.set_property({"ENABLE_MMAP": False})  # nothing may hold on to a copy that is about to go
        return core.read_model(Path(scratch) / graph.name)


def _resize_once(model: Any) -> None:
    """Put constants in place of whatever is resized and does not depend on the photo: a ViT's position embeddings.

    OpenVINO would do so too, but by reference code that takes five seconds where its own kernels take none.
    """
    ov = openvino()
    for node in model.get_ops():
        # What comes of photos is as long as the batch, which only time will tell.
        if node.get_type_name() != "Interpolate" or node.get_output_partial_shape(0).is_dynamic:
            continue
        source = node.input_value(0)
        given = ov.compile_model(ov.Model([source], []), "CPU", {"INFERENCE_PRECISION_HINT": "f32"})({})[0]
        place = ov.opset13.parameter(given.shape, np.float32)
        node.input(0).replace_source_output(place.output(0))
        resized = ov.compile_model(ov.Model([node.output(0)], [place]), "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
        constant = ov.opset13.constant(resized({0: given})[0])
        for user in node.output(0).get_target_inputs():
            user.replace_source_output(constant.output(0))


def _last_line(error: Exception) -> str:
    """What OpenVINO says in the end; before that it names its own source files."""
    return next((line for line in reversed(str(error).splitlines()) if line.strip()), type(error).__name__)
