"""Three arrays, as many repositories ship them: names of references, names of queries, and what is right.

    <set>_dbImages.npy, <set>_qImages.npy, <set>_gt.npy
    msls_val_dbImages.npy, msls_val_qImages.npy, msls_val_qIdx.npy (which queries count), msls_val_pIdx.npy

What is right comes as an object array, which is a pickle; nothing in it is run.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salad.datasets.compact_lists import Ragged
from salad.datasets.readers.base import Layout, Protocol, Sides
from salad.datasets.readers.listed_photos import file_of, panoramas, photos_at
from salad.datasets.safe_numpy import read_npy
from salad.errors import BenchmarkError

_REFERENCES = "_dbimages.npy"  # in small letters, since files are found by either


def read(root: Path, path: Path, protocol: Protocol) -> Sides:
    """Both sides and what is right.

    Raises:
        BenchmarkError: If an array is missing, damaged or does not fit, or the photos are not where they may be.
    """
    stem = path.name[: -len(_REFERENCES)]
    theirs, ours = read_npy(path).texts(), read_npy(_beside(path, f"{stem}_qImages.npy")).texts()
    # MSLS' truth is kept for the queries that count alone, and another file says which these are.
    truth = _beside(path, f"{stem}_gt.npy", f"{stem}_pIdx.npy")
    positives = read_npy(truth).rows()
    counted = file_of(path.parent, [f"{stem}_qIdx.npy"])
    if counted is not None:
        positives = _spread(positives, counted, len(ours))
    if len(positives) != len(ours):
        raise BenchmarkError(
            f"{truth} says what is right for {len(positives)} queries, but there are {len(ours)}: fetch the files of "
            "one set"
        )
    # Checked here, and not by the benchmark, since here the file to blame is known.
    for row, right in enumerate(positives):
        if right.size and not (right.min() >= 0 and right.max() < len(theirs)):
            raise BenchmarkError(
                f"{truth} calls a reference right for query {row} that is not among {len(theirs)}: fetch the files of "
                "one set"
            )
    homes = [root, path.parent, root / "images", path.parent.parent]
    homes += [root / stem for stem in protocol.stems]
    return Sides(
        photos_at(theirs, [*homes, *(home / "ref" for home in homes)], listed_in=path),
        photos_at(ours, [*homes, *(home / "query" for home in homes)], listed_in=path),
        positives=Ragged.of(map(np.unique, positives)),
        groups=panoramas(ours),
        told_by=truth.name,
    )


def _beside(path: Path, *names: str) -> Path:
    found = next((file for name in names if (file := file_of(path.parent, [name])) is not None), None)
    if found is None:
        raise BenchmarkError(f"beside {path} there is no {' or '.join(names)}: fetch it from where that file is from")
    return found


def _spread(positives: list[NDArray[np.int64]], counted: Path, queries: int) -> list[NDArray[np.int64]]:
    """Positives for all queries, where the file holds those of the ones that count: nothing for the others."""
    found = read_npy(counted).rows()
    rows = np.concatenate(found) if found else np.zeros(0, dtype=np.int64)
    once = rows.size == np.unique(rows).size and ((rows >= 0) & (rows < queries)).all()
    if rows.size != len(positives) or not once:
        raise BenchmarkError(
            f"{counted} should name {len(positives)} of {queries} queries, each once: fetch the files of one set"
        )
    spread = [np.zeros(0, dtype=np.int64) for _ in range(queries)]
    for row, right in zip(rows.tolist(), positives, strict=True):
        spread[row] = right
    return spread


LAYOUT = Layout(
    "npy triple",
    "<set>_dbImages.npy, <set>_qImages.npy, <set>_gt.npy",
    lambda protocol: [f"{stem}_{{dbImages,qImages,gt}}.npy" for stem in protocol.stems],
    lambda root, protocol: file_of(root, [stem + _REFERENCES for stem in protocol.stems]),
    read,
)
