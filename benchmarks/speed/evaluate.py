"""How long ranking takes, and how much memory, where the references are a million.

    python -m benchmarks.speed.evaluate [--references 1000000] [--queries 1000] [--dim 512] [--json figures.jsonl]

References are made up and written to a file in a temporary folder first, and read from there block by block, as
descriptors from outside are: so the memory is what judging takes, not what making them up did. Each query is
the noisy double of a reference that must come first: figures of a wrong ranking would be worth nothing.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.machine import conditions, peak_memory
from benchmarks.options import benchmark_parser
from salad.datasets.benchmark import Benchmark
from salad.datasets.compact_lists import PhotoList, Ragged
from salad.evaluation.evaluate_benchmark import EvalSettings, evaluate_descriptors
from salad.index.vectors import NpyWriter

SEED = 0
_STEP = 10_000  # references made up at once


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--references", type=int, default=1_000_000)
    parser.add_argument("--queries", type=int, default=1_000)
    parser.add_argument("--dim", type=int, default=512)
    parser.add_argument("--json", type=Path, help="add the figures to this file, one object a line")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(Path(folder), given.references, given.queries, given.dim)
    print(json.dumps(figures, indent=2))
    if given.json is not None:
        with given.json.open("a", encoding="utf-8") as file:
            file.write(json.dumps(figures) + "\n")


def measure(folder: Path, references: int, queries: int, dim: int) -> dict[str, object]:
    """Make up a set, judge it, and say what that took."""
    right = made_up(folder, references, queries, dim)
    before = peak_memory()
    benchmark = Benchmark(
        "made up",
        "made up",
        PhotoList(folder, (f"r{row}.jpg" for row in range(references))),
        PhotoList(folder, (f"q{row}.jpg" for row in range(queries))),
        Ragged(right, np.arange(queries + 1)),
    )
    began = time.perf_counter()
    result = evaluate_descriptors(
        benchmark,
        folder / "references.npy",
        folder / "queries.npy",
        name="made up",
        settings=EvalSettings(seed=SEED),
    )
    if result.recall[1] < 99:
        sys.exit(f"R@1 is {result.recall[1]:.1f} %, but every query's double must come first")
    return {
        "references": references,
        "queries": queries,
        "dim": dim,
        "seconds": round(time.perf_counter() - began, 1),
        "seconds of them ranking": round(result.seconds, 1),
        "peak MB": round(peak_memory() / 1e6),
        "peak MB before": round(before / 1e6),
        **conditions("numpy", seed=SEED),
    }


def made_up(folder: Path, references: int, queries: int, dim: int) -> np.ndarray:
    """Write both sides; the row of each query's double `[queries]`."""
    rng = np.random.default_rng(SEED)
    right = rng.choice(references, queries, replace=False)
    asked = np.empty((queries, dim), dtype=np.float32)
    with NpyWriter(folder / "references.npy", dim=dim, dtype=np.float32) as file:
        for start in range(0, references, _STEP):
            block = unit(rng.standard_normal((min(_STEP, references - start), dim), dtype=np.float32))
            here = np.flatnonzero((right >= start) & (right < start + len(block)))
            asked[here] = block[right[here] - start]
            file.write(block)
    noise = rng.standard_normal(asked.shape, dtype=np.float32) / np.sqrt(dim)
    np.save(folder / "queries.npy", unit(asked + noise))
    return right.astype(np.int64)


def unit(rows: np.ndarray) -> np.ndarray:
    """Rows at length 1."""
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


if __name__ == "__main__":
    main()
