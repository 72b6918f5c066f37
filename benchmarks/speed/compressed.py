"""A million photos of 8,448 numbers: how large their codes are, how long a query takes, how much of it they find.

    python -m benchmarks.real_descriptors DESCRIPTORS
    python -m benchmarks.speed.compressed SCRATCH --descriptors DESCRIPTORS [--photos 1000000] [--bytes 256 128 64]

makes an index in the folder SCRATCH (17 GB for a million; what was begun is gone on with; delete it afterwards), of all
references of the evaluation sets, the training photos, crops, and distractors made of those (`real_descriptors`).
Two kinds of queries are asked: photos of 150 training places, of which nothing else was made, by which the number of
candidates was chosen; and those of the evaluation sets, by which nothing was.

Recall@10 is the share of the ten best rows of an exact search that the codes find too, with centred scores, as `salad
locate` asks. Times are of `Index.search` for one query in a process of its own, which holds nothing else; the files are
in the system's memory as far as it has room for them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.accuracy.recall import SETS
from benchmarks.machine import conditions, in_a_line, in_fresh_process, peak_memory
from benchmarks.options import TRAIN, benchmark_parser
from benchmarks.real_descriptors import Described, Distractors, Half, Layout
from salad.datasets.places import find_places
from salad.images.photo import Photo
from salad.index.index import Index
from salad.processors import processors
from salad.search import compressed
from salad.search.exact import ExactSearcher

SEED = 0
K = 10
PLACES, NEWEST = 150, 2  # training places whose newest photos are queries
_BATCH = 1000  # photos added at once


class Asked(NamedTuple):
    """What is searched for and in: queries `[Q, dim]` by kind, real rows, and the rows that distractors are made of."""

    queries: dict[str, Half]
    real: Half
    parents: Half


def asked(descriptors: Path, train: Path, *, seed: int) -> Asked:
    """Set queries aside, and say what else there is."""
    photos, crops = Described.read(descriptors, "train"), Described.read(descriptors, "crops")
    places = [[str(photo.relative_to(train)) for photo in place.photos] for place in find_places(train)]
    drawn = np.random.default_rng(seed).choice(len(places), PLACES, replace=False)
    newest = {name for at in drawn for name in places[at][-NEWEST:]}
    shown = {name for at in drawn for name in places[at]}
    is_query, is_shown, cropped = (
        np.array([name in names for name in of])
        for names, of in ((newest, photos.names), (shown, photos.names), (shown, crops.names))
    )
    sets = [each for each in SETS if (descriptors / f"{each.name}-queries.npy").is_file()]
    queries = {
        side: np.concatenate([Described.read(descriptors, f"{each.name}-{side}").rows for each in sets])
        for side in ("queries", "references")
    }
    parents = np.concatenate([photos.rows[~is_shown], crops.rows[~cropped]])
    real = np.concatenate([queries["references"], photos.rows[~is_query], crops.rows[~cropped]])
    return Asked({"training": photos.rows[is_query], "evaluation": queries["queries"]}, real, parents)


def rows_of(given: Asked, count: int, *, seed: int) -> Iterator[npt.NDArray[np.floating]]:
    """`count` rows, real ones first, some at a time; the same ones each time."""
    yield from np.array_split(given.real, -(-len(given.real) // _BATCH))
    yield from Distractors(given.parents, layout=Layout(), seed=seed).blocks(count - len(given.real), step=_BATCH)


def make(folder: Path, given: Asked, count: int, *, seed: int) -> None:
    """The index of all rows, in `folder`; what it holds already is passed over."""
    dim = given.real.shape[1]
    with Index.open(folder) if folder.exists() else Index.create(folder, dim=dim, fingerprint="f", model="m") as index:
        held, at = len(index), 0
        for rows in rows_of(given, count, seed=seed) if held < count else ():
            names = [f"{number:032x}" for number in range(at, at + len(rows))]
            if at >= held:
                index.add([Photo(Path("/photos", name)) for name in names], rows, identities=names)
            at += len(rows)
            if at % 50_000 < _BATCH:
                print(f"{at} of {count} photos", flush=True)


class Truth(NamedTuple):
    """What an exact search finds: rows `[Q, k]`, and the share of them that are photos, not distractors."""

    rows: npt.NDArray[np.int64]
    real: float


def truth(index: Path, kept: Path, queries: Half, *, real: int) -> Truth:
    """The best rows of each query by an exact search, kept in a file: it reads everything, which takes a while."""
    if not kept.is_file():
        with Index.open(index, searcher=ExactSearcher) as exact:
            np.save(kept, found(exact, queries))
    rows = np.load(kept)
    return Truth(rows, float((rows[:, :K] < real).mean()))


def found(index: Index, queries: Half) -> npt.NDArray[np.int64]:
    """Rows that a search finds for each query, -1 where there is no more."""
    some = np.array_split(queries, -(-len(queries) // 64))
    hits = [best for part in some for best in index.search(part, k=K, centred=True)]
    return np.array([[match.row for match in best] + [-1] * (K - len(best)) for best in hits])


def alone(index: Path, queries: Half, candidates: int, rounds: int, exact: bool) -> dict[str, float]:
    """Milliseconds a query, asked one by one, and the memory of it; to be called in a process of its own."""
    searcher = ExactSearcher if exact else None
    compressed.CANDIDATES = candidates
    before = peak_memory()
    began = time.perf_counter()
    with Index.open(index, searcher=searcher) as opened:
        ready = time.perf_counter()
        opened.search(queries[:1], k=K, centred=True)
        figures = {"open": 1e3 * (ready - began), "first": 1e3 * (time.perf_counter() - ready)}
        figures["memory, first"] = peak_memory() / 1e6
        for query in queries[:5]:
            opened.search(query, k=K, centred=True)
        taken = []
        for number in range(rounds):
            asked = queries[number % len(queries)]
            begun, spent = time.perf_counter(), time.process_time()
            opened.search(asked, k=K, centred=True)
            taken.append((1e3 * (time.perf_counter() - begun), 1e3 * (time.process_time() - spent)))
    wall, processor = np.array(taken).T
    figures |= {"best": wall.min(), "median": float(np.median(wall)), "processor": float(np.median(processor))}
    return figures | {"memory": peak_memory() / 1e6, "memory before": before / 1e6}


def shown(name: str, recall: str, figures: dict[str, float]) -> str:
    """A line of the table."""
    times = " | ".join(f"{figures[each]:.1f}" for each in ("best", "median", "processor", "first"))
    memory = " | ".join(f"{figures[each]:.0f}" for each in ("memory before", "memory, first", "memory"))
    return f"| {name} | {recall} | {times} | {memory} |"


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--descriptors", type=Path, required=True)
    parser.add_argument("--train", type=Path, default=TRAIN, help="where the training photos lie: whose place is whose")
    parser.add_argument("--photos", type=int, default=1_000_000)
    parser.add_argument("--bytes", type=int, nargs="+", default=[256, 128, 64])
    parser.add_argument("--candidates", type=int, nargs="+", default=[200, compressed.CANDIDATES, 1000])
    parser.add_argument("--evaluation", type=int, default=300, help="evaluation queries asked, evenly spread")
    parser.add_argument("--rounds", type=int, default=40)
    given = parser.parse_args()
    what = asked(given.descriptors, given.train, seed=SEED)
    spread = np.linspace(0, len(what.queries["evaluation"]) - 1, given.evaluation).astype(int)
    queries = {"training": what.queries["training"], "evaluation": what.queries["evaluation"][spread]}
    folder = given.scratch / f"{given.photos}.index"
    print(in_a_line(conditions("numkong", "numpy", seed=SEED, threads=processors(), photos=given.photos)))
    make(folder, what, given.photos, seed=SEED)
    best = {
        kind: truth(folder, given.scratch / f"{given.photos}-{kind}.npy", each, real=len(what.real))
        for kind, each in queries.items()
    }
    photos = ", ".join(f"{100 * each.real:.0f} % for {kind} queries" for kind, each in best.items())
    print(
        f"{len(what.real)} photos, {given.photos - len(what.real)} distractors; of the ten best rows photos are {photos}"
    )
    print(
        "| way | recall@10, training | evaluation | 1 query, ms: best | median | processor | first | MB before | first | all |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for size in given.bytes:
        with Index.open(folder) as index:
            began, spent = time.perf_counter(), time.process_time()
            done = index.compress(size)
            took = f"{time.perf_counter() - began:.0f} s ({time.process_time() - spent:.0f} s of processor)"
            with index._catalog.reading():  # what belongs to the codes besides
                ((blobs,),) = index._catalog.select("SELECT SUM(LENGTH(axes) + LENGTH(middle)) FROM codings")
            total = (index.info().bytes_of_codes + blobs) / 1e6
        if done.written:
            print(
                f"{size} bytes: {done.written} codes in {took}; {total:.1f} MB with all that goes with them", flush=True
            )
        for candidates in given.candidates:
            compressed.CANDIDATES = candidates
            with Index.open(folder) as index:
                recall = " | ".join(f"{reached(found(index, queries[kind]), best[kind]):.4f}" for kind in best)
            figures = in_fresh_process(alone, folder, queries["evaluation"], candidates, given.rounds, False)
            print(shown(f"{size} bytes, {candidates} candidates", recall, figures), flush=True)
    figures = in_fresh_process(alone, folder, queries["evaluation"], 0, 3, True)
    print(shown("exact", "1 | 1", figures), flush=True)


def reached(rows: npt.NDArray[np.int64], best: Truth) -> float:
    """The share of the best rows that are found."""
    return float(np.mean([np.isin(one, other).mean() for one, other in zip(best.rows, rows, strict=True)]))


if __name__ == "__main__":
    main()
