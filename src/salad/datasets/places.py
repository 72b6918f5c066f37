"""Places to learn from, several photos of each, wherever they stand on disk.

Four layouts are read: GSV-Cities (tables beside photos), a table that `salad places` wrote, one folder a place,
and a folder of such sets. Photos of a place stand oldest first; in a folder their names must sort by time, as
the names of webcams and of numbered sessions do. No photo is opened.

The table is CSV that anybody can edit: one line a photo, with the columns `path,place,city,lat,lon,heading,time`; a
path is seen from the table's folder. Only `path` and `place` must be there. With `lat` and `lon` it is a table of
photos too, for `salad index --table`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from functools import cache
from pathlib import Path

import numpy as np

from salad.datasets.cluster import Cell
from salad.datasets.folders import names_in
from salad.datasets.readers.gsv_cities import is_gsv_cities, read_gsv_cities
from salad.datasets.training_place import FEWEST, PlaceRow, Say, TrainingPlace, by_city, clock, places_of
from salad.errors import BenchmarkError, PositionError
from salad.files import write_whole
from salad.geo import GeoPoint
from salad.images.finding import SUFFIXES
from salad.tables import CsvError, csv_line, number, read_csv

PLACES_TABLE = "places.csv"
"""What such a table is called in a folder of sets."""
COLUMNS = ("path", "place", "city", "lat", "lon", "heading", "time")


def find_places(root: Path, *, say: Say | None = None) -> list[TrainingPlace]:
    """Every place under `root`: itself one set or a table of places, or a folder of sets.

    Args:
        root: The folder or the table.
        say: Told of each table that names photos which are not there; without it a missing photo is an error.

    Raises:
        BenchmarkError: If there is no place with enough photos, a table cannot be read, or photos are missing.
    """
    if root.is_file():
        places = places_of(root, _rows(root), say)
    elif root.is_dir():
        places = _places(root, say)
    else:
        raise BenchmarkError(f"there is no folder {root} to train from")
    if not places:
        raise BenchmarkError(
            f"{root} holds no place to learn from: expected GSV-Cities' Dataframes/ and Images/, a {PLACES_TABLE} "
            f"as 'salad places' writes it, or one folder of at least {FEWEST} photos a place"
        )
    return places


def _places(root: Path, say: Say | None) -> list[TrainingPlace]:
    """The places of one folder, by whichever layout it is in."""
    if is_gsv_cities(root):
        return read_gsv_cities(root, say=say)
    table = root / PLACES_TABLE
    if table.is_file():
        return places_of(table, _rows(table), say)
    children = sorted(child for child in root.iterdir() if child.is_dir())
    # A folder of sets may hold photos in its sets' folders too; of folders that are no sets, each is a place.
    if not any(is_gsv_cities(child) or (child / PLACES_TABLE).is_file() for child in children):
        found = []
        for folder in children:
            files = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
            # A hidden one is what a file manager leaves beside a photo.
            photos = tuple(path for path in files if not path.name.startswith("."))
            found.append(TrainingPlace(folder.name, root.name, photos))
        if any(place.photos for place in found):
            return [place for place in found if len(place.photos) >= FEWEST]
    return [place for child in children for place in _places(child, say)]


def split(
    places: Sequence[TrainingPlace], *, held_out: float, seed: int
) -> tuple[list[TrainingPlace], list[TrainingPlace]]:
    """Set a part of every city's places aside, for choosing between models.

    Args:
        places: All of them.
        held_out: Which part, 0 to 1.
        seed: Decides which.

    Returns:
        Those to learn from, and those set aside.
    """
    rng = np.random.default_rng(seed)
    learn: list[TrainingPlace] = []
    choose: list[TrainingPlace] = []
    for city in by_city(places).values():
        # City by city, so that a small one is not held out as a whole by chance.
        aside = set(rng.permutation(len(city))[: round(held_out * len(city))].tolist())
        for row, place in enumerate(city):
            (choose if row in aside else learn).append(places[place])
    return learn, choose


def write_places(places: Sequence[Cell], to: Path) -> None:
    """Write a table of places at one stroke; one of that name is replaced.

    Raises:
        BenchmarkError: If the file cannot be written.
    """
    lines = [csv_line(COLUMNS)]
    # abspath and not resolve(), which would follow links: a photo keeps its own name.
    home = Path(os.path.abspath(to.parent))  # noqa: PTH100  # as above
    for place in places:
        for photo in place.photos:
            path = Path(os.path.abspath(photo.path))  # noqa: PTH100  # as above
            seen = path.relative_to(home) if path.is_relative_to(home) else path
            degrees = (f"{photo.where.lat:.7f}", f"{photo.where.lon:.7f}") if photo.where else ("", "")
            heading = "" if photo.heading is None else f"{photo.heading:.1f}"
            time = "" if photo.time is None else photo.time.isoformat()
            lines.append(csv_line((str(seen), place.name, place.city, *degrees, heading, time)))
    try:
        write_whole(to, "".join(lines).encode("utf-8", "surrogateescape"))
    except OSError as error:
        raise BenchmarkError(
            f"{to} cannot be written ({error.strerror}): name a file in a folder that is there"
        ) from error


def _rows(table: Path) -> Iterator[PlaceRow]:
    """The lines of a table of places; photos without a time are older than all others.

    Raises:
        BenchmarkError: If the table or one of its lines cannot be read.
    """

    def header(names: list[str]) -> list[str]:
        for column in COLUMNS[:2]:
            if column not in names:
                raise BenchmarkError(
                    f"{table} is no table of places, for it has no column {column!r}: write "
                    f"{','.join(COLUMNS)} in its first line, of which path and place must be there"
                )
        return names

    names = cache(names_in)  # one look at a folder, not one at each of its photos
    try:
        # Names of files need not be text: surrogates stand for the bytes that are none, as Path has it.
        for line, fields in read_csv(table, header, strict=False, errors="surrogateescape"):
            try:
                yield _row(table, fields, names)
            except (ValueError, PositionError) as error:
                raise BenchmarkError(
                    f"{table}, line {line}: cannot be read ({error}); correct the line or leave it out"
                ) from error
    except OSError as error:
        raise BenchmarkError(f"{table} cannot be read ({error.strerror}): check the name") from error
    except CsvError as error:
        raise BenchmarkError(f"{table} is not CSV ({error}): save it as CSV with commas") from error


def _row(table: Path, fields: dict[str, str], names: Callable[[Path], frozenset[str]]) -> PlaceRow:
    lat, lon, time, city = (fields.get(column, "").strip() for column in ("lat", "lon", "time", "city"))
    where = GeoPoint(number(lat), number(lon)) if lat or lon else None
    path, place = fields["path"].strip(), fields["place"].strip()
    # None holds fields that no column is there for.
    if not path or not place or "\0" in path or None in fields:
        raise ValueError("it needs a path and a place, and no more fields than the header")
    photo, city = table.parent / path, f"{table.parent.name}/{city}" if city else table.parent.name
    age = clock(datetime.fromisoformat(time) if time else None)
    return PlaceRow(photo, photo.name in names(photo.parent), city, place, where, age)
