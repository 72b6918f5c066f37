"""Places to learn from, several photos of each, wherever they stand on disk.

Four layouts are read: GSV-Cities (tables beside photos), a table that `salad places` wrote, one folder a place,
and a folder of such sets. Photos of a place stand oldest first; in a folder their names must sort by time, as
the names of webcams and of numbered sessions do. No photo is opened.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from salad.datasets.readers.gsv_cities import is_gsv_cities, read_gsv_cities
from salad.datasets.training_place import FEWEST, Listing, Say, TrainingPlace, by_city, tell_missing
from salad.errors import BenchmarkError, PositionError
from salad.files import write_whole
from salad.geo import GeoPoint, centre
from salad.images.photo import SUFFIXES, Photo
from salad.tables import csv_line

# --- Places as a table: a CSV file that `salad places` writes, anybody can edit, and `salad train` reads ---
#
# One line a photo, with the columns `path,place,city,lat,lon,heading,time`; a path is seen from the table's folder.
# Only `path` and `place` must be there. With `lat` and `lon` it is a table of photos too, for `salad index --table`.


NAME = "places.csv"
"""What such a table is called in a folder of sets."""
COLUMNS = ("path", "place", "city", "lat", "lon", "heading", "time")


class Shown(Protocol):
    """A place with what is known of its photos."""

    @property
    def name(self) -> str:
        """Its name."""
        ...

    @property
    def city(self) -> str:
        """Its city's name."""
        ...

    @property
    def photos(self) -> Sequence[Photo]:
        """Its photos, oldest first."""
        ...


class _Row(NamedTuple):
    path: Path
    key: tuple[str, str]
    where: GeoPoint | None
    time: datetime | None


def write_places(places: Sequence[Shown], to: Path) -> None:
    """Write a table of places at one stroke; one of that name is replaced.

    Raises:
        BenchmarkError: the file cannot be written.
    """
    home = Path(os.path.abspath(to.parent))  # noqa: PTH100  # as in _line
    lines = (csv_line(_line(place, photo, home)) for place in places for photo in place.photos)
    text = csv_line(COLUMNS) + "".join(lines)
    try:
        write_whole(to, text.encode("utf-8", "surrogateescape"))
    except OSError as error:
        raise BenchmarkError(
            f"{to} cannot be written ({error.strerror}): name a file in a folder that is there"
        ) from error


def read_places(table: Path, *, say: Say | None = None) -> list[TrainingPlace]:
    """The places of a table with at least `FEWEST` photos, in the order they come.

    Photos of a place stand in order of time, those without one first, and else as the table has them.

    Args:
        table: the file.
        say: takes a sentence where photos are missing, which are then left out.

    Raises:
        BenchmarkError: the table or one of its lines cannot be read; or, without `say`, a photo is missing.
    """
    there, missing = Listing(), list[Path]()
    taken: dict[tuple[str, str], list[_Row]] = {}
    for row in _rows(table):
        if row.path in there:
            taken.setdefault(row.key, []).append(row)
        else:
            missing.append(row.path)
    tell_missing(table, missing, say)
    return [_place(key, rows) for key, rows in taken.items() if len(rows) >= FEWEST]


def clock(time: datetime | None) -> datetime:
    """What to sort by: the time as clocks showed it, since some know their zone and some do not; none comes first."""
    return datetime.min if time is None else time.replace(tzinfo=None)


def _line(place: Shown, photo: Photo, home: Path) -> list[str]:
    path = Path(os.path.abspath(photo.path))  # noqa: PTH100  # resolve() would follow links, a photo keeps its own name
    seen = path.relative_to(home) if path.is_relative_to(home) else path
    degrees = ["", ""] if photo.where is None else [f"{photo.where.lat:.7f}", f"{photo.where.lon:.7f}"]
    heading = "" if photo.heading is None else f"{photo.heading:.1f}"
    time = "" if photo.time is None else photo.time.isoformat()
    return [str(seen), place.name, place.city, *degrees, heading, time]


def _place(key: tuple[str, str], rows: Sequence[_Row]) -> TrainingPlace:
    points = [row.where for row in rows if row.where is not None]
    where = centre(points) if len(points) == len(rows) else None
    city, name = key
    dated = sorted(rows, key=lambda row: clock(row.time))
    return TrainingPlace(name, city, tuple(row.path for row in dated), where)


def _rows(table: Path) -> Iterator[_Row]:
    try:
        with table.open(newline="", encoding="utf-8-sig", errors="surrogateescape") as file:
            lines = csv.DictReader(file, restval="")
            lacking = {"path", "place"} - set(lines.fieldnames or [])
            if lacking:
                raise BenchmarkError(
                    f"{table} is no table of places, for it has no column {sorted(lacking)[0]!r}: write "
                    f"{','.join(COLUMNS)} in its first line, of which path and place must be there"
                )
            yield from (_row(table, lines.line_num, fields) for fields in lines)
    except OSError as error:
        raise BenchmarkError(f"{table} cannot be read ({error.strerror}): check the name") from error
    except csv.Error as error:
        raise BenchmarkError(f"{table} is not CSV ({error}): save it as CSV with commas") from error


def _row(table: Path, number: int, fields: dict[str, str]) -> _Row:
    try:
        lat, lon, time, city = (fields.get(column, "").strip() for column in ("lat", "lon", "time", "city"))
        where = GeoPoint(float(lat), float(lon)) if lat or lon else None
        path, place = _named(fields)
        key = (f"{table.parent.name}/{city}" if city else table.parent.name, place)
        return _Row(table.parent / path, key, where, datetime.fromisoformat(time) if time else None)
    except (ValueError, PositionError) as error:
        raise BenchmarkError(
            f"{table}, line {number}: cannot be read ({error}); correct the line or leave it out"
        ) from error


def _named(fields: dict[str, str]) -> tuple[str, str]:
    path, place = fields["path"].strip(), fields["place"].strip()
    if not path or not place or "\0" in path or None in fields:
        raise ValueError("it needs a path and a place, and no more fields than the header")
    return path, place


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
        places = read_places(root, say=say)
    elif root.is_dir():
        places = _places(root, say)
    else:
        raise BenchmarkError(f"there is no folder {root} to train from")
    if not places:
        raise BenchmarkError(
            f"{root} holds no place to learn from: expected GSV-Cities' Dataframes/ and Images/, a {NAME} "
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
    if (root / NAME).is_file():
        return read_places(root / NAME, say=say)
    children = sorted(child for child in root.iterdir() if child.is_dir())
    sets = any(is_gsv_cities(child) or (child / NAME).is_file() for child in children)
    if not sets and any(_photos(child) for child in children):
        return _folders(root, children)
    return [place for child in children for place in _places(child, say)]


def _photos(folder: Path) -> tuple[Path, ...]:
    files = (path for path in folder.iterdir() if not path.name.startswith("."))
    return tuple(sorted(path for path in files if path.suffix.lower() in SUFFIXES))


def _folders(root: Path, children: Sequence[Path]) -> list[TrainingPlace]:
    found = [TrainingPlace(child.name, root.name, _photos(child)) for child in children]
    return [place for place in found if len(place.photos) >= FEWEST]
