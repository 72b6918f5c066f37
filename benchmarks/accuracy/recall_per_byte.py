r"""What is found by how many bytes a photo: salad's codes beside FAISS's IVF-PQ, OPQ and HNSW, and usearch.

    pip install faiss-cpu usearch
    python -m benchmarks.accuracy.real_descriptors DESCRIPTORS/salad-lite --model salad-lite
    python -m benchmarks.accuracy.recall_per_byte DESCRIPTORS/salad-lite [DESCRIPTORS/salad-vits ...] \
        --json per-byte.jsonl [--rows 20000] [--svg docs/recall-per-byte.svg]

Each folder is one model's, and called after it. In it are descriptors of photos; rows are all of them that are no
queries, and distractors made of those (`real_descriptors`). Queries are photos of 150 training places, of which nothing
else was made, and those of the evaluation sets; both are centred, as `salad locate` asks.

Recall@10 is the share of the ten best rows of an exact search that are found: by the codes alone, and where the exact
scores of the best 100 or 500 by codes decide, with the same code for all. Times are of one thread's processor time for
queries asked one by one, all ways in turn, the best of several rounds, as a part of an exact search's.

Every line of the JSON file is one way's; a model that is in it is not measured again.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.accuracy.byte_chart import chart
from benchmarks.accuracy.real_descriptors import Distractors, Half, Layout
from benchmarks.machine import conditions, in_a_line, turns
from benchmarks.options import TRAIN, benchmark_parser
from benchmarks.speed.compressed import asked
from salad.search.base import LONGEST_UNIT, ArrayRows, Numbers, Queries
from salad.search.exact import ExactSearcher
from salad.search.hubness import centred, mean_of_some

if TYPE_CHECKING:
    from benchmarks.accuracy.ways_to_search import Way

SEED = 0
K = 10
RESCORED = (0, 100, 500)  # rows of a query that are scored exactly
SALAD = Layout().parts.size  # numbers of a descriptor without a layout
_TOGETHER = 100  # queries asked at once, where time does not matter

Figures = dict[str, Any]


def rows_of(real: Half, parents: Half, count: int) -> Half:
    """Real rows and as many distractors as make it `count`; real ones alone where they are so many."""
    cells = (real.shape[1] - SALAD) // Layout().cell
    more = Distractors(parents, layout=Layout(cells=cells), seed=SEED).blocks(max(0, count - len(real)))
    return np.concatenate([real, *more])


def found(way: Way, rows: Half, queries: Queries, depth: int) -> Numbers:
    """The K rows that a way finds for each query: by itself, or with the exact scores of so many."""
    from benchmarks.accuracy.ways_to_search import rescored

    return rescored(rows, queries, way.find(queries, depth), K) if depth else way.find(queries, K)


def depths(way: Way) -> tuple[int, ...]:
    """How many rows it pays to score exactly."""
    return RESCORED[:1] if way.whole else RESCORED


def share(rows: Numbers, best: Numbers) -> float:
    """How many of the best rows `[Q, K]` are among those found `[Q, K]`."""
    return float((rows[:, None] == best[:, :, None]).any(axis=2).mean())


def times(all_ways: Sequence[Way], rows: Half, queries: Queries, rounds: int) -> dict[tuple[int, int], float]:
    """Processor time of each way, by its number and depth, as a part of an exact search's."""

    def one_by_one(find: Callable[[Queries], object], _: int) -> None:
        for query in queries:
            find(query[None])

    exact = ExactSearcher(ArrayRows(rows, longest=LONGEST_UNIT), threads=1)
    timed: dict[str, Callable[[int], object]] = {"exact": partial(one_by_one, partial(exact.search, k=K))}
    for number, way in enumerate(all_ways):
        for depth in depths(way):
            asks = partial(lambda way, depth, some: found(way, rows, some, depth), way, depth)
            timed[f"{number} {depth}"] = partial(one_by_one, asks)
    best = {name: min(taken) for name, taken in turns(timed, rounds=rounds, clock=time.process_time).items()}
    alone = best.pop("exact")
    print(f"exact search: {1e3 * alone / len(queries):.1f} ms a query", flush=True)
    return {(int(name.split()[0]), int(name.split()[1])): taken / alone for name, taken in best.items()}


