"""What `salad index` says when it is done, and the list of photos that it writes where one is asked for.

Counts go to people, on stderr; the list has a line for each photo and for whatever else was met on the way.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from salad.errors import SaladError

if TYPE_CHECKING:
    from salad.images.finding import Found
    from salad.index.build import Indexed, Outcome

_COLUMNS = ("path", "lat", "lon", "heading", "time", "source", "state", "remark")


@dataclass(slots=True)
class PhotoList:
    """The list of `--list FILE.csv`: kept while photos come in, written at its end, whole or not at all.

    Its first columns are those of a table of positions: who fills in what is missing can give it back with `--table`.

    Raises:
        SaladError: If no such file can be written; said before any work.
    """

    path: Path
    _lines: list[tuple[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.path.suffix.lower() != ".csv":  # so that `--list photo.jpg`, a slip, costs nobody a photo
            raise SaladError(f"--list {self.path} is no name for a list: end it in .csv")
        if self.path.is_dir() or not self.path.parent.is_dir():
            raise SaladError(f"--list {self.path} cannot be written: name a file in a folder that is there")

    def note(self, outcome: Outcome) -> None:
        """Keep a line for what became of a photo."""
        told = outcome.photo.as_dict()
        _, *known = told.values()
        self._add(outcome.photo.path, *known, outcome.photo.source, outcome.state, outcome.why)

    def note_others(self, found: Found) -> None:
        """Keep a line for each folder that cannot be read, and for each file and folder that was passed over."""
        for folder, sentence in found.unreadable.items():
            self._add(Path(folder), *[None] * 5, "unreadable", sentence)
        for each in found.passed_over:
            self._add(Path(each.path), *[None] * 5, "passed over", each.why)

    def write(self) -> None:
        """Write the list, in order of paths; one of that name is replaced.

        Raises:
            OSError: If it cannot be written.
        """
        from salad.files import write_whole
        from salad.tables import csv_line

        lines = [csv_line(_COLUMNS), *(line for _, line in sorted(self._lines))]
        write_whole(self.path, "".join(lines).encode("utf-8", "surrogateescape"))

    def _add(self, path: Path, *fields: object) -> None:
        from salad.tables import csv_line, without_formulas

        place = os.path.abspath(path)  # noqa: PTH100  # resolve() would follow links, a photo keeps its own name
        self._lines.append((place, csv_line(without_formulas([Path(place), *fields]))))


def sentences(found: Found, done: Indexed) -> Iterator[str]:
    """What people are to know beside the count of photos: what was passed over, what changed, who has no position."""
    if counted := found.counted():
        yield f"passed over: {counted}"
    if changed := str(done.changes):
        yield changed
    if done.decoded_earlier:
        count, name = len(done.decoded_earlier), done.decoded_earlier[0].name
        yield (
            f"photos of deep grey (more than eight bits) that an earlier salad described, which may have seen less in "
            f"them: {count:,}, the first {name}; take them out with 'salad remove', and index them again"
        )
    if done.unplaced:
        first = ", ".join(done.first_unplaced)
        others = done.unplaced - len(done.first_unplaced)
        have = "photo has" if done.unplaced == 1 else "photos have"
        yield f"{done.unplaced:,} {have} no position: {first}{f' and {others:,} more' if others else ''}"
