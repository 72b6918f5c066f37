"""`@` names, in which data sets write where, which way and when a photo was taken: read and written."""

from __future__ import annotations

import math
import os
import re
from contextlib import suppress
from datetime import datetime
from typing import NamedTuple

from salad.errors import PositionError
from salad.geo import GeoPoint, Utm, compass, from_utm, to_utm, zone_number
from salad.images.metadata import Position

# With the comma of some countries' programs, and the exponent that programs write for large numbers.
_NUMBER = re.compile(r"[+-]?[0-9]{1,12}(?:[.,][0-9]{0,15}(?:[eE][+-]?[0-9]{1,2})?)?")
_BAND_S = (3_500_000, 4_470_000)  # metres north from 32 to 40 degrees, with room for the edges of zones
_SUFFIX = re.compile(r"\.[A-Za-z]\w*$")
_STAMP = "YYYYMMDD_hhmmss"
_BLANK = [""] * 14  # fields that a short `@` name leaves away


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


def zone_of(fields: AtName) -> int:
    """The UTM zone that an `@` name counts in: 1 to 60, negative south of the equator, 0 where it does not say.

    `S` is a band of the north, from 32 to 40 degrees, to those who made the grid, and the southern hemisphere to many
    who write names. A latitude decides where the name has one; else the northing: what has 3.5 to 4.5 million metres
    is taken for the band (it could be Patagonia as well), all else is south. Zone and letter may stand in one field.
    """
    named, lat = fields.zone + fields.letter, fields.lat
    known = 0 < abs(lat) <= 90
    if named[-1:] in ("s", "S"):
        north = lat > 0 if known else _BAND_S[0] <= fields.northing <= _BAND_S[1]
        return zone_number(named) if north else -zone_number(named)
    if known and named.isdecimal():
        named += "N" if lat > 0 else "M"
    return zone_number(named)


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
    where, zone = None, zone_of(fields)
    with suppress(PositionError):
        where = from_utm(Utm(fields.easting, fields.northing, abs(zone), "N" if zone > 0 else "M"))
    if where is None:
        with suppress(PositionError):
            where = GeoPoint(fields.lat, fields.lon)
    remark = ""
    if where is None:
        remark = "its name gives metres that are off the UTM grid" if zone else "its name gives metres, but no UTM zone"
    heading = None if math.isnan(fields.heading) else compass(fields.heading)
    return Position(where, heading, _parse_stamp(fields.timestamp), "name", remark)


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
    stamp = "" if time is None else re.sub("[-:]", "", time.replace(tzinfo=None).isoformat("_", "seconds"))
    fields = [f"{grid.easting:010.2f}", f"{grid.northing:010.2f}", f"{grid.zone:02d}", grid.letter]
    fields += [f"{where.lat:09.5f}", f"{where.lon:010.5f}", panoid, "", degrees, "", "", "", stamp, note]
    return f"@{'@'.join(fields)}@{suffix}"


def _number(text: str) -> float:
    return float(text.replace(",", ".")) if _NUMBER.fullmatch(text) else math.nan


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
