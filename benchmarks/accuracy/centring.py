r"""What it is worth to leave out of scores what all photos of an index have in common, and how much of it to leave out.

    python -m benchmarks.accuracy.centring [MODEL ...] [--data ../shared/data/train]
    python -m benchmarks.accuracy.centring runs/heads/amos-15-vcl-10/lite2-128x64-lite-mixed-4-0/model \
        --sets amos-15 vcl-10

Each set of training photos is an index of its own: the newest photos of every place that was held out of the training
are the queries, all other photos of these places the index. With `--sets` all places of these sets take part instead,
for a model that learnt without them (`heads.py` makes such). Mean average precision in percent, by the share
of the index's mean that queries are moved by; `cosine` is that of descriptors with the mean taken from both sides. No
evaluation photo takes part.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from benchmarks.options import SHIPPED, TRAIN, benchmark_parser
from salad.datasets.places import find_places
from salad.datasets.training_place import TrainingPlace
from salad.models.model_folder import load
from salad.search.hubness import SHARE
from salad.training.recipe import PRESETS
from salad.training.validation import QUERIES, average_precision

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
Rows = npt.NDArray[np.float32]


def precision(queries: Rows, index: Rows, right: npt.NDArray[np.bool_]) -> float:
    """Mean average precision in percent; `right` is `[queries, index]`."""
    order = np.argsort(-(queries @ index.T), axis=1, kind="stable")
    ranked = np.take_along_axis(right, order, axis=1)
    return 100 * float(np.mean([average_precision(each) for each in ranked]))


def figures(described: Rows, shows: npt.NDArray[np.int64], asked: npt.NDArray[np.bool_]) -> Iterator[float]:
    """Precision by share, and that of the cosine."""
    queries, index = described[asked], described[~asked]
    right = shows[asked][:, None] == shows[~asked]
    mean = index.mean(axis=0)
    for share in SHARES:
        yield precision(queries - share * mean, index, right)
    yield precision(*(unit(rows - mean) for rows in (queries, index)), right)


def unit(rows: Rows) -> Rows:
    """The same of length 1."""
    made: Rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return made


def newest(place: TrainingPlace) -> list[bool]:
    """Which of a place's photos are queries; some of them always remain for the index."""
    count = len(place.photos)
    return [number >= count - min(QUERIES, count // 2) for number in range(count)]


def measured(name: str, places: Sequence[TrainingPlace]) -> None:
    """Print a line for each set and their mean."""
    model, rows = load(name), []
    print(f"{name} {model.fingerprint}: " + " | ".join((*map(str, SHARES), "cosine")))
    for city in sorted({place.city for place in places}):
        those = [place for place in places if place.city == city]
        described = model.describe([photo for place in those for photo in place.photos], batch_size=32)
        shows = np.array([number for number, place in enumerate(those) for _ in place.photos])
        rows.append(list(figures(described, shows, np.concatenate([newest(place) for place in those]))))
        print(f"  {city}: " + " | ".join(f"{each:.1f}" for each in rows[-1]), flush=True)
    print("  mean: " + " | ".join(f"{each:.1f}" for each in np.mean(rows, axis=0)), flush=True)


def main() -> None:
    parser = benchmark_parser(__doc__, data=TRAIN, models=SHIPPED)
    parser.add_argument("--sets", nargs="+", metavar="SET", help="how the names of sets begin that it never saw")
    asked = parser.parse_args()
    places, recipe = find_places(asked.data), PRESETS["salad-lite"].recipe
    if asked.sets:
        places = [place for place in places if place.city.startswith(tuple(asked.sets))]
    else:
        _, places = recipe.split(places)
    print(f"mean average precision by share of the mean; {SHARE} is what salad uses")
    for name in asked.models:
        measured(name, places)


if __name__ == "__main__":
    main()
