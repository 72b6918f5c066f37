"""Weights on disk <-> Describer: published files, our own folders, and names of the zoo.

Our own format is a folder that knows its own shape: `model.safetensors` beside `config.json`.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from salad.errors import ModelError, WeightsError
from salad.models import hub
from salad.models.describer import Describer, build
from salad.network import checkpoints
from salad.network.config import Calibration, ModelConfig

WEIGHTS, CONFIG = "model.safetensors", "config.json"
FORMAT = 1


def load(spec: str | Path, *, device: str | torch.device = "cpu", heads: int | None = None) -> Describer:
    """A model ready to describe photos.

    Args:
        spec: a name of the zoo, a folder of ours, or a published file.
        device: where to run, as torch names it: `cpu`, `mps`, or an accelerator with its number.
        heads: attention heads of a published file, which the file itself cannot say; width / 64 by default.

    Raises:
        WeightsError: there is no such model, or its weights are not what they must be.
        FetchError: the weights have to be fetched first and cannot be.
    """
    path = Path(spec)
    if path.is_dir():
        model = read_folder(path)
    elif path.is_file():
        model = read_published(path, heads=heads)
    elif str(spec) in hub.ZOO:
        model = _from_zoo(hub.ZOO[str(spec)], heads)
    else:
        raise WeightsError(
            f"there is no model {str(spec)!r}: give a file, a folder, or one of {', '.join(hub.ZOO)}"
        )
    try:
        return model.to(device)
    except (RuntimeError, AssertionError) as error:  # torch's own words differ from device to device
        raise ModelError(f"the device {str(device)!r} cannot be used here: {error}") from error


def read_folder(folder: Path) -> Describer:
    """A model in our own format.

    Raises:
        WeightsError: a file is missing, damaged, or does not belong to the other.
    """
    config = _read_config(folder)
    return _filled(config, _read_safetensors(folder / WEIGHTS), source=folder / WEIGHTS)


def _read_config(folder: Path) -> ModelConfig:
    for name in (CONFIG, WEIGHTS):
        if not (folder / name).is_file():
            raise WeightsError(f"{folder} is not a model: it holds no {name}")
    try:
        settings = json.loads((folder / CONFIG).read_text(encoding="utf-8"))
        version = settings.pop("format")
        if version != FORMAT:
            raise WeightsError(
                f"{folder / CONFIG} has format {version}, this salad reads {FORMAT}: upgrade salad-vpr"
            )
        return ModelConfig.from_dict(settings)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ModelError) as error:
        raise WeightsError(f"{folder / CONFIG} cannot be read: {error}") from error


def write_calibration(folder: str | Path, calibration: Calibration) -> None:
    """Put a calibration into a model's folder in place of the one it has; weights and fingerprint stay.

    Raises:
        WeightsError: it is not a model, or cannot be written; then it stays as it was.
    """
    folder = Path(folder)
    config = replace(_read_config(folder), calibration=calibration)
    draft = folder / f".{CONFIG}.part"
    try:
        draft.write_text(_as_text(config), encoding="utf-8")
        shutil.copymode(folder / CONFIG, draft)
        draft.replace(folder / CONFIG)
    except OSError as error:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise WeightsError(f"the calibration cannot be written to {folder}: {error}") from error


def _as_text(config: ModelConfig) -> str:
    return json.dumps({"format": FORMAT, **config.as_dict()}, indent=2) + "\n"


def write_folder(
    model: Describer, folder: str | Path, *, dtype: torch.dtype = torch.float32, overwrite: bool = False
) -> Path:
    """Write a model in our own format; the folder appears whole or not at all.

    Args:
        model: what to write.
        folder: where; its parent is made where missing.
        dtype: what floating-point weights are stored as.
        overwrite: whether a model already there may be replaced.

    Raises:
        WeightsError: there is something at `folder` already, or it cannot be written.
    """
    folder = Path(folder)
    if folder.exists() and not (overwrite and (folder / CONFIG).is_file()):
        raise WeightsError(f"{folder} exists already; choose another folder, or remove it first")
    weights = {
        key: (value.to(dtype) if value.is_floating_point() else value).detach().cpu().contiguous()
        for key, value in model.state_dict().items()
    }
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as beside:
            draft = Path(beside) / "new"
            draft.mkdir()
            save_file(weights, draft / WEIGHTS)
            (draft / CONFIG).write_text(_as_text(model.config), encoding="utf-8")
            shutil.copymode(draft / CONFIG, draft / WEIGHTS)  # safetensors writes for its owner alone
            if folder.exists():
                folder.rename(Path(beside) / "old")
            draft.rename(folder)
    except (OSError, SafetensorError) as error:
        raise WeightsError(f"the model cannot be written to {folder}: {error}") from error
    return folder


def read_published(path: Path, *, heads: int | None = None, name: str | None = None) -> Describer:
    """A model in one of the published layouts, read strictly.

    Raises:
        WeightsError: the file is not of a layout known here, or lacks or adds a tensor; the message lists them.
    """
    tensors = read_tensors(path)
    try:
        found = checkpoints.recognise(tensors, heads=heads)
    except WeightsError as error:
        raise WeightsError(f"{path}: {error}") from error
    config = ModelConfig(
        name=name or path.stem,
        backbone=found.backbone,
        aggregator=found.aggregator,
        provenance=f"{path.name}, layout {found.layout}",
    )
    return _filled(config, found.weights, source=path)


def _from_zoo(entry: hub.ZooEntry, heads: int | None) -> Describer:
    where = hub.fetch(entry.name)
    return read_folder(where) if where.is_dir() else read_published(where, heads=heads, name=entry.name)


def _filled(config: ModelConfig, weights: Mapping[str, Tensor], *, source: Path) -> Describer:
    try:
        model = build(config)
    except (ModelError, RuntimeError, TypeError, ValueError) as error:  # a damaged file asks for anything
        raise WeightsError(f"{source} does not describe a model that can be built: {error}") from error
    wanted, given = model.state_dict(), dict(weights)
    missing, unknown = sorted(wanted.keys() - given.keys()), sorted(given.keys() - wanted.keys())
    other = [key for key in wanted.keys() & given.keys() if wanted[key].shape != given[key].shape]
    if missing or unknown or other:
        said = [
            f"{what}: {', '.join(keys)}"
            for what, keys in (
                ("missing", missing),
                ("unknown", unknown),
                ("of another shape", sorted(other)),
            )
            if keys
        ]
        raise WeightsError(f"{source} does not fit the model it describes; {'; '.join(said)}")
    model.load_state_dict({key: value.to(wanted[key].dtype) for key, value in given.items()})
    return model


def read_tensors(path: Path) -> Mapping[str, Tensor]:
    """The named tensors of a foreign file; whatever it holds, no code of it runs.

    Raises:
        WeightsError: it cannot be read safely, or holds something else than tensors.
    """
    if path.suffix == ".safetensors":
        return _read_safetensors(path)
    try:
        raw: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a foreign pickle may fail in any way; none may run code
        raise WeightsError(
            f"{path} is no file of weights that can be read safely ({type(error).__name__})"
        ) from error
    raw = raw.get("state_dict", raw) if isinstance(raw, Mapping) else raw
    if not isinstance(raw, Mapping) or not all(isinstance(value, Tensor) for value in raw.values()):
        raise WeightsError(f"{path} holds something else than named tensors")
    return {str(key): value for key, value in raw.items()}


def _read_safetensors(path: Path) -> dict[str, Tensor]:
    try:
        return load_file(path)
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} is no safetensors file that can be read: {error}") from error
