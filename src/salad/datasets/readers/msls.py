"""Mapillary Street-Level Sequences as it is published: tables beside the photos of each city.

    train_val/<city>/{query,database}/images/<key>.jpg, raw.csv, postprocessed.csv, seq_info.csv, subtask_index.csv

The rows of a folder's tables belong together in their order. Panoramas are left out. Distances are measured on the map
of each city, and no photo is opened.

Source: Warburg et al., "Mapillary Street-Level Sequences: A Dataset for Lifelong Place Recognition", CVPR 2020.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64

from salad.datasets.compact_lists import PhotoList
from salad.datasets.coordinates import Coordinates, lat_lon_of
from salad.datasets.readers.base import Layout, Protocol, Sides
from salad.errors import BenchmarkError, reason
from salad.tables import CsvError, number, read_csv

_TRUTHS = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False, "": False}


def columns(table: Path, names: Sequence[str]) -> dict[str, list[str]]:
    """The named columns; others, such as an unnamed first one, are left aside.

    Raises:
        BenchmarkError: If the table cannot be read, lacks a column, or a line is too short.
    """

    def header(present: list[str]) -> list[str]:
        for name in names:
            if name not in present:
                raise BenchmarkError(f"{table} lacks the column {name!r}: fetch the table again")
        return present

    found: dict[str, list[str]] = {name: [] for name in names}
    try:
        for line, fields in read_csv(table, header, missing=None):
            for name, cells in found.items():
                if fields[name] is None:
                    raise BenchmarkError(f"{table}, line {line}: it ends before {name!r}")
                cells.append(fields[name].strip())
    except (OSError, UnicodeDecodeError, CsvError) as error:
        raise BenchmarkError(f"the table {table} cannot be read ({reason(error)}): fetch it again") from error
    return found


def numbers(table: Path, name: str, cells: Sequence[str]) -> Float64[np.ndarray, " n"]:
    """A column of finite numbers.

    Raises:
        BenchmarkError: If a cell is none; named by its row.
    """
    # One by one and not np.array(cells, float): a wrong cell among 15,000 wants its row told.
    read = np.full(len(cells), math.nan)
    for row, cell in enumerate(cells):
        with suppress(ValueError):
            read[row] = number(cell)
        if not math.isfinite(read[row]):
            raise BenchmarkError(f"{table}, row {row + 1}: {name} {cell[:40]!r} is no number: fetch it again")
    return read


def truths(table: Path, name: str, cells: Sequence[str]) -> Bool[np.ndarray, " n"]:
    """A column of `True` and `False`.

    Raises:
        BenchmarkError: If a cell is neither; named by its row.
    """
    for row, cell in enumerate(cells, 1):
        if cell.lower() not in _TRUTHS:
            raise BenchmarkError(f"{table}, row {row}: {name} {cell[:40]!r} is neither True nor False")
    return np.array([_TRUTHS[cell.lower()] for cell in cells], dtype=np.bool_)


# The cities of each split that a protocol is of.
CITIES = {"val": ("cph", "sf")}
TABLES = ("raw.csv", "postprocessed.csv", "seq_info.csv", "subtask_index.csv")


@dataclass(frozen=True, eq=False)
class _Part:
    """The photos of one side of one city that count."""

    names: list[str]
    metres: Float64[np.ndarray, "n 2"]
    degrees: Float64[np.ndarray, "n 2"]
    sequences: list[str]
    panoramas: int


def find(root: Path, protocol: Protocol) -> Path | None:
    """The folder of cities, where one of the protocol's is there."""
    for base in (root / "train_val", root):
        if any((base / city / "database" / TABLES[1]).is_file() for city in CITIES.get(protocol.split, ())):
            return base
    return None


