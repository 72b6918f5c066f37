"""Ways to search descriptors by fewer bytes: salad's codes, and what FAISS and usearch offer, each as one `Way`.

All are given the same rows and the same sample to learn from, and none is tuned: where a library has a default it is
kept, else the constants here say what was taken. Rows go in as float16, which each library widens as it needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import faiss
import numkong
import numpy as np
import numpy.typing as npt
from usearch.index import Index as UsearchIndex

from benchmarks.accuracy.real_descriptors import Half
from salad.search.base import LONGEST_UNIT, ArrayRows, Hits, Numbers, Queries
from salad.search.compressed import Coding
from salad.search.exact import ExactSearcher
from salad.search.principal import principal

OURS, PRODUCTS = (32, 64, 128, 256), (64, 128, 256)  # bytes of a code
LEARNT_FROM = 10_000  # rows for FAISS: so many it asks for, for 256 centroids
TURNS = 10  # of k-means
LISTS, PROBED = 128, 32  # of IVF
REDUCED = 512  # directions before OPQ, which for 8,448 would take hours
LINKS, BUILT, ASKED = 32, 40, (16, 64, 256)  # of HNSW: FAISS's defaults, and efSearch
EXPANSION = 256  # of usearch's graph, when it is searched
_STEP = 1000  # rows widened at once

Find = Callable[[Queries, int], Numbers]


@dataclass(frozen=True)
class Way:
    """One way to search.

    Attributes:
        name: Of the way.
        setting: Of its parameters, those that another way of this name has otherwise.
        code: Bytes of what stands for a row.
        beside: Bytes that are kept for each row besides: links of a graph, the row's number.
        shared: Bytes that are kept once, however many rows there are.
        find: Rows `[Q, count]` for queries `[Q, dim]`, best first; -1 where there is no more.
        whole: Whether it holds rows in half precision, so that there is nothing to be scored better.
    """

    name: str
    setting: str
    code: int
    beside: float
    shared: int
    find: Find
    whole: bool = False


def ways(rows: Half, *, seed: int) -> Iterator[Way]:
    """All of them, one after the other, for rows `[N, dim]` of length 1."""
    for size in OURS:
        yield salad_codes(rows, size, seed=seed)
    some = np.sort(np.random.default_rng(seed).choice(len(rows), min(LEARNT_FROM, len(rows)), replace=False))
    for size in PRODUCTS:
        yield ivf_pq(rows, some, size, seed=seed)
    # The axes are the same for all sizes.
    found = principal(ArrayRows(rows), some, count=min(REDUCED, rows.shape[1]), seed=seed)
    reduced = np.concatenate([(block - found.mean) @ found.axes.T for block in widened(rows)])
    for size in PRODUCTS:
        yield opq(reduced, found.axes, some, size)
    yield from hnsw(rows)
    yield usearch_bytes(rows)
    yield usearch_bits(rows)


def salad_codes(rows: Half, size: int, *, seed: int) -> Way:
    """Principal components, a signed byte each, as `salad compress` makes them."""
    coding = Coding.fitted(ArrayRows(rows, longest=LONGEST_UNIT), size=size, seed=seed)
    codes = np.concatenate([coding.encode(rows[at : at + _STEP]) for at in range(0, len(rows), _STEP)])

    def find(queries: Queries, count: int) -> Numbers:
        scores = np.asarray(numkong.dots_packed(codes, numkong.dots_pack(coding.asked(queries)))).T
        best = np.argpartition(scores, -count, axis=1)[:, -count:]
        order = np.argsort(-np.take_along_axis(scores, best, axis=1), axis=1, kind="stable")
        return np.take_along_axis(best, order, axis=1)

    return Way("salad", f"{coding.size} bytes", coding.size, 0, coding.axes.nbytes + coding.middle.nbytes, find)


def ivf_pq(rows: Half, some: Numbers, size: int, *, seed: int) -> Way:
    """FAISS's inverted lists of products of 256 centroids each, of what is left of the list's centre."""
    dim = rows.shape[1]
    index = faiss.IndexIVFPQ(faiss.IndexFlatIP(dim), dim, LISTS, size, 8, faiss.METRIC_INNER_PRODUCT)
    index.cp.niter = index.pq.cp.niter = TURNS
    index.cp.seed = index.pq.cp.seed = seed
    index.train(rows[some].astype(np.float32))
    for block in widened(rows):
        index.add(block)
    probed = faiss.SearchParametersIVF(nprobe=PROBED)
    shared = 4 * dim * (LISTS + 256)  # centres of the lists, and centroids of all parts together
    return Way(
        "FAISS IVF-PQ", f"{size} bytes", size, 8, shared, lambda queries, k: index.search(queries, k, params=probed)[1]
    )


def opq(reduced: npt.NDArray[np.float32], axes: npt.NDArray[np.float32], some: Numbers, size: int) -> Way:
    """FAISS's products of rows that were reduced and then turned so that they lose least (OPQ), each compared."""
    dim = reduced.shape[1]
    turn = faiss.OPQMatrix(dim, size)
    turn.niter, turn.niter_pq, turn.niter_pq_0 = TURNS, 4, TURNS
    turn.train(reduced[some])
    index = faiss.IndexPQ(dim, size, 8, faiss.METRIC_INNER_PRODUCT)
    index.pq.cp.niter = TURNS
    turned = turn.apply(reduced)
    index.train(turned[some])
    index.add(turned)
    shared = 4 * (axes.size + dim * dim + 256 * dim)  # axes, the turn, centroids

    def find(queries: Queries, count: int) -> Numbers:
        found: Numbers = index.search(turn.apply(queries @ axes.T), count)[1]
        return found

    return Way("FAISS PCA, OPQ", f"{size} bytes", size, 0, shared, find)


