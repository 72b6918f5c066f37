"""The sweep behind an exact search: every row against every query, by as many threads as torch may use.

A block of rows is read, widened and multiplied while it is in the processor's cache. Each thread does all three
for blocks of its own: sharing each of these short steps among threads, as torch would, costs more than the
steps. Where the processor multiplies bfloat16 by itself, many queries are swept in that, at twice the speed; it
only means that more rows are scored once more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from queue import Empty, SimpleQueue
from threading import Barrier
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import numpy.typing as npt

from salad.index.candidates import Candidates, Mask, Numbers, Queries, Scores
from salad.index.vectors import STORED, Rows

if TYPE_CHECKING:
    import torch

T = TypeVar("T")
R = TypeVar("R")
Todo = SimpleQueue[tuple[int, int]]

_WIDEN = 1 << 19  # numbers widened to float32 at a time: two megabytes, which stay in the processor's cache
_SCORES = 1 << 18  # scores a thread holds before it picks the best of them
_PARTS = 4  # parts of the work for each thread at least, so that a slow one does not keep the others waiting
_PAIRS = 64  # candidates scored once more at a time: their float64 stays in the cache too
_MANY = 16  # queries from which on bfloat16 is the quicker way; for fewer, reading and widening take the time
_FEW = 32  # matches up to which it is: more would leave too many rows to be scored once more


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What a sweep looks for: k rows of those `allowed` `[N]` for each of `queries` `[Q, dim]`.

    It multiplies in float32, or in bfloat16 where it is `coarse`.
    """

    queries: Queries
    k: int
    allowed: Mask
    coarse: bool


