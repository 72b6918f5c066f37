"""What a photo's EXIF and its file name say about where, which way and when it was taken, read and written.

Whatever is malformed counts as not said: a photo with a broken tag is a photo without a position.
"""

from __future__ import annotations

import io
import math
import os
import re
import struct
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.TiffImagePlugin import IFDRational

from salad.errors import PhotoError, PositionError, reason
from salad.files import write_whole
from salad.geo import GeoPoint, Utm, from_utm, to_utm
from salad.images.decode import in_memory, on_disk, open_image, quiet_pillow, to_rgb

if TYPE_CHECKING:
    from salad.images.decode import Pixels

_NUMBER = re.compile(r"[+-]?[0-9]{1,12}(?:\.[0-9]{0,15})?")
_SUFFIX = re.compile(r"\.[A-Za-z]\w*$")
_EXIF_TIME = "%Y:%m:%d %H:%M:%S"
_STAMP = "YYYYMMDD_hhmmss"
_MICROARCSECONDS = 3_600_000_000  # in a degree; one is 30 micrometres on the ground
_BLANK = [""] * 14  # fields that a short `@` name leaves away


@dataclass(frozen=True, slots=True)
class Position:
    """What is known of where (degrees), which way (degrees clockwise from north, 0 to 360) and when."""

    where: GeoPoint | None = None
    heading: float | None = None
    time: datetime | None = None

    def completed(self, other: Position | None) -> Position:
        """This, with whatever it does not know taken from `other`."""
        if other is None:
            return self
        return Position(
            other.where if self.where is None else self.where,
            other.heading if self.heading is None else self.heading,
            other.time if self.time is None else self.time,
        )


# --- `@` names -----------------------------------------------------------------------------


class AtName(NamedTuple):
    """The fields of an `@` name that say something, as they stand there; NaN where a number is none.

    Attributes:
        easting: Metres on the UTM grid.
        northing: Metres on the UTM grid.
        zone: Of the grid, 1 to 60, as a text.
        letter: The zone's band.
        lat: Degrees.
        lon: Degrees.
        panoid: The panorama that the photo was cut from.
        heading: Degrees.
        timestamp: Any left part of `YYYYMMDD_hhmmss`.
    """

    easting: float
    northing: float
    zone: str
    letter: str
    lat: float
    lon: float
    panoid: str
    heading: float
    timestamp: str


def split_at_name(name: str) -> AtName | None:
    """The fields of an `@` name, or None for any other name; four microseconds, since sets have millions of names.

    Between `@` stand easting, northing, zone, letter, lat, lon, panoid, tile, heading, pitch, roll, height,
    timestamp and note, then a suffix. Only easting and northing must be there.

    Args:
        name: A file's name; of a path only the last part is read.
    """
    parts = _SUFFIX.sub("", os.path.basename(name)).split("@")  # noqa: PTH119  # a Path takes as long as all the rest
    if len(parts) < 3 or parts[0]:
        return None
    _, easting, northing, zone, letter, lat, lon, panoid, _, heading, _, _, _, stamp, *_ = (*parts, *_BLANK)
    fields = AtName(
        _number(easting),
        _number(northing),
        zone,
        letter,
        _number(lat),
        _number(lon),
        panoid,
        _number(heading),
        stamp,
    )
    return None if math.isnan(fields.easting) or math.isnan(fields.northing) else fields


def parse_at_name(name: str) -> Position | None:
    """What an `@` name says, or None for any other name.

    The point is read from the UTM fields, which are written to the centimetre and by which data sets say what
    counts as right; from lat and lon where zone or letter are missing or make no sense; and is None where those
    are missing too.

    Args:
        name: A file's name; of a path only the last part is read.
    """
    fields = split_at_name(name)
    if fields is None:
        return None
    where = None
    if re.fullmatch(r"[0-9]{1,2}", fields.zone) and re.fullmatch(r"[A-Za-z]", fields.letter):
        with suppress(PositionError):
            where = from_utm(Utm(fields.easting, fields.northing, int(fields.zone), fields.letter.upper()))
    if where is None:
        with suppress(PositionError):
            where = GeoPoint(fields.lat, fields.lon)
    heading = None if math.isnan(fields.heading) else fields.heading % 360
    return Position(where, heading, _parse_stamp(fields.timestamp))


