"""Where the things that the pins hold stand now, and the few tools that all pins share.

The pins hold behaviour that must outlive every move of a module. They go through `import salad` and the command line;
what neither shows is imported here and nowhere else, so that whoever moves a module edits this one file.
"""

# ruff: noqa: F401  # most of what is imported here is for the other pins
from __future__ import annotations

import io
import json
import os
from contextlib import redirect_stderr, redirect_stdout
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from PIL import Image

import salad
from salad.cli.main import main
from salad.datasets.places import find_places
from salad.errors import BenchmarkError
from salad.evaluation.evaluate_benchmark import rank as nearest
from salad.models.fake import FakeDescriber
from salad.network.aggregator_config import AGGREGATOR_KINDS, SaladConfig, aggregator_kind, compared_aggregators
from salad.network.config import BACKBONE_KINDS, Calibration, LiteConfig, ModelConfig, Preprocessing
from salad.search.base import ArrayRows as Held
from salad.search.filters import Filter
from salad.training.recipe import PRESETS, Preset, Recipe
from salad.training.trainer import train

RECORDED = Path(__file__).with_name("recorded")
"""What was so on the day the pins were made. Right by definition: formats that others hold files of are frozen."""


def shipped(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """The configuration of a model that ships, as JSON holds it, and its weights by their names."""
    model = salad.load(name)
    return model.config.as_dict(), model.network.state_dict()


class Ran(NamedTuple):
    """What a command did: its exit code, what it wrote to stdout, what to stderr."""

    code: int
    out: str
    err: str


def salad_says(*arguments: object) -> Ran:
    """Run `salad ARGUMENTS` in this process."""
    code: Any = None
    wide = mock.patch.dict(os.environ, {"COLUMNS": "200"})
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err, wide:
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as left:
            code = left.code
    return Ran(0 if code is None else code, out.getvalue(), err.getvalue())


def recorded(name: str) -> Any:
    """What `recorded/NAME.json` holds."""
    return json.loads((RECORDED / f"{name}.json").read_text(encoding="utf-8"))


def street(number: int, *, seed: int = 0, side: int = 96) -> Image.Image:
    """A photo of coloured squares that no other number has; another seed is another photo of the same street."""
    squares = np.random.default_rng(number).integers(0, 256, (6, 6, 3))
    squares = squares + np.random.default_rng([number, seed]).integers(-12, 13, squares.shape)
    pixels = np.clip(squares, 0, 255).astype(np.uint8)
    return Image.fromarray(np.kron(pixels, np.ones((side // 6, side // 6, 1), dtype=np.uint8)))


def gone(before: Any, now: Any, at: str = "") -> list[str]:
    """What is no longer there, or is another now, as paths through the JSON; what is new in `now` is welcome."""
    if isinstance(before, dict) and isinstance(now, dict):
        lost = [f"{at}/{key}" for key in before if key not in now]
        return lost + [each for key in before if key in now for each in gone(before[key], now[key], f"{at}/{key}")]
    return [] if before == now else [f"{at}: {before!r} is {now!r}"]


def shape(value: Any) -> Any:
    """A JSON value with its types in place of its values: keys that are numbers as N, lists by all they hold."""
    if isinstance(value, dict):
        merged: dict[str, Any] = {}
        for key, one in value.items():
            name = "N" if key.isdigit() else key
            merged[name] = _either(merged[name], shape(one)) if name in merged else shape(one)
        return merged
    if isinstance(value, list):
        return {"each": reduce(_either, map(shape, value)) if value else None}
    return "null" if value is None else type(value).__name__


def _either(one: Any, other: Any) -> Any:
    if isinstance(one, dict) and isinstance(other, dict):
        return {
            **one,
            **{key: _either(one[key], value) if key in one else value for key, value in other.items()},
        }
    if isinstance(one, str) and isinstance(other, str):
        return " | ".join(sorted({*one.split(" | "), *other.split(" | ")}))
    return one if isinstance(one, dict) else other
