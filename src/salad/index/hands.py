"""The hands that read photos while the model works: threads, each with a helper process where there are many."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import islice
from typing import TypeVar

from salad.helpers import Helpers
from salad.reading import Here

T = TypeVar("T")
R = TypeVar("R")

FEW = 32
"""Fewer photos are read in threads: helpers would take longer to start."""
_LARGEST = 2 << 30  # bytes that the largest photo takes while it is decoded


@contextmanager
def workers() -> Iterator[Executor]:
    """Threads for reading photos; on an error or an interrupt what they have not begun is dropped."""
    pool = ThreadPoolExecutor(_hands(), thread_name_prefix="salad-photos")
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def reader_for(photos: int) -> Iterator[Here]:
    """What reads that many photos for the threads: helpers, unless there are few."""
    reader = Here() if photos < FEW else Helpers(_hands())
    try:
        yield reader
    finally:
        reader.close()


def _hands() -> int:
    """How many photos are read at a time: one a core, and each with memory for the largest photo there is."""
    hands = min(8, os.cpu_count() or 1)
    with suppress(AttributeError, OSError, ValueError):  # no such call, or no such number, on this system
        hands = min(hands, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // _LARGEST)
    return max(1, hands)


def in_order(pool: Executor, work: Callable[[T], R], items: Iterable[T], *, ahead: int) -> Iterator[R]:
    """`map` over `pool` that keeps the order and never has more than `ahead` items in hand."""
    source = iter(items)
    waiting: deque[Future[R]] = deque()
    while True:
        waiting.extend(pool.submit(work, item) for item in islice(source, ahead - len(waiting)))
        if not waiting:
            return
        yield waiting.popleft().result()
