"""What it costs that each photo is read by a worker process within limits, and what hostile photos come to there.

    python -m benchmarks.speed.limits [--data DIR] [--rounds 9]

The cost is that of one photo after another: read (opening, EXIF, hash, decoding, squeezing) by a process that waits for
it, beside the same in this process. Both take turns on the same photos, of 640 x 480 and of 4000 x 3000 pixels made as
for benchmarks.speed.pipeline; the best round counts. To start a process is measured too; a command does so while its
model loads, and a library once.

Each hostile photo of tests/images/hostile.py is read by a new process: seconds by the clock with the process's start,
and the most memory that it held.
"""

from __future__ import annotations

import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

from benchmarks.machine import conditions, in_a_line, turns
from benchmarks.options import TRAIN, benchmark_parser
from benchmarks.speed.pipeline import DISTINCT, SEED, SIZES, make_photos
from salad.errors import PhotoError
from salad.images.worker_process import read
from salad.images.workers import Pool, Workers
from tests.images.hostile import HOSTILE

TO = (322, 322, "bilinear")


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__, data=TRAIN)
    parser.add_argument("--rounds", type=int, default=9)
    asked = parser.parse_args()
    print(in_a_line(conditions("pillow", seed=SEED, rounds=asked.rounds)))
    with tempfile.TemporaryDirectory() as folder:
        for size, shape in SIZES.items():
            make_photos(Path(folder, size), asked.data, shape, DISTINCT)
            print(cost(sorted(Path(folder, size).iterdir()), size, asked.rounds))
        print(f"to start a process{1000 * start(Path(folder, 'small'), asked.rounds):13.0f} ms")
        for name, write in HOSTILE.items():
            path = Path(folder, name)
            write(path)
            print(f"{name:<38} {hostile(path, folder)}", flush=True)
            path.unlink()


def cost(paths: list[Path], size: str, rounds: int) -> str:
    """What a photo takes by a process and in this one, for people."""
    with Workers(1) as workers:
        taken = turns(
            {
                "here": lambda _: [read(path, TO) for path in paths],
                "by a process": lambda _: [workers.read(path, TO) for path in paths],
            },
            rounds=rounds,
        )
    here, there = (1000 * min(taken[way]) / len(paths) for way in ("here", "by a process"))
    return f"{size} photos: {there:.2f} ms each by a process, {here:.2f} here, ratio {there / here:.2f}"


def start(folder: Path, rounds: int) -> float:
    """Seconds from asking a new process for a photo to its answer, less those of a process that waits."""
    path = min(folder.iterdir())
    fresh, waits = [], []
    for _ in range(rounds):
        pool = Pool()
        for taken in (fresh, waits):
            begun = time.perf_counter()
            with Workers(1, pool=pool) as workers:
                workers.read(path, TO)
            taken.append(time.perf_counter() - begun)
        pool.close()
    return min(fresh) - min(waits)


def hostile(path: Path, folder: str) -> str:
    """How long a photo takes and how much, and what is said of it, for people."""
    pool = Pool()
    pool.prepare()
    peak, done = [0], threading.Event()
    process = pool._free[0]._process  # whose memory nobody else can tell once it was ended
    watch = threading.Thread(target=_watch, args=(0 if process is None else process.pid, peak, done))
    watch.start()
    begun = time.perf_counter()
    with Workers(1, pool=pool) as workers:
        try:
            said = workers.read(path, TO).trouble or "opened"
        except PhotoError as error:
            said = str(error)
    seconds = time.perf_counter() - begun
    done.set()
    watch.join()
    pool.close()
    return f"{seconds:5.1f} s {peak[0] / 1e9:5.2f} GB   {said.replace(folder, '')}"


def _watch(pid: int, peak: list[int], done: threading.Event) -> None:
    """Ask every 10 ms for the most memory that a process has held, as Linux tells it."""
    while not done.wait(0.01):
        with suppress(OSError, StopIteration):
            lines = Path(f"/proc/{pid}/status").read_text().splitlines()
            peak[0] = max(peak[0], 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")))


if __name__ == "__main__":
    main()
