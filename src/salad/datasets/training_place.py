"""What training looks at: places, their photos, and which photo of which place a batch shows."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from salad.errors import BenchmarkError
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


# --- Which of the photos that a table names are there: one look at a folder, not one at each of its photos ---


class Listing:
    """The names in folders, each folder listed once, when it is first asked for."""

    def __init__(self) -> None:
        self._names: dict[Path, frozenset[str]] = {}

    def __contains__(self, path: Path) -> bool:
        return path.name in self.names(path.parent)

    def names(self, folder: Path) -> frozenset[str]:
        """What a folder holds; nothing where there is no such folder."""
        if folder not in self._names:
            try:
                self._names[folder] = frozenset(os.listdir(folder))  # noqa: PTH208  # names, not a Path for each
            except OSError:
                self._names[folder] = frozenset()
        return self._names[folder]


def tell_missing(table: Path, missing: list[Path], say: Say | None) -> None:
    """Say that a table names photos in vain, in one sentence; where nobody listens, refuse.

    Raises:
        BenchmarkError: some are missing and `say` is None.
    """
    if not missing:
        return
    more = f" (nor are {len(missing) - 1} more)" if len(missing) > 1 else ""
    fault = f"{table} names {missing[0].name}, which is not in {missing[0].parent}{more}"
    if say is None:
        raise BenchmarkError(f"{fault}: fetch what is missing, or take its lines out of the table")
    say(f"{fault}: left out")
