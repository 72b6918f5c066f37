"""How long a photo takes: decoding and squeezing it, and describing it, each by itself.

    python -m benchmarks.speed.describe [MODEL ...] [--photos 48] [--threads 1]

The photos are drawn (480 x 360 JPEG), so anyone can repeat it. Models take turns in one process and the median of
the rounds is shown; compare them with one another rather than with another machine's.
"""

from __future__ import annotations

import datetime
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from benchmarks.machine import machine
from benchmarks.options import benchmark_parser

import salad
from salad.demo.town.town import draw_town
from salad.images.decode import decode

SEED, ROUNDS = 7, 5


def milliseconds(run: Callable[[], object], photos: int) -> float:
    """Of the clock, for each photo."""
    begun = time.perf_counter()
    run()
    return 1000 * (time.perf_counter() - begun) / photos


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__, models=["salad-lite"])
    parser.add_argument("--photos", type=int, default=48)
    parser.add_argument("--threads", type=int, default=1)
    asked = parser.parse_args()
    torch.set_num_threads(asked.threads)
    models = [salad.load(name) for name in asked.models]
    with tempfile.TemporaryDirectory() as folder:
        paths = draw_town(Path(folder), seed=SEED, references=asked.photos, queries=1).references
        seen: dict[str, list[float]] = {}
        for turn in range(ROUNDS + 1):
            for model in models:
                size = model.preprocessing
                pixels = [decode(path, size.height, size.width, size.resample) for path in paths]
                for what, run in (
                    ("decode and squeeze", lambda size=size: [
                        decode(path, size.height, size.width, size.resample) for path in paths
                    ]),
                    ("describe", lambda model=model, pixels=pixels: model.describe(pixels)),
                    ("describe one by one", lambda model=model, pixels=pixels: model.describe(pixels, batch_size=1)),
                ):  # fmt: skip
                    spent = milliseconds(run, len(paths))
                    if turn:  # the first warms up
                        seen.setdefault(f"{model.name}: {what}", []).append(spent)
    about = f"{machine()}, {asked.threads} threads, torch {torch.__version__}, {datetime.date.today()}, seed {SEED}"
    print(f"{about}, {asked.photos} photos of 480 x 360, median of {ROUNDS} rounds")
    for what, each in seen.items():
        print(f"{what:<45} {statistics.median(each):7.1f} ms a photo")


if __name__ == "__main__":
    main()
