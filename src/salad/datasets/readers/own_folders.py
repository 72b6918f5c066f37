"""A user's own two folders: with a table of what is right, or with photos that know where they were taken."""

from __future__ import annotations

from pathlib import Path

from salad.datasets.compact_lists import PhotoList
from salad.datasets.folders import SIDES, names_below, sides_in
from salad.datasets.readers.base import Layout, Protocol, Sides

TRUTH_TABLE = "gt.csv"


def folders(root: Path) -> tuple[Path, Path] | None:
    """The folders of references and of queries, by what people call them."""
    return sides_in(root, SIDES, inside=("", "images/test", "test"))


def looked_for(_: Protocol) -> list[str]:
    """What is looked for."""
    return [f"{references}/ and {queries}/" for references, queries in SIDES]


def _find_truth(root: Path, _: Protocol) -> Path | None:
    table = root / TRUTH_TABLE
    return table if table.is_file() and folders(root) else None


def _find_folder(root: Path, _: Protocol) -> Path | None:
    found = folders(root)
    return found[0] if found else None


def _read(root: Path, _: Protocol) -> Sides:
    found = folders(root)
    assert found is not None
    theirs, ours = (PhotoList(folder, names_below(folder)) for folder in found)
    return Sides(theirs, ours)


TRUTH = Layout(
    "gt.csv",
    "gt.csv (query,positives) beside database/ and queries/",
    lambda protocol: [TRUTH_TABLE, *looked_for(protocol)],
    _find_truth,
    _read,
)
FOLDER = Layout("folder", "database/ and queries/ of photos with positions", looked_for, _find_folder, _read)
