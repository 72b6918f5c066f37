"""What an index knows of a photo: a row of its table, written with a checksum and checked as it is read."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from salad.errors import PositionError
from salad.geo import GeoPoint, null_island
from salad.images.metadata import SOURCES, rank
from salad.images.photo import Photo
from salad.images.photo_table import LONGEST_PATH
from salad.index.database import shortened

COLUMNS = "row, path, lat, lon, heading, time, identity, source, removed, facts"
"""What `known_of_row` reads."""
UNKNOWN = -1
"""In place of a checksum that was never written."""
PLACED = "lat BETWEEN -90 AND 90 AND lon BETWEEN -180 AND 180 AND NOT (lat = 0 AND lon = 0)"
"""A condition of SQL that holds for the rows in which `known_of_row` finds a position."""
AT_NULL_ISLAND = "the index has it at 0,0, which counts as no position"
"""What `known_of_row` remarks of a photo whose position earlier versions took for one."""


class Known(NamedTuple):
    """A row of the table.

    Attributes:
        row: Row of the matrix.
        photo: What is known of the photo; what makes no sense counts as unknown.
        identity: Its content.
        source: Where its position came from, if that was noted: as it stands there, for the checksum is of that.
        trouble: What is damaged, if anything: a sentence.
    """

    row: int
    photo: Photo
    identity: str
    source: str | None
    trouble: str


def columns_of(photo: Photo) -> tuple[Any, ...]:
    """A photo as the table has it: path in bytes, latitude, longitude, heading, time."""
    path, *known = photo.as_dict().values()
    return os.fsencode(path), *known


def facts_sum(told: Iterable[Any]) -> int:
    """The checksum (CRC-32) of what is known of a photo, as docs/index-format.md tells it; a removed one has none.

    Args:
        told: Path, latitude, longitude, heading, time, content and source, as the table has them.
    """
    return zlib.crc32(b"\0".join(map(_as_bytes, told)))


def _as_bytes(value: Any) -> bytes:
    if isinstance(value, str | bytes):
        return b"t" + os.fsencode(value)
    if value is None or value != value:  # NaN, which SQLite keeps as nothing
        return b"n"
    return b"r" + struct.pack("<d", value + 0.0)  # SQLite knows no -0.0


def known_of_row(row: Sequence[Any]) -> Known:
    """What a row of the table says, from the columns `COLUMNS` names.

    Where the checksum is not that of the row nobody can tell what of it is damaged, so all counts as unknown: the
    photo can still be used.
    """
    number, path, lat, lon, heading, time, identity, source, removed, noted = row
    name = path if isinstance(path, str) else os.fsdecode(path) if isinstance(path, bytes) else str(path)
    told = Photo(Path(name if len(name) <= LONGEST_PATH else shortened(name)))
    content = identity if isinstance(identity, str) else ""
    if noted != UNKNOWN and noted != _expected(row):
        return Known(number, told, content, None, _sentence(name, "record"))
    where = taken = None
    if isinstance(lat, float) and isinstance(lon, float):
        with suppress(PositionError):
            where = GeoPoint(lat, lon)
    if isinstance(time, str):
        with suppress(ValueError):
            taken = datetime.fromisoformat(time)
    turned = heading if isinstance(heading, float) and 0 <= heading <= 360 else None
    wrong = {
        "path": not isinstance(path, str) or "\0" in path or len(path) > LONGEST_PATH,
        "position": (lat, lon) != (None, None) and where is None,
        "heading": heading is not None and turned is None,
        "time": time is not None and taken is None,
        "content": not content,
        "mark of removal": removed not in (0, 1),
    }
    named = " and ".join(part for part, bad in wrong.items() if bad)
    remark = ""
    if null_island(where):
        where, remark = None, AT_NULL_ISLAND
    noted_source = source if isinstance(source, str) else None
    said_by = noted_source if where is not None and noted_source in SOURCES else None
    photo = Photo(told.path, where, turned, taken, said_by, remark)
    return Known(number, photo, content, noted_source, named and _sentence(name, named))


def with_news(held: Photo, news: Photo) -> Photo:
    """What is known of a photo that an index holds, when it was met again: the news, which take nothing away.

    What a table or a correction says stays, since the photo itself does not know better, until another table or
    correction comes.

    Args:
        held: What the index says.
        news: What was found now, with the path where it was.
    """
    stays = held.source in ("correction", "table") and rank(news.source) > rank(held.source)
    first, second = (held, news) if stays else (news, held)
    placed = first if first.where is not None else second
    return replace(
        news,
        where=placed.where,
        heading=second.heading if first.heading is None else first.heading,
        time=first.time or second.time,
        source=placed.source if placed.where is not None else None,
        remark="" if placed is held and held.where is not None else news.remark,
    )


def _expected(row: Sequence[Any]) -> int | None:
    """What the checksum of a row, as `known_of_row` takes it, must be."""
    removed = row[-2] == 1
    return None if removed else facts_sum(row[1:8])


def _sentence(name: str, what: str) -> str:
    return f"the {what} of {shortened(name)} in the table is damaged: remove the photo and index it again"
