"""A model on disk: our own folder, which knows its own shape, and the one door `load` to every kind of weights.

Our format is a folder of `model.safetensors` beside `config.json`. It is read and written as arrays, without torch.
A third file, `graph.onnx`, lets other runtimes than torch run it: it points into the weights by offsets and would give
rubbish with any others, without an error. So `config.json` holds the checksums of both, and they are compared whenever
the model is opened.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from salad.errors import MissingExtraError, ModelError, PhotoError, WeightsError, reason
from salad.files import read_json, sha256_of
from salad.models import hub
from salad.models.describer import Describer, PhotoLike, squeezed
from salad.models.engines import Engine, EngineName, Weights, choose
from salad.models.onnx_engine import OnnxEngine
from salad.models.openvino_engine import OpenVinoEngine
from salad.models.torch_engine import TorchEngine, check_published, published_network, write_file, write_graph
from salad.network.config import MOST_OF_WEIGHTS, Calibration, ModelConfig, Preprocessing, check_sizes

WEIGHTS, CONFIG, GRAPH = "model.safetensors", "config.json", "graph.onnx"
FORMAT, QUANTIZED = 1, 2  # the second came with models that do not compute in float32, which older versions refuse
CHECKED_ON = 10  # photos that a graph is compared with torch on
_MOST_OF_A_GRAPH, _LONGEST_CONFIG = 1 << 27, 1 << 20  # bytes

Checksums = dict[str, str]
"""SHA-256 of a model's graph and of the weights it points into, by the names of their files; empty without a graph."""


class Weighted(Protocol):
    """What can be written: a `Describer`, or a torch module of `salad.network`."""

    @property
    def config(self) -> ModelConfig:
        """What the model is."""
        ...

    def weights(self) -> Weights:
        """Its weights under their serialised names."""
        ...


def load(
    spec: str | Path,
    *,
    device: str = "cpu",
    heads: int | None = None,
    engine: EngineName = "auto",
    threads: int | None = None,
) -> Describer:
    """A model ready to describe photos.

    A model of our own format that has a graph needs no torch. One that has none still tells its name, its
    preprocessing, its calibration and its fingerprint without it; describing says what is missing.

    Args:
        spec: A name of the zoo, a folder of ours, or a published file.
        device: Where to run, as torch names it: `cpu`, `mps`, or an accelerator with its number.
        heads: Attention heads of a published file, which the file itself cannot say; width / 64 by default.
        engine: What runs it: `onnx` (ONNX Runtime), `openvino` (the extra `fast`), `torch`, or `auto`, which chooses
            one that computes in float32, or what the model was quantized for; `Describer.engine_choice` says which,
            and why.
        threads: How many a batch is spread over; what the engine thinks best where not given.

    Raises:
        WeightsError: If there is no such model, or its weights are not what they must be.
        FetchError: If the weights have to be fetched first and cannot be.
        ModelError: If the device cannot be used, or the engine cannot run the model.
        MissingExtraError: If it is a published file, and torch is not installed.
    """
    # What lies on disk goes before the zoo: a folder named like one of its models is somebody's own copy.
    path, name = Path(spec), None
    if not path.exists():
        if str(spec) not in hub.ZOO:
            raise WeightsError(
                f"there is no model {str(spec)!r}: give a file, a folder, or one of {', '.join(hub.ZOO)}"
            )
        name = str(spec)
        if hub.entry(name).layout != "own":
            check_published()
        path = hub.fetch(name)
    if path.is_dir():
        return read_folder(path, device=device, engine=engine, threads=threads)
    if engine not in ("auto", "torch"):
        raise ModelError(f"{path} is a published file, which torch alone runs: convert it with 'salad weights convert'")
    return read_published(path, heads=heads, name=name, device=device)


def read_folder(
    folder: Path, *, device: str = "cpu", engine: EngineName = "auto", threads: int | None = None
) -> Describer:
    """A model in our own format; the arguments are those of `load`.

    Raises:
        WeightsError: If a file is missing, damaged, or does not belong to the others.
        ModelError: If the device cannot be used, or the engine cannot run the model.
    """
    config, checksums = _read_config(folder)
    _check_files(folder, checksums)
    choice = choose(engine, graph=GRAPH in checksums, precision=config.precision, device=device)
    if choice.name != "torch":  # which says so itself, of the network that it builds
        _check_sizes(folder, config)
    file, read = folder / WEIGHTS, partial(_read_weights, folder / WEIGHTS)
    runs: Engine
    if choice.name == "onnx":
        runs = OnnxEngine(config, folder / GRAPH, read, device=device, threads=threads)
        _ = runs.session  # now, so that damaged files are said of here and not at the first photo
    elif choice.name == "openvino":
        runs = OpenVinoEngine(config, folder / GRAPH if GRAPH in checksums else file, read, threads=threads)
        _ = runs.compiled
    else:
        runs = TorchEngine(config, read, source=file, device=device, threads=threads)
        with suppress(MissingExtraError):
            _ = runs.network
    return Describer(config, runs, engine_choice=choice)


