"""What the vote makes of its constants: on street photos of places held out of training, never on evaluation photos.

    python benchmarks/vote.py [--data ../shared/data/train] [--city sfxl-240]

The index holds the older half of every place's photos. Queries are the newest photos of the places held out; half
of those places are taken out of the index, so that their queries have no answer and should get none.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from aggregator import machine

import salad
from salad.data.places import TrainingPlace, find_places, split
from salad.geo import metres_between
from salad.index import Match
from salad.photos import Photo
from salad.place.voting import vote

ROOT = Path(__file__).resolve().parents[1]
SEED, NEWEST, K = 0, 3, 5
SHARPNESS, MIN_SHARE, MIN_SCORE = (10, 20, 40), (0.3, 0.4, 0.5), (0.25, 0.3, 0.35, 0.4)


def where(path: Path) -> salad.GeoPoint:
    """The position in a GSV-Cities name."""
    lat, lon = path.stem.split("_")[5:7]
    return salad.GeoPoint(float(lat), float(lon))


def matched(
    model: salad.Describer, learnt: Sequence[TrainingPlace], apart: Sequence[TrainingPlace]
) -> list[tuple[Path, bool, list[Match]]]:
    """Each query with whether it can be answered, and its matches."""
    known, unknown = apart[::2], apart[1::2]
    old = [path for place in (*learnt, *known) for path in place.photos[: len(place.photos) // 2]]
    new = [
        (path, here)
        for places, here in ((known, True), (unknown, False))
        for p in places
        for path in p.photos[-NEWEST:]
    ]
    with tempfile.TemporaryDirectory() as folder:
        made = salad.Index.create(
            Path(folder) / "i", dim=model.dim, fingerprint=model.fingerprint, model=model.name
        )
        with made as index:
            index.add([Photo(path, where(path)) for path in old], model.describe(old))
            found = index.search(model.describe([path for path, _ in new]), k=K)
    return [(path, here, matches) for (path, here), matches in zip(new, found, strict=True)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data" / "train")
    parser.add_argument("--city", default="sfxl-240", help="a set in GSV-Cities' layout, for its positions")
    asked = parser.parse_args()
    model = salad.load("salad-lite")
    sides = split(find_places(asked.data), held_out=0.2, seed=SEED)  # just as salad-lite was trained
    learnt, apart = ([place for place in side if place.city.startswith(asked.city)] for side in sides)
    queries = matched(model, learnt, apart)
    can = [query for query in queries if query[1]]
    print(
        f"{machine()}, {datetime.date.today()}, seed {SEED}: {len(can)} queries with an answer, "
        f"{len(queries) - len(can)} without"
    )
    print("sharpness min_share min_score | answered  right of these | answered without an answer there")
    for sharpness, min_share, min_score in itertools.product(SHARPNESS, MIN_SHARE, MIN_SCORE):
        voting = partial(vote, sharpness=sharpness, min_share=min_share, min_score=min_score)
        places = [(path, here, voting(matches)) for path, here, matches in queries]
        answered = [(path, place) for path, here, place in places if here and place]
        right = [metres_between(place.where, where(path)) <= 25 for path, place in answered]
        false = np.mean([place is not None for _, here, place in places if not here])
        print(
            f"{sharpness:9} {min_share:9} {min_score:9} | {100 * len(answered) / len(can):6.1f} %  "
            f"{100 * np.mean(right):12.1f} % | {100 * false:6.1f} %"
        )


if __name__ == "__main__":
    main()
