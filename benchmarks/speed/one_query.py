"""How long one query of an index takes, and how much memory, in a process that does nothing else.

    python -m benchmarks.speed.one_query city.index queries.npy [--candidates 500] [--rounds 100]

Queries are descriptors `[Q, dim]`, asked one by one, with centred scores, as `salad locate` asks. Without candidates
searches are exact. Milliseconds on the clock (the best, the median) and of the processor (the median; threads add up);
of opening the index and of the first search; and the most memory, before, after the first search and after all, in MB.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np

from benchmarks.machine import peak_memory
from benchmarks.options import benchmark_parser
from salad.index.index import Index
from salad.search import compressed
from salad.search.exact import ExactSearcher

K = 10


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("index", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--candidates", type=int, default=compressed.CANDIDATES, help="0 for an exact search")
    parser.add_argument("--rounds", type=int, default=100)
    given = parser.parse_args()
    compressed.CANDIDATES = given.candidates or compressed.CANDIDATES
    queries = np.load(given.queries)
    figures = {"memory before": peak_memory() / 1e6}
    began = time.perf_counter()
    with Index.open(given.index, searcher=None if given.candidates else ExactSearcher) as index:
        figures["open"] = 1e3 * (time.perf_counter() - began)
        index.search(queries[0], k=K, centred=True)
        figures |= {"first": 1e3 * (time.perf_counter() - began), "memory, first": peak_memory() / 1e6}
        index.search(queries[0], k=K, centred=True)  # which keeps what it reads
        taken = []
        for number in range(given.rounds):
            begun, spent = time.perf_counter(), time.process_time()
            index.search(queries[number % len(queries)], k=K, centred=True)
            taken.append((1e3 * (time.perf_counter() - begun), 1e3 * (time.process_time() - spent)))
    wall, processor = np.array(taken).T
    figures |= {"best": wall.min(), "median": float(np.median(wall)), "processor": float(np.median(processor))}
    print(json.dumps(figures | {"memory": peak_memory() / 1e6}))


if __name__ == "__main__":
    main()
