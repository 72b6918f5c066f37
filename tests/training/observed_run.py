"""No test: a run that writes down what every process of it sees, for test_processes and test_killed to compare.

`python observed_run.py PHOTOS TO WHAT` with WHAT as JSON: settings of the recipe, `devices`, where to `wait` to be
killed, and `runs` to make one after another, by name. With several devices this very command is started once more for
each of the others; with several `nodes`, whoever calls it starts it once for each.
"""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import torch

from salad.datasets.places import find_places
from salad.network.aggregator_config import SaladConfig
from salad.network.config import ModelConfig, Preprocessing, ViTConfig
from salad.training import checkpoint, trainer
from salad.training.batches import ImageCache
from salad.training.recipe import Preset, Recipe

MODEL = ModelConfig(
    "tiny",
    ViTConfig(16, 2, 2, grid=3),
    SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=4, hidden=8, dropout=0.0),
    Preprocessing(42, 42),
)
RECIPE: dict[str, Any] = {
    "head_steps": 2,
    "tune_steps": 4,
    "places": 3,
    "views": 3,
    "warmup": 1,
    "tuned_blocks": 1,
    "measure_every": 2,
    "save_every": 1,
    "precision": "32-true",
    "augment": "none",
    "held_out": 0.34,
}


def observed(
    photos: Path, to: Path, *, devices: int = 1, nodes: int = 1, resume: bool = False, **recipe: Any
) -> list[dict[str, Any]]:
    """Train; each step's loss and gradients as this process had them, and the photos it read."""
    seen: list[dict[str, Any]] = []
    read: list[str] = []
    learn, array = trainer.backward_in_parts, ImageCache.photos

    def watched(fabric: Any, module: Any, **settings: Any) -> torch.Tensor:
        loss = learn(fabric, module, **settings)
        gradients = {
            name: weight.grad.clone() for name, weight in module.module.named_parameters() if weight.grad is not None
        }
        seen.append({"loss": float(loss), "gradients": gradients, "read": sorted(read)})
        read.clear()
        return loss

    def reading(images: ImageCache, views: Any) -> Any:
        read.extend(f"{view.place.name}/{view.path.name}" for view in views)
        return array(images, views)

    with (
        mock.patch.object(trainer, "backward_in_parts", watched),
        mock.patch.object(ImageCache, "photos", reading),
    ):
        trainer.train(
            Preset(MODEL, "", Recipe(**(RECIPE | recipe))),
            find_places(photos),
            to=to,
            accelerator="cpu",
            devices=devices,
            nodes=nodes,
            resume=resume,
            say=lambda _: None,
        )
    return seen


@contextlib.contextmanager
def waiting(where: str) -> Iterator[None]:
    """Say so and wait to be killed: `step N` after that step, or `saving N` with half of that checkpoint written."""
    at, number = where.split()
    save, step = torch.save, trainer._Trainer._step

    def wait() -> None:
        print("waiting", flush=True)  # noqa: T201  # to the test that kills
        time.sleep(600)

    def saving(state: Any, file: Any, **options: Any) -> None:
        save(state, file, **options)
        if at == "saving" and isinstance(state, dict) and state["step"] == int(number):
            file.truncate(file.tell() // 2)
            wait()

    def stepping(run: Any, stage: Any) -> None:
        step(run, stage)
        if at == "step" and run.state.step == int(number):
            wait()

    with (
        mock.patch.object(checkpoint.torch, "save", saving),
        mock.patch.object(trainer._Trainer, "_step", stepping),
    ):
        yield


if __name__ == "__main__":
    from salad.training.devices import rank

    settings = json.loads(sys.argv[3])
    runs = settings.pop("runs", {"": {}})
    with waiting(settings.pop("wait", "step 1000000")):
        for name, more in runs.items():
            to = Path(sys.argv[2]) / name
            seen = observed(Path(sys.argv[1]), to, **settings, **more)
            to.mkdir(exist_ok=True)  # on a machine where no process writes
            torch.save(seen, to / f"seen-{rank()}.pt")