def best_pairs(
    rows: Rows, queries: Queries, *, k: int, allowed: Mask
) -> tuple[Numbers, Numbers, npt.NDArray[np.float64]]:
    """Pairs (query, row) that hold every best k of the allowed rows and a few more, with exact scores: `[P]` each.

    A row that holds NaN or infinity, or is longer than a descriptor can be, is damaged and never among them.

    Args:
        rows: `[N, dim]`.
        queries: `[Q, dim]`, at least one.
        k: How many are wanted for each query.
        allowed: `[N]`.

    Raises:
        StoreError: If the disk does not give the rows.
    """
    import torch

    rows.keep()
    threads = max(1, min(torch.get_num_threads(), rows.held * rows.dim // _WIDEN))
    with _team(threads) as team:
        coarse = len(queries) >= _MANY and k <= _FEW and _multiplies_bfloat16()
        best = _swept(team, rows, _Wanted(queries, k, allowed[: rows.held], coarse), threads=threads)
        leaders = best.leaders()
        exact = _rescored(team, rows, queries=queries, pairs=best.pairs(leaders))
        rivals = best.rivals(leaders, exact)
        more = _rescored(team, rows, queries=queries, pairs=best.pairs(rivals))
    return *best.pairs(np.concatenate([leaders, rivals])), np.concatenate([exact, more])


def _swept(team: Executor | None, rows: Rows, wanted: _Wanted, *, threads: int) -> Candidates:
    largest = max(1, _SCORES // len(wanted.queries))
    todo = _parts(wanted.allowed, _PARTS * threads, largest=largest)
    try:
        best, *others = _each(team, lambda _: _sweep(rows, wanted, todo), range(threads))
    finally:
        _drop(todo)  # on an error or an interrupt nobody begins another part
    for other in others:
        best.merge(other)
    return best


def _rescored(
    team: Executor | None, rows: Rows, *, queries: Queries, pairs: tuple[Numbers, Numbers]
) -> npt.NDArray[np.float64]:
    """Exact scores of pairs (query, row): `[P]`."""
    query_of, row_of = pairs
    scores = np.empty(len(row_of))
    order = np.argsort(row_of, kind="stable")  # as they lie on the disk

    def rescore(low: int) -> None:
        some = order[low : low + _PAIRS]
        scores[some] = _exact(rows, queries, query_of[some], row_of[some])

    _each(team, rescore, range(0, len(order), _PAIRS))
    return scores


def _parts(allowed: Mask, least: int, *, largest: int) -> Todo:
    """(First row, row behind the last) of parts that are equal but for one row; none without an allowed row."""
    count = max(1, least, -(-len(allowed) // largest))
    todo: Todo = SimpleQueue()
    for start, stop in pairwise(np.linspace(0, len(allowed), count + 1).astype(int).tolist()):
        if allowed[start:stop].any():
            todo.put((start, stop))
    return todo


def _drop(todo: Todo) -> None:
    try:
        while True:
            todo.get_nowait()
    except Empty:
        pass


# --- threads --------------------------------------------------------------------------------


@contextmanager
def _team(size: int) -> Iterator[Executor | None]:
    """Threads in each of which torch computes alone; None where one is enough, the caller's own.

    torch keeps the number of threads for each thread by itself, but what was set last is also what threads to
    come begin with; so it is set back here, once all have taken theirs.
    """
    if size == 1:
        yield None
        return
    import torch

    before = torch.get_num_threads()
    ready = Barrier(size + 1)

    def settle() -> None:
        torch.get_num_threads()  # a thread takes the remembered number when it first asks: be that done
        torch.set_num_threads(1)
        ready.wait()

    with ThreadPoolExecutor(size, thread_name_prefix="salad-search") as team:
        try:
            for _ in range(size):
                team.submit(settle)
            ready.wait()
        except BaseException:
            ready.abort()  # those who wait for the others need not
            raise
        torch.set_num_threads(before)
        yield team


def _each(team: Executor | None, work: Callable[[T], R], items: Iterable[T]) -> list[R]:
    return list(map(work, items) if team is None else team.map(work, items))


# --- multiplying ----------------------------------------------------------------------------


def _sweep(rows: Rows, wanted: _Wanted, todo: Todo) -> Candidates:
    """Score one part after another until none is left."""
    import torch

    # A caller may have told torch to multiply float32 as bfloat16: that is coarse too.
    coarse = wanted.coarse or torch.get_float32_matmul_precision() != "highest"
    best = Candidates(wanted.queries, k=wanted.k, coarse=coarse)
    scorer = _Scorer(rows, wanted)
    # Lower precision that a caller switched on for its model is not for scores.
    with torch.inference_mode(), torch.autocast("cpu", enabled=False):
        while True:
            try:
                start, stop = todo.get_nowait()
            except Empty:
                return best
            best.offer(start, scorer.scores(start, stop), wanted.allowed[start:stop])


class _Scorer:
    """Reads, widens and multiplies; its memory is used again for each block."""

    def __init__(self, rows: Rows, wanted: _Wanted) -> None:
        import torch

        self._rows, self._allowed = rows, wanted.allowed
        self._step = max(1, _WIDEN // rows.dim)
        self._spare = np.empty((min(self._step, rows.held), rows.dim), dtype=STORED)
        self._wide = torch.from_numpy(np.empty(self._spare.shape, dtype=np.float32))
        self._asked = torch.tensor(wanted.queries)
        self._coarse = None
        if wanted.coarse:
            self._asked = self._asked.to(torch.bfloat16)
            self._coarse = torch.empty_like(self._wide, dtype=torch.bfloat16)

    def scores(self, start: int, stop: int) -> Scores:
        """Scores `[Q, stop - start]` of these rows; -infinity for blocks of which no row is allowed."""
        import torch

        scores = torch.full((len(self._asked), stop - start), -torch.inf, dtype=self._asked.dtype)
        size = -(-(stop - start) // -(-(stop - start) // self._step))  # as few blocks as may be, all alike
        for low in range(start, stop, size):
            block_allowed = self._allowed[low : min(low + size, stop)]
            if block_allowed.any():
                block = self._rows.block(low, low + len(block_allowed), self._spare)
                at = low - start
                torch.mm(self._asked, self._widened(block).T, out=scores[:, at : at + len(block)])
        return scores.float().numpy()

    def _widened(self, block: npt.NDArray[np.float16]) -> torch.Tensor:
        import torch

        wide = self._wide[: len(block)].copy_(torch.from_numpy(block))  # many times as fast as numpy does it
        return wide if self._coarse is None else self._coarse[: len(block)].copy_(wide)


def _multiplies_bfloat16() -> bool:
    """Whether the processor has instructions for it, as far as torch tells."""
    import torch

    told: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)()  # from torch 2.8 on
    return bool(told.get("avx512_bf16") or told.get("amx_bf16"))


def _exact(rows: Rows, queries: Queries, query_of: Numbers, row_of: Numbers) -> npt.NDArray[np.float64]:
    """Dot products of pairs in float64, each by itself, so that equal rows score equally: `[len(row_of)]`."""
    import torch

    wide = torch.from_numpy(rows.take(row_of)).float().double().numpy()  # faster than at one stroke
    wide *= queries[query_of].astype(np.float64)
    scores: npt.NDArray[np.float64] = wide.sum(axis=1)
    return scores
