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
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from salad.errors import ModelError, needs_extra
from salad.files import open_file, parse_json
from salad.network.config import PHOTOS, SETTINGS, Output, Preprocessing
from salad.network.network import Network, evaluating

if TYPE_CHECKING:
    import onnx_ir as ir
    from onnxruntime import InferenceSession

OPSET = 20  # Gelu came with it; the runtimes of 2024 know it
COSINE = 0.99999  # of a descriptor by the graph and by the network, at least
TOLERANCE = 1e-3  # of tokens, as a share of the largest number among them, and of a plan's shares
_LONGEST_HEADER = 100_000_000  # bytes
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
    size = network.config.preprocessing
    # Two photos: with one, the exporter may take the batch for a constant.
    example = torch.zeros(2, size.height, size.width, 3, dtype=torch.uint8, device=network.device)
    model = _exported(network, _Graph(network), example, PHOTOS, network.config.outputs)
    _point_into(weights, model.graph)
    model.metadata_props[SETTINGS] = json.dumps(network.config.counted, sort_keys=True)
    _save(model, to)


def export_file(network: Network, to: Path, *, normalised: bool = False) -> None:
    """Write a network as one file with all its weights, by COLMAP's contract; run `check_file` before it is trusted.

    Its input is `images`, float32 `[-1, 3, height, width]` of RGB, its output `descriptor`, float32 `[-1, dim]`.

    Args:
        network: What to export; its photos' size is the file's.
        to: The file to write.
        normalised: Whether images come normalised by the model's mean and deviation, rather than as RGB / 255.

    Raises:
        MissingExtraError: If the exporter is not installed.
        ModelError: If the network cannot be exported.
    """
    size = network.config.preprocessing
    example = torch.zeros(2, 3, size.height, size.width, device=network.device)
    model = _exported(network, _Normalising(network, normalised), example, "images", ["descriptor"])
    # Whoever finds the file alone should learn from it what to feed it with.
    told = {"width": size.width, "height": size.height, "resample": size.resample, "mean": size.mean, "std": size.std}
    model.metadata_props["salad.input"] = json.dumps({**told, "normalised": normalised})
    model.metadata_props["salad.model"] = f"{network.config.name} {network.fingerprint}"
    _save(model, to)


def check_file(
    network: Network, file: Path, photos: UInt8[np.ndarray, "n height width 3"], *, normalised: bool = False
) -> None:
    """Run a file that `export_file` wrote beside the network, in batches of several sizes.

    Raises:
        ModelError: If it cannot be run, or computes anything else.
    """
    size = network.config.preprocessing
    images = photos.transpose(0, 3, 1, 2).astype(np.float32) / 255
    if normalised:
        mean, std = (np.array(values, np.float32).reshape(3, 1, 1) for values in (size.mean, size.std))
        images = (images - mean) / std
    _check(network, file, photos, {"images": images}, outputs=["descriptor"], named=file.name)


class _Normalising(nn.Module):
    """The network for images of RGB / 255, or for images that somebody else has normalised."""

    def __init__(self, network: Network, normalised: bool) -> None:
        super().__init__()
        self.network, self.normalised = network, normalised

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Tensor:
        if not self.normalised:
            images = (images - self.network.mean) / self.network.std
        descriptors: Tensor = self.network(images)
        return descriptors


def _exported(network: Network, module: nn.Module, example: Tensor, takes: str, gives: Sequence[str]) -> ir.Model:
    """A module around a network as a graph for any batch.

    Raises:
        MissingExtraError: If the exporter is not installed.
        ModelError: If it cannot be exported.
    """
    with needs_extra("exporting a model", "torch"):
        import onnxscript  # noqa: F401  # the exporter's own library, which it would ask for in words of its own
    try:
        with _quiet(), evaluating(network), torch.no_grad():
            program = torch.onnx.export(
                module,
                (example,),
                dynamo=True,
                dynamic_shapes=({0: torch.export.Dim.DYNAMIC},),
                input_names=[takes],
                output_names=list(gives),
                opset_version=OPSET,
                optimize=False,  # it would fold weights into constants of the graph's own
                verbose=False,
            )
    except Exception as error:  # the exporter raises whatever its parts raise
        raise ModelError(f"the model {network.config.name} cannot be exported: {error}") from error
    assert program is not None
    _tidy(program.model)
    return program.model


def _save(model: ir.Model, to: Path) -> None:
    import onnx_ir as ir

    model.producer_name, model.producer_version = "salad", None
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
    _check(network, graph, photos, {PHOTOS: photos}, outputs=network.config.outputs, named=network.config.name)


def _check(
    network: Network,
    file: Path,
    photos: UInt8[np.ndarray, "n height width 3"],
    fed: Mapping[str, np.ndarray],
    *,
    outputs: Sequence[Output],
    named: str,
) -> None:
    """Run a file, fed with the same photos in its own form, beside the network, a few at a time."""
    start = 0
    with _refusing(named):
        session = _session(file)
        for batch in BATCHES:
            some = slice(start, start + batch)
            start += batch
            found = session.run(list(outputs), {name: np.ascontiguousarray(value[some]) for name, value in fed.items()})
            with evaluating(network), torch.no_grad():
                due = network.outputs(np.ascontiguousarray(photos[some]), outputs)
            for (name, right), given in zip(due.items(), found, strict=True):
                _compare(name, given, right.float().cpu().numpy())


def _session(graph: Path) -> InferenceSession:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])


@contextmanager
def _refusing(name: str) -> Iterator[None]:
    """Whatever goes wrong inside is a sentence about the graph of that name."""
    try:
        yield
    except ModelError as error:
        raise ModelError(f"the graph of {name} is wrong, and is not kept: {error}") from error
    except Exception as error:  # the runtime's errors have no common ancestor
        raise ModelError(f"the graph of {name} cannot be run, and is not kept: {error}") from error


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

    with open_file(weights) as file:
        # The header says where each tensor begins; safetensors reads none that is longer.
        stored = parse_json(file.read(min(_LONGEST_HEADER, *struct.unpack("<Q", file.read(8)))))
        length = file.tell() - 8
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
