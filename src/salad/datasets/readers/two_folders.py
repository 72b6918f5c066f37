"""Two folders of photos and no more, told apart by what they are called.

    ref/0000000.jpg, query/0000000.jpg     two drives along one road, or two looks at the same cameras: Nordland, SPED
    new/<number>.png, old/<number>.jpg     pairs of one name each: AmsterTime
    database/, queries/                    a user's own, whose photos know where they were taken, or with a `gt.csv`

What is right is the protocol's to say.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from salad.datasets.compact_lists import PhotoList
from salad.datasets.folders import SIDES, in_order, names_below, sides_in
from salad.datasets.readers.base import Layout, Protocol, Sides

TRUTH_TABLE = "gt.csv"


def own_folders(root: Path) -> tuple[Path, Path] | None:
    """A user's folders of references and of queries, by what people call them."""
    return sides_in(root, SIDES, inside=("", "images/test", "test"))


@dataclass(frozen=True)
class _TwoFolders:
    """How two folders are found and read.

    Attributes:
        folders: The folders of references and of queries below a root, where both are there.
        order: Puts a folder's photos in order, by their names.
        table: A file that must lie beside the folders.
    """

    folders: Callable[[Path], tuple[Path, Path] | None]
    order: Callable[[Sequence[str]], list[str]] = sorted
    table: str | None = None

    def find(self, root: Path, _: Protocol) -> Path | None:
        """The table where there must be one, else the folder of references."""
        found = self.folders(root)  # without both folders a table says nothing
        if found is None or self.table is None:
            return found and found[0]
        return root / self.table if (root / self.table).is_file() else None

    def read(self, root: Path, _found: Path, _: Protocol) -> Sides:
        found = self.folders(root)
        assert found is not None
        references, queries = (PhotoList(folder, self.order(names_below(folder))) for folder in found)
        return Sides(references, queries)

    def layout(self, name: str, what: str, *looked_for: str) -> Layout:
        return Layout(name, what, lambda _: looked_for, self.find, self.read)


# People call their folders in many ways, and `looked for` should name them all.
_OWN = [f"{references}/ and {queries}/" for references, queries in SIDES]

DRIVES = _TwoFolders(lambda root: sides_in(root, (("ref", "query"), ("refs", "queries"))), order=in_order).layout(
    "drives", "ref/0000000.jpg and query/0000000.jpg", "ref/ and query/ of numbered photos"
)
PAIRS = _TwoFolders(lambda root: sides_in(root, (("new", "old"),))).layout(
    "pairs", "new/<name>.png and old/<name>.jpg", "new/ and old/ of photos of the same names"
)
TRUTH = _TwoFolders(own_folders, table=TRUTH_TABLE).layout(
    "gt.csv", "gt.csv (query,positives) beside database/ and queries/", TRUTH_TABLE, *_OWN
)
FOLDER = _TwoFolders(own_folders).layout("folder", "database/ and queries/ of photos with positions", *_OWN)