def read_published(path: Path, *, heads: int | None = None, name: str | None = None, device: str = "cpu") -> Describer:
    """A model in one of the published layouts, read strictly.

    Raises:
        WeightsError: If the file is not of a layout known here, or lacks or adds a tensor; the message lists them.
        ModelError: If the device cannot be used.
        MissingExtraError: If torch is not installed.
    """
    return Describer.of(published_network(path, heads=heads, name=name, device=device))


def write_folder(model: Weighted, folder: str | Path, *, dtype: str = "float32", overwrite: bool = False) -> Path:
    """Write a model in our own format, without a graph (`add_graph`); the folder appears whole or not at all.

    Args:
        model: What to write.
        folder: Where; its parent is made where missing.
        dtype: What floating-point weights are stored as: `float32`, or `float16` for half the size.
        overwrite: Whether a model already there may be replaced.

    Raises:
        WeightsError: If there is something at `folder` already, or it cannot be written.
    """
    folder = Path(folder)
    if folder.exists() and not (overwrite and (folder / CONFIG).is_file()):
        raise WeightsError(f"{folder} exists already; choose another folder, or remove it first")
    with np.errstate(over="ignore"):  # beyond the range of float16 a weight is infinite, as torch has it too
        weights = {
            key: np.asarray(value, dtype if value.dtype.kind == "f" else None, order="C")
            for key, value in model.weights().items()
        }
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # Beside its place and not in the system's folder: only within one disk is a rename a single step.
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as scratch:
            draft = Path(scratch) / "new"
            draft.mkdir()
            save_file(weights, draft / WEIGHTS)
            (draft / CONFIG).write_text(_config_text(model.config), encoding="utf-8")
            shutil.copymode(draft / CONFIG, draft / WEIGHTS)  # safetensors writes for its owner alone
            # Between the two renames there is no model for a moment, but at no moment half a one.
            if folder.exists():
                folder.rename(Path(scratch) / "old")
            draft.rename(folder)
    except (OSError, SafetensorError) as error:
        raise WeightsError(f"the model cannot be written to {folder}: {reason(error)}") from error
    return folder


def write_calibration(folder: str | Path, calibration: Calibration) -> None:
    """Put a calibration into a model's folder in place of the one it has; weights and fingerprint stay.

    Raises:
        WeightsError: If it is not a model, or cannot be written; then it stays as it was.
    """
    folder = Path(folder)
    config, checksums = _read_config(folder)
    _rewrite_config(folder, replace(config, calibration=calibration), checksums, what="the calibration")


def add_graph(folder: str | Path, photos: Sequence[PhotoLike] = ()) -> Path:
    """Put a graph into a model's folder, so that it needs no torch from now on; it is checked against torch first.

    Args:
        folder: The model.
        photos: To check it on: ten of them, evenly spread, and made pictures where fewer can be read.

    Returns:
        The graph.

    Raises:
        WeightsError: If it is not a model, or cannot be written; then it stays as it was.
        ModelError: If the model cannot be exported, or the graph computes anything else than torch does.
        MissingExtraError: If torch or its exporter is not installed.
    """
    folder = Path(folder)
    config, _ = _read_config(folder)
    engine = TorchEngine(config, partial(_read_weights, folder / WEIGHTS), source=folder / WEIGHTS)
    # In the model's own folder: where a graph lies is where it looks for its weights.
    draft = folder / f".{GRAPH}.part"
    try:
        write_graph(engine.network, folder / WEIGHTS, draft, _checked_on(photos, config.preprocessing))
        shutil.copymode(folder / CONFIG, draft)
        checksums = {GRAPH: sha256_of(draft), WEIGHTS: sha256_of(folder / WEIGHTS)}
        # An old graph's checksum goes first: between two renames there may be a model without a graph, but none with
        # one that is not its own.
        _rewrite_config(folder, config, {}, what="the graph")
        draft.replace(folder / GRAPH)
    except OSError as error:
        raise WeightsError(f"the graph cannot be written to {folder}: {reason(error)}") from error
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
    _rewrite_config(folder, config, checksums, what="the graph")
    return folder / GRAPH


