"""From how many photos on codes are quicker than an exact search: one query, in milliseconds of the processor.

    python -m benchmarks.speed.codes_or_exact [--sizes 2176x10000 8448x10000 ...] [--rounds 15]

Rows are made up, since what they say does not matter to the time. Both ways are asked in turns; the rows are in a file
and, as in an index, stay in memory where they have room.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.machine import conditions, in_a_line, turns
from benchmarks.options import benchmark_parser
from benchmarks.speed.search import SEED, made_up, swept, unit
from salad.index.vectors import FileRows
from salad.search.compressed import CANDIDATES, CompressedSearcher
from salad.search.exact import ExactSearcher

SIZES = [f"{dim}x{rows}" for dim in (2176, 8448) for rows in (5_000, 10_000, 20_000, 30_000)]
K = 10


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--sizes", nargs="+", default=SIZES, metavar="DIMxPHOTOS")
    parser.add_argument("--rounds", type=int, default=15)
    given = parser.parse_args()
    print(in_a_line(conditions("numkong", "numpy", seed=SEED, threads=1, rounds=given.rounds, candidates=CANDIDATES)))
    print("| dim | photos | exact, ms | codes, ms | codes / exact |\n|---|---|---|---|---|")
    for size in given.sizes:
        dim, count = map(int, size.split("x"))
        with tempfile.TemporaryDirectory() as folder:
            made_up(Path(folder, "rows.f16"), count, dim)
            rows = FileRows(Path(folder, "rows.f16"), rows=count, dim=dim)
            query = unit(np.random.default_rng(SEED + 1), 1, dim)
            exact, coded = ExactSearcher(rows, threads=1), CompressedSearcher.of(rows, threads=1)
            ways = {
                "exact": lambda _, by=exact, of=rows, asked=query: swept(by, of, asked, K),
                "codes": lambda _, by=coded, of=rows, asked=query: swept(by, of, asked, K),
            }
            taken = turns(ways, rounds=given.rounds, clock=time.process_time)
            best = {name: 1e3 * min(seconds) for name, seconds in taken.items()}
            ratio = best["codes"] / best["exact"]
            print(f"| {dim} | {count} | {best['exact']:.1f} | {best['codes']:.1f} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main()
