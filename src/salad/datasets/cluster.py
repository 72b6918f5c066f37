"""Places from any photos that know where they were taken: what was taken in one spot, looking one way, is a place.

The earth is cut into squares, and each square by the way a camera looked. What falls together is a cell; a cell
with enough photos is a place. Of places too near to one another the one with more photos stays, so that no two
places show the same thing under two names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from salad.datasets.neighbours import Neighbours, squares
from salad.datasets.training_place import FEWEST, TrainingPlace, clock
from salad.errors import BenchmarkError
from salad.geo import GeoPoint, centre, in_degrees
from salad.images.photo import Photo

Reason = Literal["no position", "unreadable", "too few in their cell", "too near another place"]
Unreadable = Callable[[Sequence[Path]], Mapping[Path, str]]

_CITY_M = 10_000.0  # places of one city hang together by steps of at most about this


@dataclass(frozen=True, slots=True)
class Cell:
    """A place with all that is known of its photos.

    Attributes:
        name: Where it is, to 10 cm, and which way it looks, in degrees from north, or `any`.
        city: About where its city is; places that hang together by steps of 10 km or so are of one city.
        photos: Oldest first.
        where: The middle of where they were taken.
    """

    name: str
    city: str
    photos: tuple[Photo, ...]
    where: GeoPoint

    @property
    def place(self) -> TrainingPlace:
        """This place, as training takes it."""
        return TrainingPlace(self.name, self.city, tuple(photo.path for photo in self.photos), self.where)


@dataclass(frozen=True, slots=True)
class Clustering:
    """What became of photos.

    Attributes:
        places: In order from south to north, then from west to east.
        left_out: The photos that are in none of them, by reason; every reason is there.
        trouble: A sentence for each photo that cannot be read.
    """

    places: tuple[Cell, ...]
    left_out: dict[Reason, tuple[Path, ...]]
    trouble: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """What became of photos, in numbers, as JSON holds it."""
        used = sum(len(place.photos) for place in self.places)
        left_out = {reason: len(paths) for reason, paths in self.left_out.items()}
        return {
            "photos": used + sum(left_out.values()),
            "used": used,
            "places": len(self.places),
            "cities": len({place.city for place in self.places}),
            "left_out": left_out,
        }


def find_cells(
    photos: Sequence[Photo],
    *,
    side_m: float = 10.0,
    turn: float = 45.0,
    fewest: int = FEWEST,
    apart_m: float = 100.0,
    unreadable: Unreadable | None = None,
) -> Clustering:
    """The places that photos show.

    Args:
        photos: Each once; those without a heading make cells of their own.
        side_m: Metres along a side of a square.
        turn: Degrees of the compass that count as looking the same way; 360 for no matter.
        fewest: Photos of a place, at least; not below `FEWEST`, for training would leave them out.
        apart_m: Metres between two places, at least; 0 keeps all of them, for a sampler that keeps the distance.
        unreadable: Which of the photos that would be used cannot be read, with a sentence for each; all are trusted
            where it is not given.

    Raises:
        BenchmarkError: If a number makes no sense.
    """
    for what, value, sound in (
        ("a square's side in metres", side_m, 1 <= side_m <= 1e5),
        ("a turn in degrees", turn, 1 <= turn <= 360),
        ("the fewest photos of a place", fewest, fewest >= FEWEST),
        ("metres between places", apart_m, 0 <= apart_m <= 1e5),
    ):
        if not sound:
            raise BenchmarkError(f"{value:g} makes no sense for {what}: see 'salad places --help'")
    cells, few = _enough(_cells(photos, side_m, turn), fewest)
    # Opening photos takes the time here, so that only those are opened whose cell would be a place.
    bad = unreadable([photo.path for cell in cells.values() for photo in cell]) if unreadable else {}
    readable = {key: [photo for photo in cell if photo.path not in bad] for key, cell in cells.items()}
    cells, fewer = _enough(readable, fewest)
    middles = [centre([photo.where for photo in cell if photo.where is not None]) for cell in cells.values()]
    places = [
        # Six digits are 10 cm: no two cells are so near to each other, but for those that look another way.
        Cell(f"{middle.lat:.6f}_{middle.lon:.6f}_{way}", city, tuple(cell), middle)
        for ((_, _, way), cell), middle, city in zip(cells.items(), middles, _cities(middles), strict=True)
    ]
    # Of places too near to one another the one with more photos stays.
    near = Neighbours(middles, apart_m)
    kept: set[int] = set()
    for number in sorted(range(len(places)), key=lambda number: -len(places[number].photos)):
        if kept.isdisjoint(near.of(number).tolist()):
            kept.add(number)
    thinned = [photo.path for number, place in enumerate(places) if number not in kept for photo in place.photos]
    return Clustering(
        tuple(place for number, place in enumerate(places) if number in kept),
        {
            "no position": tuple(photo.path for photo in photos if photo.where is None),
            "unreadable": tuple(bad),
            "too few in their cell": tuple(few + fewer),
            "too near another place": tuple(thinned),
        },
        tuple(bad.values()),
    )


Key = tuple[int, int, str]  # row and column of the square, and the way its photos look


def _cells(photos: Sequence[Photo], side_m: float, turn: float) -> dict[Key, list[Photo]]:
    """Photos by where they were taken and which way they look, cells in order, photos oldest first."""
    placed = [photo for photo in photos if photo.where is not None]
    rows, columns = squares(in_degrees(photo.where for photo in placed), side_m)
    cells: dict[Key, list[Photo]] = {}
    for photo, row, column in zip(placed, rows.tolist(), columns.tolist(), strict=True):
        cells.setdefault((row, column, _way(photo.heading, turn)), []).append(photo)
    # In order, whatever the order of the photos: the same photos give the same table.
    return {key: sorted(cells[key], key=lambda photo: (clock(photo.time), photo.path)) for key in sorted(cells)}


def _way(heading: float | None, turn: float) -> str:
    """The middle of the part of the compass that a heading is in; the first part's middle is north."""
    parts = round(360 / turn)  # whole parts, so that the compass closes without a rest
    if heading is None or parts <= 1:
        return "any"
    part = round(heading / 360 * parts) % parts
    return f"{round(part * 360 / parts) % 360:03d}"


