"""What can be known of a photo beside its pixels (where, which way and when), and whose word counts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime

from salad.geo import GeoPoint, null_island

SOURCES = ("correction", "table", "name", "sidecar", "exif", "xmp", "takeout")
"""Who may say where a photo was taken, in the order in which they win.

A user's correction, a table, the photo's `@` name, XMP beside it (`NAME.EXT.xmp`, then `NAME.xmp`), its EXIF, XMP
inside it, and the JSON that Google Takeout puts beside it."""
_TOLD = {
    "correction": "its correction",
    "table": "its row of the table",
    "name": "its name",
    "sidecar": "the XMP beside it",
    "exif": "its EXIF",
    "xmp": "the XMP in it",
    "takeout": "the JSON beside it",
}
NOTHING_SAID = "nothing in it or beside it says where it was taken"
"""Why most photos without a position have none."""


@dataclass(frozen=True, slots=True)
class Position:
    """What is known of where (degrees), which way (degrees clockwise from north, 0 to 360) and when.

    Attributes:
        where: Where the photo was taken.
        heading: Which way the camera looked.
        time: When; local time where it carries no time zone.
        source: Who says where, one of `SOURCES`.
        remark: What of it was not understood, or why nothing is known: half a sentence, which may be empty.
    """

    where: GeoPoint | None = None
    heading: float | None = None
    time: datetime | None = None
    source: str | None = field(default=None, compare=False)
    remark: str = field(default="", compare=False)


def settled(said: Iterable[Position]) -> Position:
    """What counts of what several sources say: position, heading and time, each from the first that knows it.

    A position of exactly 0,0 counts as none, whoever says it. Remarks are kept up to those of the source whose
    position counts, since who comes after it was not asked.

    Args:
        said: What each says, with its `source`, in any order; who says nothing may be left out.
    """
    where = heading = time = source = None
    remarks: list[str] = []
    for one in sorted(said, key=lambda one: rank(one.source)):
        if where is None:
            remarks.append(one.remark)
            if null_island(one.where):
                remarks.append(f"{_TOLD[one.source or SOURCES[-1]]} says 0,0, which counts as no position")
            elif one.where is not None:
                where, source = one.where, one.source
        heading = one.heading if heading is None else heading
        time = one.time if time is None else time
    told = list(dict.fromkeys(remark for remark in remarks if remark))
    return Position(where, heading, time, source, "; ".join(told))


def rank(source: str | None) -> int:
    """The place of a source in the order in which they win, from 0; one that is none of `SOURCES` comes last."""
    return SOURCES.index(source) if source in SOURCES else len(SOURCES)
