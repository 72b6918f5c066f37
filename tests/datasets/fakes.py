"""Tiny data sets in the layouts that the published ones have: each generator writes one below a folder.

Photos are empty files, since no reader opens them. What is right is worked out here from where photos were put.
"""

from __future__ import annotations

import pickle
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from salad.geo import GeoPoint, Utm, from_utm, shifted
from salad.images.at_names import at_name

PITTSBURGH = (585_000.0, 4_477_000.0)  # metres in zone 17 T


def touch(folder: Path, names: Iterable[str]) -> Path:
    """Empty files."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def line(count: int, step: float, start: float = 0.0) -> list[float]:
    """Places along a street, in metres."""
    return [start + step * row for row in range(count)]


def near(ours: Sequence[float], theirs: Sequence[float], metres: float = 25.0) -> list[list[int]]:
    """What is right along a street."""
    return [[row for row, other in enumerate(theirs) if abs(place - other) <= metres] for place in ours]


def at_names(
    root: Path,
    references: Sequence[float],
    queries: Sequence[float],
    *,
    split: str = "images/test",
    sides: tuple[str, str] = ("database", "queries"),
    zone: str = "17@T",
) -> Path:
    """`@` names along a street that runs east."""
    for side, places in zip(sides, (references, queries), strict=True):
        names = [
            f"@{PITTSBURGH[0] + place:010.2f}@{PITTSBURGH[1]:010.2f}@{zone}@@@{side}{row}@@{row:03d}@@@@2015@@.jpg"
            for row, place in enumerate(places)
        ]
        touch(root / split / side, names)
    return root


def mock_names(root: Path, numbers: Iterable[int], *, step: float = 1000.0) -> Path:
    """`@` names of sets without positions: metres made up from the number, no zone."""
    names = [f"@0@{step * number:07.1f}@@@@@{number}@@@@@@@@.jpg" for number in numbers]
    touch(root / "images" / "test" / "database", names)
    touch(root / "images" / "test" / "queries", names)
    return root


def at_points(folder: Path, points: Iterable[GeoPoint], headings: Iterable[float] | None = None) -> Path:
    """Whole `@` names anywhere on earth."""
    points = list(points)
    turns = list(headings) if headings is not None else [None] * len(points)
    named = (at_name(p, heading=h, note=str(row)) for row, (p, h) in enumerate(zip(points, turns, strict=True)))
    return touch(folder, named)


def numbered(root: Path, references: Iterable[int], queries: Iterable[int]) -> Path:
    """Nordland and SPED: `ref/0000000.jpg`, `query/0000000.jpg`."""
    touch(root / "ref", (f"{number:07d}.jpg" for number in references))
    touch(root / "query", (f"{number:07d}.jpg" for number in queries))
    return root


def pairs(root: Path, numbers: Iterable[int], only_new: Iterable[int] = ()) -> Path:
    """AmsterTime: `new/<n>.png`, `old/<n>.jpg`."""
    numbers = list(numbers)
    touch(root / "new", (f"{number}.png" for number in (*numbers, *only_new)))
    touch(root / "old", (f"{number}.jpg" for number in numbers))
    return root


def gsv_cities(root: Path, photos_of: dict[str, Sequence[int]]) -> Path:
    """GSV-Cities: for each city how many photos each of its places has."""
    (root / "Dataframes").mkdir(parents=True)
    for city, counts in photos_of.items():
        lines = ["place_id,year,month,northdeg,city_id,lat,lon,panoid"]
        for place, count in enumerate(counts):
            for month in range(1, count + 1):
                lines.append(f"{place},2019,{month},90,{city},51.1{place}0,-0.0500,pano{month}")
                name = f"{city}_{place:07d}_2019_{month:02d}_090_51.1{place}0_-0.0500_pano{month}.jpg"
                touch(root / "Images" / city, [name])
        (root / "Dataframes" / f"{city}.csv").write_text("\n".join(lines) + "\n")
    return root


# --- MSLS ----------------------------------------------------------------------------------

_CITY_ORIGINS = {"cph": (33, "U", 347_000.0, 6_172_000.0), "sf": (10, "S", 551_000.0, 4_180_000.0)}


def msls(
    root: Path,
    streets: dict[str, tuple[Sequence[float], Sequence[float]]],
    *,
    panoramas: Sequence[int] = (),
    subset: Sequence[int] | None = None,
) -> Path:
    """MSLS' tables: for each city where references and queries stand along its street.

    Args:
        root: the folder.
        streets: metres along the street.
        panoramas: rows of each side of each city that are panoramas.
        subset: rows of the queries of each city that count in the small set; all by default.
    """
    for city, sides in streets.items():
        for side, places in zip(("database", "query"), sides, strict=True):
            folder = root / "train_val" / city / side
            keys = [f"{city}-{side}-{row}" for row in range(len(places))]
            counted = range(len(places)) if subset is None or side == "database" else subset
            (folder / "images").mkdir(parents=True)
            touch(folder / "images", (f"{key}.jpg" for key in keys))
            _msls_tables(folder, city, keys, places, panoramas, counted)
    return root


def _msls_tables(
    folder: Path,
    city: str,
    keys: Sequence[str],
    places: Sequence[float],
    panoramas: Sequence[int],
    counted: Sequence[int],
) -> None:
    zone, letter, east, north = _CITY_ORIGINS[city]
    raw = [",key,lon,lat,ca,captured_at,pano"]
    placed = [",key,easting,northing,night,control_panel,view_direction,unique_cluster"]
    ordered = [",key,sequence_key,frame_number"]
    tasks = [",all,s2w,w2s,o2n,n2o,d2n,n2d"]
    for row, (key, place) in enumerate(zip(keys, places, strict=True)):
        where = from_utm(Utm(east + place, north, zone, letter))
        raw.append(f"{row},{key},{where.lon},{where.lat},90.0,2016-07-01,{row in panoramas}")
        placed.append(f"{row},{key},{east + place},{north},False,False,Forward,{row}")
        ordered.append(f"{row},{key},drive{row // 2},{row}")
        tasks.append(f"{row},{row in counted},False,False,False,False,False,False")
    tables = {"raw": raw, "postprocessed": placed, "seq_info": ordered, "subtask_index": tasks}
    for name, lines in tables.items():
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")


# --- arrays --------------------------------------------------------------------------------


def ragged(rows: Iterable[Sequence[int]]) -> np.ndarray[Any, Any]:
    """An object array of arrays, as `_gt.npy` holds it."""
    rows = list(rows)
    held = np.empty(len(rows), dtype=object)
    for place, row in enumerate(rows):
        held[place] = np.array(row, dtype=np.int64) if row else np.array([])
    return held


def npy_triple(
    root: Path,
    stem: str,
    references: Sequence[str],
    queries: Sequence[str],
    positives: Iterable[Sequence[int]],
    *,
    counted: Sequence[int] | None = None,
) -> Path:
    """Three arrays beside the photos; four where only some queries count."""
    touch(root, [*references, *queries])
    np.save(root / f"{stem}_dbImages.npy", np.array(references))
    np.save(root / f"{stem}_qImages.npy", np.array(queries))
    np.save(root / f"{stem}_{'gt' if counted is None else 'pIdx'}.npy", ragged(positives), allow_pickle=True)
    if counted is not None:
        np.save(root / f"{stem}_qIdx.npy", np.array(counted))
    return root


def views(count: int, folder: str = "") -> list[str]:
    """Names as Pittsburgh has them: two views of each panorama."""
    return [f"{folder}{row // 2 // 4:03d}/{row // 2:06d}_pitch1_yaw{row % 2 + 1}.jpg" for row in range(count)]


def npz(root: Path, stem: str, references: Sequence[float], queries: Sequence[float], metres: float = 25.0) -> Path:
    """Metres and two lists of names."""
    theirs, ours = views(len(references)), views(len(queries), "queries_real/")
    touch(root, [*theirs, *ours])
    np.savez(
        root / f"{stem}.npz",
        utmQ=np.array([(PITTSBURGH[0] + place, PITTSBURGH[1]) for place in queries]),
        utmDb=np.array([(PITTSBURGH[0] + place, PITTSBURGH[1]) for place in references]),
        posDistThr=metres,
    )
    (root / f"{stem}_imageNames_index.txt").write_text("".join(f"./{name}\n" for name in theirs))
    (root / f"{stem}_imageNames_query.txt").write_text("".join(f"./{name}\n" for name in ours))
    return root


class Bomb:
    """What runs a command where a careless reader unpickles it."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        import os

        return os.system, (f"touch {self.marker}",)


