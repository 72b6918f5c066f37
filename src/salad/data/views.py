"""What training looks at: places, their photos, and which photo of which place a batch shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from salad.geo import GeoPoint

FEWEST = 4  # GSV-Cities' own rule: a place with fewer photos is left out

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class TrainingPlace:
    """Photos of one place.

    Args:
        name: tells it from the other places of its city.
        city: the set or the city it comes from.
        photos: oldest first.
        where: the middle of where its photos were taken, as far as that is known.
    """

    name: str
    city: str
    photos: tuple[Path, ...]
    where: GeoPoint | None = None


@dataclass(frozen=True, slots=True)
class View:
    """One photo in a batch.

    Args:
        path: the photo.
        label: which place of the batch it shows.
        mirrored: whether it is to be mirrored; a mirrored place is a place of its own, mirrored in all its photos.
        place: the place it shows, whose other photos may stand in for one that cannot be read.
    """

    path: Path
    label: int
    mirrored: bool
    place: TrainingPlace


def by_city(places: Sequence[TrainingPlace]) -> dict[str, list[int]]:
    """The numbers of each city's places, cities in the order they come."""
    cities: dict[str, list[int]] = {}
    for number, place in enumerate(places):
        cities.setdefault(place.city, []).append(number)
    return cities