def at_name(
    where: GeoPoint,
    *,
    heading: float | None = None,
    time: datetime | None = None,
    panoid: str = "",
    note: str = "",
    suffix: str = ".jpg",
) -> str:
    """The `@` name of a photo, to the centimetre, the whole degree and the second; a time zone is not kept.

    Raises:
        PositionError: If UTM has no coordinate for `where`, or a text holds `@` or a slash.
    """
    for text in (panoid, note, suffix):
        if re.search(r"[@/\\\0]", text):
            raise PositionError(f"{text!r} cannot stand in an `@` name: leave out '@' and slashes")
    grid = to_utm(where)
    degrees = "" if heading is None else f"{round(heading % 360) % 360:03d}"
    stamp = "" if time is None else re.sub("[-:]", "", _clock(time, "_"))
    fields = [f"{grid.easting:010.2f}", f"{grid.northing:010.2f}", f"{grid.zone:02d}", grid.letter]
    fields += [f"{where.lat:09.5f}", f"{where.lon:010.5f}", panoid, "", degrees, "", "", "", stamp, note]
    return f"@{'@'.join(fields)}@{suffix}"


def _clock(time: datetime, between: str) -> str:
    """As the clock showed it, to the second."""
    return time.replace(tzinfo=None).isoformat(between, "seconds")


def _number(text: str) -> float:
    return float(text) if _NUMBER.fullmatch(text) else math.nan


def _parse_stamp(text: str) -> datetime | None:
    """Any left part of `YYYYMMDD_hhmmss` from the year on; what is missing is the earliest it can be."""
    shape = "".join("0" if c.isdecimal() and c.isascii() else c for c in text)
    if len(text) < 4 or not re.sub("[A-Za-z]", "0", _STAMP).startswith(shape):
        return None
    digits = text.replace("_", "")
    numbers = [int(digits[:4]), *(int(digits[i : i + 2]) for i in range(4, len(digits) - 1, 2))]
    with suppress(ValueError):
        return datetime(*(numbers + [1, 1][len(numbers) - 1 :]))  # type: ignore[arg-type]  # at most six numbers
    return None


# --- EXIF ----------------------------------------------------------------------------------


def read_exif(path: Path, *, file: IO[bytes] | None = None) -> Position:
    """What a photo's EXIF says; nothing where the file is broken, as `decode` will say in a sentence.

    Args:
        path: The file.
        file: The same file where it is held in memory already; read from its beginning.
    """
    with suppress(Exception), on_disk(path) if file is None else nullcontext(file) as source:
        image = open_image(path, source)
        with quiet_pillow():
            # Image's own getexif, because PNG's would decode the pixels in search of more
            return from_exif(Image.Image.getexif(image))
    return Position()


def save_jpeg(
    image: Image.Image | Pixels,
    path: str | Path,
    *,
    where: GeoPoint | None = None,
    heading: float | None = None,
    time: datetime | None = None,
    quality: int = 90,
) -> None:
    """Write a photo as JPEG with its position, heading (to 0.01 degree) and time (to the second) as EXIF.

    Args:
        image: A photo, or uint8 `[H, W, 3]`.
        path: The file; it is replaced whole or not at all.
        where: Written to a millionth of a second of arc, 0.03 mm.
        heading: Degrees clockwise from north.
        time: Its time zone is written where it has one.
        quality: 1 to 95.

    Raises:
        PhotoError: If the file cannot be written.
    """
    path = Path(path)
    rgb = to_rgb(image if isinstance(image, Image.Image) else Image.fromarray(image))
    buffer = io.BytesIO()
    try:
        rgb.save(buffer, "JPEG", quality=quality, exif=to_exif(Position(where, heading, time)))
        write_whole(path, buffer.getvalue())
    except OSError as error:
        raise PhotoError(f"{path} cannot be written ({reason(error)}): check the folder and the size") from error


def from_exif(exif: Image.Exif) -> Position:
    """What EXIF says: GPS latitude and longitude, image direction, original time and offset. Never raises.

    A direction may be from magnetic north; it is taken as it stands.
    """
    gps, shot = _ifd(exif, IFD.GPSInfo), _ifd(exif, IFD.Exif)
    lat = _angle(gps.get(GPS.GPSLatitude), gps.get(GPS.GPSLatitudeRef), "NS")
    lon = _angle(gps.get(GPS.GPSLongitude), gps.get(GPS.GPSLongitudeRef), "EW")
    where = None
    if lat is not None and lon is not None:
        with suppress(PositionError):
            where = GeoPoint(lat, lon)
    turned = _floats(gps.get(GPS.GPSImgDirection))
    heading = turned[0] % 360 if len(turned) == 1 and 0 <= turned[0] <= 360 else None
    tags = (Base.DateTimeOriginal, Base.OffsetTimeOriginal)
    clock, offset = (str(shot.get(tag, "")).strip(" \0") for tag in tags)
    for text, form in ((clock + offset, _EXIF_TIME + "%z"), (clock, _EXIF_TIME)):
        with suppress(ValueError):
            return Position(where, heading, datetime.strptime(text, form))
    return Position(where, heading)


