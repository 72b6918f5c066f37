"""What `salad index` makes of the machine: the whole beside what its parts allow, for small photos and large ones.

    python -m benchmarks.speed.pipeline [MODEL ...] [--data DIR] [--small 1000] [--large 300] [--rounds 3]

The parts are reading a photo (opening, EXIF, hash, decoding, squeezing) and describing it, each alone on one thread
of one process, in processor time. They allow so many photos a second as there are processors, divided by their sum;
the whole is one run of the command, from its start to its end, on as many processors as it may use. Parts and whole
take turns, and the best of the rounds counts. Two shares of that bound are shown: by the clock, which is worth
something on a machine that does nothing else, and by the processors' time, which leaves out waiting and no work.

Photos are made of the training photos: resized to 640 x 480 and to 4000 x 3000 pixels with a little noise, so that a
file is as long as a camera's, and saved with position, heading and time. Of twenty pictures of each size copies are
made, with a few bytes behind their end, so that every one is a photo of its own.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import salad
from benchmarks.machine import conditions, in_a_line
from benchmarks.options import SHIPPED, TRAIN, benchmark_parser
from benchmarks.speed.startup import children
from benchmarks.speed.startup import salad as command
from salad.geo import GeoPoint
from salad.images.exif import save_jpeg
from salad.images.finding import find_photos
from salad.images.worker_process import read
from salad.processors import processors

SEED, DISTINCT, NOISE = 7, 20, 3.0
SIZES = {"small": (640, 480), "large": (4000, 3000)}


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__, models=SHIPPED, data=TRAIN)
    parser.add_argument("--small", type=int, default=1000)
    parser.add_argument("--large", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        counts = {size: getattr(asked, size) for size in SIZES}
        for size, count in counts.items():
            make_photos(home / size, asked.data, SIZES[size], count)
        runs = [Run(name, size, home) for name in asked.models for size in SIZES]
        for _ in range(asked.rounds):
            for run in runs:
                run.again()
    print(in_a_line(conditions("onnxruntime", "pillow", seed=SEED, rounds=asked.rounds, processors=processors())))
    print(f"{'model':<18} photos  read + describe, ms   whole, photos/s   bound   of it by clock   by processor")
    for run in runs:
        print(run.line())


@dataclass
class Run:
    """One model on photos of one size.

    Args:
        model: Its name.
        size: Which photos.
        home: The folder that theirs is in.
    """

    model: str
    size: str
    home: Path
    took: dict[str, list[float]] = field(default_factory=dict)

    def again(self) -> None:
        """Measure parts and whole once more."""
        paths, model = sorted((self.home / self.size).iterdir()), salad.load(self.model, threads=1)
        to, few = model.preprocessing, paths[:DISTINCT]
        pixels = [read(path, (to.height, to.width, to.resample)).pixels for path in few]
        self._time("read", len(few), lambda: [read(path, (to.height, to.width, to.resample)) for path in few])
        self._time("describe", len(few), lambda: [model.describe([photo]) for photo in pixels if photo is not None])
        index, used, began = self.home / "index", children(), time.perf_counter()
        command(Path(sys.executable), "index", str(self.home / self.size), "--to", str(index), "--model", self.model)
        self.took.setdefault("wall", []).append((time.perf_counter() - began) / len(paths))
        self.took.setdefault("used", []).append((children() - used) / len(paths))
        shutil.rmtree(index)

    def _time(self, part: str, count: int, work: Callable[[], Any]) -> None:
        began = time.process_time()
        work()
        self.took.setdefault(part, []).append((time.process_time() - began) / count)

    def line(self) -> str:
        """What it took, for people."""
        best = {part: min(times) for part, times in self.took.items()}
        parts = best["read"] + best["describe"]
        bound = processors() / parts
        shares = f"{1 / best['wall'] / bound:10.2f} {parts / best['used']:16.2f}"
        told = f"{1000 * best['read']:8.1f} + {1000 * best['describe']:6.1f}"
        return f"{self.model:<18} {self.size:<7} {told} {1 / best['wall']:18.1f} {bound:10.1f} {shares}"


def make_photos(folder: Path, source: Path, size: tuple[int, int], count: int) -> None:
    """Photos of a size, of other photos that lie in and below a folder."""
    rng = np.random.default_rng(SEED)
    chosen = rng.permutation(np.array(find_photos([source]), dtype=object))[:DISTINCT]
    folder.mkdir(parents=True)
    for number, path in enumerate(chosen):
        with Image.open(path) as opened:
            image = np.asarray(opened.convert("RGB").resize(size, Image.Resampling.BICUBIC), dtype=np.float32)
        noise = rng.normal(0, NOISE, (*image.shape[:2], 1)).astype(np.float32)
        made = folder / f"{number:05}.jpg"
        taken = {"where": GeoPoint(48 + number / 1e3, 11.5), "heading": float(number), "time": datetime(2024, 5, 1, 12)}
        save_jpeg(np.clip(image + noise, 0, 255).astype(np.uint8), made, **taken)
    held = [path.read_bytes() for path in sorted(folder.iterdir())]
    for number in range(len(held), count):
        (folder / f"{number:05}.jpg").write_bytes(held[number % len(held)] + b"%d" % number)


if __name__ == "__main__":
    main()
