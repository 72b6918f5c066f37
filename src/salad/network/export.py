"""A network as `graph.onnx`: what runtimes run without torch.

The graph holds what is computed and no weights: each of them is named by its place in `model.safetensors`, which lies
beside it, so that a model is stored once and a graph is a few hundred kilobytes. Weights in half precision stay so on
disk and are widened where they are used. It takes photos in bytes, of one size and in any batch, and gives every output
that an engine can be asked for (`salad.models.engines`).

A graph is nothing to believe in: one made with a careless `len(x)` holds the batch of its example for ever, and says
nothing. So `check_graph` runs it beside the network, and whoever writes one checks it first.
"""

from __future__ import annotations

import json
import logging
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor, nn

from salad.errors import ModelError, needs_extra
from salad.network.config import PHOTOS, SETTINGS, Preprocessing
from salad.network.network import Network, evaluating

if TYPE_CHECKING:
    import onnx_ir as ir

OPSET = 20  # Gelu came with it; the runtimes of 2024 know it
COSINE = 0.99999  # of a descriptor by the graph and by the network, at least
TOLERANCE = 1e-3  # of tokens, as a share of the largest number among them, and of a plan's shares
BATCHES = (1, 2, 7)  # ten photos: a graph that holds the batch of its example fails with two of the three


class _Graph(nn.Module):
    """The network with all its outputs at once, as the exporter follows it."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, photos: UInt8[Tensor, "batch height width 3"]) -> tuple[Tensor, ...]:
        made = self.network.outputs(photos, self.network.config.outputs)
        return tuple(made.values())


def export_graph(network: Network, weights: Path, to: Path) -> None:
    """Write a network's graph; run `check_graph` before anybody trusts it.

    Args:
        network: What to export; its photos' size is the graph's.
        weights: Its `model.safetensors`, which must lie in the graph's folder from now on and stay byte for byte.
        to: The file to write.

    Raises:
        MissingExtraError: If the exporter is not installed.
        ModelError: If the network cannot be exported.
    """
    with needs_extra("exporting a model", "torch"):
        import onnx_ir as ir
        import onnxscript  # noqa: F401  # the exporter's own library, which it would ask for in words of its own

    size = network.config.preprocessing
    # Two photos: with one, the exporter may take the batch for a constant.
    example = torch.zeros(2, size.height, size.width, 3, dtype=torch.uint8, device=network.device)
    try:
        with _quiet(), evaluating(network), torch.no_grad():
            program = torch.onnx.export(
                _Graph(network),
                (example,),
                dynamo=True,
                dynamic_shapes=({0: torch.export.Dim.DYNAMIC},),
                input_names=[PHOTOS],
                output_names=list(network.config.outputs),
                opset_version=OPSET,
                optimize=False,  # it would fold weights into constants of the graph's own
                verbose=False,
            )
    except Exception as error:  # the exporter raises whatever its parts raise
        raise ModelError(f"the model {network.config.name} cannot be exported: {error}") from error
    assert program is not None
    model = program.model
    _tidy(model)
    _point_into(weights, model.graph)
    model.producer_name, model.producer_version = "salad", None
    model.metadata_props[SETTINGS] = json.dumps(network.config.counted, sort_keys=True)
    ir.save(model, to)


def check_graph(network: Network, graph: Path, photos: UInt8[np.ndarray, "n height width 3"]) -> None:
    """Run a graph beside the network it was made of, in batches of several sizes.

    Args:
        network: What gives the right answers.
        graph: The file, beside its weights.
        photos: Ten of them, of the model's size; more are passed over.

    Raises:
        ModelError: If the graph cannot be run, or computes anything else.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    start = 0
    try:
        session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
        for batch in BATCHES:
            some = np.ascontiguousarray(photos[start : start + batch])
            start += batch
            found = session.run(list(network.config.outputs), {PHOTOS: some})
            with evaluating(network), torch.no_grad():
                due = network.outputs(some, network.config.outputs)
            for (name, right), given in zip(due.items(), found, strict=True):
                _compare(name, given, right.float().cpu().numpy())
    except ModelError as error:
        raise ModelError(f"the graph of {network.config.name} is wrong, and is not kept: {error}") from error
    except Exception as error:  # the runtime's errors have no common ancestor
        raise ModelError(f"the graph of {network.config.name} cannot be run, and is not kept: {error}") from error


