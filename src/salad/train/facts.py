"""What is told of a run beside what it recalls: how large, how fast, learnt from what, on which machine."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import statistics
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch

from salad.data.places import TrainingPlace
from salad.model.counting import parameters
from salad.model.describer import Describer
from salad.train.loop import LOG
from salad.train.recipe import Preset


def counted(model: Describer, preset: Preset) -> dict[str, int]:
    """All parameters, and those that were trained."""
    recipe = preset.recipe
    every = parameters(model)
    if not recipe.head_steps + recipe.tune_steps:
        return {"all": every, "trained": 0}
    model.backbone.train_last(recipe.tuned_blocks if recipe.tune_steps else 0)
    return {"all": every, "trained": parameters(model, trained_only=True)}


def milliseconds(model: Describer, *, photos: int = 8, rounds: int = 5) -> float:
    """Milliseconds to describe a photo that is read and squeezed already, several at a time; the median round."""
    size, chance = model.preprocessing, np.random.default_rng(0)
    noise = list(chance.integers(0, 256, (photos, size.height, size.width, 3), dtype=np.uint8))
    model.describe(noise, batch_size=photos)  # the first call prepares what the others find ready
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        model.describe(noise, batch_size=photos)
        times.append(time.perf_counter() - began)
    return round(1000 * statistics.median(times) / photos, 2)


def summary(places: Sequence[TrainingPlace]) -> dict[str, Any]:
    """How much there is to learn from, and a digest of the names, wherever on a machine the photos lie."""
    names = sorted((place.city, place.name, [photo.name for photo in place.photos]) for place in places)
    return {
        "places": len(places),
        "photos": sum(len(place.photos) for place in places),
        "cities": dict(sorted(Counter(place.city for place in places).items())),
        "digest": hashlib.sha256(json.dumps(names).encode()).hexdigest()[:16],
    }


def machine(device: str) -> dict[str, Any]:
    """What bears on how fast it was, and on the last bits."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "device": device,
    }


def seconds_of(folder: Path, measured: float) -> float:
    """How long a run took, interruptions left out, as its log says; where it keeps none, as was measured now."""
    with suppress(OSError, ValueError, KeyError, IndexError, TypeError):
        return float(json.loads((folder / LOG).read_text(encoding="utf-8").splitlines()[-1])["seconds"])
    return round(measured, 1)
