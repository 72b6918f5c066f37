"""Two drives along one road, or two looks at the same cameras: `ref/0000000.jpg` and `query/0000000.jpg`.

So come Nordland and SPED; photos stand in the order of their numbers.
"""

from __future__ import annotations

from pathlib import Path

from salad.datasets.compact_lists import PhotoList
from salad.datasets.folders import in_order, names_below, sides_in
from salad.datasets.readers.base import Layout, Protocol, Sides


def looked_for(_: Protocol) -> list[str]:
    """What is looked for."""
    return ["ref/ and query/ of numbered photos"]


def find(root: Path, _: Protocol) -> Path | None:
    """The folder of references."""
    folders = sides_in(root, (("ref", "query"), ("refs", "queries")))
    return folders[0] if folders else None


def read(root: Path, protocol: Protocol) -> Sides:
    """Both sides; what is right is the protocol's to say.

    Raises:
        BenchmarkError: a folder cannot be read or is empty.
    """
    references = find(root, protocol)
    assert references is not None
    queries = root / {"ref": "query", "refs": "queries"}[references.name]
    theirs, ours = (PhotoList(folder, in_order(names_below(folder))) for folder in (references, queries))
    return Sides(theirs, ours)


LAYOUT = Layout("drives", "ref/0000000.jpg and query/0000000.jpg", looked_for, find, read)