def hnsw(rows: Half) -> Iterator[Way]:
    """FAISS's graph of the rows themselves, in half precision."""
    index = faiss.IndexHNSWSQ(rows.shape[1], faiss.ScalarQuantizer.QT_fp16, LINKS, faiss.METRIC_INNER_PRODUCT)
    index.hnsw.efConstruction = BUILT
    index.train(rows[:_STEP].astype(np.float32))
    for block in widened(rows):
        index.add(block)
    graph = index.hnsw
    beside = (4 * graph.neighbors.size() + 8 * graph.offsets.size() + 4 * graph.levels.size()) / len(rows)
    for wide in ASKED:
        asked = faiss.SearchParametersHNSW(efSearch=wide)
        yield Way(
            "FAISS HNSW",
            f"efSearch {wide}",
            2 * rows.shape[1],
            beside,
            0,
            lambda queries, count, asked=asked: index.search(queries, count, params=asked)[1],
            whole=True,
        )


def usearch_bytes(rows: Half) -> Way:
    """A graph by usearch, of rows as signed bytes at one step for all: its own step takes 1 for the largest number."""
    most = float(np.quantile(np.abs(rows[: 10 * _STEP].astype(np.float32)), 0.99999))
    index = UsearchIndex(ndim=rows.shape[1], metric="ip", dtype="i8", expansion_search=EXPANSION)
    for at in range(0, len(rows), _STEP):
        block = rows[at : at + _STEP].astype(np.float32)
        index.add(np.arange(at, at + len(block)), as_bytes(block, most), threads=1)

    def asked(queries: Queries) -> npt.NDArray[np.int8]:
        return as_bytes(queries, np.abs(queries).max(axis=1, keepdims=True))

    return _usearch(index, "i8", rows.shape[1], asked)


def usearch_bits(rows: Half) -> Way:
    """A graph by usearch, of a bit a number: on which side of the rows' mean it lies."""
    mean = np.mean([block.mean(axis=0) for block in widened(rows)], axis=0)
    index = UsearchIndex(ndim=rows.shape[1], metric="hamming", dtype="b1", expansion_search=EXPANSION)
    for number, block in enumerate(widened(rows)):
        index.add(number * _STEP + np.arange(len(block)), np.packbits(block > mean, axis=1), threads=1)
    # Queries were moved by half of the mean already; what is left of it is taken out here.
    return _usearch(index, "b1", rows.shape[1] // 8, lambda queries: np.packbits(queries > mean / 2, axis=1))


def _usearch(index: UsearchIndex, kind: str, code: int, asked: Callable[[Queries], npt.NDArray[np.generic]]) -> Way:
    beside = index.serialized_length / len(index) - code

    def find(queries: Queries, count: int) -> Numbers:
        best = np.full((len(queries), count), -1)
        for number, query in enumerate(asked(queries)):
            keys = index.search(query, count, threads=1).keys
            best[number, : len(keys)] = keys
        return best

    return Way(f"usearch {kind}", f"expansion {EXPANSION}", code, beside, 0, find)


def as_bytes(rows: npt.NDArray[np.float32], most: float | npt.NDArray[np.float32]) -> npt.NDArray[np.int8]:
    """Rows as signed bytes, of which 127 stands for `most` or more."""
    return np.clip(np.rint(rows * (127 / most)), -127, 127).astype(np.int8)


def widened(rows: Half) -> Iterator[npt.NDArray[np.float32]]:
    """Rows as float32, some at a time."""
    for at in range(0, len(rows), _STEP):
        yield rows[at : at + _STEP].astype(np.float32)


def rescored(rows: Half, queries: Queries, candidates: Numbers, k: int) -> Numbers:
    """The k best of each query's candidates `[Q, count]` by exact scores; -1 where there is no more."""
    best = np.full((len(queries), k), -1)
    for number, (query, each) in enumerate(zip(queries, candidates, strict=True)):
        those = np.sort(each[each >= 0])
        hits: Hits = ExactSearcher(ArrayRows(rows[those], longest=LONGEST_UNIT), threads=1).search(query[None], k=k)
        best[number, : hits.rows.shape[1]] = those[hits.rows[0]]
    return best
