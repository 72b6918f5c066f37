"""How long a photo takes: decoding and squeezing it, and describing it, each by itself.

    python -m benchmarks.speed.describe [MODEL ...] [--photos 48] [--threads 1]

The photos are drawn (480 x 360 JPEG), so anyone can repeat it. Models take turns in one process and the median of
the rounds is shown; compare them with one another rather than with another machine's.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch

import salad
from benchmarks.machine import conditions, in_a_line, medians, turns
from benchmarks.options import benchmark_parser
from salad.demo.town.town import draw_town
from salad.images.decode import decode

SEED, ROUNDS = 7, 5


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
        ways: dict[str, Callable[[int], object]] = {}
        for model in models:
            size = model.preprocessing
            decoded = partial(decode, height=size.height, width=size.width, resample=size.resample)
            pixels = [decoded(path) for path in paths]
            ways |= {
                f"{model.name}: decode and squeeze": lambda _, decoded=decoded: [decoded(path) for path in paths],
                f"{model.name}: describe": lambda _, model=model, pixels=pixels: model.describe(pixels),
                f"{model.name}: describe one by one": lambda _, model=model, pixels=pixels: model.describe(
                    pixels, batch_size=1
                ),
            }
        spent = medians(turns(ways, rounds=ROUNDS))
    told = conditions("torch", seed=SEED, threads=asked.threads, photos=f"{asked.photos} of 480 x 360", rounds=ROUNDS)
    print(in_a_line(told))
    for way, each in spent.items():
        print(f"{way:<45} {each / asked.photos:7.1f} ms a photo")


if __name__ == "__main__":
    main()
