"""Exact search: every query against every row, best first. The only one there is; everybody calls it.

Rows pass by in blocks, so there may be more of them than memory holds. A block is multiplied in half precision by
NumKong's kernels, in threads of our own (the kernels let go of the interpreter). Such a score is rounded, but by no
more than a bound that is proven below. Rows that rounding may hide among a query's best k are its candidates; they are
scored once more in float64, each pair by itself. So equal rows have equal scores wherever they stand, neither blocks
nor threads nor the processor's kernels show in the result, and ties are in order of row.

The bound. Let s q be a query and t r a row, at scales s and t that are powers of two, and h and g the same rounded to
the kernel's type, float16 or bfloat16. The kernel multiplies h and g without error (two numbers of 11 bits make one of
22, two of 8 bits one of 16, and float32 holds 24) and adds in float32, in an order of its own. To add n numbers in
whatever order is off by at most gamma = n u / (1 - n u) times the sum of their sizes, u being what one addition may be
off by (Higham, "Accuracy and Stability of Numerical Algorithms", section 4.2); and by Cauchy and Schwarz that sum is at
most |h| |g|. So

    |kernel(h, g) - (s q) . (t r)| <= gamma |h| |g| + |h| |g - t r| + |h - s q| |t r|

where |h| and |h - s q| are known of each query, and |t r| is at most t times the longest row. |g - t r| is 0 where the
rows are of the kernel's type; else it is at most 2^-11 of their length for float16, 2^-8 for bfloat16, and 2^-25 for
each number too small to be rounded so well. Nothing overflows, since the scales keep h and g below 2^16, and what is
lost below is less than that: a product of two numbers of float16 is 2^-48 at least, and float32 holds 2^-126.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from queue import SimpleQueue
from threading import Event, Lock
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numkong
import numpy as np
import numpy.typing as npt

from salad.processors import processors
from salad.search.base import (
    Block,
    DamagedRowError,
    Hits,
    Mask,
    Numbers,
    Queries,
    Rows,
    Scores,
    as_mask,
    as_queries,
    check_k,
)

if TYPE_CHECKING:
    from salad.search.filters import Filter

Single = npt.NDArray[np.float32]

# Numbers of rows in a block, 4 MiB of float16: large enough that what a block costs besides does not show.
_BLOCK = 1 << 21
# Queries multiplied with a block at one stroke: from 128 on, the kernels take up to twice as long for each of them.
_BATCH = 96
# Numbers of the queries that rows pass by at once: the kernels keep them as float32, 256 MiB.
_TOGETHER = 1 << 26
# Candidates of a batch; more are scored exactly at once, so that memory stays small even where all rows are alike.
_CANDIDATES = 1 << 20
# Where the processor multiplies bfloat16 by itself, kernels take half the time for it. But it leaves more rows to be
# scored exactly; so it pays where rows and queries are many, and few matches are wanted of each.
_BFLOAT16 = ("genoa", "sapphireamx", "neonbfdot", "smebf16")  # NumKong's names for such processors
_MANY_ROWS, _MANY_QUERIES, _FEW = 1 << 14, 16, 32
_PAIRS = 1 << 17  # numbers scored exactly at a time: 1 MiB of float64
_WORK = 1 << 22  # multiplications that are worth a thread


class _Kernel(NamedTuple):
    """What numbers are rounded to before they are multiplied.

    Attributes:
        name: NumKong's name of the type.
        rounding: What rounding a number to it may take off it, as a part of the number.
        adding: The same of adding two sums: float32's 2^-24, or twice that where an instruction need not round to the
            nearest, as Arm's for bfloat16 does not.
    """

    name: Literal["float16", "bfloat16"]
    rounding: float
    adding: float

    def gamma(self, count: int) -> float:
        """The bound's gamma for so many numbers; two more are to spare for what float64 rounds in the rest of it."""
        off = (count + 2) * self.adding
        return off / (1 - off)


_HALF = _Kernel("float16", 2.0**-11, 2.0**-24)
_COARSE = _Kernel("bfloat16", 2.0**-8, 2.0**-23)


