"""Photos that are references and queries at once: such a query finds itself, and the figure is too good.

Files of one content are found by their sizes first, so that few are read. Pictures saved anew, smaller or in
another format are looked for among what the model found alike: the best matches of each query are opened, and two
pictures are one where their thumbnails differ by little more than what JPEG does.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64

from salad.errors import BenchmarkError, PhotoError, reason
from salad.images.photo import Photo, content_hash
from salad.images.workers import Workers

SIDE = 32  # the thumbnails' side in pixels
ALIKE = 3.0  # grey levels that thumbnails of one picture may differ by on average; JPEG at quality 50 makes about 1
VARIED = 8.0  # grey levels that a thumbnail must vary by to be told from another: fog and night are all alike
LOOKED_AT = 3  # best matches of a query that are looked at
LIKELY = 0.9  # score below which two photos are not looked at; one picture saved twice scores 0.98 and more


@dataclass(frozen=True, slots=True)
class Leak:
    """A photo that is in both sides.

    Attributes:
        query: Its number among the queries.
        reference: Its row among the references.
        query_path: Its file among the queries.
        reference_path: Its file among the references.
        kind: Whether the files are the same, byte for byte, or only the pictures.
        difference: Grey levels between the thumbnails, on average; 0 for the same file.
    """

    query: int
    reference: int
    query_path: str
    reference_path: str
    kind: Literal["file", "picture"]
    difference: float = 0.0


def find_leaks(
    queries: Sequence[Photo],
    references: Sequence[Photo],
    *,
    matches: Iterable[Sequence[int]] = (),
    scores: Sequence[Sequence[float]] | None = None,
) -> tuple[Leak, ...]:
    """Look for photos that are in both sides.

    Args:
        queries: The photos asked about.
        references: The photos they are looked for among.
        matches: Rows of references that look like each query, best first; where not given, only files of one
            content are found.
        scores: The matches' scores; those below 0.9 are not looked at. Where not given, all are.

    Raises:
        BenchmarkError: If a photo cannot be read.
    """
    try:
        same = same_files(queries, references)
        found = {(leak.query, leak.reference) for leak in same}
        pairs = [
            (number, int(row))
            for number, rows in enumerate(matches)
            for rank, row in enumerate(rows[:LOOKED_AT])
            if row >= 0 and (scores is None or scores[number][rank] >= LIKELY)
        ]
        return (*same, *same_pictures(queries, references, [pair for pair in pairs if pair not in found]))
    except (OSError, PhotoError) as error:
        # A photo's own sentence names it; the system's reason does not.
        named = f"{error.filename} cannot be read ({reason(error)})" if isinstance(error, OSError) else reason(error)
        raise BenchmarkError(f"whether photos are in both sides cannot be told: {named}") from error


def same_files(queries: Sequence[Photo], references: Sequence[Photo]) -> list[Leak]:
    """Files of one content on both sides; only those whose size is on both sides are read.

    Raises:
        OSError: If a photo is not there.
        PhotoError: If it cannot be read.
    """
    sizes: dict[int, list[int]] = defaultdict(list)
    for number, photo in enumerate(queries):
        sizes[os.stat(photo.path).st_size].append(number)  # noqa: PTH116  # Path's method takes twice as long
    hashes: dict[int, dict[str, list[int]]] = {}  # of the queries of a size, once a reference is of that size
    leaks = []
    for row, photo in enumerate(references):
        size = os.stat(photo.path).st_size  # noqa: PTH116  # the same, a million times
        if size not in sizes:
            continue
        if size not in hashes:
            hashes[size] = defaultdict(list)
            for number in sizes[size]:
                hashes[size][content_hash(queries[number].path)].append(number)
        for number in hashes[size].get(content_hash(photo.path), ()):
            leaks.append(Leak(number, row, str(queries[number].path), str(photo.path), "file"))
    return leaks


def same_pictures(
    queries: Sequence[Photo], references: Sequence[Photo], pairs: Iterable[tuple[int, int]]
) -> list[Leak]:
    """Pairs of a query and a reference, in the order of the queries, whose thumbnails show one picture.

    Raises:
        PhotoError: If a photo cannot be read.
    """
    last, seen = -1, np.zeros(0)
    leaks = []
    for number, row in pairs:
        query, reference = queries[number].path, references[row].path
        if number != last:
            last, seen = number, thumbnail(query)
        if float(seen.std()) < VARIED:
            continue
        difference = float(np.abs(seen - thumbnail(reference)).mean())
        if difference <= ALIKE:
            leaks.append(Leak(number, row, str(query), str(reference), "picture", difference))
    return leaks


def thumbnail(path: Path) -> Float64[np.ndarray, "side side"]:
    """A photo in 32 x 32 grey levels.

    Raises:
        PhotoError: If it cannot be read.
    """
    with Workers(1) as workers:
        small = workers.decode(path, SIDE, SIDE, "box")
    grey: Float64[np.ndarray, "side side"] = small.astype(np.float64).mean(axis=2)
    return grey
