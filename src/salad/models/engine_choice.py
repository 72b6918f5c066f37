"""The fastest engine for a long run, measured: which one that is differs from processor to processor.

Only engines that compute in float32 are compared, so descriptors and fingerprint stay what they are. One photo is not
worth it, nor are a hundred: a measurement takes a second or two. It is remembered, for each machine, model and version,
in `engines.json` in the folder of what is fetched.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal

import numpy as np

from salad.errors import SaladError
from salad.files import read_json, write_whole
from salad.models import hub
from salad.models.describer import Describer, DescriberLike
from salad.models.engines import Choice, Engine
from salad.models.onnx_engine import OnnxEngine
from salad.models.openvino_engine import OpenVinoEngine

LONG = 1000  # photos: from there on a few percent of a run are more than what is spent on finding them
GAIN = 0.95  # of the time, or less, is worth another engine: two measurements may differ by more than nothing
SECONDS = 0.5  # of measuring each, and never less than one batch

Times = Mapping[str, float]


def settle(model: DescriberLike, *, photos: int) -> Choice | None:
    """Let a model that is about to describe many photos run by the fastest engine; one that was asked for stays.

    Args:
        model: Changed in place where another engine is faster.
        photos: How many there are.

    Returns:
        Which engine it is, and why; None where that was never a question.
    """
    if not isinstance(model, Describer) or model.engine_choice is None:
        return None
    choice, given = model.engine_choice, model.engine
    if not choice.open or photos < LONG or not isinstance(given, OnnxEngine) or _installed("openvino") is None:
        return choice
    rival = OpenVinoEngine(given.config, given.graph, given.weights, threads=given.threads)
    file, key = hub.home() / "engines.json", _key(model, given.threads)
    known = _remembered(file)
    try:
        times = known[key] if key in known else _measured({"onnx": given, "openvino": rival}, given)
    except SaladError:  # it cannot run here: then nothing is lost
        return choice
    if key not in known:
        with suppress(OSError):  # a folder that may not be written to is measured again next time
            file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(file, json.dumps({**known, key: times}, indent=2).encode())
    name: Literal["onnx", "openvino"] = "onnx"
    if times["openvino"] <= GAIN * times["onnx"]:
        name, model.engine = "openvino", rival
    told = ", ".join(f"{1000 * seconds:.1f} ms a photo by {engine}" for engine, seconds in times.items())
    model.engine_choice = Choice(name, f"measured here: {told}")
    return model.engine_choice


def _key(model: Describer, threads: int) -> str:
    """What a measurement holds for."""
    versions = (f"{package} {_installed(package)}" for package in ("onnxruntime", "openvino"))
    machine = platform.node(), platform.machine(), platform.processor()
    return ", ".join([*machine, *versions, f"{threads} threads", model.fingerprint])


def _remembered(file: Path) -> dict[str, Times]:
    """All measurements there are; none where the file is missing or no such file."""
    try:
        held = read_json(file, most=1 << 24)
        return {str(key): {name: float(times[name]) for name in ("onnx", "openvino")} for key, times in held.items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return {}


def _measured(engines: Mapping[str, Engine], given: OnnxEngine) -> Times:
    """Seconds that each engine takes a photo, at its best; they take turns, for other work falls on both."""
    height, width = given.size
    photos = np.random.default_rng(0).integers(0, 256, (2 * given.threads, height, width, 3), np.uint8)
    best = {name: float("inf") for name in engines}
    for engine in engines.values():
        engine.run(photos)  # loads, compiles and warms up
    until = time.perf_counter() + SECONDS * len(engines)
    while True:
        for name, engine in engines.items():
            begun = time.perf_counter()
            engine.run(photos)
            best[name] = min(best[name], (time.perf_counter() - begun) / len(photos))
        if time.perf_counter() > until:
            return best


def _installed(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
