"""What every search keeps to: rows of numbers go in; the rows most like a query, and how alike, come out.

Nothing here knows of photos, models or SQLite. An index has its rows in a file, an evaluation in memory or in somebody
else's `.npy`, training in a file that it throws away; each gives them to a `Searcher` by the one protocol `Rows`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from salad.errors import SearchError

if TYPE_CHECKING:
    from salad.search.filters import Filter

Queries: TypeAlias = npt.NDArray[np.float32]
Mask: TypeAlias = npt.NDArray[np.bool_]
Numbers: TypeAlias = npt.NDArray[np.int64]
Scores: TypeAlias = npt.NDArray[np.float64]
Block: TypeAlias = npt.NDArray[np.floating]  # float16 or float32

UNIT_TOLERANCE = 0.01  # a length further from 1 is no rounding: the descriptor was not normalised
LONGEST_UNIT = 1 + 2 * UNIT_TOLERANCE  # of a row of length 1, given with that tolerance and stored as float16


class DamagedRowError(SearchError):
    """A row is no descriptor, and nobody said that it may be passed over.

    Attributes:
        row: Its number.
    """

    def __init__(self, row: int) -> None:
        """Name the row."""
        super().__init__(
            f"the descriptor of row {row} (from 0) holds NaN, infinity or numbers too large to multiply: check the "
            "model and the photo it came from"
        )
        self.row = row

    def __reduce__(self) -> tuple[type[DamagedRowError], tuple[int]]:
        return type(self), (self.row,)  # else another process would be given its sentence for a row


class Rows(Protocol):
    """Descriptors, one a row `[N, dim]`, read where and when they are asked for, by any number of threads at once."""

    @property
    def dim(self) -> int:
        """Numbers in a row."""
        ...

    @property
    def dtype(self) -> np.dtype[np.floating]:
        """What a row's numbers are: float16 or float32, in the machine's own order of bytes."""
        ...

    @property
    def longest(self) -> float | None:
        """No sound row is longer than this; damaged ones are passed over.

        A row that holds NaN or infinity is never found, and one that is too long is not where it scores higher than a
        sound row can. Nobody needs to measure rows for that.

        None where rows may have any length and a damaged one must not pass: then each is measured as it passes by, and
        one whose length is no number is a `DamagedRowError`.
        """
        ...

    def __len__(self) -> int:
        """How many there are."""
        ...

    def block(self, start: int, stop: int, spare: Block) -> Block:
        """The rows from `start` to `stop`, not to be written to; fewer where the last of them are lost.

        Args:
            start: The first row.
            stop: The row behind the last.
            spare: Memory `[n, dim]` of this type, n >= stop - start, for rows that are not in memory; used where
                need be.
        """
        ...

    def take(self, rows: Numbers) -> Block:
        """These rows, in the order given: `[len(rows), dim]`."""
        ...


class ArrayRows:
    """Rows that are in memory.

    Args:
        descriptors: `[N, dim]`; float16 and float32 stay what they are, anything else becomes float32.
        longest: As in `Rows`: None for descriptors of any length, of which each must be sound.
    """

    def __init__(self, descriptors: npt.NDArray[np.floating], *, longest: float | None = None) -> None:
        # float64 is more than descriptors say, and no kernel of ours takes it.
        kind = np.float16 if descriptors.dtype.type is np.float16 else np.float32
        with np.errstate(over="ignore"):  # what is beyond float32 is a damaged row, and told as such
            self._rows: Block = np.ascontiguousarray(descriptors, dtype=kind)
        self.longest = longest

    @property
    def dim(self) -> int:
        """Numbers in a row."""
        return int(self._rows.shape[1])

    @property
    def dtype(self) -> np.dtype[np.floating]:
        """float16 or float32."""
        return self._rows.dtype

    def __len__(self) -> int:
        return len(self._rows)

    def block(self, start: int, stop: int, spare: Block) -> Block:  # noqa: ARG002  # they are in memory already
        """The rows from `start` to `stop`."""
        return self._rows[start:stop]

    def take(self, rows: Numbers) -> Block:
        """These rows, in the order given: `[len(rows), dim]`."""
        return self._rows[rows]


@dataclass(frozen=True, eq=False, slots=True)
class Hits:
    """What was found for each query, best first, equal scores in order of row.

    Attributes:
        rows: `[Q, k]` numbers of rows, -1 where there is no more.
        scores: `[Q, k]` dot products of query and row, -infinity where there is no more.
    """

    rows: Numbers
    scores: Scores

    @classmethod
    def none(cls, queries: int, k: int) -> Hits:
        """Nothing found yet, to be filled in."""
        return cls(np.full((queries, k), -1, dtype=np.int64), np.full((queries, k), -np.inf))


class Searcher(Protocol):
    """The seam that every search engine keeps, whatever holds the rows; tests/search/test_contract.py sees to it."""

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        ...

    @property
    def takes_filters(self) -> bool:
        """Whether it knows where and when its rows were taken, as a database of vectors may, and so takes a filter.

        Any other is given a mask by whoever knows.
        """
        ...

    def __len__(self) -> int:
        """How many rows are searched; some of them may be damaged or lost."""
        ...

    def search(self, queries: npt.NDArray[np.floating], *, k: int, allowed: Mask | Filter | None = None) -> Hits:
        """The k best rows of each query; any number of threads may ask at once.

        Args:
            queries: `[Q, dim]`, of any length.
            k: How many, at least one. `Hits` are `[Q, min(k, N)]`.
            allowed: Which rows may come out, as a mask `[N]` or, where it `takes_filters`, a filter; all of them
                where not given. It holds before the ranking.

        Raises:
            SearchError: If the queries are of another dimension or not finite, k is below 1, or the mask is of other
                rows.
        """
        ...


SearcherFactory: TypeAlias = Callable[[Rows], Searcher]


def as_queries(queries: npt.NDArray[np.floating], dim: int) -> Queries:
    """Queries as float32 `[Q, dim]`.

    Raises:
        SearchError: If they are not of dimension `dim`, or not all finite.
    """
    with np.errstate(over="ignore"):  # before it is looked at: a float64 may be infinite there
        asked = np.asarray(queries, dtype=np.float32)
    if asked.ndim != 2 or asked.shape[1] != dim:
        raise SearchError(
            f"these queries have shape {list(asked.shape)}, but rows of {dim} numbers are searched: describe both with "
            "one model"
        )
    bad = np.flatnonzero(~np.isfinite(asked).all(axis=1))
    if bad.size:
        raise SearchError(
            f"the descriptor of query {bad[0]} (from 0) holds NaN or infinity: check the model and the photo it came "
            "from"
        )
    return np.ascontiguousarray(asked)


def as_mask(allowed: Mask | Filter | None, rows: int) -> Mask | None:
    """What a searcher that takes no filters was given.

    Raises:
        SearchError: If it is a filter, or is not `[rows]` of true and false.
    """
    # Numbers would be taken for a mask here and for rows there.
    if allowed is None or (isinstance(allowed, np.ndarray) and allowed.shape == (rows,) and allowed.dtype == np.bool_):
        return allowed
    given = f"{allowed.dtype} of shape {list(allowed.shape)}" if isinstance(allowed, np.ndarray) else "a filter"
    raise SearchError(f"{rows} rows are searched, and a mask says which of them may be found: this is {given}")


def check_k(k: int) -> None:
    """Make sure that something is asked for.

    Raises:
        SearchError: If k is below 1.
    """
    if k < 1:
        raise SearchError(f"k is {k}: ask for at least one match")
