"""GSV-Cities as an evaluation set: of each place the newest photo is a query, the others are its references.

Only the tables and one listing of each city's folder are read.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from salad.data.gsv_cities import is_gsv_cities, read_gsv_cities
from salad.data.lazy import PhotoList, Ragged
from salad.data.rules import Layout, Protocol, Sides
from salad.data.views import TrainingPlace
from salad.errors import BenchmarkError


def looked_for(_: Protocol) -> list[str]:
    """What is looked for."""
    return ["Dataframes/<City>.csv and Images/<City>/"]


def find(root: Path, _: Protocol) -> Path | None:
    """The folder of tables."""
    return root / "Dataframes" if is_gsv_cities(root) else None


def read(root: Path, _: Protocol) -> Sides:
    """Both sides.

    Raises:
        BenchmarkError: a table cannot be read or holds no place of four photos.
    """
    notes: list[str] = []
    places = read_gsv_cities(root, say=notes.append)
    if not places:
        raise BenchmarkError(
            f"{root} holds no place of four photos: fetch its Images, or name another folder"
        )
    theirs = [(place, photo) for place in places for photo in place.photos[:-1]]
    counts = np.array([len(place.photos) - 1 for place in places], dtype=np.int64)
    ends = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return Sides(
        _photos(root, theirs),
        _photos(root, [(place, place.photos[-1]) for place in places]),
        positives=Ragged(np.arange(ends[-1], dtype=np.int64), ends),
        groups=tuple(f"{place.city}/{place.name}" for place in places),
        told_by="Dataframes",
        notes=tuple(notes),
    )


def _photos(root: Path, photos: list[tuple[TrainingPlace, Path]]) -> PhotoList:
    where = [place.where for place, _ in photos]
    known = np.array([(point.lat, point.lon) if point else (np.nan, np.nan) for point in where])
    return PhotoList(root, (str(photo.relative_to(root)) for _, photo in photos), where=known)


LAYOUT = Layout("GSV-Cities", "Dataframes/<City>.csv beside Images/<City>/", looked_for, find, read)
