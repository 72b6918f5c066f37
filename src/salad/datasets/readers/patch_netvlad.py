"""An `.npz` of metres (`utmQ`, `utmDb`, `posDistThr`) and two lists of names, as Patch-NetVLAD's authors gave them out.

    <set>.npz, <set>_imageNames_index.txt, <set>_imageNames_query.txt

The lists may also be arrays in the file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from salad.datasets.coordinates import Coordinates
from salad.datasets.neighbours import near_on_map
from salad.datasets.readers.base import Layout, Protocol, Radius, Sides
from salad.datasets.readers.listed_photos import file_of, panoramas, photos_at
from salad.datasets.safe_numpy import Arrays, read_npz
from salad.errors import BenchmarkError, reason
from salad.tables import read_lines

# What the two lists are called where they are arrays in the file: every copy has its own names.
_LISTS = (("dbImages", "qImages"), ("dbImageFns", "qImageFns"), ("imageNames_index", "imageNames_query"))


def read(root: Path, path: Path, protocol: Protocol) -> Sides:
    """Both sides and what is right.

    Raises:
        BenchmarkError: If a file is missing, damaged or does not fit, or the photos are not where they may be.
    """
    arrays = read_npz(path)
    missing = [name for name in ("utmQ", "utmDb", "posDistThr") if name not in arrays]
    if missing:
        raise BenchmarkError(f"{path} holds no {missing[0]}: take the file that the data set comes with")
    theirs, ours = _lists(root, path, protocol, arrays)
    their_places = Coordinates.in_zone(_metres(path, arrays["utmDb"], len(theirs)), protocol.zone)
    our_places = Coordinates.in_zone(_metres(path, arrays["utmQ"], len(ours)), protocol.zone)
    # Within which distance these files count a reference as right stands in them, and must be the protocol's.
    radius = arrays["posDistThr"].numbers().ravel()
    wanted = protocol.rule.metres if isinstance(protocol.rule, Radius) else None
    if radius.size != 1 or not 0 < radius[0] < 1e6 or (wanted is not None and radius[0] != wanted):
        raise BenchmarkError(
            f"{path} calls {radius.tolist()[:3]} m right, but {protocol.name} means {protocol.rule}: take the file of "
            "that protocol"
        )
    homes = [root, root / "images", path.parent, root.parent, *(root / stem for stem in protocol.stems)]
    below = [*homes, *(home / "queries_real" for home in homes)]
    return Sides(
        photos_at(theirs, homes, listed_in=path, where=their_places.lat_lon),
        photos_at(ours, below, listed_in=path, where=our_places.lat_lon),
        positives=near_on_map(our_places, their_places, float(radius[0])),
        groups=panoramas(ours),
        told_by=path.name,
    )


def _lists(root: Path, path: Path, protocol: Protocol, arrays: dict[str, Arrays]) -> tuple[list[str], list[str]]:
    """Names of references and of queries."""
    for references, queries in _LISTS:
        if references in arrays and queries in arrays:
            return arrays[references].texts(), arrays[queries].texts()
    stems = dict.fromkeys([path.stem, *protocol.stems])
    files = [file_of(root, [f"{stem}_imageNames_{side}.txt" for stem in stems]) for side in ("index", "query")]
    if files[0] is None or files[1] is None:
        raise BenchmarkError(
            f"{path} comes with two lists of names, {path.stem}_imageNames_index.txt and ..._query.txt, which are not "
            f"below {root}: fetch them from where it is from"
        )
    return _lines(files[0]), _lines(files[1])


def _lines(path: Path) -> list[str]:
    try:
        return [line.strip() for line in read_lines(path) if line.strip()]
    except (OSError, ValueError) as error:
        raise BenchmarkError(f"the list {path} cannot be read ({reason(error)}): fetch it again") from error


def _metres(path: Path, given: Arrays, count: int) -> Float64[np.ndarray, "n 2"]:
    metres = given.numbers()
    # Some copies have a line for east and one for north. Two photos are a square either way, and read as written.
    if metres.shape != (count, 2) and metres.shape == (2, count):
        metres = metres.T
    if metres.shape != (count, 2) or not np.isfinite(metres).all():
        raise BenchmarkError(f"{path} should hold metres for {count} photos, but has {metres.shape}: fetch both again")
    return np.ascontiguousarray(metres)


LAYOUT = Layout(
    "npz",
    "<set>.npz with utmQ, utmDb, posDistThr, and two lists of names",
    lambda protocol: [f"{stem}.npz with {stem}_imageNames_{{index,query}}.txt" for stem in protocol.stems],
    lambda root, protocol: file_of(root, [f"{stem}.npz" for stem in protocol.stems]),
    read,
)
