"""A million photos of 8,448 numbers: how large their codes are, how long a query takes, how much of it they find.

    python -m benchmarks.accuracy.real_descriptors DESCRIPTORS
    python -m benchmarks.speed.compressed SCRATCH --descriptors DESCRIPTORS [--photos 1000000] [--bytes 256 128 64]

makes an index in the folder SCRATCH (17 GB for a million; what was begun is gone on with; delete it afterwards), of all
references of the evaluation sets, the training photos, crops, and distractors made of those (`real_descriptors`).
Two kinds of queries are asked: photos of 150 training places, of which nothing else was made, by which the number of
candidates was chosen; and those of the evaluation sets, by which nothing was.

Recall@10 is the share of the ten best rows of an exact search that the codes find too, with centred scores, as `salad
locate` asks. Times are those of `one_query`, in a process that holds nothing else; the files are in the system's
memory as far as it has room for them.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.accuracy.real_descriptors import Described, Distractors, Half, Layout
from benchmarks.accuracy.recall import SETS
from benchmarks.machine import conditions, in_a_line
from benchmarks.options import TRAIN, benchmark_parser
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


def truth(index: Path, kept: Path, queries: Half) -> npt.NDArray[np.int64]:
    """The best rows of each query by an exact search; kept in a file, since to read everything takes a while."""
    if not kept.is_file():
        with Index.open(index, searcher=ExactSearcher) as exact:
            np.save(kept, found(exact, queries))
    rows: npt.NDArray[np.int64] = np.load(kept)
    return rows


def found(index: Index, queries: Half) -> npt.NDArray[np.int64]:
    """The rows that a search finds for each query: `[Q, K]`."""
    return np.array([[match.row for match in best] for best in index.search(queries, k=K, centred=True)])


def alone(index: Path, queries: Path, candidates: int, rounds: int) -> dict[str, float]:
    """What `one_query` says."""
    options = ["--candidates", str(candidates), "--rounds", str(rounds)]
    command = [sys.executable, "-m", "benchmarks.speed.one_query", str(index), str(queries), *options]
    said: dict[str, float] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return said


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
    parser.add_argument("--queries", type=int, default=300, help="of each kind, evenly spread")
    parser.add_argument("--rounds", type=int, default=100)
    given = parser.parse_args()
    what = asked(given.descriptors, given.train, seed=SEED)
    queries = np.concatenate(
        [rows[np.linspace(0, len(rows) - 1, given.queries).astype(int)] for rows in what.queries.values()]
    )
    kinds = {name: slice(n * given.queries, (n + 1) * given.queries) for n, name in enumerate(what.queries)}
    folder, saved = given.scratch / f"{given.photos}.index", given.scratch / "queries.npy"
    given.scratch.mkdir(parents=True, exist_ok=True)
    np.save(saved, queries)
    print(in_a_line(conditions("numkong", "numpy", seed=SEED, threads=processors(), photos=given.photos)), flush=True)
    make(folder, what, given.photos, seed=SEED)
    best = truth(folder, given.scratch / f"{given.photos}-{given.queries}.npy", queries)
    photos = ", ".join(f"{100 * (best[those] < len(what.real)).mean():.0f} % ({kind})" for kind, those in kinds.items())
    others = given.photos - len(what.real)
    print(f"{len(what.real)} photos, {others} distractors; {given.queries} queries of each kind; "
          f"of their ten best rows photos are {photos}")  # fmt: skip
    heads = ["way", *(f"recall@10, {kind}" for kind in kinds), "ms: best", "median", "processor", "first"]
    print("| " + " | ".join([*heads, "MB before", "first", "all"]) + " |\n" + "|---" * 9 + "|", flush=True)
    for size in given.bytes:
        with Index.open(folder) as index:
            began, spent = time.perf_counter(), time.process_time()
            done = index.compress(size)
            took = f"{time.perf_counter() - began:.0f} s ({time.process_time() - spent:.0f} s of processor)"
            total = (done.rows * size + coding_bytes(size, index.dim)) / 1e6
        if done.written:
            print(f"{size} bytes: {done.written} codes in {took}; {total:.1f} MB with how they are coded", flush=True)
        for candidates in given.candidates:
            compressed.CANDIDATES = candidates
            with Index.open(folder) as index:
                same = (found(index, queries)[:, None] == best[:, :, None]).any(axis=2)
            figures = alone(folder, saved, candidates, given.rounds)
            recall = " | ".join(f"{same[those].mean():.4f}" for those in kinds.values())
            print(shown(f"{size} bytes, {candidates} candidates", recall, figures), flush=True)
    figures = alone(folder, saved, 0, 3)
    print(shown("exact", " | ".join("1" for _ in kinds), figures), flush=True)


def coding_bytes(size: int, dim: int) -> int:
    """What is kept besides the codes themselves: directions in half precision, and where the mean lies."""
    return size * dim * 2 + size * 4


if __name__ == "__main__":
    main()
