"""The directions in which rows differ most (principal components), found without ever holding the rows.

All directions of 8,448 numbers would take a covariance of 285 MB and minutes. A few hundred are found by letting a
random guess of them be turned by the covariance a few times, for which rows pass by in blocks.

Source: Halko, Martinsson, Tropp, "Finding Structure with Randomness", SIAM Review 2011, algorithms 4.4 and 5.3.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salad.search.base import UNIT_TOLERANCE, Numbers, Rows
from salad.search.exact import widened

Single = npt.NDArray[np.float32]

_STEP = 1024  # rows widened at once
_SPARE = 32  # so many more directions are sought than wanted, that the last of them are right too
_TURNS = 3  # of the guess


class Principal(NamedTuple):
    """Where rows lie and how they spread.

    Attributes:
        mean: `[dim]` of the rows.
        axes: `[count, dim]`, directions of length 1 at right angles, that of the widest spread first.
        spread: `[count]`, standard deviations along them.
    """

    mean: Single
    axes: Single
    spread: Single


def principal(rows: Rows, those: Numbers, *, count: int, seed: int = 0) -> Principal:
    """The directions in which rows differ most; damaged rows are left out.

    Args:
        rows: `[N, dim]`.
        those: Numbers of the rows that are looked at, ascending.
        count: How many directions, at most `dim`.
        seed: Of the guess that is begun with.

    Raises:
        StoreError: If the disk does not give the rows.
    """
    total, found = np.zeros(rows.dim), 0
    for block in _sound(rows, those):
        total += block.sum(axis=0, dtype=np.float64)
        found += len(block)
    mean = (total / max(1, found)).astype(np.float32)

    def turned(axes: Single) -> Single:
        """The covariance times `[dim, n]` directions."""
        out = np.zeros(axes.shape, np.float32)
        for block in _sound(rows, those):
            block -= mean
            out += block.T @ (block @ axes)
        return out / np.float32(max(1, found))

    guess = np.random.default_rng(seed).standard_normal((rows.dim, min(count + _SPARE, rows.dim)), dtype=np.float32)
    axes = np.linalg.qr(guess)[0]
    for _ in range(_TURNS):
        axes = np.linalg.qr(turned(axes))[0]
    # What is left is small: the covariance among the directions found.
    size, along = np.linalg.eigh(axes.T @ turned(axes))
    widest = np.argsort(-size, kind="stable")[:count]
    return Principal(mean, np.ascontiguousarray((axes @ along[:, widest]).T), np.sqrt(np.maximum(size[widest], 0)))


def _sound(rows: Rows, those: Numbers) -> Iterator[Single]:
    """The rows that are finite and, where rows have a length, have it; widened, some at a time."""
    for low in range(0, len(those), _STEP):
        block = widened(rows.take(those[low : low + _STEP]))
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(np.einsum("ij,ij->i", block, block))
        good = np.isfinite(length) if rows.longest is None else np.abs(length - 1) <= 2 * UNIT_TOLERANCE
        yield block[good]