def _enough(cells: Mapping[Key, list[Photo]], fewest: int) -> tuple[dict[Key, list[Photo]], list[Path]]:
    """The cells that have enough photos, and the photos of all others."""
    kept = {key: cell for key, cell in cells.items() if len(cell) >= fewest}
    return kept, [photo.path for key, cell in cells.items() if key not in kept for photo in cell]


def _cities(points: Sequence[GeoPoint]) -> list[str]:
    """A city's name for each point: latitude and longitude of the middle of its southernmost part."""
    # Imported here, as in `neighbours`.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Parts of cities first, squares of 10 km: there are few of them however many points there are.
    parts: dict[tuple[int, int], list[int]] = {}
    rows, columns = squares(in_degrees(points), _CITY_M)
    for number, square in enumerate(zip(rows.tolist(), columns.tolist(), strict=True)):
        parts.setdefault(square, []).append(number)
    members = [parts[square] for square in sorted(parts)]
    middles = [centre([points[number] for number in part]) for part in members]
    near = Neighbours(middles, 1.5 * _CITY_M)
    pairs = np.array([(part, other) for part in range(len(members)) for other in near.of(part)], dtype=np.int64)
    one, other = pairs.reshape(-1, 2).T
    steps = coo_array((np.ones(len(one)), (one, other)), shape=(len(members), len(members)))
    _, city_of = connected_components(steps, directed=False)
    _, southernmost = np.unique(city_of, return_index=True)
    names = [""] * len(points)
    for part, city in zip(members, city_of.tolist(), strict=True):
        first = middles[southernmost[city]]
        for number in part:
            names[number] = f"{first.lat:.2f}_{first.lon:.2f}"
    return names
