"""What `index_size.py` compares: made-up descriptors, and three ways to store and search them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from salad.images.photo import Photo

SEED, K, QUERIES = 20, 5, 100
BATCH = 1000  # photos in one `Index.add`
MIDDLES, SCATTER = 1000, 0.8  # a row is a middle plus noise of that length: neighbours score 1 / 1.64 = 0.61

Floats = npt.NDArray[np.float32]


class Way(NamedTuple):
    """How to add `[n, dim]` from a row on (returns seconds), to find first answers, and to save (returns bytes)."""

    add: Callable[[Floats, int], float]
    top: Callable[[Floats], list[int]]
    save: Callable[[Path], int]


# --- what is stored and asked ---------------------------------------------------------------


def batches(count: int, dim: int) -> Iterator[Floats]:
    """Descriptors `[BATCH, dim]` float32 of length 1, `count` in all."""
    middles = _middles(dim)
    for start in range(0, count, BATCH):
        yield _around(middles, min(BATCH, count - start), (SEED, dim, 1 + start))


def queries(dim: int) -> Floats:
    """Descriptors `[QUERIES, dim]` that are not in the index but near some that are."""
    return _around(_middles(dim), QUERIES, (SEED, dim, 0))


def _middles(dim: int) -> Floats:
    return _unit(np.random.default_rng([SEED, dim]).standard_normal((MIDDLES, dim), dtype=np.float32))


def _around(middles: Floats, count: int, seed: tuple[int, ...]) -> Floats:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((count, middles.shape[1]), dtype=np.float32)
    noise *= np.float32(SCATTER / np.sqrt(middles.shape[1]))
    noise += middles[rng.integers(0, len(middles), count)]
    return _unit(noise)


def _unit(rows: Floats) -> Floats:
    rows /= np.sqrt(np.einsum("ij,ij->i", rows, rows))[:, None]
    return rows


def photos(start: int, count: int) -> list[Photo]:
    """Photos in made-up places of a square of 10 km."""
    from salad.geo import GeoPoint, shifted
    from salad.images.photo import Photo

    middle = GeoPoint(52.0, 5.0)
    places = np.random.default_rng([SEED, start]).uniform(-5000, 5000, (count, 2))
    return [
        Photo(Path(f"/made-up/{start // BATCH:04}/{start + n:07}.jpg"), shifted(middle, *place))
        for n, place in enumerate(places.tolist())
    ]


# --- the three ways -------------------------------------------------------------------------


def ours(folder: Path, _count: int, dim: int) -> Way:
    """A salad index in `folder`."""
    from salad.index.index import Index

    index = Index.create(folder, dim=dim, fingerprint=f"made-up-{dim}", model="made-up")

    def add(rows: Floats, start: int) -> float:
        taken, contents = photos(start, len(rows)), [f"{start + n:064x}" for n in range(len(rows))]
        return seconds(lambda: index.add(taken, rows, identities=contents))

    def save(path: Path) -> int:
        index.close()
        return sum(file.stat().st_size for file in path.iterdir())

    return Way(add, lambda asked: [found[0].row for found in index.search(asked, k=K)], save)


def flat(_folder: Path, _count: int, dim: int) -> Way:
    """FAISS's flat index of dot products, float32 in memory."""
    import faiss

    index = faiss.IndexFlatIP(dim)

    def save(path: Path) -> int:
        faiss.write_index(index, str(path))
        return path.stat().st_size

    return Way(
        lambda rows, _start: seconds(lambda: index.add(rows)),
        lambda asked: index.search(asked, K)[1][:, 0].tolist(),
        save,
    )


def plain(_folder: Path, count: int, dim: int) -> Way:
    """A float32 matrix in memory, multiplied by numpy."""
    matrix = np.empty((count, dim), dtype=np.float32)

    def save(path: Path) -> int:
        with path.open("wb") as file:
            np.save(file, matrix)
        return path.stat().st_size

    return Way(
        lambda rows, start: seconds(lambda: matrix.__setitem__(slice(start, start + len(rows)), rows)),
        lambda asked: _best(matrix, asked)[:, 0].tolist(),
        save,
    )


def _best(matrix: Floats, asked: Floats) -> npt.NDArray[np.int64]:
    """Rows of the best K of each query, best first."""
    scores = asked @ matrix.T
    some = np.argpartition(scores, -K, axis=1)[:, -K:]
    order = np.take_along_axis(scores, some, axis=1).argsort(axis=1)[:, ::-1]
    return np.take_along_axis(some, order, axis=1)


MAKE = {"salad": ours, "faiss flat": flat, "numpy": plain}


def opened(name: str, path: Path) -> Callable[[Floats], object]:
    """What was saved, ready to be asked."""
    if name == "salad":
        from salad.index.index import Index

        index = Index.open(path)
        return lambda asked: index.search(asked, k=K)
    if name == "faiss flat":
        import faiss

        stored = faiss.read_index(str(path))
        return lambda asked: stored.search(asked, K)
    matrix = np.load(path)
    return lambda asked: _best(matrix, asked)


def seconds(run: Callable[[], object]) -> float:
    """Of the clock."""
    begun = time.perf_counter()
    run()
    return time.perf_counter() - begun


def set_threads(name: str, threads: int) -> None:
    """For a way's library; it also brings its code in, which is not the matrix's memory."""
    if name == "salad":
        import salad.index.index  # noqa: F401  # to bring its code in

        os.environ["OMP_NUM_THREADS"] = str(threads)
    elif name == "faiss flat":
        import faiss

        faiss.omp_set_num_threads(threads)