def made_pictures(size: Preprocessing, count: int = sum(BATCHES), *, seed: int = 0) -> UInt8[np.ndarray, "n h w 3"]:
    """Pictures that are as rough as photos are, where there are none at hand: clouds of colour.

    Args:
        size: Height and width in pixels.
        count: How many.
        seed: Others for another.
    """
    chance = np.random.default_rng(seed)
    # A photo's spectrum falls with the frequency (Field, 1987); noise as it comes would be one grey to every filter.
    down, across = np.fft.fftfreq(size.height)[:, None], np.fft.fftfreq(size.width)
    falling = 1 / np.maximum(np.hypot(down, across), 1 / max(size.height, size.width))
    noise = chance.standard_normal((count, 3, size.height, size.width))
    clouds = np.fft.ifft2(np.fft.fft2(noise) * falling).real
    low, high = clouds.min(axis=(2, 3), keepdims=True), clouds.max(axis=(2, 3), keepdims=True)
    pictures: np.ndarray = ((clouds - low) / (high - low) * 255).astype(np.uint8)
    return pictures.transpose(0, 2, 3, 1)


def _compare(name: str, given: np.ndarray, right: np.ndarray) -> None:
    if given.shape != right.shape:
        raise ModelError(f"its {name} is of shape {list(given.shape)}, the network's {list(right.shape)}")
    if name == "descriptor":
        cosine = float((given.astype(np.float64) * right).sum(axis=1).min())
        if not cosine >= COSINE:  # and so that NaN is refused
            raise ModelError(f"its descriptors are at a cosine of {cosine:.6f} to the network's, {COSINE} is due")
        return
    apart = float(np.abs(given - right).max()) / max(1.0, float(np.abs(right).max()))
    if not apart <= TOLERANCE:
        raise ModelError(f"its {name} is {apart:.2g} away from the network's, {TOLERANCE:g} is allowed")


def _tidy(model: ir.Model) -> None:
    """Take away what only whoever debugs the exporter reads, nine tenths of the file, and what comes twice."""
    from onnx_ir.passes import common

    for tidy in (
        common.ClearMetadataAndDocStringPass(),
        common.IdentityEliminationPass(),
        common.CommonSubexpressionEliminationPass(),
        common.RemoveUnusedNodesPass(),
    ):
        tidy(model)


def _point_into(weights: Path, graph: ir.Graph) -> None:
    """Let every weight be the bytes that a safetensors file has of it."""
    import onnx_ir as ir

    with weights.open("rb") as file:
        (length,) = struct.unpack("<Q", file.read(8))  # of the header, which says where each tensor begins
        stored = json.loads(file.read(length))
    kinds = {"F32": ir.DataType.FLOAT, "F16": ir.DataType.FLOAT16}
    for name, value in list(graph.initializers.items()):
        key = name.removeprefix("network.")
        if key not in stored:  # mean and std of the preprocessing, and constants: they stay in the graph
            continue
        begin, end = stored[key]["data_offsets"]
        kind, shape = kinds[stored[key]["dtype"]], ir.Shape(stored[key]["shape"])
        tensor = ir.ExternalTensor(
            weights.name, 8 + length + begin, end - begin, kind, shape=shape, name=key, base_dir=weights.parent
        )
        own = ir.Value(name=key, shape=shape, type=ir.TensorType(kind), const_value=tensor)
        graph.initializers.pop(name)
        graph.register_initializer(own)
        if kind == ir.DataType.FLOAT:
            ir.convenience.replace_all_uses_with(value, own)
            continue
        widen = ir.node("Cast", [own], {"to": int(ir.DataType.FLOAT)})
        ir.convenience.replace_all_uses_with(value, widen.outputs[0])
        graph.insert_before(graph[0], widen)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the exporter's talk of its own workings, none of which a user can do anything about."""
    logger = logging.getLogger("torch.onnx")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(before)
