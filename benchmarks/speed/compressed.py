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

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.accuracy.recall import SETS
from benchmarks.options import TRAIN, benchmark_parser
from benchmarks.real_descriptors import Described, Distractors, Half, Layout
from salad.datasets.places import find_places
from salad.images.photo import Photo
from salad.index.index import Index

SEED = 0
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
        for rows in rows_of(given, count, seed=seed):
            names = [f"{number:032x}" for number in range(at, at + len(rows))]
            if at >= held:
                index.add([Photo(Path("/photos", name)) for name in names], rows, identities=names)
            at += len(rows)
            if at % 50_000 < _BATCH:
                print(f"{at} of {count} photos", flush=True)


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--descriptors", type=Path, required=True)
    parser.add_argument("--train", type=Path, default=TRAIN, help="where the training photos lie: whose place is whose")
    parser.add_argument("--photos", type=int, default=1_000_000)
    given = parser.parse_args()
    what = asked(given.descriptors, given.train, seed=SEED)
    print({name: len(rows) for name, rows in what.queries.items()}, len(what.real), len(what.parents))
    make(given.scratch / "million.index", what, given.photos, seed=SEED)


if __name__ == "__main__":
    main()
