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

from salad.datasets.neighbours import Neighbours
from salad.datasets.training_place import TrainingPlace, View
from salad.index.vectors import FileRows, append, storable
from salad.models.describer import DescriberLike
from salad.search.base import SearcherFactory
from salad.search.exact import ExactSearcher
from salad.training.batches import ImageCache

_AT_ONCE = 512  # photos read, described and written together
_BATCH = 32  # of those, how many the model takes at a time
_ASKED = 1 << 22  # numbers of places that are searched for together
_SPARE = 32  # look-alikes asked for besides those a clique needs: many will be taken

Likeness = list[dict[int, float]]
"""For each place, its look-alikes and their scores."""


def mine(
    model: DescriberLike,
    places: Sequence[TrainingPlace],
    images: ImageCache,
    *,
    folder: Path,
    size: int,
    apart_m: float = 100,
    searcher: SearcherFactory = ExactSearcher,
) -> list[list[int]]:
    """Cliques of places that look alike, the most alike first; each place is in one at most.

    Args:
        model: what they look alike to.
        places: what is searched; of each its middle photo.
        images: where photos come from, squeezed for the model.
        folder: a file is made in it, of a descriptor for each place, and removed in the end.
        size: most places of a clique; some at the end are smaller.
        apart_m: no two places nearer than this are in one clique, where their positions are known.
        searcher: what finds the look-alikes of a place.

    Returns:
        Numbers of places, two or more a clique; what is like no other that is left is in none.

    Raises:
        BenchmarkError: If no photo of a place can be read.
        StoreError: If the folder has no room.
    """
    near = Neighbours([place.where for place in places], apart_m)
    nearby = [near.of(number).tolist() for number in range(len(places))]
    k = 1 + max(map(len, nearby), default=0) + 4 * size + _SPARE  # itself, those near, and enough besides
    likeness: Likeness = []
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="alike-", dir=folder) as made:
        rows = _described(model, places, images, Path(made) / "descriptors.f16")
        search = searcher(rows)
        for start, block in rows.blocks(numbers=_ASKED):
            rows.keep()  # they are swept once for each block
            hits = search.search(block, k=k)
            found = zip(hits.rows.tolist(), hits.scores.tolist(), strict=True)
            for number, (others, scores) in enumerate(found, start):
                # The same street from a few steps on looks alike too, and is no mistake; -1 is no row at all.
                barred = {number, -1, *nearby[number]}
                alike = zip(others, scores, strict=True)
                likeness.append({other: score for other, score in alike if other not in barred})
        rows.close()
    return greedy_cliques(likeness, near, size)


def _described(model: DescriberLike, places: Sequence[TrainingPlace], images: ImageCache, path: Path) -> FileRows:
    """Describe the middle photo of each place, into a file: descriptors of all may be more than memory holds."""
    path.touch()
    for start in range(0, len(places), _AT_ONCE):
        part = places[start : start + _AT_ONCE]
        views = [
            View(place.photos[len(place.photos) // 2], label, mirrored=False, place=place)
            for label, place in enumerate(part)
        ]
        pixels = images.photos(views).permute(0, 2, 3, 1).numpy()
        found = model.describe(list(pixels), batch_size=_BATCH)
        append(path, storable(found, len(part), model.dim), at=start)
    return FileRows(path, rows=len(places), dim=model.dim)


def greedy_cliques(likeness: Likeness, near: Neighbours, size: int) -> list[list[int]]:
    """Whoever is most like another begins, and draws in who is most like all that are in already.

    Args:
        likeness: of each place, its look-alikes; none of them near it.
        near: who is near whom.
        size: most places of a clique.
    """
    order = sorted(range(len(likeness)), key=lambda number: (-max(likeness[number].values(), default=-1.0), number))
    free, cliques = set(order), list[list[int]]()
    for first in order:
        if first not in free:
            continue
        clique, total = [first], dict[int, float]()
        barred = {first, *near.of(first).tolist()}
        while len(clique) < size:
            # Where a pair's score is not known, since neither is among the other's best, it counts as nothing.
            for other, score in likeness[clique[-1]].items():
                total[other] = total.get(other, 0.0) + score
            candidates = [other for other in total if other in free and other not in barred]
            if not candidates:
                break
            best = max(candidates, key=lambda other: (total[other], -other))
            clique.append(best)
            barred |= {best, *near.of(best).tolist()}
        if len(clique) > 1:
            free -= set(clique)
            cliques.append(clique)
    return cliques