def to_exif(position: Position) -> Image.Exif:
    """The same tags for writing: the point to a millionth of a second of arc, the heading to 0.01."""
    exif = Image.Exif()
    gps: dict[int, Any] = {}
    if position.where is not None:
        lat, lon = position.where.lat, position.where.lon
        gps[GPS.GPSVersionID] = b"\x02\x03\x00\x00"
        gps[GPS.GPSLatitudeRef] = "S" if lat < 0 else "N"
        gps[GPS.GPSLatitude] = tuple(IFDRational(*fraction) for fraction in _degrees_minutes_seconds(lat))
        gps[GPS.GPSLongitudeRef] = "W" if lon < 0 else "E"
        gps[GPS.GPSLongitude] = tuple(IFDRational(*fraction) for fraction in _degrees_minutes_seconds(lon))
    if position.heading is not None:
        gps[GPS.GPSImgDirectionRef] = "T"
        gps[GPS.GPSImgDirection] = IFDRational(round(position.heading % 360 * 100) % 36_000, 100)
    if gps:
        exif[IFD.GPSInfo] = gps
    if position.time is not None:
        shot = {int(Base.DateTimeOriginal): _clock(position.time, " ").replace("-", ":")}
        if (offset := position.time.utcoffset()) is not None:
            minutes = round(offset.total_seconds() / 60)
            sign = "-" if minutes < 0 else "+"
            shot[int(Base.OffsetTimeOriginal)] = f"{sign}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}"
        exif[IFD.Exif] = shot
    return exif


def _ifd(exif: Image.Exif, which: IFD) -> dict[int, Any]:
    try:
        return dict(exif.get_ifd(which))
    except Exception:  # a broken table may raise anything at all; it then says nothing
        return {}


def _floats(value: Any) -> list[float]:
    """The numbers of a tag, however it holds them; none where one of them is none."""
    items = list(value) if isinstance(value, tuple | list) else [value]
    try:
        numbers = [float(item) for item in items]
    except (TypeError, ValueError, ArithmeticError):
        return []
    return numbers if all(math.isfinite(number) for number in numbers) else []


def _angle(value: Any, reference: object, signs: str) -> float | None:
    """Degrees from one to three numbers (degrees, minutes, seconds) and the letter that gives the sign."""
    letter = reference.decode("ascii", "replace") if isinstance(reference, bytes) else str(reference)
    letter = letter.strip(" \0").upper()
    numbers = _floats(value)
    if letter not in tuple(signs) or not 1 <= len(numbers) <= 3 or min(numbers) < 0:
        return None
    degrees = sum(number / float(60**i) for i, number in enumerate(numbers))
    return -degrees if letter == signs[1] else degrees


def _degrees_minutes_seconds(degrees: float) -> list[tuple[int, int]]:
    """As EXIF writes an angle: three fractions, the seconds in millionths; its sign is a letter elsewhere."""
    whole, rest = divmod(round(abs(degrees) * _MICROARCSECONDS), _MICROARCSECONDS)
    minutes, micro = divmod(rest, _MICROARCSECONDS // 60)
    return [(whole, 1), (minutes, 1), (micro, 1_000_000)]


# --- a copy of a JPEG with another position ------------------------------------------------
#
# Pixels are copied byte by byte, never decoded. What the EXIF held stays where it stood, so that thumbnails and
# makers' notes, which name their own whereabouts, stay right: the new tables of tags are added at its end, and
# only the pointer to the first table is changed.


_EXIF = b"Exif\0\0"
_EMPTY = b"II*\0\x08\0\0\0" + bytes(6)  # a TIFF of one table without a tag
_LONGEST = 0xFFFF - 2 - len(_EXIF)  # bytes of EXIF that a JPEG's segment can hold
_BYTE, _ASCII, _LONG, _RATIONAL = 1, 2, 4, 5
_SUPERSEDED = frozenset(
    {GPS.GPSLatitudeRef, GPS.GPSLatitude, GPS.GPSLongitudeRef, GPS.GPSLongitude, GPS.GPSHPositioningError}
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
    tiff = _EMPTY
    for kind, low, high in _segments(jpeg):
        if kind == 0xE1 and jpeg[low + 4 :].startswith(_EXIF):
            start, end, tiff = low, high, jpeg[low + 4 + len(_EXIF) : high]
            break
        if kind == 0xE0 and low == 2:  # JFIF wants to come first
            start = end = high
    placed = _placed(tiff, where, within_m)
    if len(placed) > _LONGEST:
        raise PhotoError("its EXIF is so long already that no position can be added")
    head = b"\xff\xe1" + struct.pack(">H", 2 + len(_EXIF) + len(placed)) + _EXIF
    return jpeg[:start] + head + placed + jpeg[end:]


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
        (GPS.GPSLatitude, _degrees_minutes_seconds(where.lat)),
        (GPS.GPSLongitude, _degrees_minutes_seconds(where.lon)),
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
