"""`@` names, the usual exchange format: what is known of a photo stands in its file's name.

    <root>/images/{train,val,test}/{database,queries}/@easting@northing@zone@letter@lat@lon@panoid@...@.jpg

Also `processed/test/` (SF-XL), `gallery` (SVOX), or the two folders directly. No photo is opened or looked at: each
folder is listed once. Positions are measured on the map, as the sets that come so were made; only easting and northing
must be there.
"""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from salad.datasets.compact_lists import PhotoList
from salad.datasets.folders import names_below, sides_in
from salad.datasets.neighbours import Coordinates
from salad.datasets.readers.base import Layout, Protocol, Sides, spots_of
from salad.datasets.readers.utm_grid import on_earth, zone_number
from salad.errors import BenchmarkError

_NUMBER = re.compile(r"[+-]?[0-9]{1,12}(?:\.[0-9]{0,15})?")
_SUFFIX = re.compile(r"\.[A-Za-z]\w*$")
_EAST, _NORTH, _ZONE, _LETTER, _LAT, _LON, _PANOID, _HEADING = 0, 1, 2, 3, 4, 5, 6, 8


def looked_for(protocol: Protocol) -> list[str]:
    """What is looked for."""
    references, queries = protocol.sides[0]
    return [f"images/{protocol.split}/{references}/ and {queries}/ of @-named photos"]


def find(root: Path, protocol: Protocol) -> Path | None:
    """The folder of references, where both are there and the first photo of it has an `@` name."""
    folders = _folders(root, protocol)
    return folders[0] if folders and _looks_so(folders[0]) else None


def read(root: Path, protocol: Protocol) -> Sides:
    """Both sides.

    Raises:
        BenchmarkError: a folder cannot be read or is empty, or a photo's name has no easting and northing.
    """
    folders = _folders(root, protocol)
    assert folders is not None
    (references, theirs, _), (queries, ours, panoramas) = (read_side(folder) for folder in folders)
    return Sides(references, queries, spots=(ours, theirs), groups=panoramas if all(panoramas) else None)


def read_side(folder: Path) -> tuple[PhotoList, Coordinates, tuple[str, ...]]:
    """A folder's photos, where they stand, and which panorama each is of (empty where it does not say).

    Raises:
        BenchmarkError: as `read`.
    """
    names = names_below(folder)
    count = len(names)
    numbers = np.full((count, 5), math.nan)  # easting, northing, latitude, longitude, heading
    zones = np.zeros(count, dtype=np.int64)
    panoramas: list[str] = []
    for row, name in enumerate(names):
        fields = parts(name)
        numbers[row] = [_number(fields[place]) for place in (_EAST, _NORTH, _LAT, _LON, _HEADING)]
        zones[row] = zone_number(fields[_ZONE] + fields[_LETTER])
        panoramas.append(fields[_PANOID])
    lost = np.flatnonzero(np.isnan(numbers[:, :2]).any(axis=1))
    if lost.size:
        raise BenchmarkError(
            f"{lost.size} of {count} photos of {folder} have no easting and northing in their names, the first "
            f"{names[int(lost[0])]}: names must begin @easting@northing@zone@letter@"
        )
    globe = _globe(numbers[:, :2], zones, numbers[:, 2:4])
    photos = PhotoList(folder, names, where=globe, headings=numbers[:, 4] % 360)
    return photos, spots_of(numbers[:, :2].copy(), zones, globe), tuple(panoramas)


def parts(name: str) -> list[str]:
    """The fields of a file's name, empty ones where it has none; of a path only the last part is read."""
    fields = _SUFFIX.sub("", name.rpartition("/")[2]).split("@")
    told = fields[1:] if len(fields) > 2 and not fields[0] else []
    return told + [""] * (15 - len(told))


def _globe(
    grid: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    zones: np.ndarray[tuple[int, ...], np.dtype[np.int64]],
    degrees: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """By easting and northing, which are written to the centimetre; by latitude and longitude where these fail."""
    globe = on_earth(grid, zones)
    there = (np.abs(degrees) <= (90, 180)).all(axis=1)
    fallen = np.isnan(globe[:, 0]) & there
    globe[fallen] = degrees[fallen]
    return globe


def _number(text: str) -> float:
    return float(text) if _NUMBER.fullmatch(text) else math.nan


def _folders(root: Path, protocol: Protocol) -> tuple[Path, Path] | None:
    inside: Sequence[str] = (f"images/{protocol.split}", f"processed/{protocol.split}", protocol.split, "")
    return sides_in(root, protocol.sides, inside=inside)


def _looks_so(folder: Path) -> bool:
    """Whether a photo of a folder has an `@` name, folders in it gone into; of millions, some are looked at."""
    for _ in range(4):
        with os.scandir(folder) as entries:
            some = [entry for entry in itertools.islice(entries, 100) if not entry.name.startswith(".")]
        if any(entry.name.startswith("@") and entry.is_file() for entry in some):
            return True
        inner = next((entry for entry in some if entry.is_dir()), None)
        if inner is None:
            return False
        folder = Path(inner.path)
    return False


LAYOUT = Layout(
    "@ names", "<root>/images/<split>/{database,queries}/@easting@northing@...", looked_for, find, read
)
