"""Places to learn from, several photos of each, wherever they stand on disk.

Four layouts are read: GSV-Cities (tables beside photos), a table that `salad places` wrote, one folder a place,
and a folder of such sets. Photos of a place stand oldest first; in a folder their names must sort by time, as
the names of webcams and of numbered sessions do. No photo is opened.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from salad.data import placestable
from salad.data.gsv_cities import is_gsv_cities, read_gsv_cities
from salad.data.views import FEWEST, Say, TrainingPlace, View, by_city
from salad.errors import BenchmarkError
from salad.photos import SUFFIXES

__all__ = ["FEWEST", "TrainingPlace", "View", "find_places", "split"]


def find_places(root: Path, *, say: Say | None = None) -> list[TrainingPlace]:
    """Every place under `root`: itself one set or a table of places, or a folder of sets.

    Args:
        root: the folder or the table.
        say: takes a sentence for each table that names photos which are not there; they are then left out.
            Where nobody listens, a missing photo is an error.

    Raises:
        BenchmarkError: there is no place with enough photos, a table cannot be read, or photos are missing.
    """
    if root.is_file():
        places = placestable.read_places(root, say=say)
    elif root.is_dir():
        places = _places(root, say)
    else:
        raise BenchmarkError(f"there is no folder {root} to train from")
    if not places:
        raise BenchmarkError(
            f"{root} holds no place to learn from: expected GSV-Cities' Dataframes/ and Images/, a {placestable.NAME} "
            f"as 'salad places' writes it, or one folder of at least {FEWEST} photos a place"
        )
    return places


def split(
    places: Sequence[TrainingPlace], *, held_out: float, seed: int
) -> tuple[list[TrainingPlace], list[TrainingPlace]]:
    """Set a share of every city's places apart, for choosing between models."""
    chance = np.random.default_rng(seed)
    learn: list[TrainingPlace] = []
    choose: list[TrainingPlace] = []
    for city in by_city(places).values():
        apart = set(chance.permutation(len(city))[: round(held_out * len(city))].tolist())
        for number, place in enumerate(city):
            (choose if number in apart else learn).append(places[place])
    return learn, choose


def _places(root: Path, say: Say | None) -> list[TrainingPlace]:
    if is_gsv_cities(root):
        return read_gsv_cities(root, say=say)
    if (root / placestable.NAME).is_file():
        return placestable.read_places(root / placestable.NAME, say=say)
    children = sorted(child for child in root.iterdir() if child.is_dir())
    sets = any(is_gsv_cities(child) or (child / placestable.NAME).is_file() for child in children)
    if not sets and any(_photos(child) for child in children):
        return _folders(root, children)
    return [place for child in children for place in _places(child, say)]


def _photos(folder: Path) -> tuple[Path, ...]:
    files = (path for path in folder.iterdir() if not path.name.startswith("."))
    return tuple(sorted(path for path in files if path.suffix.lower() in SUFFIXES))


def _folders(root: Path, children: Sequence[Path]) -> list[TrainingPlace]:
    found = [TrainingPlace(child.name, root.name, _photos(child)) for child in children]
    return [place for place in found if len(place.photos) >= FEWEST]
