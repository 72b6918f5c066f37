"""Places to learn from: several photos of each, and batches of them.

Two layouts are read: GSV-Cities (tables beside photos) and one folder a place. Photos of a place stand oldest
first; in a folder their names must sort by time, as the names of webcams and of numbered sessions do.
"""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salad.errors import BenchmarkError
from salad.photos import SUFFIXES

FEWEST = 4  # GSV-Cities' own rule: a place with fewer photos is left out


@dataclass(frozen=True, slots=True)
class TrainingPlace:
    """Photos of one place, oldest first; `city` is the set it comes from."""

    name: str
    city: str
    photos: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class View:
    """One photo in a batch.

    Args:
        path: the photo.
        label: which place of the batch it shows.
        mirrored: whether it is to be mirrored; a mirrored place is a place of its own, mirrored in all its photos.
    """

    path: Path
    label: int
    mirrored: bool


def find_places(root: Path) -> list[TrainingPlace]:
    """Every place under `root`: itself one set, or a folder of sets.

    Raises:
        BenchmarkError: there is no place with enough photos, or a table names a photo that is not there.
    """
    if not root.is_dir():
        raise BenchmarkError(f"there is no folder {root} to train from")
    places = _places(root)
    if not places:
        raise BenchmarkError(
            f"{root} holds no place to learn from: expected GSV-Cities' Dataframes/ and Images/, or one folder of "
            f"at least {FEWEST} photos a place"
        )
    return places


def split(
    places: Sequence[TrainingPlace], *, held_out: float, seed: int
) -> tuple[list[TrainingPlace], list[TrainingPlace]]:
    """Set a share of every city's places apart, for choosing between models."""
    chance = np.random.default_rng(seed)
    learn: list[TrainingPlace] = []
    choose: list[TrainingPlace] = []
    for city in _cities(places).values():
        apart = set(chance.permutation(len(city))[: round(held_out * len(city))].tolist())
        for number, place in enumerate(city):
            (choose if number in apart else learn).append(place)
    return learn, choose


def batches(
    places: Sequence[TrainingPlace], *, per_batch: int, views: int, seed: int, start: int = 0
) -> Iterator[list[View]]:
    """Batches without end; a city takes part in each by the square root of its size.

    The n-th batch depends on `seed` and n alone, so a run that goes on from `start` sees what it would have seen.

    Raises:
        BenchmarkError: there are fewer places than a batch needs.
    """
    if len(places) < per_batch:
        raise BenchmarkError(f"a batch needs {per_batch} places, but there are {len(places)}")
    cities = list(_cities(places).values())
    shares = np.sqrt([len(city) for city in cities])
    chances = np.concatenate(
        [np.full(len(c), s / len(c)) for c, s in zip(cities, shares / shares.sum(), strict=True)]
    )
    everyone = [place for city in cities for place in city]
    number = start
    while True:
        chance = np.random.default_rng((seed, number))
        chosen = chance.choice(len(everyone), size=per_batch, replace=False, p=chances)
        yield [
            View(everyone[index].photos[photo], label, mirrored)
            for label, index in enumerate(chosen)
            for mirrored in [bool(chance.random() < 0.5)]
            for photo in _some(chance, len(everyone[index].photos), views)
        ]
        number += 1


def _some(chance: np.random.Generator, photos: int, views: int) -> list[int]:
    rounds = math.ceil(views / photos)  # a place with too few photos shows some of them twice
    return np.concatenate([chance.permutation(photos) for _ in range(rounds)])[:views].tolist()  # type: ignore[no-any-return]  # list of int


def _places(root: Path) -> list[TrainingPlace]:
    if (root / "Dataframes").is_dir():
        return _gsv_cities(root)
    children = sorted(child for child in root.iterdir() if child.is_dir())
    if any(_photos(child) for child in children):
        return _folders(root, children)
    return [place for child in children for place in _places(child)]


def _cities(places: Sequence[TrainingPlace]) -> dict[str, list[TrainingPlace]]:
    cities: dict[str, list[TrainingPlace]] = defaultdict(list)
    for place in places:
        cities[place.city].append(place)
    return cities


def _photos(folder: Path) -> tuple[Path, ...]:
    files = (path for path in folder.iterdir() if not path.name.startswith("."))
    return tuple(sorted(path for path in files if path.suffix.lower() in SUFFIXES))


def _folders(root: Path, children: Sequence[Path]) -> list[TrainingPlace]:
    found = [TrainingPlace(child.name, root.name, _photos(child)) for child in children]
    return [place for place in found if len(place.photos) >= FEWEST]


def _gsv_cities(root: Path) -> list[TrainingPlace]:
    places: list[TrainingPlace] = []
    for table in sorted((root / "Dataframes").glob("*.csv")):
        taken: dict[str, list[tuple[str, Path]]] = defaultdict(list)
        with table.open(newline="", encoding="utf-8") as lines:
            for number, row in enumerate(csv.DictReader(lines), start=2):
                try:
                    taken[row["place_id"]].append(
                        (f"{int(row['year']):04d}{int(row['month']):02d}", _gsv_photo(root, table, row))
                    )
                except (KeyError, TypeError, ValueError) as error:
                    raise BenchmarkError(f"{table}, line {number}: cannot be read ({error!r})") from error
        for name, dated in taken.items():
            if len(dated) >= FEWEST:
                places.append(
                    TrainingPlace(name, f"{root.name}/{table.stem}", tuple(p for _, p in sorted(dated)))
                )
    return places


def _gsv_photo(root: Path, table: Path, row: dict[str, str]) -> Path:
    # lat and lon stand in the name exactly as in the table, so they are never parsed
    name = (
        f"{row['city_id']}_{int(row['place_id']):07d}_{int(row['year']):04d}_{int(row['month']):02d}_"
        f"{int(row['northdeg']):03d}_{row['lat']}_{row['lon']}_{row['panoid']}"
    )
    for suffix in (".jpg", ".JPG"):
        path = root / "Images" / table.stem / f"{name}{suffix}"
        if path.is_file():
            return path
    raise BenchmarkError(f"{table} names {name}.jpg, which is not in {root / 'Images' / table.stem}")
