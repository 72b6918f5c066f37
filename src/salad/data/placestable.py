"""Places as a table: a CSV file that `salad places` writes, anybody can edit, and `salad train` reads.

One line a photo, with the columns `path,place,city,lat,lon,heading,time`; a path is seen from the table's folder.
Only `path` and `place` must be there. With `lat` and `lon` it is a table of photos too, for `salad index --table`.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple, Protocol

from salad.csvtext import csv_line
from salad.data.listing import Listing, tell_missing
from salad.data.views import FEWEST, Say, TrainingPlace
from salad.errors import BenchmarkError, PositionError
from salad.geo import GeoPoint, centre
from salad.photos import Photo
from salad.wholefile import write_whole

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
