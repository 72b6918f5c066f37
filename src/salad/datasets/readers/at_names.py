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
from pathlib import Path

import numpy as np

from salad.datasets.compact_lists import PhotoList
from salad.datasets.coordinates import Coordinates, lat_lon_of
from salad.datasets.folders import names_below, sides_in
from salad.datasets.readers.base import Layout, Protocol, Sides
from salad.errors import BenchmarkError
from salad.images.at_names import split_at_name, zone_of


def find(root: Path, protocol: Protocol) -> Path | None:
    """The folder of references, where both are there and the first photo of it has an `@` name."""
    folders = _folders(root, protocol)
    return folders[0] if folders and _has_at_names(folders[0]) else None


def read(root: Path, _found: Path, protocol: Protocol) -> Sides:
    """Both sides.

    Raises:
        BenchmarkError: If a folder cannot be read or is empty, or a photo's name has no easting and northing.
    """
    folders = _folders(root, protocol)
    assert folders is not None
    (references, theirs, _), (queries, ours, panoramas) = map(read_side, folders)
    groups = panoramas if all(panoramas) else None
    return Sides(references, queries, coordinates=(ours, theirs), groups=groups)


def read_side(folder: Path) -> tuple[PhotoList, Coordinates, tuple[str, ...]]:
    """A folder's photos, where they stand, and which panorama each is of (empty where it does not say).

    Raises:
        BenchmarkError: As `read`.
    """
    names = names_below(folder)
    numbers = np.full((len(names), 5), math.nan)  # easting, northing, latitude, longitude, heading
    zones = np.zeros(len(names), dtype=np.int64)
    panoramas: list[str] = []
    for row, name in enumerate(names):
        fields = split_at_name(name)
        if fields is None:
            continue  # without a position, which is told of below
        numbers[row] = fields.easting, fields.northing, fields.lat, fields.lon, fields.heading
        zones[row] = zone_of(fields)
        panoramas.append(fields.panoid)
    # Copied, so that the table of five columns can be let go: of 2.8 million photos it takes 112 MB.
    metres, degrees = numbers[:, :2].copy(), numbers[:, 2:4]
    lost = np.flatnonzero(np.isnan(metres).any(axis=1))
    if lost.size:
        raise BenchmarkError(
            f"{lost.size} of {len(names)} photos of {folder} have no easting and northing in their names, the first "
            f"{names[int(lost[0])]}: names must begin @easting@northing@zone@letter@"
        )
    # Easting and northing are written to the centimetre, degrees to a metre: these stand in only where those fail.
    lat_lon = lat_lon_of(metres, zones)
    by_degrees = np.isnan(lat_lon[:, 0]) & (np.abs(degrees) <= (90, 180)).all(axis=1)
    lat_lon[by_degrees] = degrees[by_degrees]
    photos = PhotoList(folder, names, where=lat_lon, headings=numbers[:, 4] % 360)
    return photos, Coordinates(metres, zones, lat_lon), tuple(panoramas)


def _folders(root: Path, protocol: Protocol) -> tuple[Path, Path] | None:
    # The exchange format first, then SF-XL's own, then the two folders wherever they are.
    inside = (f"images/{protocol.split}", f"processed/{protocol.split}", protocol.split, "")
    return sides_in(root, protocol.sides, inside=inside)


def _has_at_names(folder: Path) -> bool:
    """Whether a photo of a folder has an `@` name, folders in it gone into; of millions, some are looked at."""
    for _ in range(4):  # as deep as sets are seen to go
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
    "@ names",
    "<root>/images/<split>/{database,queries}/@easting@northing@...",
    lambda protocol: [f"images/{protocol.split}/{'/ and '.join(protocol.sides[0])}/ of @-named photos"],
    find,
    read,
)
