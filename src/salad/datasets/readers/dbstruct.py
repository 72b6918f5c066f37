"""`dbStruct` in a MATLAB file: Pittsburgh and Tokyo 24/7 as NetVLAD's authors gave them out.

Which set, names of references, 2 x N metres, names of queries, 2 x M metres, N, M, the distance that counts as right,
its square, and the square for trivial positives. The metres do not say their UTM zone; the protocol does.

Source: Arandjelović et al., "NetVLAD: CNN architecture for weakly supervised place recognition", CVPR 2016.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from salad.datasets.matlab import read_struct
from salad.datasets.readers.base import Layout, Protocol, Radius, Sides
from salad.datasets.readers.photo_lists import file_of, photos_at
from salad.datasets.readers.utm_grid import spots_in
from salad.errors import BenchmarkError

_SET = ("whichSet", "dbImageFns", "utmDb", "qImageFns", "utmQ")
FIELDS = (*_SET, "numImages", "numQueries", "posDistThr", "posDistSqThr", "nonTrivPosDistSqThr")
_QUERIES = ("queries_real", "247query_subset_v2", "247query_v3", "queries", "")
_VIEW = re.compile(r"_pitch[0-9]+_yaw[0-9]+\.\w+$")


def looked_for(protocol: Protocol) -> list[str]:
    """What is looked for."""
    return [f"{stem}.mat" for stem in protocol.stems]


def find(root: Path, protocol: Protocol) -> Path | None:
    """The file."""
    return file_of(root, looked_for(protocol))


def read(root: Path, protocol: Protocol) -> Sides:
    """Both sides.

    Raises:
        BenchmarkError: the file cannot be read, its parts do not fit, or the photos are not where they may be.
    """
    path = find(root, protocol)
    assert path is not None
    told = _named(read_struct(path, "dbStruct"))
    _check_distance(path, told["posDistThr"], protocol)
    theirs, ours = (_texts(path, told[name]) for name in ("dbImageFns", "qImageFns"))
    their_spots = spots_in(_metres(path, told["utmDb"], len(theirs)), protocol.zone)
    our_spots = spots_in(_metres(path, told["utmQ"], len(ours)), protocol.zone)
    homes = [root, root / "images", path.parent, root / "raw_data", *(root / stem for stem in protocol.stems)]
    return Sides(
        photos_at(theirs, homes, listed_in=path, where=their_spots.lat_lon),
        photos_at(
            ours,
            (home / below for home in homes for below in _QUERIES),
            listed_in=path,
            where=our_spots.lat_lon,
        ),
        spots=(our_spots, their_spots),
        groups=panoramas(ours),
    )


def panoramas(names: Sequence[str]) -> tuple[str, ...] | None:
    """The panorama that each photo was cut from, where every name says so: its views are one place."""
    whole = tuple(_VIEW.sub("", name) for name in names)
    return whole if all(len(cut) < len(name) for cut, name in zip(whole, names, strict=True)) else None


def _named(told: dict[str, Any]) -> dict[str, Any]:
    """By the fields' names, or by their order where they are called otherwise."""
    if all(name in told for name in FIELDS[1:5]):
        return {"posDistThr": None} | told
    return dict.fromkeys(FIELDS) | dict(zip(FIELDS, told.values(), strict=False))


def _check_distance(path: Path, distance: Any, protocol: Protocol) -> None:
    if isinstance(distance, np.ndarray) and distance.size == 1 and isinstance(protocol.rule, Radius):
        metres = float(distance.ravel()[0])
        if metres != protocol.rule.metres:
            raise BenchmarkError(
                f"{path} calls {metres:g} m right, but {protocol.name} means {protocol.rule.metres:g} m: take the file "
                "of that protocol"
            )


def _texts(path: Path, cells: Any) -> list[str]:
    if not isinstance(cells, list) or not all(isinstance(cell, str) for cell in cells):
        raise BenchmarkError(
            f"the dbStruct of {path} lacks a list of photos: take the file the data set comes with"
        )
    return [cell.strip() for cell in cells]


def _metres(path: Path, given: Any, count: int) -> Float64[np.ndarray, "n 2"]:
    if not isinstance(given, np.ndarray) or given.shape != (2, count) or not np.isfinite(given).all():
        raise BenchmarkError(
            f"the dbStruct of {path} should hold 2 x {count} metres for its {count} photos: take the file the data set "
            "comes with"
        )
    return np.ascontiguousarray(given.T)


LAYOUT = Layout("dbStruct", "<set>.mat with a dbStruct, queries below queries_real/", looked_for, find, read)