def read(_: Path, base: Path, protocol: Protocol) -> Sides:
    """Both sides, all of the protocol's cities one after the other.

    Raises:
        BenchmarkError: If a city or a table is missing, a table cannot be read, or its tables do not fit together.
    """
    cities = CITIES[protocol.split]
    theirs, ours = (
        [_part(base, f"{city}/{side}", protocol.subset) for city in cities] for side in ("database", "query")
    )
    # The tables do not say in which zone a city's metres are counted: it is the one zone of the city's middle, also
    # for photos beyond its edge.
    zones = []
    for part in theirs:
        lat, lon = np.median(part.degrees, axis=0) if len(part.degrees) else (0.0, math.nan)
        number = 0 if math.isnan(lon) else int(np.clip((lon + 180) // 6 + 1, 1, 60))
        zones.append(number if lat >= 0 else -number)
    panoramas = sum(part.panoramas for part in (*theirs, *ours))
    (references, their_places), (queries, our_places) = (_side(base, parts, zones) for parts in (theirs, ours))
    return Sides(
        references,
        queries,
        coordinates=(our_places, their_places),
        groups=tuple(name for part in ours for name in part.sequences),
        notes=(f"{panoramas} panoramas were left out",) if panoramas else (),
    )


def _part(base: Path, side: str, subset: str) -> _Part:
    """The photos of `<city>/<side>` that are no panoramas, and of the subset where there is one."""
    folder = base / side
    missing = [table for table in TABLES if not (folder / table).is_file()]
    if missing:
        raise BenchmarkError(f"{folder} lacks {', '.join(missing)}: unpack this city of MSLS there")
    raw, placed, ordered, tasks = (folder / table for table in TABLES)
    seen = columns(raw, ("key", "lon", "lat", "pano"))
    metric = columns(placed, ("key", "easting", "northing"))
    drives = columns(ordered, ("key", "sequence_key"))
    # The tables belong together by the order of their rows; sorted anew, one would give photos others' places.
    if not seen["key"] == metric["key"] == drives["key"]:
        raise BenchmarkError(f"the tables of {folder} do not name the same photos in one order: fetch them again")
    panoramas = truths(raw, "pano", seen["pano"])
    taken = ~panoramas
    # The table of subsets has no keys of its own, only as many rows.
    if subset:
        in_subset = truths(tasks, subset, columns(tasks, (subset,))[subset])
        if len(in_subset) != len(panoramas):
            raise BenchmarkError(
                f"{tasks} has {len(in_subset)} rows, but there are {len(panoramas)} photos: fetch it again"
            )
        taken &= in_subset
    rows = np.flatnonzero(taken)
    metres = np.stack([numbers(placed, name, metric[name]) for name in ("easting", "northing")], axis=1)
    degrees = np.stack([numbers(raw, name, seen[name]) for name in ("lat", "lon")], axis=1)
    return _Part(
        [f"{side}/images/{metric['key'][row]}.jpg" for row in rows],
        metres[rows],
        degrees[rows],
        [f"{side.split('/')[0]}/{drives['sequence_key'][row]}" for row in rows],
        int(panoramas.sum()),
    )


def _side(base: Path, parts: list[_Part], zones: list[int]) -> tuple[PhotoList, Coordinates]:
    """The photos of all cities, each city's metres counted in its own zone."""
    names = [name for part in parts for name in part.names]
    metres = np.concatenate([part.metres for part in parts])
    zone: Int64[np.ndarray, " n"] = np.repeat(np.array(zones, dtype=np.int64), [len(part.names) for part in parts])
    lat_lon = lat_lon_of(metres, zone)
    # A photo's metres may be broken where its degrees are not, and it need not be lost for that.
    off_grid = np.isnan(lat_lon[:, 0])
    degrees = np.concatenate([part.degrees for part in parts])
    lat_lon[off_grid] = np.clip(degrees[off_grid], (-90, -180), (90, 180))
    return PhotoList(base, names, where=lat_lon), Coordinates(metres, zone, lat_lon)


LAYOUT = Layout(
    "MSLS tables",
    "train_val/<city>/{query,database}/ with four tables",
    lambda protocol: [
        f"train_val/{city}/{{query,database}}/{{{','.join(TABLES)}}}" for city in CITIES.get(protocol.split, ())
    ],
    find,
    read,
)
