"""`dbStruct` in a MATLAB file: Pittsburgh and Tokyo 24/7 as NetVLAD's authors gave them out.

Which set, names of references, 2 x N metres, names of queries, 2 x M metres, N, M, the distance that counts as right,
its square, and the square for trivial positives. The metres do not say their UTM zone; the protocol does.

Source: Arandjelović et al., "NetVLAD: CNN architecture for weakly supervised place recognition", CVPR 2016.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from salad.datasets.compact_lists import PhotoList
from salad.datasets.coordinates import Coordinates
from salad.datasets.matlab import read_struct
from salad.datasets.readers.base import Layout, Protocol, Radius, Sides
from salad.datasets.readers.listed_photos import file_of, panoramas, photos_at
from salad.errors import BenchmarkError

_FIELDS = (
    *("whichSet", "dbImageFns", "utmDb", "qImageFns", "utmQ"),
    *("numImages", "numQueries", "posDistThr", "posDistSqThr", "nonTrivPosDistSqThr"),
)
# Where queries lie below the photos: Pittsburgh, Tokyo 24/7 in two versions, and others.
_QUERIES = ("queries_real", "247query_subset_v2", "247query_v3", "queries", "")


def read(root: Path, path: Path, protocol: Protocol) -> Sides:
    """Both sides.

    Raises:
        BenchmarkError: If the file cannot be read, its parts do not fit, or the photos are not where they may be.
    """
    fields = read_struct(path, "dbStruct")
    # Some copies call their fields otherwise, but keep their order.
    if not fields.keys() >= set(_FIELDS[1:5]):
        fields = dict(zip(_FIELDS, fields.values(), strict=False))
    # A file for another distance looks just the same, and would judge by it in silence.
    distance = fields.get("posDistThr")
    if isinstance(distance, np.ndarray) and distance.size == 1 and isinstance(protocol.rule, Radius):
        metres = float(distance.ravel()[0])
        if metres != protocol.rule.metres:
            raise BenchmarkError(
                f"{path} calls {metres:g} m right, but {protocol.name} means {protocol.rule.metres:g} m: take the file "
                "of that protocol"
            )
    # The names are below a folder that the file does not name, and each copy of a set has its own.
    homes = [root, root / "images", path.parent, root / "raw_data", *(root / stem for stem in protocol.stems)]
    below = [home / queries for home in homes for queries in _QUERIES]
    references, theirs = _side(path, fields.get("dbImageFns"), fields.get("utmDb"), homes, protocol.zone)
    queries, ours = _side(path, fields.get("qImageFns"), fields.get("utmQ"), below, protocol.zone)
    return Sides(
        references,
        queries,
        coordinates=(ours, theirs),
        groups=panoramas([name.strip() for name in fields["qImageFns"]]),
    )


def _side(path: Path, names: Any, metres: Any, tried: Iterable[Path], zone: str) -> tuple[PhotoList, Coordinates]:
    """One side's photos, below the first of some folders that holds them, and where they stand."""
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise BenchmarkError(f"the dbStruct of {path} lacks a list of photos: take the file the data set comes with")
    if not isinstance(metres, np.ndarray) or metres.shape != (2, len(names)) or not np.isfinite(metres).all():
        raise BenchmarkError(
            f"the dbStruct of {path} should hold 2 x {len(names)} metres for its {len(names)} photos: take the file "
            "the data set comes with"
        )
    places = Coordinates.in_zone(np.ascontiguousarray(metres.T), zone)
    return photos_at(names, tried, listed_in=path, where=places.lat_lon), places


LAYOUT = Layout(
    "dbStruct",
    "<set>.mat with a dbStruct, queries below queries_real/",
    lambda protocol: [f"{stem}.mat" for stem in protocol.stems],
    lambda root, protocol: file_of(root, [f"{stem}.mat" for stem in protocol.stems]),
    read,
)