class ExactSearcher:
    """Finds the rows with the highest dot products.

    Args:
        rows: What is searched.
        threads: Most threads; where not given, as many as the process may use processors, or as the environment's
            `OMP_NUM_THREADS` says.
    """

    takes_filters = False

    def __init__(self, rows: Rows, *, threads: int | None = None) -> None:
        self._rows = rows
        self._threads = threads or processors()

    @property
    def dim(self) -> int:
        """Numbers in a row."""
        return self._rows.dim

    def __len__(self) -> int:
        return len(self._rows)

    def search(self, queries: npt.NDArray[np.floating], *, k: int, allowed: Mask | Filter | None = None) -> Hits:
        """The k best rows of each query, as `Searcher.search` says.

        Raises:
            SearchError: If the queries are of another dimension or not finite, k is below 1, or `allowed` is no mask
                of these rows.
            DamagedRowError: If a row may have any length and has none.
            StoreError: If the rows lie on a disk that does not give them.
        """
        check_k(k)
        asked, mask = as_queries(queries, self.dim), as_mask(allowed, len(self))
        k = min(k, len(self))
        if not k or not len(asked):
            return Hits.none(len(asked), k)
        found = [hits for some in pieces(asked, _TOGETHER // self.dim) for hits in self._search(some, k, mask)]
        return Hits(np.concatenate([hits.rows for hits in found]), np.concatenate([hits.scores for hits in found]))

    def _search(self, queries: Queries, k: int, allowed: Mask | None) -> list[Hits]:
        """Let all rows pass by these queries; what was found for each batch of them."""
        many = len(self) >= _MANY_ROWS and len(queries) >= _MANY_QUERIES and k <= _FEW
        quick = many and any(numkong.get_capabilities().get(name) for name in _BFLOAT16)
        kernel = _COARSE if quick else _HALF
        batches = [_Batch(some, _Candidates(self._rows, some, k), kernel) for some in pieces(queries, _BATCH)]
        threads = max(1, min(self._threads, len(self) * self.dim * len(queries) // _WORK))
        # Four blocks a thread at least, so that a slow one does not keep the others waiting.
        size = max(1, min(_BLOCK // self.dim, -(-len(self) // (4 * threads))))
        # Where blocks begin that nobody has begun, if a row of them is allowed; behind them, an end for each thread.
        todo: SimpleQueue[int | None] = SimpleQueue()
        for start in range(0, len(self), size):
            if allowed is None or allowed[start : start + size].any():
                todo.put(start)
        for _ in range(threads):
            todo.put(None)
        stopped = Event()

        def sweep(_: int) -> None:
            try:
                reader = _Reader(self._rows, size, allowed, kernel)
                for first in iter(todo.get, None):
                    block = reader.read(first, min(first + size, len(self)))
                    for batch in batches:
                        if stopped.is_set():  # a block may take seconds where queries are many
                            return
                        batch.offer(block)
            except BaseException:
                stopped.set()  # where this thread fails, the others need not go on
                raise

        with nullcontext() if threads == 1 else ThreadPoolExecutor(threads, "salad-search") as team:
            each: Callable[..., Iterator[Any]] = map if team is None else team.map
            try:
                list(each(sweep, range(threads)))
            except BaseException:
                stopped.set()  # on an interrupt too, or leaving would wait for all of it
                raise
            return list(each(lambda batch: batch.candidates.hits(), batches))


def pieces(queries: Queries, most: int) -> list[Queries]:
    """Queries some at a time, about as many each time."""
    return np.array_split(queries, -(-len(queries) // max(1, most)))


class _Ready(NamedTuple):
    """A block of rows that can be multiplied.

    Attributes:
        first: Number of the first row.
        rounded: `[n, dim]`, `scale` times the rows, in the kernel's type.
        scale: A power of two.
        longest: No sound row is longer than this.
        off: How far a row of `rounded` is at most from `scale` times the row.
        allowed: `[n]`, or None for all.
    """

    first: int
    rounded: Any
    scale: float
    longest: float
    off: float
    allowed: Mask | None


class _Reader:
    """Reads blocks for one thread; its memory is used again for each."""

    def __init__(self, rows: Rows, size: int, allowed: Mask | None, kernel: _Kernel) -> None:
        self._rows, self._allowed, self._kernel = rows, allowed, kernel
        shape = (min(size, len(rows)), rows.dim)
        self._spare: Block = np.empty(shape, dtype=rows.dtype)
        # A tensor of NumKong's, since numpy knows no bfloat16.
        self._rounded: Any = None if rows.dtype == kernel.name else numkong.empty(shape, dtype=kernel.name)

    def read(self, start: int, stop: int) -> _Ready:
        """Rows from `start` to `stop`; fewer where the last are lost.

        Raises:
            DamagedRowError: If a row may have any length and has none.
        """
        block = self._rows.block(start, stop, self._spare)
        allowed = None if self._allowed is None else self._allowed[start : start + len(block)]
        longest = self._rows.longest
        if longest is None:
            longest = _longest(block, start)
        if self._rounded is None or not len(block):
            return _Ready(start, block, 1.0, longest, 0.0, allowed)
        scale = 1.0
        if block.dtype == np.float32 and not 2.0**-4 <= longest < 2.0**15:
            # To where float16 is at its best. float32 holds no factor much larger than 2^100.
            scale = 2.0 ** min(100, 15 - int(np.frexp(longest)[1]))
        rounded = self._rounded[: len(block)]
        with np.errstate(all="ignore"):  # a damaged row may overflow, and shows by that
            numkong.astype(block if scale == 1 else block * np.float32(scale), self._kernel.name, out=rounded)
        off = self._kernel.rounding * scale * longest + 2.0**-25 * np.sqrt(self._rows.dim)
        return _Ready(start, rounded, scale, longest, off, allowed)


def _longest(block: Block, start: int) -> float:
    """The length of the longest row, or a little more."""
    wide = widened(block)
    with np.errstate(over="ignore", invalid="ignore"):  # it shows below
        squares = np.einsum("ij,ij->i", wide, wide)
    bad = np.flatnonzero(~np.isfinite(squares))
    if bad.size:
        raise DamagedRowError(start + int(bad[0]))
    # The sum is off by gamma, and squares below 2^-149 are lost in it.
    found = float(np.sqrt(squares.max(initial=0), dtype=np.float64))
    return found * (1 + _HALF.gamma(block.shape[1])) + 2.0**-74 * float(np.sqrt(block.shape[1]))


def widened(block: Block) -> Single:
    """A block as float32, of which numpy takes its time too."""
    if block.dtype == np.float32 or not block.size:
        return block.astype(np.float32, copy=False)
    return np.asarray(numkong.astype(block, "float32"))


class _Batch:
    """Queries that are multiplied with a block at one stroke, and the candidates of each so far."""

    def __init__(self, queries: Queries, candidates: _Candidates, kernel: _Kernel) -> None:
        """Round and pack queries `[Q, dim]`."""
        self.candidates = candidates
        self._gamma = kernel.gamma(queries.shape[1])
        # float16 reaches from 2^-24 to 2^16, and a query may have any length: a power of two, which changes no order,
        # brings its largest number just below 2^15. That bfloat16 reaches further is no harm.
        power = 15 - np.frexp(np.abs(queries).max(axis=1))[1]
        scaled = np.ldexp(queries.astype(np.float64), power[:, None])
        rounded = numkong.astype(scaled.astype(np.float32), kernel.name)
        wide = np.asarray(numkong.astype(rounded, "float32")).astype(np.float64)
        self._packed = numkong.dots_pack(rounded)
        self._scale: Scores = np.ldexp(1.0, power)
        self._length: Scores = np.linalg.norm(wide, axis=1)
        self._off: Scores = np.linalg.norm(wide - scaled, axis=1)

    def offer(self, block: _Ready) -> None:
        """Take the candidates among a block's rows."""
        if not len(block.rounded):
            return
        reach = block.scale * block.longest
        off = self._length * (self._gamma * (reach + block.off) + block.off) + self._off * reach
        # No sound row scores above this, or below its opposite; NaN and infinity show by it too.
        most = (self._length + self._off) * reach + off
        scale = self._scale * block.scale
        scores: Single = np.asarray(numkong.dots_packed(block.rounded, self._packed))
        near = scores >= _below(np.maximum(self.candidates.reached() * scale - off, -most))
        if block.allowed is not None and not block.allowed.all():
            near &= block.allowed[:, None]
        k = self.candidates.k
        if k < len(scores) and np.count_nonzero(near) > 4 * k * scores.shape[1]:
            # So many pass at first that it pays to see what the block's own k-th best keeps out. It is rounded itself,
            # and so is what is compared with it: hence twice.
            sound = np.where(near & (scores <= most), scores, np.float32(-np.inf))
            kth = -np.partition(-sound, k - 1, axis=0)[k - 1].astype(np.float64)
            near &= scores >= _below(kth - 2 * off)
        row, query = np.divmod(np.flatnonzero(near), scores.shape[1])
        score = scores[row, query].astype(np.float64)
        sane = score <= most[query]
        row, query, score = row[sane], query[sane], score[sane]
        # From here on scores are true ones: those of blocks at different scales are compared.
        low, high = ((score + side * off[query]) / scale[query] for side in (-1, 1))
        self.candidates.offer(_Pairs(query, row + block.first, low, high))


def _below(limits: Scores) -> Single:
    """Limits as float32, rounded down."""
    with np.errstate(over="ignore"):  # beyond float32 lies what no row of this block reaches
        return np.nextafter(limits.astype(np.float32), np.float32(-np.inf))


class _Pairs(NamedTuple):
    """Queries with rows `[P]` each, and between what their scores lie; the two are one where it is known exactly."""

    query: Numbers
    row: Numbers
    low: Scores
    high: Scores

    def those(self, which: Numbers | Mask) -> _Pairs:
        """Some of them, in the order given."""
        return _Pairs(self.query[which], self.row[which], self.low[which], self.high[which])


class _Candidates:
    """Rows that may be among the k best of each query, the best for sure among them; threads share it.

    Args:
        rows: What they are numbers of.
        queries: `[Q, dim]`.
        k: How many are wanted for each.
    """

    def __init__(self, rows: Rows, queries: Queries, k: int) -> None:
        self.k = k
        self._rows, self._queries = rows, queries
        none = np.zeros(0, dtype=np.int64)
        self._pairs = _Pairs(none, none, np.zeros(0), np.zeros(0))
        self._new: list[_Pairs] = []
        self._reached: Scores = np.full(len(queries), -np.inf)
        self._lock = Lock()

    def reached(self) -> Scores:
        """A score that k rows of each query reach: `[Q]`; -infinity where none is known."""
        with self._lock:
            return self._reached.copy()

    def offer(self, pairs: _Pairs) -> None:
        """Take more of them."""
        with self._lock:
            self._new.append(pairs)
            # To sort takes long where they are many: so as many more may wait as there are.
            wanted, held = len(self._queries) * self.k, len(self._pairs.row)
            if sum(len(each.row) for each in self._new) > max(wanted, held):
                self._leave_behind()
                if len(self._pairs.row) > max(_CANDIDATES, 2 * wanted):
                    self._settle()

    def hits(self) -> Hits:
        """The k best of each query."""
        with self._lock:
            self._leave_behind()
            self._settle()
            found = Hits.none(len(self._queries), self.k)
            rank = _ranks(self._pairs.query)
            found.rows[self._pairs.query, rank] = self._pairs.row
            found.scores[self._pairs.query, rank] = self._pairs.low
            return found

    def _leave_behind(self) -> None:
        """Let go of those that k others of their query leave behind for sure."""
        pairs = _Pairs(*(np.concatenate(each) for each in zip(self._pairs, *self._new, strict=True)))
        self._new = []
        order = np.lexsort((-pairs.low, pairs.query))
        kth = order[_ranks(pairs.query[order]) == self.k - 1]
        self._reached[pairs.query[kth]] = np.maximum(self._reached[pairs.query[kth]], pairs.low[kth])
        self._pairs = pairs.those(pairs.high >= self._reached[pairs.query])

    def _settle(self) -> None:
        """Score exactly what is not yet, and keep the k best."""
        pairs = self._pairs
        exact = pairs.low.copy()
        open_ = np.flatnonzero(pairs.low < pairs.high)
        open_ = open_[np.argsort(pairs.row[open_], kind="stable")]  # as they lie on the disk
        step = max(1, _PAIRS // self._rows.dim)
        for start in range(0, len(open_), step):
            some = open_[start : start + step]
            # Each pair by itself: a sum over a row takes no notice of the rows beside it, a matrix product would.
            wide = widened(self._rows.take(pairs.row[some])).astype(np.float64)
            wide *= self._queries[pairs.query[some]]
            exact[some] = wide.sum(axis=1)
        order = np.lexsort((pairs.row, -exact, pairs.query))
        order = order[_ranks(pairs.query[order]) < self.k]
        self._pairs = _Pairs(pairs.query, pairs.row, exact, exact).those(order)


def _ranks(query: Numbers) -> Numbers:
    """The place of each pair among those of its query, from 0, where pairs are in order of query."""
    return np.arange(len(query)) - np.searchsorted(query, query, "left")
