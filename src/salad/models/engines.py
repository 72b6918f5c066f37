"""The Engine seam: what runs a model, images in and arrays out.

    photos, squeezed ──> Engine ──> descriptor [batch, dim]
                                    patches    [batch, rows, columns, d]
                                    cls        [batch, d]
                                    plan       [batch, clusters (and dustbin), rows, columns]

An engine takes photos as they are decoded, in bytes: normalisation is part of what it runs, so no caller can
normalise wrongly, and a quarter of the numbers travels to an accelerator. It knows one size of photo and any size of
batch, and is asked for its outputs by name, as runtimes of exported graphs want it. No array is a tensor.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, get_args

import numpy as np
import numpy.typing as npt

from salad.errors import ModelError, WeightsError
from salad.network.config import ModelConfig, Output, Precision

Weights = Mapping[str, Any]
"""Arrays under the names they have in `model.safetensors`."""
Photos = npt.NDArray[np.uint8]
"""RGB `[batch, height, width, 3]`."""
EngineName = Literal["auto", "onnx", "openvino", "torch"]
"""What a user may ask for."""
Outputs = dict[Output, npt.NDArray[np.float32]]
"""Arrays whose first axis is the batch's."""


class Engine(Protocol):
    """What runs a model; `models.fake.FakeEngine` runs without any.

    The same photos give the same numbers whatever batch they are in, up to rounding, and from any thread.
    """

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels of the photos it takes."""
        ...

    @property
    def outputs(self) -> tuple[Output, ...]:
        """What it can be asked for; `plan` only where tokens are shared out by one."""
        ...

    @property
    def device(self) -> str:
        """Where it runs, in its own words."""
        ...

    def weights(self) -> Weights:
        """The weights it runs with now: the model's fingerprint is made of them."""
        ...

    def run(self, photos: Photos, outputs: Sequence[Output] = ("descriptor",)) -> Outputs:
        """Run a batch, which may be empty.

        Args:
            photos: RGB of 0 to 255, all of the engine's size.
            outputs: What is wanted of `self.outputs`.

        Returns:
            One array for each output. Descriptors have length 1; where the plan has a dustbin it is the last row, and
            every token's column sums to 1.

        Raises:
            ModelError: If the photos are of another shape or type, or an output is not there.
            MissingExtraError: If what it runs on is not installed.
        """
        ...


def check_request(engine: Engine, photos: Photos, outputs: Sequence[Output]) -> None:
    """Refuse what an engine cannot run, in the same words for every engine.

    Raises:
        ModelError: If the photos are of another shape or type, or an output is not there.
    """
    # Exported graphs are made for one size; what a flexible engine would let pass must fail in the first one too.
    height, width = engine.size
    if photos.dtype != np.uint8 or photos.ndim != 4 or photos.shape[1:] != (height, width, 3):
        raise ModelError(
            f"photos of {photos.dtype} {list(photos.shape)} cannot be run: this model takes uint8 "
            f"[batch, {height}, {width}, 3]"
        )
    for name in outputs:
        if name not in engine.outputs:
            raise ModelError(f"this model has no output {name!r}: ask for {', '.join(engine.outputs)}")


def check_settings(config: ModelConfig, made_of: str, *, graph: Path, command: str) -> None:
    """Refuse a graph that was made of other settings than those it lies beside.

    A setting changed by hand, the size or the colours' mean, would change the fingerprint and nothing else.

    Args:
        config: What lies beside it.
        made_of: The settings that the graph tells of.
        graph: Its file.
        command: What writes it anew.

    Raises:
        WeightsError: If they are not the same.
    """
    if made_of != json.dumps(config.counted, sort_keys=True):
        raise WeightsError(
            f"{graph} was made of other settings than the config.json beside it has: write it anew with '{command}'"
        )


def photo_by_photo(
    run: Callable[[Photos], list[np.ndarray]], photos: Photos, *, threads: int, apart: bool = True
) -> list[np.ndarray]:
    """What a runtime makes of a batch, which may be empty, asked for one photo at a time and a thread each.

    What a layer makes of one photo stays in a core's own cache, what it makes of sixteen does not, and threads with a
    photo each do not wait for one another.

    Args:
        run: Asks the runtime, from any thread; one array for each output.
        photos: Of the engine's size.
        threads: How many.
        apart: False where the runtime does better with the whole batch, as on an accelerator.
    """
    # No runtime promises anything of an empty batch: one photo says what shapes there are.
    asked = np.ascontiguousarray(photos) if len(photos) else np.zeros((1, *photos.shape[1:]), np.uint8)
    if not apart or len(asked) == 1:
        whole = run(asked)
    else:
        with ThreadPoolExecutor(min(threads, len(asked)), "salad-describe") as team:
            whole = [np.concatenate(same) for same in zip(*team.map(run, asked[:, None]), strict=True)]
    return [value[: len(photos)] for value in whole]


class Choice(NamedTuple):
    """Which engine runs a model, and why it is that one, for whoever wonders.

    Args:
        name: `onnx`, `openvino` or `torch`.
        why: A clause.
        open: Whether a long run may look for a faster one (`salad.models.engine_choice`).
    """

    name: Literal["onnx", "openvino", "torch"]
    why: str
    open: bool = False


def choose(asked: EngineName, *, graph: bool, precision: Precision = "float32", device: str = "cpu") -> Choice:
    """The engine for a model; where `auto` is asked for, one that computes in float32 and is ready at once.

    Args:
        asked: What the user wants.
        graph: Whether there is a graph of the model.
        precision: What the model computes in.
        device: Where it is to run, as torch names it.

    Raises:
        ModelError: If there is no such engine, or it cannot run the model.
    """
    if asked not in get_args(EngineName):
        raise ModelError(f"there is no engine {asked!r}: give {', '.join(get_args(EngineName))}")
    reduced = precision != "float32"
    if reduced and asked not in ("auto", "openvino"):
        raise ModelError(f"a model in {precision} runs by OpenVINO alone: ask for the engine auto, and not for {asked}")
    if (reduced or asked == "openvino") and device != "cpu":
        raise ModelError(f"OpenVINO runs a model on the processor alone: give the device cpu, and not {device!r}")
    if reduced:
        return Choice("openvino", f"nothing else runs a model in {precision}")
    if asked in ("onnx", "openvino") and not graph:
        raise ModelError(
            f"the engine {asked} runs a model by its graph.onnx, and this one has none: write it with "
            "'salad weights graph'"
        )
    if asked != "auto":
        return Choice(asked, "it was asked for")
    if not graph:
        return Choice("torch", "the model has no graph.onnx")
    if device != "cpu" and find_spec("torch") is not None:
        return Choice("torch", f"it runs on {device}")
    return Choice("onnx", "it is ready at once and computes in float32", open=device == "cpu")
