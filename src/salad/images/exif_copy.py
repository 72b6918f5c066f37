"""A copy of a JPEG with another position.

Pixels are copied byte by byte, never decoded. What the EXIF held stays where it stood, so that thumbnails and
makers' notes, which name their own whereabouts, stay right: the new tables of tags are added at its end, and
only the pointer to the first table is changed. A position that XMP says is blanked there, so that nobody reads two.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from PIL.ExifTags import GPS, IFD

from salad.errors import PhotoError, reason
from salad.files import write_whole
from salad.geo import GeoPoint
from salad.images.decode import in_memory
from salad.images.exif import degrees_minutes_seconds
from salad.images.xmp import without_place

_EXIF = b"Exif\0\0"
_EMPTY = b"II*\0\x08\0\0\0" + bytes(6)  # a TIFF of one table without a tag
_LONGEST = 0xFFFF - 2 - len(_EXIF)  # bytes of EXIF that a JPEG's segment can hold
_BYTE, _ASCII, _LONG, _RATIONAL = 1, 2, 4, 5
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_SUPERSEDED = frozenset(
    {
        *(GPS.GPSLatitudeRef, GPS.GPSLatitude, GPS.GPSLongitudeRef, GPS.GPSLongitude, GPS.GPSHPositioningError),
        GPS.GPSStatus,  # `V` says that the receiver had no fix
        GPS.GPSMapDatum,  # metres away from the WGS84 that is written, which goes without saying
    }
)


def copy_with_position(photo: Path, copy: Path, where: GeoPoint, *, within_m: float | None = None) -> None:
    """Write a copy of a JPEG with a position; the photo itself is only read, the copy whole or not at all.

    Args:
        photo: A JPEG, whatever its name ends in.
        copy: Where to; nothing may be there.
        where: The position, written to a millionth of a second of arc, 0.03 mm.
        within_m: How far off it may be, in metres.

    Raises:
        PhotoError: If the photo is no JPEG, its EXIF is damaged or too long, or the copy exists or cannot be
            written.
    """
    held = in_memory(photo).getvalue()
    try:
        data = with_position(held, where, within_m=within_m)
    except PhotoError as error:
        raise PhotoError(f"{photo} gets no copy with a position: {error}") from error
    if os.path.lexists(copy):
        raise PhotoError(f"{copy} exists already: move it away, or write to another folder")
    try:
        write_whole(copy, data)
    except OSError as error:
        raise PhotoError(f"{copy} cannot be written ({reason(error)}): check the folder and the disk") from error


def with_position(jpeg: bytes, where: GeoPoint, *, within_m: float | None = None) -> bytes:
    """The bytes of a JPEG with a position in its EXIF.

    Raises:
        PhotoError: If they are no JPEG, or the EXIF is damaged or too long; the message says which.
    """
    if not jpeg.startswith(b"\xff\xd8\xff"):
        raise PhotoError("it is no JPEG, and only a JPEG can take one without a change of its pixels")
    start = end = 2
    tiff = None
    rest = bytearray(jpeg)
    for kind, low, high in _segments(jpeg):
        if kind == 0xE1 and jpeg.startswith(_EXIF, low + 4) and tiff is None:
            start, end, tiff = low, high, jpeg[low + 4 + len(_EXIF) : high]
        if kind == 0xE1 and jpeg.startswith(_XMP, low + 4):
            rest[low + 4 + len(_XMP) : high] = without_place(jpeg[low + 4 + len(_XMP) : high])
        if kind == 0xE0 and low == 2 and tiff is None:  # JFIF wants to come first
            start = end = high
    placed = _placed(_EMPTY if tiff is None else tiff, where, within_m)
    if len(placed) > _LONGEST:
        raise PhotoError("its EXIF is so long already that no position can be added")
    head = b"\xff\xe1" + struct.pack(">H", 2 + len(_EXIF) + len(placed)) + _EXIF
    return bytes(rest[:start]) + head + placed + rest[end:]


def _segments(jpeg: bytes) -> Iterator[tuple[int, int, int]]:
    """The kind of each segment before the pixels, where it starts and where it ends."""
    at = 2
    while at + 4 <= len(jpeg) and jpeg[at] == 0xFF and jpeg[at + 1] not in (0xDA, 0xD9):
        if jpeg[at + 1] == 0xFF:  # a marker may be padded
            at += 1
            continue
        end = at + 2 + struct.unpack_from(">H", jpeg, at + 2)[0]
        if end > len(jpeg):
            raise PhotoError("it is cut short")
        yield jpeg[at + 1], at, end
        at = end


@dataclass(frozen=True, slots=True)
class _Table:
    """A table of tags: its entries of 12 bytes each by tag, and where the next table is."""

    entries: dict[int, bytes]
    following: int

    @classmethod
    def read(cls, tiff: bytes, order: str, at: int) -> _Table:
        (count,) = struct.unpack_from(order + "H", tiff, at)
        (following,) = struct.unpack_from(order + "I", tiff, at + 2 + 12 * count)
        cut = [tiff[at + 2 + 12 * n :][:12] for n in range(count)]
        return cls({struct.unpack(order + "H", entry[:2])[0]: entry for entry in cut}, following)

    def packed(self, order: str) -> bytes:
        return (
            struct.pack(order + "H", len(self.entries))
            + b"".join(self.entries[tag] for tag in sorted(self.entries))
            + struct.pack(order + "I", self.following)
        )


def _placed(tiff: bytes, where: GeoPoint, within_m: float | None) -> bytes:
    """The same EXIF with a position at its end: numbers, a table of GPS tags, a first table that points to it."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(tiff[:4])
    if order is None:
        raise PhotoError("its EXIF is damaged")
    try:
        first = _Table.read(tiff, order, struct.unpack_from(order + "I", tiff, 4)[0])
        old = first.entries.get(IFD.GPSInfo)
        gps = _Table({}, 0) if old is None else _Table.read(tiff, order, struct.unpack(order + "8xI", old)[0])
    except struct.error as error:
        raise PhotoError("its EXIF is damaged") from error
    grown = tiff + bytes(len(tiff) % 2)  # numbers and tables begin at even places
    entries = {tag: entry for tag, entry in gps.entries.items() if tag not in _SUPERSEDED}
    # A version of the tags that stands there already is kept.
    entries.setdefault(GPS.GPSVersionID, struct.pack(order + "HHI4s", GPS.GPSVersionID, _BYTE, 4, b"\2\3\0\0"))
    south, west = b"S" if where.lat < 0 else b"N", b"W" if where.lon < 0 else b"E"
    for tag, letter in ((GPS.GPSLatitudeRef, south), (GPS.GPSLongitudeRef, west)):
        entries[tag] = struct.pack(order + "HHI4s", tag, _ASCII, 2, letter)
    numbers = [
        (GPS.GPSLatitude, degrees_minutes_seconds(where.lat)),
        (GPS.GPSLongitude, degrees_minutes_seconds(where.lon)),
    ]
    if within_m is not None:
        numbers.append((GPS.GPSHPositioningError, [(min(round(within_m * 100), 0xFFFFFFFF), 100)]))
    for tag, fractions in numbers:  # too long for an entry, which says where they are
        entries[tag] = struct.pack(order + "HHII", tag, _RATIONAL, len(fractions), len(grown))
        grown += b"".join(struct.pack(order + "II", *fraction) for fraction in fractions)
    pointer = struct.pack(order + "HHII", IFD.GPSInfo, _LONG, 1, len(grown))
    grown += _Table(entries, 0).packed(order)
    at_first = len(grown)
    grown += _Table({**first.entries, IFD.GPSInfo: pointer}, first.following).packed(order)
    return grown[:4] + struct.pack(order + "I", at_first) + grown[8:]
