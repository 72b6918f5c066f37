"""Photos that are references and queries at once: such a query finds itself, and the figure is too good.

Files of one content are found by their sizes first, so that few are read. Pictures saved anew, smaller or in
another format are looked for among what the model found alike: the best matches of each query are opened, and two
pictures are one where their thumbnails differ by little more than what JPEG does.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from salad.errors import BenchmarkError, PhotoError
from salad.images.decode import decode
from salad.images.photo import Photo, content_hash

SIDE = 32  # the thumbnails' side in pixels
ALIKE = 3.0  # grey levels that thumbnails of one picture may differ by on average; JPEG at quality 50 makes about 1
VARIED = 8.0  # grey levels that a thumbnail must vary by to be told from another: fog and night are all alike
LOOKED_AT = 3  # best matches of a query that are looked at
LIKELY = 0.9  # score below which two photos are not looked at; one picture saved twice scores 0.98 and more


@dataclass(frozen=True, slots=True)
class Leak:
    """A photo that is in both sides.

    Attributes:
        query: its number among the queries.
        reference: its row among the references.
        query_path: its file among the queries.
        reference_path: its file among the references.
        kind: whether the files are the same, byte for byte, or only the pictures.
        difference: grey levels between the thumbnails, on average; 0 for the same file.
    """

    query: int
    reference: int
    query_path: str
    reference_path: str
    kind: Literal["file", "picture"]
    difference: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """The JSON form."""
        return asdict(self)


def find_leaks(
    queries: Sequence[Photo],
    references: Sequence[Photo],
    *,
    matches: Iterable[Sequence[int]] = (),
    scores: Sequence[Sequence[float]] | None = None,
) -> tuple[Leak, ...]:
    """Look for photos that are in both sides.

    Args:
        queries: the photos asked about.
        references: the photos they are looked for among.
        matches: rows of references that look like each query, best first; where not given, only files of one
            content are found.
        scores: the matches' scores; those below 0.9 are not looked at. Where not given, all are.

    Raises:
        BenchmarkError: a photo cannot be read.
    """
    try:
        same = list(_same_files(queries, references))
        found = {(leak.query, leak.reference) for leak in same}
        pairs = [pair for pair in _likely(matches, scores) if pair not in found]
        return (*same, *_same_pictures(queries, references, pairs))
    except (OSError, PhotoError) as error:
        raise BenchmarkError(f"whether photos are in both sides cannot be told: {error}") from error


def _same_files(queries: Sequence[Photo], references: Sequence[Photo]) -> Iterator[Leak]:
    sizes: dict[int, list[int]] = defaultdict(list)
    for number, photo in enumerate(queries):
        sizes[_size(photo.path)].append(number)
    contents: dict[int, dict[str, list[int]]] = {}
    for row, photo in enumerate(references):
        size = _size(photo.path)
        if size not in sizes:
            continue
        if size not in contents:
            contents[size] = defaultdict(list)
            for number in sizes[size]:
                contents[size][content_hash(queries[number].path)].append(number)
        for number in contents[size].get(content_hash(photo.path), ()):
            yield Leak(number, row, str(queries[number].path), str(photo.path), "file")


def _size(path: Path) -> int:
    return os.stat(path).st_size  # noqa: PTH116  # a method of Path takes twice as long, a million times


def _likely(
    matches: Iterable[Sequence[int]], scores: Sequence[Sequence[float]] | None
) -> Iterator[tuple[int, int]]:
    for number, rows in enumerate(matches):
        for place, row in enumerate(rows[:LOOKED_AT]):
            if row >= 0 and (scores is None or scores[number][place] >= LIKELY):
                yield number, int(row)


def _same_pictures(
    queries: Sequence[Photo], references: Sequence[Photo], pairs: Iterable[tuple[int, int]]
) -> Iterator[Leak]:
    last, seen = -1, np.zeros(0)
    for number, row in pairs:
        query, reference = queries[number].path, references[row].path
        if number != last:
            last, seen = number, thumbnail(query)
        if float(seen.std()) < VARIED:
            continue
        difference = float(np.abs(seen - thumbnail(reference)).mean())
        if difference <= ALIKE:
            yield Leak(number, row, str(query), str(reference), "picture", difference)


def thumbnail(path: Path) -> Float64[np.ndarray, "side side"]:
    """A photo in 32 x 32 grey levels.

    Raises:
        PhotoError: it cannot be read.
    """
    small = decode(path, SIDE, SIDE, "box")
    grey: Float64[np.ndarray, "side side"] = small.astype(np.float64).mean(axis=2)
    return grey
