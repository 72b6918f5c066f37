"""A model on disk: our own folder, which knows its own shape, and the one door `load` to every kind of weights.

Our format is a folder of `model.safetensors` beside `config.json`. It is read and written as arrays, without torch.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from salad.errors import MissingExtraError, ModelError, WeightsError
from salad.models import hub
from salad.models.describer import Describer
from salad.models.engines import Weights
from salad.models.torch_engine import TorchEngine, published_network
from salad.network.config import Calibration, ModelConfig

WEIGHTS, CONFIG = "model.safetensors", "config.json"
FORMAT = 1


class Weighted(Protocol):
    """What can be written: a `Describer`, or a torch module of `salad.network`."""

    @property
    def config(self) -> ModelConfig:
        """What the model is."""
        ...

    def weights(self) -> Weights:
        """Its weights under their serialised names."""
        ...


def load(spec: str | Path, *, device: str = "cpu", heads: int | None = None) -> Describer:
    """A model ready to describe photos.

    Where torch is not installed, a model of our own format still tells its name, its preprocessing, its calibration
    and its fingerprint; describing says what is missing.

    Args:
        spec: A name of the zoo, a folder of ours, or a published file.
        device: Where to run, as torch names it: `cpu`, `mps`, or an accelerator with its number.
        heads: Attention heads of a published file, which the file itself cannot say; width / 64 by default.

    Raises:
        WeightsError: If there is no such model, or its weights are not what they must be.
        FetchError: If the weights have to be fetched first and cannot be.
        ModelError: If the device cannot be used.
    """
    # What lies on disk goes before the zoo: a folder named like one of its models is somebody's own copy.
    path, name = Path(spec), None
    if not path.exists():
        if str(spec) not in hub.ZOO:
            raise WeightsError(
                f"there is no model {str(spec)!r}: give a file, a folder, or one of {', '.join(hub.ZOO)}"
            )
        path, name = hub.fetch(str(spec)), str(spec)
    if path.is_dir():
        return read_folder(path, device=device)
    return read_published(path, heads=heads, name=name, device=device)


def read_folder(folder: Path, *, device: str = "cpu") -> Describer:
    """A model in our own format.

    Raises:
        WeightsError: If a file is missing, damaged, or does not belong to the other.
        ModelError: If the device cannot be used.
    """
    config, file = _read_config(folder), folder / WEIGHTS
    engine = TorchEngine(config, partial(_read_weights, file), source=file, device=device)
    with suppress(MissingExtraError):
        _ = engine.network  # now, so that damaged weights are said of here and not at the first photo
    return Describer(config, engine)


def read_published(path: Path, *, heads: int | None = None, name: str | None = None, device: str = "cpu") -> Describer:
    """A model in one of the published layouts, read strictly.

    Raises:
        WeightsError: If the file is not of a layout known here, or lacks or adds a tensor; the message lists them.
        ModelError: If the device cannot be used.
        MissingExtraError: If torch is not installed.
    """
    return Describer.of(published_network(path, heads=heads, name=name, device=device))


def write_folder(model: Weighted, folder: str | Path, *, dtype: str = "float32", overwrite: bool = False) -> Path:
    """Write a model in our own format; the folder appears whole or not at all.

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
        raise WeightsError(f"the model cannot be written to {folder}: {error}") from error
    return folder


def write_calibration(folder: str | Path, calibration: Calibration) -> None:
    """Put a calibration into a model's folder in place of the one it has; weights and fingerprint stay.

    Raises:
        WeightsError: If it is not a model, or cannot be written; then it stays as it was.
    """
    folder = Path(folder)
    config = replace(_read_config(folder), calibration=calibration)
    draft = folder / f".{CONFIG}.part"
    try:
        draft.write_text(_config_text(config), encoding="utf-8")
        shutil.copymode(folder / CONFIG, draft)  # whoever could read the model still can
        draft.replace(folder / CONFIG)
    except OSError as error:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise WeightsError(f"the calibration cannot be written to {folder}: {error}") from error


def _read_config(folder: Path) -> ModelConfig:
    for name in (CONFIG, WEIGHTS):
        if not (folder / name).is_file():
            raise WeightsError(f"{folder} is not a model: it holds no {name}")
    try:
        settings = json.loads((folder / CONFIG).read_text(encoding="utf-8"))
        # Before anything else is read of it: a newer format may mean something else by the same words.
        version = settings.pop("format")
        if version != FORMAT:
            raise WeightsError(f"{folder / CONFIG} has format {version}, this salad reads {FORMAT}: upgrade salad-vpr")
        return ModelConfig.from_dict(settings)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ModelError) as error:
        raise WeightsError(f"{folder / CONFIG} cannot be read: {error}") from error


def _config_text(config: ModelConfig) -> str:
    return json.dumps({"format": FORMAT, **config.as_dict()}, indent=2) + "\n"


def _read_weights(file: Path) -> dict[str, np.ndarray]:
    try:
        return load_file(file)
    except (KeyError, TypeError) as error:  # bfloat16 is torch's alone
        raise WeightsError(f"{file} holds numbers of a type that is not known here ({error})") from error
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{file} is no safetensors file that can be read: {error}") from error