def malicious_npy(path: Path, marker: Path) -> Path:
    """An `_gt.npy` that runs code in a careless reader."""
    held = np.empty(1, dtype=object)
    held[0] = Bomb(marker)
    np.save(path, held, allow_pickle=True)
    return path


def pickled(array: np.ndarray[Any, Any], protocol: int) -> bytes:
    """The bytes of an `.npy` of an object array, pickled by any protocol."""
    header = f"{{'descr': '|O', 'fortran_order': False, 'shape': ({len(array)},), }}"
    padded = header + " " * (-(len(header) + 11) % 64) + "\n"
    start = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded.encode()
    return start + pickle.dumps(array, protocol=protocol)


# --- MATLAB --------------------------------------------------------------------------------


def _element(kind: int, content: bytes, order: str) -> bytes:
    return struct.pack(f"{order}II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def _matrix(value: Any, order: str, name: bytes = b"") -> bytes:
    if isinstance(value, dict):
        kind, sides = 2, (1, 1)
        fields = b"".join(field.encode().ljust(32, b"\0") for field in value)
        rest = _element(5, struct.pack(f"{order}I", 32), order) + _element(1, fields, order)
        rest += b"".join(_matrix(part, order) for part in value.values())
    elif isinstance(value, list):
        kind, sides = 1, (len(value), 1)
        rest = b"".join(_matrix(part, order) for part in value)
    elif isinstance(value, str):
        kind, sides = 4, (1, len(value))
        rest = _element(16, value.encode(), order)
    else:
        array = np.atleast_2d(np.asarray(value, dtype=np.float64))
        kind, sides = 6, array.shape
        rest = _element(9, array.astype(f"{order}f8").tobytes(order="F"), order)
    head = _element(6, struct.pack(f"{order}II", kind, 0), order)
    head += _element(5, struct.pack(f"{order}{len(sides)}i", *sides), order) + _element(1, name, order)
    return _element(14, head + rest, order)


def mat_file(value: Any, *, name: str = "dbStruct", order: str = "<", packed: bool = False) -> bytes:
    """A MATLAB file of version 5, written without SciPy, of either byte order."""
    import zlib

    content = _matrix(value, order, name.encode())
    if packed:
        shut = zlib.compress(content)
        content = struct.pack(f"{order}II", 15, len(shut)) + shut
    head = b"MATLAB 5.0 MAT-file".ljust(124, b" ")
    return head + struct.pack(f"{order}H", 0x0100) + (b"IM" if order == "<" else b"MI") + content


def dbstruct(
    root: Path,
    stem: str,
    references: Sequence[float],
    queries: Sequence[float],
    *,
    metres: float = 25.0,
    order: str = "<",
    packed: bool = True,
    photos: str = ".jpg",
) -> Path:
    """`<stem>.mat` beside the photos, queries below `queries_real/`; places along a street in zone 17 T."""
    theirs, ours = views(len(references)), views(len(queries))
    touch(root, (name.replace(".jpg", photos) for name in theirs))
    touch(root / "queries_real", ours)
    grid = [
        np.array([[PITTSBURGH[0] + place for place in places], [PITTSBURGH[1]] * len(places)])
        for places in (references, queries)
    ]
    told = {
        "whichSet": "test",
        "dbImageFns": theirs,
        "utmDb": grid[0],
        "qImageFns": ours,
        "utmQ": grid[1],
        "numImages": len(references),
        "numQueries": len(queries),
        "posDistThr": metres,
        "posDistSqThr": metres**2,
        "nonTrivPosDistSqThr": 100,
    }
    (root / f"{stem}.mat").write_bytes(mat_file(told, order=order, packed=packed))
    return root


def town(start: GeoPoint, spots: Iterable[tuple[float, float]]) -> list[GeoPoint]:
    """Points so many metres north and east of a start."""
    return [shifted(start, north, east) for north, east in spots]
