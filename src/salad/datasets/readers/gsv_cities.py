"""GSV-Cities: a table a city, its photos beside it, some 530,000 of them in 62,000 places.

    Dataframes/<City>.csv    place_id,year,month,northdeg,city_id,lat,lon,panoid
    Images/<City>/           <city_id>_<place_id>_<year>_<month>_<northdeg>_<lat>_<lon>_<panoid>.jpg

Training takes all photos of its places. As an evaluation set the newest photo of each place is a query and the others
are its references. Only the tables and one listing of each city's folder are read; no photo is opened or looked at.

Source: Ali-bey et al., "GSV-Cities: Toward appropriate supervised visual place recognition", Neurocomputing 2022.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from salad.datasets.compact_lists import PhotoList, Ragged
from salad.datasets.folders import names_in
from salad.datasets.readers.base import Layout, Protocol, Sides
from salad.datasets.training_place import PlaceRow, Say, TrainingPlace, places_of
from salad.errors import BenchmarkError, PositionError
from salad.geo import GeoPoint, in_degrees
from salad.tables import CsvError, number, read_csv, whole

TABLES, PHOTOS = "Dataframes", "Images"


def is_gsv_cities(root: Path) -> bool:
    """Whether a folder is laid out like GSV-Cities."""
    return (root / TABLES).is_dir()


def read_gsv_cities(root: Path, *, say: Say | None = None) -> list[TrainingPlace]:
    """Every place of every city with at least `FEWEST` photos, cities in order of name.

    Raises:
        BenchmarkError: If a line of a table cannot be read; or, without `say`, if a photo is missing.
    """
    tables = sorted((root / TABLES).glob("*.csv"))
    return [place for table in tables for place in places_of(table, _rows(root, table), say)]


def _rows(root: Path, table: Path) -> Iterator[PlaceRow]:
    folder, city = root / PHOTOS / table.stem, f"{root.name}/{table.stem}"
    names, line = names_in(folder), 1
    try:
        for line, fields in read_csv(table, strict=False, missing=None):
            month = f"{whole(fields['year']):04d}_{whole(fields['month']):02d}"
            # lat and lon stand in the name exactly as in the table: as numbers they would lose zeros at their end
            lat, lon, place = fields["lat"], fields["lon"], fields["place_id"]
            heading = whole(fields["northdeg"])
            stem = f"{fields['city_id']}_{whole(place):07d}_{month}_{heading:03d}_{lat}_{lon}_{fields['panoid']}"
            # Photos end in either, and each must be found without a look at the disk.
            name = f"{stem}.JPG" if f"{stem}.jpg" not in names and f"{stem}.JPG" in names else f"{stem}.jpg"
            where = GeoPoint(number(lat), number(lon))
            yield PlaceRow(folder / name, name in names, city, place, where, (month, name))
            line += 1  # where the next one begins, should the reader not come to its end
    except OSError as error:
        raise BenchmarkError(f"{table} cannot be read ({error.strerror}): fetch it again") from error
    except (KeyError, AttributeError, ValueError, CsvError, PositionError) as error:
        raise BenchmarkError(f"{table}, line {line}: cannot be read ({error}): correct it") from error


def read(root: Path, _found: Path, _: Protocol) -> Sides:
    """Both sides.

    Raises:
        BenchmarkError: If a table cannot be read or holds no place of four photos.
    """
    notes: list[str] = []
    places = read_gsv_cities(root, say=notes.append)
    if not places:
        raise BenchmarkError(f"{root} holds no place of four photos: fetch its Images, or name another folder")
    # Photos stand oldest first: who asks comes after those who are asked, as in use.
    theirs = [(place, photo) for place in places for photo in place.photos[:-1]]
    return Sides(
        _photos(root, theirs),
        _photos(root, [(place, place.photos[-1]) for place in places]),
        positives=Ragged(np.arange(len(theirs), dtype=np.int64), [len(place.photos) - 1 for place in places]),
        groups=tuple(f"{place.city}/{place.name}" for place in places),
        told_by=TABLES,
        notes=tuple(notes),
    )


def _photos(root: Path, photos: list[tuple[TrainingPlace, Path]]) -> PhotoList:
    where = in_degrees(place.where for place, _ in photos)
    return PhotoList(root, (str(photo.relative_to(root)) for _, photo in photos), where=where)


LAYOUT = Layout(
    "GSV-Cities",
    "Dataframes/<City>.csv beside Images/<City>/",
    lambda _: [f"{TABLES}/<City>.csv and {PHOTOS}/<City>/"],
    lambda root, _: root / TABLES if is_gsv_cities(root) else None,
    read,
)
