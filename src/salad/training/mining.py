"""Places that look alike to a model as it stands: batches of them teach it to look closer.

One photo of each place is described and searched for among the others'. The place most like another begins a
clique, and draws in whatever is most like all that is in it already, as long as it is somewhere else on earth.

Source: Izquierdo and Civera, "Close, But Not There: Boosting Geographic Distance Sensitivity in Visual Place
Recognition", ECCV 2024.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from salad.datasets.neighbours import Neighbours
from salad.datasets.training_place import TrainingPlace, View
from salad.images.photo import Photo
from salad.index.index import Index
from salad.models.describer import Describes
from salad.training.batches import ImageCache

_AT_ONCE = 512  # photos read, described and committed together
_BATCH = 32  # of those, how many the model takes at a time
_SPARE = 32  # look-alikes asked for besides those a clique needs: many will be taken

Likeness = list[dict[int, float]]
"""For each place, its look-alikes and their scores."""


def mine(
    model: Describes,
    places: Sequence[TrainingPlace],
    shelf: ImageCache,
    *,
    folder: Path,
    size: int,
    apart_m: float = 100,
) -> list[list[int]]:
    """Cliques of places that look alike, the most alike first; each place is in one at most.

    Args:
        model: what they look alike to.
        places: what is searched; of each its middle photo.
        shelf: where photos come from, squeezed for the model.
        folder: an index is made in it, of as many rows as there are places, and removed in the end.
        size: most places of a clique; some at the end are smaller.
        apart_m: no two places nearer than this are in one clique, where their positions are known.

    Returns:
        Numbers of places, two or more a clique; what is like no other that is left is in none.

    Raises:
        BenchmarkError: no photo of a place can be read.
        StoreError: the folder has no room.
    """
    near = Neighbours([place.where for place in places], apart_m)
    shut = [near.of(number).tolist() for number in range(len(places))]
    k = 1 + max(map(len, shut), default=0) + 4 * size + _SPARE  # itself, those near, and enough besides
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="alike-", dir=folder) as made:
        likeness = _likeness(model, places, shelf, Path(made) / "index", k=k)
    for alike, others in zip(likeness, shut, strict=True):
        for other in others:
            alike.pop(other, None)
    return _cliques(likeness, near, size)


def _likeness(
    model: Describes, places: Sequence[TrainingPlace], shelf: ImageCache, folder: Path, *, k: int
) -> Likeness:
    """The `k` most alike of each place, by an exact search."""
    likeness: Likeness = [{} for _ in places]
    with Index.create(folder, dim=model.dim, fingerprint=model.fingerprint, model=model.name) as index:
        for start in range(0, len(places), _AT_ONCE):
            part = places[start : start + _AT_ONCE]
            numbers = range(start, start + len(part))
            photos = [Photo(folder / str(number)) for number in numbers]  # two places may share a file
            contents = [f"{number:032x}" for number in numbers]
            index.add(photos, _described(model, part, shelf), identities=contents)
        for page in index.pages():
            found = index.search(page.descriptors, k=k)
            for photo, matches in zip(page.photos, found, strict=True):
                others = {
                    int(match.photo.path.name): match.score for match in matches if match.photo != photo
                }
                likeness[int(photo.path.name)] = others
    return likeness


def _described(
    model: Describes, places: Sequence[TrainingPlace], shelf: ImageCache
) -> Float32[np.ndarray, "places dim"]:
    views = [
        View(place.photos[len(place.photos) // 2], label, mirrored=False, place=place)
        for label, place in enumerate(places)
    ]
    pixels = shelf.photos(views).permute(0, 2, 3, 1).numpy()
    return model.describe(list(pixels), batch_size=_BATCH)


def _cliques(likeness: Likeness, near: Neighbours, size: int) -> list[list[int]]:
    """Greedily: whoever is most like another begins; places that were taken are out."""
    order = sorted(
        range(len(likeness)), key=lambda number: (-max(likeness[number].values(), default=-1.0), number)
    )
    free, cliques = set(order), list[list[int]]()
    for first in order:
        if first in free:
            clique = _grown(first, likeness, near, size, free)
            if len(clique) > 1:
                free -= set(clique)
                cliques.append(clique)
    return cliques


def _grown(first: int, likeness: Likeness, near: Neighbours, size: int, free: set[int]) -> list[int]:
    """A clique around a place: again and again the free place that is most like all members together.

    Where a pair's score is not known, since neither is among the other's best, it counts as nothing.
    """
    clique, shut = [first], {first, *near.of(first).tolist()}
    total: dict[int, float] = {}
    while len(clique) < size:
        for other, score in likeness[clique[-1]].items():
            total[other] = total.get(other, 0.0) + score
        open_ = [other for other in total if other in free and other not in shut]
        if not open_:
            return clique
        best = max(open_, key=lambda other: (total[other], -other))
        clique.append(best)
        shut |= {best, *near.of(best).tolist()}
    return clique
