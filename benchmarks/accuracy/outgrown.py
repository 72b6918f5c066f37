"""What an index loses that has outgrown its codes: fitted on the first part of its photos only, searched whole.

    python -m benchmarks.accuracy.real_descriptors DESCRIPTORS
    python -m benchmarks.accuracy.outgrown DESCRIPTORS [--bytes 256] [--candidates 200]

The index is of training photos alone, in the order of their sets, as an index grows that webcams, parks, corridors and
streets are added to one after the other: what comes later is of another kind than what the codes were fitted on. Every
tenth photo is a query instead.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.accuracy.real_descriptors import Described
from benchmarks.machine import conditions, in_a_line
from benchmarks.options import benchmark_parser
from salad.search.base import LONGEST_UNIT, ArrayRows
from salad.search.compressed import ArrayCodes, Coding, CompressedSearcher
from salad.search.exact import ExactSearcher

SEED = 0
K = 10


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("descriptors", type=Path)
    parser.add_argument("--bytes", type=int, default=256)
    parser.add_argument("--candidates", type=int, default=200)
    parser.add_argument("--parts", type=int, nargs="+", default=[1, 2, 4, 8])
    given = parser.parse_args()
    every = Described.read(given.descriptors, "train").rows
    asked = np.arange(len(every)) % 10 == 0
    rows, queries = ArrayRows(every[~asked], longest=LONGEST_UNIT), every[asked]
    best = ExactSearcher(rows).search(queries, k=K).rows
    print(in_a_line(conditions("numkong", "numpy", seed=SEED, bytes=given.bytes, candidates=given.candidates)))
    print(f"{len(rows)} photos, {len(queries)} queries\n| fitted on | recall@{K} |\n|---|---|")
    for part in given.parts:
        coding = Coding.fitted(rows, size=given.bytes, those=np.arange(len(rows) // part), seed=SEED)
        searcher = CompressedSearcher(rows, ArrayCodes(coding, rows), candidates=given.candidates)
        found = searcher.search(queries, k=K).rows
        same = (found[:, None] == best[:, :, None]).any(axis=2).mean()
        print(f"| {len(rows) // part}, 1 / {part} | {same:.4f} |", flush=True)


if __name__ == "__main__":
    main()
