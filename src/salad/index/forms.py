"""Photos as a table that other programs read: CSV, Parquet, GeoJSON. One line a photo, in a given order.

CSV keeps every name, even one that is not UTF-8; Parquet cannot. GeoJSON has the photos as points, with null
for those without a position.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from salad.csvtext import csv_line
from salad.errors import PositionError, StoreError
from salad.geo import GeoPoint
from salad.parquet import arrow, rows
from salad.photos import Photo

Form = Literal["csv", "parquet", "geojson"]
Put = Callable[[Sequence[Photo], Sequence[str]], None]
Record = Mapping[str, Any]

COLUMNS = ("path", "lat", "lon", "heading", "time", "identity")
_DEGREES = ("lat", "lon", "heading")


# --- writing -------------------------------------------------------------------------------


def writer(path: Path) -> AbstractContextManager[Put]:
    """Begin a table at `path`, of the form its name ends in; what it gives takes photos and their contents.

    Raises:
        MissingExtraError: If it is to be Parquet, and what writes it is not installed.
    """
    return {".csv": _csv_writer, ".parquet": _parquet_writer, ".geojson": _geojson_writer}[path.suffix](path)


@contextmanager
def _csv_writer(path: Path) -> Iterator[Put]:
    with path.open("w", encoding="utf-8", errors="surrogateescape", newline="") as file:
        file.write(csv_line(COLUMNS))
        yield lambda photos, identities: file.writelines(
            csv_line(record[name] for name in COLUMNS) for record in map(_record, photos, identities)
        )


@contextmanager
def _geojson_writer(path: Path) -> Iterator[Put]:
    with path.open("w", encoding="utf-8") as file:
        between = ""
        file.write('{"type": "FeatureCollection", "features": [')

        def put(photos: Sequence[Photo], identities: Sequence[str]) -> None:
            nonlocal between
            for record in map(_record, photos, identities):
                text = _is_text(record["path"])  # names that are not UTF-8 are escaped
                file.write(f"{between}\n{json.dumps(_feature(record), ensure_ascii=not text)}")
                between = ","

        yield put
        file.write("\n]}\n")


@contextmanager
def _parquet_writer(path: Path) -> Iterator[Put]:
    pyarrow, parquet = arrow("writing Parquet")
    kinds = {name: pyarrow.float64() if name in _DEGREES else pyarrow.string() for name in COLUMNS}
    schema = pyarrow.schema(list(kinds.items()))
    with parquet.ParquetWriter(path, schema) as file:

        def put(photos: Sequence[Photo], identities: Sequence[str]) -> None:
            records = list(map(_record, photos, identities))
            for path in (record["path"] for record in records if not _is_text(record["path"])):
                raise StoreError(
                    f"{os.fsencode(path)!r} is not UTF-8, and Parquet holds no other names: export as csv"
                )
            file.write_table(pyarrow.Table.from_pylist(records, schema=schema))

        yield put


def _record(photo: Photo, identity: str) -> dict[str, Any]:
    where = photo.where
    return {
        "path": str(photo.path),
        "lat": where.lat if where else None,
        "lon": where.lon if where else None,
        "heading": photo.heading,
        "time": photo.time.isoformat() if photo.time else None,
        "identity": identity,
    }


def _feature(record: Record) -> dict[str, Any]:
    lat, lon = record["lat"], record["lon"]
    point = None if lat is None else {"type": "Point", "coordinates": [lon, lat]}
    rest = {name: record[name] for name in COLUMNS if name not in ("lat", "lon")}
    return {"type": "Feature", "geometry": point, "properties": rest}


def _is_text(path: str) -> bool:
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True


# --- reading -------------------------------------------------------------------------------


def read(path: Path) -> Iterator[tuple[Photo, str | None]]:
    """The photos of a table, of the form its name ends in, with their contents where it tells them.

    Columns: `path` (seen from the table's folder), and `lat`, `lon`, `heading`, `time` and `identity` where
    they are known. More columns do no harm.

    Raises:
        StoreError: If the table cannot be read, or a line of it makes no sense; it is named.
        MissingExtraError: If it is Parquet, and what reads it is not installed.
    """
    readers = {".csv": _csv_records, ".parquet": rows, ".geojson": _geojson_records}
    done = 0
    try:
        for record in readers[path.suffix.lower()](path):
            yield _photo(record, path.parent)
            done += 1
    except OSError as error:
        raise StoreError(f"{path} cannot be read ({error}): check the name and permissions") from error
    except (ValueError, KeyError, TypeError, AttributeError, PositionError, csv.Error) as error:
        raise StoreError(f"{path}, photo {done + 1}: {error}; correct it, or leave it out") from error


def _csv_records(path: Path) -> Iterator[Record]:
    with path.open(encoding="utf-8-sig", errors="surrogateescape", newline="") as file:
        table = csv.DictReader(file, strict=True, restval="")
        names = [name.strip().lower() for name in table.fieldnames or []]
        if names.count("path") != 1:
            raise ValueError(f"it needs one column 'path', but has {', '.join(names) or 'none'}")
        table.fieldnames = names
        for record in table:
            if None in record:
                raise ValueError("it has more fields than the first line (put names with commas in quotes)")
            yield record


def _geojson_records(path: Path) -> Iterable[Record]:
    told = json.loads(path.read_text(encoding="utf-8"))
    return (_flat(feature) for feature in told["features"])


def _flat(feature: Record) -> Record:
    record, point = dict(feature["properties"]), feature["geometry"]
    if point is not None:
        record["lon"], record["lat"], *_ = point["coordinates"]
    return record


def _photo(record: Record, folder: Path) -> tuple[Photo, str | None]:
    path, time = record["path"], record.get("time")
    if not isinstance(path, str) or not path or "\0" in path:
        raise ValueError(f"{path!r} is no file's name")
    lat, lon, heading = (_degrees(record.get(name), name) for name in _DEGREES)
    if (lat is None) != (lon is None):
        raise ValueError(f"{path} has a latitude or a longitude, but not both")
    where = GeoPoint(lat, lon) if lat is not None and lon is not None else None
    when = time if isinstance(time, datetime) else datetime.fromisoformat(time) if time else None
    turned = heading if heading is None or 0 <= heading <= 360 else heading % 360
    return Photo(folder / path, where, turned, when), record.get("identity") or None


def _degrees(value: object, name: str) -> float | None:
    if value is None or value == "":
        return None
    try:
        number = float(str(value))
    except ValueError:
        raise ValueError(f"{name} {value!r} is not a number of degrees") from None
    if math.isnan(number):  # as pandas writes what is not known
        return None
    if not abs(number) <= 1e6:
        raise ValueError(f"{name} {value!r} is not a number of degrees")
    return number
