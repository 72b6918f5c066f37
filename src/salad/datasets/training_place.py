"""What training looks at: places, their photos, and which photo of which place a batch shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from salad.errors import BenchmarkError
from salad.geo import GeoPoint, centre

FEWEST = 4  # GSV-Cities' own rule: a place with fewer photos is left out

Say = Callable[[str], None]
"""Takes a sentence for people while work goes on, such as one on photos that are missing and were left out."""


@dataclass(frozen=True, slots=True)
class TrainingPlace:
    """Photos of one place.

    Attributes:
        name: Tells it from the other places of its city.
        city: The set or the city it comes from.
        photos: Oldest first.
        where: The middle of where its photos were taken, as far as that is known.
    """

    name: str
    city: str
    photos: tuple[Path, ...]
    where: GeoPoint | None = None


@dataclass(frozen=True, slots=True)
class View:
    """One photo in a batch.

    Attributes:
        path: The photo.
        label: Which place of the batch it shows.
        mirrored: Whether it is to be mirrored; a mirrored place is a place of its own, mirrored in all its photos.
        place: The place it shows, whose other photos may stand in for one that cannot be read.
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


def clock(time: datetime | None) -> datetime:
    """What to sort by: the time as clocks showed it, since some know their zone and some do not; none comes first."""
    return datetime.min if time is None else time.replace(tzinfo=None)


class PlaceRow(NamedTuple):
    """A photo as a line of a table has it: its file, whether that is there, its place, and by what it is sorted."""

    path: Path
    there: bool
    city: str
    place: str
    where: GeoPoint | None
    age: Any


def places_of(table: Path, rows: Iterable[PlaceRow], say: Say | None) -> list[TrainingPlace]:
    """The places of a table with at least `FEWEST` photos, in the order they come.

    Raises:
        BenchmarkError: If a photo is missing, and `say` is None.
    """
    missing: list[Path] = []
    taken: dict[tuple[str, str], list[PlaceRow]] = {}
    for row in rows:
        if row.there:
            taken.setdefault((row.place, row.city), []).append(row)
        else:
            missing.append(row.path)
    if missing:
        more = f" (nor are {len(missing) - 1} more)" if len(missing) > 1 else ""
        fault = f"{table} names {missing[0].name}, which is not in {missing[0].parent}{more}"
        if say is None:
            raise BenchmarkError(f"{fault}: fetch what is missing, or take its lines out of the table")
        say(f"{fault}: left out")
    places = []
    for place, photos in taken.items():
        if len(photos) >= FEWEST:
            points = [row.where for row in photos if row.where is not None]
            # Where only some photos say where they were taken, the others may be anywhere.
            where = centre(points) if len(points) == len(photos) else None
            oldest_first = tuple(row.path for row in sorted(photos, key=lambda row: row.age))
            places.append(TrainingPlace(*place, oldest_first, where))
    return places
