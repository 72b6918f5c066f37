"""How long an exact search takes, by NumKong's kernels and by plain numpy; and how much memory, of how many rows.

    python -m benchmarks.speed.search [--rows 60000] [--dim 2176] [--queries 1 100] [-k 5] [--threads 1] [--rounds 5]
    python -m benchmarks.speed.search --rows 1000000 --dim 256 --no-numpy

Rows of length 1 are made up, written to a file of float16 in a temporary folder, as an index keeps them, and searched
there. Both ways take turns, and the best of several rounds counts: a busy machine then harms both alike. The first
search of all, which finds nothing in memory, is told apart. What both find must be the same.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.machine import conditions, in_a_line, peak_memory, turns
from benchmarks.options import benchmark_parser
from salad.index.vectors import FileRows
from salad.search.base import Hits, Searcher
from salad.search.exact import ExactSearcher

SEED = 0
_STEP = 2000  # rows made up, or multiplied by numpy, at once


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--rows", type=int, default=60_000)
    parser.add_argument("--dim", type=int, default=2176)
    parser.add_argument("--queries", type=int, nargs="+", default=[1, 100])
    parser.add_argument("-k", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1, help="of our own; numpy takes OMP_NUM_THREADS")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--no-numpy", action="store_true", help="leave numpy out, which takes ten times as long")
    given = parser.parse_args()
    print(in_a_line(conditions("numkong", "numpy", seed=SEED, **vars(given))))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "rows.f16")
        made_up(path, given.rows, given.dim)
        rows = FileRows(path, rows=given.rows, dim=given.dim)
        queries = unit(np.random.default_rng(SEED + 1), max(given.queries), given.dim)
        before = peak_memory()
        searcher = ExactSearcher(rows, threads=given.threads)
        began = time.perf_counter()
        searcher.search(queries[:1], k=given.k)
        print(f"first search: {1e3 * (time.perf_counter() - began):.1f} ms; memory {before / 1e6:.0f} MB before")
        for count in given.queries:
            ways: dict[str, Callable[[int], Hits]] = {
                "NumKong": lambda _, asked=queries[:count]: swept(searcher, rows, asked, given.k)
            }
            if not given.no_numpy:
                ways["numpy"] = lambda _, asked=queries[:count]: plain(rows, asked, given.k)
            found = {way: search(0) for way, search in ways.items()}
            if len(found) > 1 and not np.array_equal(found["NumKong"].rows, found["numpy"].rows):
                sys.exit("the two find different rows")
            taken = turns(ways, rounds=given.rounds)
            figures = ", ".join(f"{way} {1e3 * min(each) / count:.2f}" for way, each in taken.items())
            print(f"{count} queries, ms a query: {figures}; memory {peak_memory() / 1e6:.0f} MB at most")


def swept(searcher: Searcher, rows: FileRows, queries: np.ndarray, k: int) -> Hits:
    """As an index searches: rows of a small one stay in memory from the second sweep on."""
    rows.keep()
    return searcher.search(queries, k=k)


def plain(rows: FileRows, queries: np.ndarray, k: int) -> Hits:
    """Every score by float32 matrix products of blocks that numpy widens, then the k best."""
    scores = np.empty((len(queries), len(rows)), np.float32)
    spare = np.empty((_STEP, rows.dim), np.float16)
    for start in range(0, len(rows), _STEP):
        block = rows.block(start, min(start + _STEP, len(rows)), spare)
        scores[:, start : start + len(block)] = queries @ block.astype(np.float32).T
    some = np.argpartition(-scores, k - 1, axis=1)[:, :k]
    found = np.take_along_axis(scores, some, axis=1)
    order = np.argsort(-found, axis=1, kind="stable")
    return Hits(np.take_along_axis(some, order, axis=1), np.take_along_axis(found, order, axis=1).astype(float))


def made_up(path: Path, rows: int, dim: int) -> None:
    """Write rows of length 1 as float16."""
    rng = np.random.default_rng(SEED)
    with path.open("wb") as file:
        for start in range(0, rows, _STEP):
            file.write(unit(rng, min(_STEP, rows - start), dim).astype(np.float16).tobytes())


def unit(rng: np.random.Generator, rows: int, dim: int) -> np.ndarray:
    """Rows of length 1 that point anywhere."""
    drawn = rng.standard_normal((rows, dim), dtype=np.float32)
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


if __name__ == "__main__":
    main()