def write_onnx(model: Describer, to: str | Path, photos: Sequence[PhotoLike] = (), *, normalised: bool = False) -> Path:
    """Write a model as one ONNX file by COLMAP's contract, all weights in it; it is checked against torch first.

    Args:
        model: What to write, in float32.
        to: The file; another one there is replaced.
        photos: To check it on: ten of them, evenly spread, and made pictures where fewer can be read.
        normalised: Whether the file is to be fed with images that are normalised by the model's mean and deviation,
            rather than with RGB / 255.

    Raises:
        WeightsError: If it cannot be written.
        ModelError: If the model cannot be exported, or the file computes anything else than torch does.
        MissingExtraError: If torch or its exporter is not installed.
    """
    try:
        write_file(model.network, Path(to), _checked_on(photos, model.preprocessing), normalised=normalised)
    except OSError as error:
        raise WeightsError(f"the model cannot be written to {to}: {reason(error)}") from error
    return Path(to)


def _checked_on(photos: Sequence[PhotoLike], size: Preprocessing) -> list[np.ndarray]:
    """Up to ten photos of those given that can be read, squeezed."""
    readable: list[np.ndarray] = []
    for photo in photos[:: max(1, len(photos) // CHECKED_ON)]:
        if len(readable) < CHECKED_ON:
            with suppress(PhotoError):
                readable.append(squeezed(photo, size))
    return readable


def _rewrite_config(folder: Path, config: ModelConfig, checksums: Checksums, *, what: str) -> None:
    draft = folder / f".{CONFIG}.part"
    try:
        draft.write_text(_config_text(config, checksums), encoding="utf-8")
        shutil.copymode(folder / CONFIG, draft)  # whoever could read the model still can
        draft.replace(folder / CONFIG)
    except OSError as error:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise WeightsError(f"{what} cannot be written to {folder}: {reason(error)}") from error


def _read_config(folder: Path) -> tuple[ModelConfig, Checksums]:
    for name in (CONFIG, WEIGHTS):
        if not (folder / name).is_file():
            raise WeightsError(f"{folder} is not a model: it holds no {name}")
    try:
        settings = read_json(folder / CONFIG, most=_LONGEST_CONFIG)
        # Before anything else is read of it: a newer format may mean something else by the same words.
        version = settings.pop("format")
        if type(version) is not int or version not in (FORMAT, QUANTIZED):
            raise WeightsError(
                f"{folder / CONFIG} has format {str(version)[:20]}, this salad reads {FORMAT} and {QUANTIZED}: upgrade "
                "salad-vpr"
            )
        # Left out where there is no graph, for older versions refuse a setting that they do not know.
        checksums = dict(settings.pop("files", {}))
        config = ModelConfig.from_dict(settings)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ModelError) as error:
        raise WeightsError(f"{folder / CONFIG} cannot be read: {reason(error)}") from error
    if version != _format_of(config):
        raise WeightsError(
            f"{folder / CONFIG} has format {version}, which is not that of a model in {config.precision}"
        )
    return config, checksums


def _check_sizes(folder: Path, config: ModelConfig) -> None:
    try:
        check_sizes(config)
    except (ModelError, TypeError) as error:
        raise WeightsError(f"{folder / CONFIG} does not describe a model that can be run: {error}") from error


def _config_text(config: ModelConfig, checksums: Checksums | None = None) -> str:
    files = {"files": checksums} if checksums else {}
    return json.dumps({"format": _format_of(config), **config.as_dict(), **files}, indent=2) + "\n"


def _format_of(config: ModelConfig) -> int:
    return FORMAT if config.precision == "float32" else QUANTIZED


def _check_files(folder: Path, checksums: Checksums) -> None:
    for name, most in ((WEIGHTS, MOST_OF_WEIGHTS), (GRAPH, _MOST_OF_A_GRAPH)):
        if (folder / name).is_file() and (folder / name).stat().st_size > most:
            raise WeightsError(f"{folder / name} is longer than {most:,} bytes, which no model's is: copy it anew")
    for name, due in checksums.items():
        if name not in (GRAPH, WEIGHTS) or not (folder / name).is_file():
            raise WeightsError(f"{folder / CONFIG} tells of a file {name!r}, which is not there: copy the model anew")
        if sha256_of(folder / name) != due:
            raise WeightsError(
                f"{folder / name} is not the file that {CONFIG} beside it was written for, and graph and weights only "
                "fit each other: copy the model anew, or write its graph anew with 'salad weights graph'"
            )


def _read_weights(file: Path) -> dict[str, np.ndarray]:
    try:
        weights: dict[str, np.ndarray] = load_file(file)
        strange = {str(value.dtype) for value in weights.values() if value.dtype.kind not in "fiub"}
    except (KeyError, TypeError) as error:
        raise WeightsError(f"{file} holds numbers of a type that is not known here ({error})") from error
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{file} is no safetensors file that can be read: {reason(error)}") from error
    # bfloat16 is torch's alone until some library teaches NumPy what it is, and then no fingerprint was made for it.
    if strange:
        raise WeightsError(f"{file} holds numbers of a type that is not known here ({strange.pop()})")
    return weights
