"""How large an index may grow: adding, searching, memory and disk, beside FAISS flat and a plain numpy matrix.

    python -m benchmarks.speed.index_size [--sizes 2176x10000 8448x10000 ...] [--rounds 11] [--threads 2] [--json FILE]

Descriptors are made up: unit rows around a thousand middles, so that some are as close as neighbouring photos
are; the same seed draws the same ones. All ways get the same batches and queries and take turns in one process,
and the median of the rounds is shown; compare within one run only. Ours is asked through `Index.add` and
`Index.search`, which also keep and name photos; the others return numbers of rows. Memory is the highest
resident memory of a fresh process that opens what is on the disk and answers 1 and then 100 queries.

Each size is measured in processes of its own, so that the number of threads holds for every library in them.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from benchmarks.machine import conditions, in_a_line, in_fresh_process, installed, medians, peak_memory, turns
from benchmarks.options import benchmark_parser
from benchmarks.speed.index_ways import (
    BATCH,
    MAKE,
    QUERIES,
    SEED,
    Floats,
    K,
    Way,
    batches,
    opened,
    queries,
    set_threads,
)

SIZES = ("2176x10000", "8448x10000", "2176x100000", "8448x100000")
GOAL_ROWS = 20_000  # a second, at 2,176 numbers
SETTLE = 0.05  # seconds: threads of the way before that still spin must not slow the next
ONE, MANY = "1 query, ms", f"{QUERIES} queries, ms"

Figures = dict[str, dict[str, float]]  # by way, by what


def measure(count: int, dim: int, folder: Path, rounds: int, threads: int) -> Figures:
    """Every figure but memory, of every way that fits; to be called in a process of its own."""
    ways: dict[str, Way] = {}
    for name in fitting(count, dim):
        set_threads(name, threads)
        ways[name] = MAKE[name](folder / name, count, dim)
    spent = dict.fromkeys(ways, 0.0)
    for number, rows in enumerate(batches(count, dim)):
        for name, way in ways.items():
            spent[name] += way.add(rows, number * BATCH)
    figures: Figures = {name: {"rows a second": count / spent[name]} for name in ways}
    asked = queries(dim)
    for _ in range(2):  # warms up, too
        tops = {name: way.top(asked) for name, way in ways.items()}
    for name, top in tops.items():
        figures[name]["agreed"] = sum(a == b for a, b in zip(top, tops["salad"], strict=True))
    for questions, what in ((1, ONE), (QUERIES, MANY)):
        spent = medians(turns(asking(ways, asked, questions), rounds=rounds, settle=SETTLE))
        for name, milliseconds in spent.items():
            figures[name][what] = milliseconds
    for name in figures:
        figures[name]["disk, MiB"] = ways.pop(name).save(folder / name) / 2**20
    return figures


def asking(ways: Mapping[str, Way], asked: Floats, questions: int) -> dict[str, Callable[[int], object]]:
    """Each way asked as many questions at once; each round asks others, where that is fewer than there are."""

    def ask(way: Way, turn: int) -> object:
        low = turn * questions % QUERIES
        return way.top(asked[low : low + questions])

    return {name: partial(ask, way) for name, way in ways.items()}


def fitting(count: int, dim: int) -> list[str]:
    """The ways that fit into memory together; FAISS needs half as much again while it grows."""
    matrix, free = count * dim * 4, available()
    ways, need = ["salad"], matrix / 2  # what the system keeps of our file, so that nobody waits for the disk
    for name, more in (("faiss flat", 1.5 * matrix), ("numpy", matrix)):
        if name == "faiss flat" and installed("faiss-cpu") is None:
            print("faiss flat: passed over, it is not installed (pip install faiss-cpu)", flush=True)
        elif need + more > 0.95 * free:
            spare = f"it needs {more / 2**30:.1f} GiB and {(free - need) / 2**30:.1f} GiB are left"
            print(f"{name}, {dim} x {count}: passed over, {spare}", flush=True)
        else:
            ways.append(name)
            need += more
    return ways


def available() -> float:
    """Bytes of memory that are free, as far as the system tells."""
    told = Path("/proc/meminfo")
    lines = told.read_text().splitlines() if told.is_file() else []
    kibibytes = next((line.split()[1] for line in lines if line.startswith("MemAvailable")), None)
    return float("inf") if kibibytes is None else int(kibibytes) * 1024.0


def memory(name: str, path: Path, dim: int, threads: int) -> tuple[float, float]:
    """Highest resident mebibytes before and after opening and searching; in a process of its own."""
    set_threads(name, threads)
    asked = queries(dim)
    before = peak_memory() / 2**20
    run = opened(name, path)
    for _ in range(2):
        run(asked[:1])
        run(asked)
    return before, peak_memory() / 2**20


# --- printing -------------------------------------------------------------------------------


def one_size(count: int, dim: int, folder: Path, asked: argparse.Namespace) -> Figures:
    """Measure a size in fresh processes and print its lines."""
    figures = in_fresh_process(measure, count, dim, folder, asked.rounds, asked.threads)
    for name, found in figures.items():
        before, peak = in_fresh_process(memory, name, folder / name, dim, asked.threads)
        found["memory, MiB"], found["memory before, MiB"] = peak, before
        if name != "salad":
            (folder / name).unlink()
        print(
            f"| {dim} | {count} | {name} | {found['rows a second']:.0f} | {found[ONE]:.2f} | {found[MANY]:.1f} | "
            f"{peak:.0f} ({before:.0f}) | {found['disk, MiB']:.1f} | {found['agreed']:.0f} of {QUERIES} |",
            flush=True,
        )
    return figures


def verdicts(size: str, figures: Figures) -> list[str]:
    """How the goals stand at one size, a line each."""
    mine, said = figures["salad"], []
    if size.startswith("2176x"):
        rate = mine["rows a second"]
        said.append(f"{rate:.0f} rows a second (goal {GOAL_ROWS}): {_told(rate >= GOAL_ROWS)}")
    if other := figures.get("faiss flat"):
        for what in (ONE, MANY):
            ratio = mine[what] / other[what]
            said.append(f"{what[:-4]} in {ratio:.2f} of FAISS's time (goal 1): {_told(ratio <= 1)}")
    return [f"- {size}: {each}" for each in said]


def _told(met: bool) -> str:
    return "met" if met else "missed"


def parsed() -> argparse.Namespace:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--sizes", nargs="+", default=SIZES, metavar="DIMxPHOTOS")
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--folder", type=Path, help="where the indexes go, and stay; else they are deleted")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def main() -> None:
    """Measure and print."""
    asked = parsed()
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = str(asked.threads)  # read by the processes that measure, as they start
    told = conditions(
        *("numpy", "faiss-cpu", "numkong"),
        seed=SEED,
        threads=asked.threads,
        rounds=asked.rounds,
        batch=BATCH,
        k=K,
    )
    print(in_a_line(told) + "\n")
    print(
        f"| dim | photos | way | rows added a second | {ONE} | {MANY} | peak memory, MiB (before opening) | "
        "disk, MiB | same first answer |\n" + "|---" * 9 + "|"
    )
    said: list[str] = []
    for size in asked.sizes:
        dim, count = (int(part) for part in size.split("x"))
        home = asked.folder or Path(tempfile.mkdtemp())
        (home / size).mkdir(parents=True)
        try:
            told[size] = one_size(count, dim, home / size, asked)
        finally:
            if asked.folder is None:
                shutil.rmtree(home)
        said += verdicts(size, told[size])
    print("\n" + "\n".join(said))
    if asked.json:
        asked.json.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
