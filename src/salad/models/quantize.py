"""A model in bfloat16 or int8, of which a processor multiplies two or four numbers where it multiplies one float32.

What comes out is another model, with a fingerprint of its own: its descriptors lie near those of the model it was made
of, and are not the same. It runs by OpenVINO alone. Whether it still recognises places is not for this module to say:
`salad.evaluation.quantization` asks that before a model is written.
"""

from __future__ import annotations

import io
import json
import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from salad.errors import MissingExtraError, ModelError
from salad.models.describer import Describer
from salad.models.engines import Choice, Photos
from salad.models.openvino_engine import BITS, GRAPH, NUMBERS, OpenVinoEngine, adds_in_32_bits, no_telemetry, openvino
from salad.network.config import SETTINGS

Reduced = Literal["bf16", "int8"]


def quantized(model: Describer, photos: Photos, *, precision: Reduced) -> Describer:
    """The same model in another precision.

    Args:
        model: In float32, opened with the engine `openvino`.
        photos: What numbers pass through the model is learnt on these, for int8; bf16 needs none.
        precision: What to compute in.

    Raises:
        ModelError: If the model runs in another engine, computes in less than float32 already, or there are no photos
            for int8.
        MissingExtraError: If OpenVINO or NNCF is not installed.
    """
    engine = model.engine
    if not isinstance(engine, OpenVinoEngine) or model.config.precision != "float32":
        raise ModelError(f"{model.name} cannot be made {precision}: open a model in float32 with the engine openvino")
    graph = engine.model()
    _fold_constants(graph)
    if precision == "int8":
        if not len(photos):
            raise ModelError(f"{model.name} cannot be made int8 without photos to learn its numbers' range on")
        graph = _int8(graph, photos)
    config = replace(
        model.config,
        name=f"{model.name}-{precision}",
        precision=precision,
        provenance=f"{model.config.provenance}; {model.name} ({model.fingerprint}) in {precision}".lstrip("; "),
    )
    graph.set_rt_info(json.dumps(config.counted, sort_keys=True), SETTINGS)
    files = _as_bytes(graph, half=precision == "bf16")
    made = OpenVinoEngine(config, Path(config.name), partial(dict, files), threads=engine.threads)
    return Describer(config, made, engine_choice=Choice("openvino", f"nothing else runs a model in {precision}"))


def _fold_constants(graph: Any) -> None:
    """Compute now what does not depend on the photo: filters and norms that are one, weights that were stored in half.

    Only a filter that stands there as a constant is made int8.
    """
    openvino()
    from openvino.passes import ConstantFolding, Manager

    passes = Manager()
    passes.register_pass(ConstantFolding())
    passes.run_passes(graph)


def _int8(graph: Any, photos: Photos) -> Any:
    try:
        with no_telemetry():
            import nncf
    except ImportError as error:
        raise MissingExtraError("making a model int8", "fast") from error
    # Other processors add pairs of products in 16 bits, which those of 8 bits overflow: salad-lite's descriptors are
    # then at a cosine of 0.957 to float32's. With 7 bits they are at 0.980, and the same on every processor; where
    # nothing overflows, 8 bits are nearer still (0.987).
    bits = 8 if adds_in_32_bits() else 7
    overflow = nncf.OverflowFix.DISABLE if bits == 8 else nncf.OverflowFix.ENABLE
    with _silence():
        made = nncf.quantize(
            graph,
            nncf.Dataset([photo[None] for photo in photos]),
            # With smooth quantization and ranges that are not symmetric: best for both trunks, on training photos.
            model_type=nncf.ModelType.TRANSFORMER,
            advanced_parameters=nncf.AdvancedQuantizationParameters(overflow_fix=overflow),
            subset_size=len(photos),
        )
    made.set_rt_info(str(bits), BITS)
    return made


@contextmanager
def _silence() -> Iterator[None]:
    """Without NNCF's bars, which it draws into results, and its talk."""
    logger = logging.getLogger("nncf")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        logger.setLevel(before)


def _as_bytes(graph: Any, *, half: bool) -> dict[str, np.ndarray]:
    """OpenVINO's two files of a graph, as `model.safetensors` holds them."""
    with tempfile.TemporaryDirectory(prefix="salad-") as scratch:
        path = Path(scratch) / GRAPH
        openvino().save_model(graph, path, compress_to_fp16=half)
        return {name: np.fromfile(Path(scratch) / name, np.uint8) for name in (GRAPH, NUMBERS)}
