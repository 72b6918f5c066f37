"""Where, which way and when a photo was taken, as XMP says: inside photos, and in files beside them.

XMP is XML of strangers. It is read by expat without document types, and so without entities. Only properties of the
photo itself are looked at, which are attributes or children of an `rdf:Description` right below `rdf:RDF`.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from typing import NoReturn
from xml.parsers import expat  # nosec B405  # with document types refused, see below

from salad.errors import PositionError
from salad.geo import GeoPoint, around, compass, null_island
from salad.images.metadata import Position
from salad.images.times import parse_time
from salad.tables import shown

LONGEST_XMP = 1 << 20
"""Bytes of the longest packet that is read, in a photo or beside it."""
_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_EXIF = "http://ns.adobe.com/exif/1.0/"
_XMP = "http://ns.adobe.com/xap/1.0/"
_DJI = ("http://www.dji.com/drone-dji/1.0/", "http://www.autelrobotics.com/drone/1.0/")
_PARROT = "http://www.parrot.com/drone-parrot/1.0/"
_PIX4D = "http://pix4d.com/camera/1.0"
_PANORAMA = "http://ns.google.com/photos/1.0/panorama/"
_LONG_NAMESPACE = re.compile(rb"xmlns[^=<>]{0,100}=\s*[\"'][^\"'<>]{300}")
"""None of those that mean something is so long; expat writes it out before each name that it stands for."""
_ROOT, _DESCRIPTION = f"{_RDF} RDF", f"{_RDF} Description"
_PLACES = (
    (f"{_EXIF} GPSLatitude", f"{_EXIF} GPSLongitude"),
    # What drones know of themselves: the second name is misspelt by the maker.
    *((f"{maker} GpsLatitude", f"{maker} {name}") for maker in _DJI for name in ("GpsLongitude", "GpsLongtitude")),
    *((f"{maker} Latitude", f"{maker} Longitude") for maker in _DJI),
)
_HEADINGS = (
    f"{_EXIF} GPSImgDirection",
    f"{_PANORAMA} PoseHeadingDegrees",
    *(f"{maker} GimbalYawDegree" for maker in _DJI),  # where the camera looks, which is not where the drone flies
    f"{_PARROT} CameraYawDegree",
    f"{_PIX4D} Yaw",
    f"{_PIX4D}/ Yaw",
)
_TIMES = (
    f"{_EXIF} DateTimeOriginal",
    "http://ns.adobe.com/photoshop/1.0/ DateCreated",
    f"{_EXIF} DateTimeDigitized",
    f"{_XMP} CreateDate",
    f"{_EXIF} GPSTimeStamp",
)
_WANTED = frozenset({*(name for pair in _PLACES for name in pair), *_HEADINGS, *_TIMES})
_PLACED = frozenset(
    {
        *(name for pair in _PLACES for name in pair),
        *(f"{_EXIF} {name}" for name in ("GPSStatus", "GPSMapDatum", "GPSHPositioningError")),
    }
)
"""What says where the photo was taken, and how well that is known."""
_TAG = re.compile(rb"<(?:[^<>\"']|\"[^\"]*\"|'[^']*')*>")
_LONGEST_VALUE = 100  # letters of a value that means something here
_NUMBER = r"\d{1,12}(?:\.\d{0,20})?"
_ANGLE = re.compile(
    rf"\s*([+-]?{_NUMBER})\s*(?:,\s*({_NUMBER})\s*(?:,\s*({_NUMBER})\s*)?)?([A-Z]*)\s*", re.ASCII | re.IGNORECASE
)
_REAL = re.compile(rf"\s*([+-]?{_NUMBER})\s*(?:/\s*([+-]?{_NUMBER})\s*)?", re.ASCII)
_DEEPEST = 64  # elements within elements


class _NoXmpError(Exception):
    """The packet holds what none of them needs; expat lets it pass through."""


def parse_xmp(packet: bytes, *, source: str = "xmp", told: str = "the XMP in it") -> Position:
    """What a packet of XMP says of position, heading and time; whatever is malformed counts as not said.

    Of the fields that may hold each, the first that does counts: Exif's own, then those of drones and panoramas.

    Args:
        packet: Its bytes, in UTF-8, or in UTF-16 with a mark.
        source: Who says so, of `salad.images.metadata.SOURCES`.
        told: What a remark calls it.
    """
    try:
        held = _properties(packet)
    except (expat.ExpatError, _NoXmpError, UnicodeError):
        return Position(source=source, remark=f"{told} cannot be read")
    where, remark = None, ""
    for names in _PLACES:
        lat, lon = (held.get(name, "") for name in names)
        # Drones write 0,0 as Exif's where they know better in fields of their own.
        if (lat or lon) and (where is None or null_island(where)):
            point = _point(lat, lon)
            where = where if point is None else point
            held_as = f"{shown(lat, most=20)}, {shown(lon, most=20)}"
            remark = remark or f"the position in {told} is not understood ({held_as})"
    headings = (_real(held.get(name, "")) for name in _HEADINGS)
    heading = next((compass(turned) for turned in headings if math.isfinite(turned)), None)
    times = (parse_time(held.get(name, "")) for name in _TIMES)
    return Position(where, heading, next((time for time in times if time), None), source, "" if where else remark)


def _properties(packet: bytes) -> dict[str, str]:
    """The properties that mean something here, each by its namespace and name; the first of each."""
    utf_16 = packet[:2] in (b"\xff\xfe", b"\xfe\xff")
    clean = packet.decode("utf-16" if utf_16 else "utf-8", "replace").strip("\0\ufeff \t\r\n").encode()
    if len(packet) > LONGEST_XMP or _LONG_NAMESPACE.search(clean):
        raise _NoXmpError
    held: dict[str, str] = {}
    open_elements: list[str] = []
    text: list[str] = []

    def refuse(*_: object) -> NoReturn:
        raise _NoXmpError

    def begin(name: str, attributes: dict[str, str]) -> None:
        if name == _DESCRIPTION and open_elements[-1:] == [_ROOT]:
            for key in _WANTED.intersection(attributes):
                held.setdefault(key, attributes[key].strip())
        if len(open_elements) == _DEEPEST:
            raise _NoXmpError
        open_elements.append(name)
        text.clear()

    def end(name: str) -> None:
        open_elements.pop()
        if name in _WANTED and open_elements[-2:] == [_ROOT, _DESCRIPTION]:
            held.setdefault(name, "".join(text).strip())
        text.clear()

    def hear(data: str) -> None:
        if open_elements and open_elements[-1] in _WANTED:
            text.append(data)

    parser = expat.ParserCreate("utf-8", " ")
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = begin, end, hear
    parser.Parse(clean, True)
    return held


def _point(lat: str, lon: str) -> GeoPoint | None:
    """A point whose latitude and longitude are both understood, else None; longitudes may go on beyond 180."""
    north, east = _angle(lat, "NS"), _angle(lon, "EW")
    if not abs(east) <= 360:  # NaN too
        return None
    with suppress(PositionError):
        return GeoPoint(north, around(east))
    return None


def _angle(text: str, signs: str) -> float:
    """Degrees of `36,48,0S`, `36,48.0S` or `-36.8`; NaN where neither sign nor letter tells the half of the earth."""
    found = _ANGLE.fullmatch(text) if len(text) <= _LONGEST_VALUE else None
    if found is None:
        return math.nan
    number, minutes, seconds, letter = found.groups()
    signed = number[0] in "+-"
    letter = letter[:1].upper()
    degrees = abs(float(number)) + float(minutes or 0) / 60 + float(seconds or 0) / 3600
    if not letter and minutes is None:  # a decimal number needs no letter, whether or not a sign stands before it
        return math.copysign(degrees, float(number))
    if signed or not letter or letter not in signs:
        return math.nan
    return -degrees if letter == signs[1] else degrees


def _real(text: str) -> float:
    """A number, or a fraction; NaN for whatever is neither."""
    found = _REAL.fullmatch(text) if len(text) <= _LONGEST_VALUE else None
    if found is None:
        return math.nan
    below = float(found[2] or 1)
    return float(found[1]) / below if below else math.nan


def without_place(packet: bytes) -> bytes:
    """The same packet, as long as before, with spaces where the photo's position stood; of the rest nothing moves.

    What is not read as XMP here stays as it is. So do positions of what else the packet tells, such as the destination.

    Args:
        packet: Its bytes, in UTF-8, as a JPEG holds them.
    """
    kept = bytearray(packet)
    open_elements: list[str] = []
    begun = 0  # where the last element of a position began

    def refuse(*_: object) -> NoReturn:
        raise _NoXmpError

    def blank(low: int, high: int) -> None:
        kept[low:high] = b" " * (high - low)

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal begun
        start = begun = parser.CurrentByteIndex
        if name == _DESCRIPTION and open_elements[-1:] == [_ROOT]:
            tag = _TAG.match(packet, start)
            for key in _PLACED.intersection(attributes) if tag else ():
                local = re.escape(key.rpartition(" ")[2].encode())
                written = re.compile(rb"\s[^\s=\"'<>]*:" + local + rb"\s*=\s*(?:\"[^\"]*\"|'[^']*')")
                for found in written.finditer(packet, start, tag.end() if tag else start):
                    blank(*found.span())
        if len(open_elements) == _DEEPEST:
            raise _NoXmpError
        open_elements.append(name)

    def end(name: str) -> None:
        open_elements.pop()
        if name in _PLACED and open_elements[-2:] == [_ROOT, _DESCRIPTION]:
            whole = _TAG.match(packet, begun)
            empty = whole is not None and whole[0].endswith(b"/>")  # then its end is told behind it
            blank(begun, whole.end() if whole and empty else packet.index(b">", parser.CurrentByteIndex) + 1)

    parser = expat.ParserCreate("utf-8", " ")
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    if len(packet) > LONGEST_XMP or _LONG_NAMESPACE.search(packet):
        return packet
    try:
        parser.Parse(packet.rstrip(b"\0"), True)
    except (expat.ExpatError, _NoXmpError, ValueError):
        return packet
    return bytes(kept)
