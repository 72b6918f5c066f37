"""`descriptors.f16`: one row a photo, raw little-endian float16, only ever appended to.

The file does not know its own length. How many rows count is the ledger's word (see `ledger.py`); bytes
behind them are what an interrupted `add` left, and the next `add` writes over them.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salad.errors import StoreError

Half = npt.NDArray[np.float16]
STORED = np.dtype("<f2")
UNIT_TOLERANCE = 0.01  # a length further from 1 is no rounding: the descriptor was not normalised


def storable(descriptors: npt.NDArray[np.floating], count: int, dim: int) -> Half:
    """Descriptors of `count` photos as they are stored: `[count, dim]` float16.

    Raises:
        StoreError: If their shape is another, or a row is not finite and of length 1.
    """
    given = np.asarray(descriptors)
    if given.shape != (count, dim):
        raise StoreError(
            f"{count} photos need descriptors of shape {[count, dim]}, but these have {list(given.shape)}: "
            "describe them with the index's own model"
        )
    lengths = np.linalg.norm(given.astype(np.float32), axis=1)
    if not (np.abs(lengths - 1) <= UNIT_TOLERANCE).all():
        raise StoreError("descriptors must be finite and of length 1: normalise them, or check the model")
    return given.astype(STORED)


def append(path: Path, rows: Half, *, at: int) -> None:
    """Write `rows` behind the `at` rows that count, and see them onto the disk.

    Args:
        path: The matrix file.
        rows: `[N, dim]` float16.
        at: Rows that are already committed; whatever lies behind them is written over.

    Raises:
        StoreError: If the disk is full or the file cannot be written; what was committed is untouched.
    """
    start = at * rows.shape[1] * STORED.itemsize
    try:
        with path.open("r+b") as file:
            try:
                file.seek(start)
                file.write(np.ascontiguousarray(rows, dtype=STORED).data)
                file.flush()
                os.fsync(file.fileno())
            except OSError:
                with suppress(OSError):
                    file.truncate(start)  # give the space back: on a full disk others need it
                raise
    except OSError as error:
        raise StoreError(
            f"{path} cannot be written ({error.strerror}): nothing was added; make room, or check permissions"
        ) from error


def view(path: Path, rows: int, dim: int) -> Half:
    """Map the first `rows` rows, read only: `[rows, dim]` float16.

    Raises:
        StoreError: If the file is missing or holds fewer rows than were committed.
    """
    if rows == 0:
        return np.zeros((0, dim), dtype=np.float16)
    try:
        size = path.stat().st_size
    except OSError as error:
        raise StoreError(f"{path} is missing: restore it, or index the photos again") from error
    held = size // (dim * STORED.itemsize)
    if held < rows:
        raise StoreError(
            f"{path} is truncated (it holds {held} descriptors, {rows} were committed): restore it, or index "
            "the photos again"
        )
    return np.asarray(np.memmap(path, dtype=STORED, mode="r", shape=(rows, dim)))