def measured(folder: Path, given: argparse.Namespace) -> Iterator[Figures]:
    """A model's figures, one way after the other."""
    from benchmarks.accuracy.ways_to_search import ways

    what = asked(folder, given.train, seed=SEED)
    rows = rows_of(what.real, what.parents, given.rows)
    mean = mean_of_some(ArrayRows(rows, longest=LONGEST_UNIT), np.ones(len(rows), np.bool_))
    queries, kinds = [], {}
    for kind, some in what.queries.items():
        kept = some[np.linspace(0, len(some) - 1, min(given.queries, len(some))).astype(int)]
        kinds[kind] = slice(sum(map(len, queries)), sum(map(len, queries)) + len(kept))
        queries.append(kept.astype(np.float32))
    moved, _ = centred(np.concatenate(queries), mean)
    best = ExactSearcher(ArrayRows(rows, longest=LONGEST_UNIT), threads=1).search(moved, k=K).rows
    about = {
        "model": folder.name,
        "rows": len(rows),
        "photos": len(what.real),
        "queries": {kind: those.stop - those.start for kind, those in kinds.items()},
        "photos among the best": {kind: float((best[those] < len(what.real)).mean()) for kind, those in kinds.items()},
    }
    print(in_a_line(conditions("faiss-cpu", "usearch", "numkong", "numpy", seed=SEED, **about)), flush=True)
    every = []
    for way in ways(rows, seed=SEED):
        every.append(way)
        print(f"{way.name}, {way.setting}: made", flush=True)
    taken = times(every, rows, moved[np.linspace(0, len(moved) - 1, given.timed).astype(int)], given.rounds)
    for number, way in enumerate(every):
        recall = {}
        for depth in depths(way):
            parts = np.array_split(moved, -(-len(moved) // _TOGETHER))
            rows_found = np.concatenate([found(way, rows, some, depth) for some in parts])
            recall[str(depth)] = {
                "all": share(rows_found, best),
                **{kind: share(rows_found[those], best[those]) for kind, those in kinds.items()},
            }
        yield {
            **about,
            "way": way.name,
            "setting": way.setting,
            "bytes": {"code": way.code, "beside": round(way.beside, 1), "shared": way.shared},
            "recall": recall,
            "time": {str(depth): taken[number, depth] for depth in depths(way)},
            **conditions("faiss-cpu", "usearch", "numkong", "numpy", seed=SEED),
        }


def table(figures: Sequence[Figures]) -> str:
    """One model's figures for a page, a line a way."""
    lines = [
        "| | bytes a photo | once, MB | recall@10: codes alone | best 100 scored | best 500 "
        "| time: codes alone | best 100 scored | best 500 |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for each in figures:
        size = each["bytes"]
        held = f"{size['code']:,}" + (f" + {size['beside']:,.0f}" if size["beside"] else "")
        recall = [
            f"{each['recall'][str(depth)]['all']:.3f}" if str(depth) in each["recall"] else "" for depth in RESCORED
        ]
        taken = [f"{each['time'][str(depth)]:.2f}" if str(depth) in each["time"] else "" for depth in RESCORED]
        shared = f"{size['shared'] / 1e6:.1f}" if size["shared"] else "0"
        lines.append(
            f"| {each['way']}, {each['setting']} | {held} | {shared} | " + " | ".join([*recall, *taken]) + " |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("folders", type=Path, nargs="*", metavar="DESCRIPTORS")
    parser.add_argument("--json", type=Path, required=True, help="figures are appended here")
    parser.add_argument("--svg", type=Path, help="draw all figures of the JSON file here")
    parser.add_argument("--train", type=Path, default=TRAIN, help="where the training photos lie: whose place is whose")
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--queries", type=int, default=300, help="of each kind at most, evenly spread")
    parser.add_argument("--timed", type=int, default=4, help="queries asked in a round")
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args()
    try:
        import faiss
        import usearch  # noqa: F401  # needed by what is imported later
    except ImportError as error:
        parser.error(f"{error.name} is missing, which salad's codes are compared with: pip install faiss-cpu usearch")
    faiss.omp_set_num_threads(1)
    kept = [json.loads(line) for line in given.json.read_text().splitlines()] if given.json.is_file() else []
    for folder in given.folders:
        if any(each["model"] == folder.name for each in kept):
            print(f"{folder.name}: in {given.json} already")
            continue
        new = list(measured(folder, given))
        with given.json.open("a", encoding="utf-8") as out:
            out.writelines(json.dumps(each) + "\n" for each in new)
        kept += new
    by_model = {each["model"]: [one for one in kept if one["model"] == each["model"]] for each in kept}
    for model, figures in by_model.items():
        print(
            f"\n{model}: {in_a_line({key: figures[0][key] for key in ('machine', 'date', 'seed', 'rows', 'photos')})}\n"
        )
        print(table(figures))
    if given.svg:
        given.svg.write_text(chart(by_model), encoding="utf-8")


if __name__ == "__main__":
    main()
