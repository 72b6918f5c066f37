"""Search by codes: a few hundred bytes a row are asked first, the best of them scored by the rows themselves.

A row's code tells where it lies along the directions in which rows differ most (`principal`), a signed byte for each;
a query is told along the same directions. One step serves all of them, so that a code is off by as much in each. What
is multiplied so ranks all rows; a few hundred that come out on top are read from where they lie and searched exactly.
So every score is that of an exact search. A row is only missed where its code leaves it behind hundreds of others.

Rows that have no code, since they are newer or what holds their codes is damaged, are searched exactly beside that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from queue import SimpleQueue
from threading import Lock
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeAlias

import numkong
import numpy as np
import numpy.typing as npt

from salad.processors import processors
from salad.search.base import (
    ArrayRows,
    Block,
    DamagedRowError,
    Hits,
    Mask,
    Numbers,
    Queries,
    Rows,
    as_mask,
    as_queries,
    check_k,
)
from salad.search.exact import ExactSearcher, Single, pieces, widened
from salad.search.principal import principal

if TYPE_CHECKING:
    from salad.search.filters import Filter

Bytes: TypeAlias = npt.NDArray[np.int8]
Half: TypeAlias = npt.NDArray[np.float16]

CANDIDATES = 500  # rows of each query that are scored exactly: benchmarks/speed/compressed.py compares others
SAMPLE = 8192  # rows that a coding is fitted on
BLOCK = 1 << 24  # bytes of codes in a block
_SPARE = 20  # candidates for each match, where many matches are asked for
_FEW = 4  # times as many rows as there are candidates are scored at once: to ask their codes first would take longer
_REACH = 4.0  # standard deviations that a byte tells apart in the widest direction
_TOP = 127  # the largest number of a code: -128 would have no opposite
_BATCH = 96  # queries multiplied with a block at one stroke
_GATHERED = 1 << 24  # numbers of rows in memory at once to be scored: 32 MiB
_WORK = 1 << 22  # multiplications that are worth a thread


@dataclass(frozen=True, eq=False, slots=True)
class Coding:
    """How rows are told by bytes.

    Attributes:
        axes: `[bytes, dim]`, directions at right angles.
        middle: `[bytes]`, where the mean of all rows lies along them.
        step: How far a row moves along a direction from one number of its code to the next.
    """

    axes: Half
    middle: Single
    step: float

    @classmethod
    def fitted(cls, rows: Rows, *, size: int, those: Numbers | None = None, seed: int = 0) -> Self:
        """A coding for rows, fitted on some of them.

        Args:
            rows: `[N, dim]`.
            size: Bytes of a code; where rows have fewer numbers than that, so many.
            those: Numbers of the rows that it may be fitted on, ascending; all of them where not given.
            seed: Of which of them are drawn, if they are many, and of the fit.

        Raises:
            StoreError: If the disk does not give the rows.
        """
        some = np.arange(len(rows)) if those is None else those
        if len(some) > SAMPLE:
            some = np.sort(np.random.default_rng(seed).choice(some, SAMPLE, replace=False, shuffle=False))
        found = principal(rows, some, count=min(size, rows.dim), seed=seed)
        axes = found.axes.astype(np.float16)
        step = _REACH * float(found.spread.max(initial=0.0)) / _TOP
        return cls(axes, axes.astype(np.float32) @ found.mean, step if step > 0 else 1.0)

    @property
    def size(self) -> int:
        """Bytes of a code."""
        return len(self.axes)

    def encode(self, rows: Block) -> Bytes:
        """Codes `[n, bytes]` of rows `[n, dim]`; that of a damaged row is of no use, and does no harm."""
        with np.errstate(all="ignore"):
            along = (widened(rows) @ widened(self.axes).T - self.middle) / np.float32(self.step)
        code: Bytes = np.clip(np.rint(np.nan_to_num(along)), -_TOP, _TOP).astype(np.int8)
        return code

    def asked(self, queries: Queries) -> Bytes:
        """Queries `[Q, dim]` of any length as they are multiplied with codes: `[Q, bytes]`, each at a scale of its own.

        Where the mean lies does not matter to them: it adds as much to every row's score.
        """
        power = 14 - np.frexp(np.abs(queries).max(axis=1, initial=0))[1]  # to where float16 is at its best
        scaled = np.ldexp(queries.astype(np.float64), power[:, None]).astype(np.float16)
        along = np.asarray(numkong.dots_packed(self.axes, numkong.dots_pack(scaled))).T
        most = np.abs(along).max(axis=1, keepdims=True)
        return np.ascontiguousarray(np.rint(along * (_TOP / np.where(most > 0, most, 1))), dtype=np.int8)


class Codes(Protocol):
    """Codes of the first rows of many, in blocks; any number of threads may ask at once."""

    @property
    def coding(self) -> Coding:
        """How they are coded."""
        ...

    def __len__(self) -> int:
        """How many rows have codes."""
        ...

    def keep(self) -> None:
        """Say that all blocks are about to be asked for."""
        ...

    def block(self, number: int, spare: Bytes) -> Bytes | None:
        """The codes of rows `number * block_rows(coding)` and on, not to be written to; None where they are damaged.

        Args:
            number: Of the block.
            spare: Memory `[block_rows(coding), bytes]` for codes that are not in memory; used where need be.
        """
        ...


def block_rows(size: int) -> int:
    """Rows in a block of codes of `size` bytes each."""
    return max(1, BLOCK // size)


class ArrayCodes:
    """Codes that are in memory.

    Args:
        coding: How rows are coded.
        rows: What is coded, all of it.
    """

    def __init__(self, coding: Coding, rows: Rows) -> None:
        self.coding = coding
        self._codes: Bytes = np.empty((len(rows), coding.size), np.int8)
        step = max(1, _GATHERED // rows.dim)
        spare: Block = np.empty((min(step, len(rows)), rows.dim), dtype=rows.dtype)
        for start in range(0, len(rows), step):
            block = rows.block(start, min(start + step, len(rows)), spare)
            if rows.longest is None:
                bad = np.flatnonzero(~np.isfinite(block).all(axis=1))
                if bad.size:
                    raise DamagedRowError(start + int(bad[0]))
            self._codes[start : start + len(block)] = coding.encode(block)

    def __len__(self) -> int:
        return len(self._codes)

    def keep(self) -> None:
        """They are in memory already."""

    def block(self, number: int, spare: Bytes) -> Bytes:  # noqa: ARG002  # they are in memory already
        """The codes of a block of rows."""
        size = block_rows(self.coding.size)
        return self._codes[number * size : (number + 1) * size]


class CompressedSearcher:
    """Finds the rows with the highest dot products, nearly always all of them.

    Args:
        rows: What is searched. Rows that are lost must not be allowed in a search.
        codes: Of these rows.
        candidates: Rows of each query that are scored exactly, at least; `CANDIDATES` where not given.
        threads: Most threads; where not given, as `ExactSearcher` has it.
    """

    takes_filters = False

    def __init__(self, rows: Rows, codes: Codes, *, candidates: int | None = None, threads: int | None = None) -> None:
        self._rows, self._codes = rows, codes
        self._candidates, self._threads = candidates or CANDIDATES, threads or processors()
        self._exact = ExactSearcher(rows, threads=threads)

    @classmethod
    def of(
        cls, rows: Rows, *, size: int = 256, candidates: int | None = None, threads: int | None = None, seed: int = 0
    ) -> Self:
        """One that makes codes of its own, in memory; `SearcherFactory` for whoever has no index.

        Raises:
            DamagedRowError: If a row may have any length and has none.
        """
        codes = ArrayCodes(Coding.fitted(rows, size=size, seed=seed), rows)
        return cls(rows, codes, candidates=candidates, threads=threads)

    @property
    def dim(self) -> int:
        """Numbers in a row."""
        return self._rows.dim

    def __len__(self) -> int:
        return len(self._rows)

    def search(self, queries: npt.NDArray[np.floating], *, k: int, allowed: Mask | Filter | None = None) -> Hits:
        """The k best rows of each query, as `Searcher.search` says, but for those that their codes leave far behind.

        Raises:
            SearchError: If the queries are of another dimension or not finite, k is below 1, or `allowed` is no mask
                of these rows.
            StoreError: If the rows lie on a disk that does not give them.
        """
        check_k(k)
        asked, mask = as_queries(queries, self.dim), as_mask(allowed, len(self))
        k = min(k, len(self))
        if not k or not len(asked):
            return Hits.none(len(asked), k)
        wanted = max(self._candidates, _SPARE * k)
        if _FEW * wanted >= len(self):
            return self._exact.search(asked, k=k, allowed=mask)
        if mask is not None and np.count_nonzero(mask) <= _FEW * wanted:
            return self._among(np.flatnonzero(mask), asked, k)
        self._codes.keep()
        found = [self._coded(some, k, wanted, mask) for some in pieces(asked, _BATCH)]
        return Hits(np.concatenate([hits.rows for hits in found]), np.concatenate([hits.scores for hits in found]))

    def _coded(self, queries: Queries, k: int, wanted: int, allowed: Mask | None) -> Hits:
        """What is found for a batch of queries: among their candidates, and among the rows that have no codes."""
        size = self._codes.coding.size
        step, best = block_rows(size), _Best(len(queries), wanted)
        blocks = -(-len(self._codes) // step)
        packed = numkong.dots_pack(self._codes.coding.asked(queries))
        threads = max(1, min(self._threads, blocks, len(self._codes) * size * len(queries) // _WORK))
        without: list[slice] = [slice(len(self._codes), len(self))]

        todo: SimpleQueue[int | None] = SimpleQueue()  # blocks that nobody has begun; behind them, an end for each
        for number in [*range(blocks), *[None] * threads]:
            todo.put(number)

        def sweep(_: int) -> None:
            spare: Bytes = np.empty((min(step, len(self._codes)), size), np.int8)
            for number in iter(todo.get, None):
                here = slice(number * step, min((number + 1) * step, len(self._codes)))
                may = None if allowed is None else allowed[here]
                if may is not None and not may.any():
                    continue
                codes = self._codes.block(number, spare)
                if codes is None:
                    without.append(here)
                else:
                    best.offer(here.start, np.asarray(numkong.dots_packed(codes, packed)), may)

        with nullcontext() if threads == 1 else ThreadPoolExecutor(threads, "salad-search") as team:
            each: Callable[..., Iterable[Any]] = map if team is None else team.map
            list(each(sweep, range(threads)))
            alone = list(each(lambda one: self._among(one[0], one[1][None], k), zip(best.rows(), queries, strict=True)))
        found = Hits(np.concatenate([one.rows for one in alone]), np.concatenate([one.scores for one in alone]))
        rest = np.zeros(len(self), np.bool_)
        for those in without:
            rest[those] = True if allowed is None else allowed[those]
        return _merged([found, self._exact.search(queries, k=k, allowed=rest)], k) if rest.any() else found

    def _among(self, those: Numbers, queries: Queries, k: int) -> Hits:
        """The k best for each query among some rows, ascending: exactly."""
        found = [Hits.none(len(queries), k)]
        for some in np.array_split(those, max(1, -(-len(those) * self.dim // _GATHERED))):
            near = ExactSearcher(ArrayRows(self._rows.take(some), longest=self._rows.longest), threads=1)
            try:
                hits = near.search(queries, k=k)
            except DamagedRowError as error:
                raise DamagedRowError(int(some[error.row])) from None
            found.append(Hits(np.where(hits.rows < 0, -1, some[hits.rows]) if len(some) else hits.rows, hits.scores))
        return _merged(found, k)


def _merged(found: list[Hits], k: int) -> Hits:
    """The k best of several, each of other rows."""
    rows, scores = (
        np.concatenate(each, axis=1) for each in zip(*((hits.rows, hits.scores) for hits in found), strict=True)
    )
    order = np.lexsort((rows, -scores), axis=1)[:, :k]
    return Hits(np.take_along_axis(rows, order, axis=1), np.take_along_axis(scores, order, axis=1))


class _Best:
    """The best rows of each query by their codes, equal ones in order of row; threads share it.

    Args:
        queries: How many.
        wanted: Rows of each.
    """

    def __init__(self, queries: int, wanted: int) -> None:
        self._queries, self._wanted = queries, wanted
        self._least = np.full(queries, np.iinfo(np.int32).min)  # whatever has less is left behind
        self._new: list[npt.NDArray[np.int64]] = []  # query, row and score: `[3, n]`
        self._held = 0  # of them were looked through
        self._lock = Lock()

    def offer(self, first: int, scores: npt.NDArray[np.int32], allowed: Mask | None) -> None:
        """Take those that matter of a block's scores `[n, queries]`, whose first row is the one named."""
        near = scores >= self._least
        if allowed is not None and not allowed.all():
            near &= allowed[:, None]
        behind = len(scores) - self._wanted
        if behind > 0 and np.count_nonzero(near) > 2 * self._wanted * self._queries:
            # So many pass at first that it pays to leave behind what the block's own best do.
            allowed_scores = np.where(near, scores, np.iinfo(np.int32).min)
            near &= scores >= np.partition(allowed_scores, behind, axis=0)[behind]
        flat = np.flatnonzero(near)
        if not len(flat):
            return
        row, query = np.divmod(flat, self._queries)
        with self._lock:
            self._new.append(np.stack([query, row + first, scores.reshape(-1)[flat]]))
            if sum(each.shape[1] for each in self._new) > self._held + self._wanted * self._queries:
                self._leave_behind()

    def rows(self) -> list[Numbers]:
        """The best rows of each query, in order of row."""
        if self._new:
            self._leave_behind()
        query, row, _ = self._new[0] if self._new else np.zeros((3, 0), np.int64)
        ends = np.searchsorted(query, np.arange(1, self._queries))
        return [np.sort(some) for some in np.split(row, ends)]

    def _leave_behind(self) -> None:
        query, row, score = every = np.concatenate(self._new, axis=1)
        every = every[:, np.lexsort((row, -score, query))]
        rank = np.arange(every.shape[1]) - np.searchsorted(every[0], every[0], "left")
        least = self._least.copy()
        last = every[:, rank == self._wanted - 1]
        least[last[0]] = last[2]
        self._least, self._new = least, [every[:, rank < self._wanted]]
        self._held = self._new[0].shape[1]
