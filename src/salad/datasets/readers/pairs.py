"""AmsterTime as it is published: `new/<number>.png` and `old/<number>.jpg`, a pair of one name each."""

from __future__ import annotations

from pathlib import Path

from salad.datasets.compact_lists import PhotoList
from salad.datasets.folders import names_below, sides_in
from salad.datasets.readers.base import Layout, Protocol, Sides


def looked_for(_: Protocol) -> list[str]:
    """What is looked for."""
    return ["new/ and old/ of photos of the same names"]


def find(root: Path, _: Protocol) -> Path | None:
    """The folder of references."""
    folders = sides_in(root, (("new", "old"),))
    return folders[0] if folders else None


def read(root: Path, _: Protocol) -> Sides:
    """Both sides; the pair is found by name.

    Raises:
        BenchmarkError: a folder cannot be read or is empty.
    """
    theirs, ours = (PhotoList(root / side, names_below(root / side)) for side in ("new", "old"))
    return Sides(theirs, ours)


LAYOUT = Layout("pairs", "new/<name>.png and old/<name>.jpg", looked_for, find, read)
