"""Tables as people and programs write them: what columns are called, degrees, times, and where nothing is known.

What can only mean one thing is read; what may mean two is refused by a sentence that says which two, since a guess
would put photos elsewhere in silence.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from typing import Literal

from salad.geo import GeoPoint
from salad.tables import number, shown

_WORDS = {
    "path": ("sourcefile", "filename", "file", "name", "image", "photo"),
    "lat": ("latitude", "gpslatitude"),
    "lon": ("longitude", "long", "lng", "gpslongitude"),
    "lat_ref": ("gpslatituderef",),
    "lon_ref": ("gpslongituderef",),
    "heading": ("gpsimgdirection",),
    "time": ("datetimeoriginal",),
}
"""What else columns are called; long names in one word are exiftool's."""
_UNKNOWN = frozenset({"", "-", "nan", "null", "none", "na", "n/a", "<na>", "nat", "\\n"})
_MOST_TURNED = 1e6  # degrees, beyond which a turn is lost in rounding
# Typographic signs for plain ones; spaces that do not break, and marks of direction that come along by copy and paste.
_PLAIN = str.maketrans(
    {
        "\u2212": "-",
        "\u2013": "-",
        "\u00a0": " ",
        "\u2009": " ",
        "\u202f": " ",
        "\u200b": "",
        "\u200e": "",
        "\u200f": "",
    }
)
_DECIMAL_COMMA = re.compile(r"(?<=[0-9]),(?=[0-9])")
_SEXAGESIMAL = re.compile(
    r"""(?P<before>[NSEW])?\s*(?P<sign>[+-]?)\s*
    (?P<degrees>[0-9]{1,3}(?:\.[0-9]{0,15})?)\s*
    (?:(?:[°º˚:]|DEG)\s*
      (?:(?P<minutes>[0-9]{1,2}(?:\.[0-9]{0,15})?)\s*
        (?:['\u2032\u2019´:]\s*
          (?:(?P<seconds>[0-9]{1,2}(?:\.[0-9]{0,15})?)\s*(?:"{1,2}|''|\u2033|\u2032\u2032|\u201d)?\s*)?
        )?
      )?
    )?
    (?P<after>[NSEW])?""",
    re.VERBOSE,
)
_CLOCK = (
    r"(?:[T ,]\s*(?P<hour>[0-9]{1,2})(?P<rest>:[0-9]{2}(?::[0-9]{2}(?:[.,][0-9]{1,9})?)?)"
    r"\s*(?P<zone>Z|[+-][0-9]{2}:?[0-9]{2})?)?"
)
_YEAR_FIRST = re.compile(r"(?P<year>[0-9]{4})[:/.](?P<month>[0-9]{1,2})[:/.](?P<day>[0-9]{1,2})" + _CLOCK)
_DAY_FIRST = re.compile(r"(?P<day>[0-9]{1,2})\.\s?(?P<month>[0-9]{1,2})\.\s?(?P<year>[0-9]{4})" + _CLOCK)
_EITHER_FIRST = re.compile(r"[0-9]{1,2}[/-][0-9]{1,2}[/-][0-9]{2,4}\b.*")
_NEVER = re.compile(r"000[01]\D.*")  # what cameras write whose clock was never set


def columns(names: Sequence[str]) -> list[str]:
    """The names of a table's columns as we call them, in small letters; a name that stands for none of ours as it is.

    A column that is called as ours is that one, whatever others there are. Where none is, and several might be meant,
    as `file` and `name`, all of them keep their names: only exiftool's `SourceFile` is always the path.
    """
    called = [name.strip().lower() for name in names]
    for ours, words in _WORDS.items():
        meant = {word for word in words if word in called} if ours not in called else set()
        meant = meant & {"sourcefile"} or meant
        if len(meant) == 1:
            called = [ours if name in meant else name for name in called]
    return called


def unknown(value: object) -> bool:
    """Whether a field says that nothing is known: empty, `NaN`, `NULL` and the like; a NaN equals not even itself."""
    return value is None or value != value or (isinstance(value, str) and value.strip().lower() in _UNKNOWN)


def degrees(value: object, name: Literal["lat", "lon", "heading"]) -> float | None:
    """Degrees as a number, with a decimal point or comma, or as in `47° 30' 12.5" N`; None where nothing is known.

    A letter stands for the sign, `S` and `W` being negative.

    Args:
        value: A field of a table.
        name: What it is, which says which letters it may have.

    Raises:
        ValueError: If it is no such thing, or has a sign and a letter.
    """
    if unknown(value):
        return None
    text = str(value).translate(_PLAIN).strip()
    if text.count(",") == 1 and "." not in text:
        text = _DECIMAL_COMMA.sub(".", text)
    try:
        found = number(text.rstrip(" °º"))
    except ValueError:
        found = _of_sixtieths(text, name)
    if name == "heading" and abs(found) > _MOST_TURNED:
        raise ValueError(f"its {name} {shown(value)} is not a number of degrees")
    return found


def _of_sixtieths(text: str, name: Literal["lat", "lon", "heading"]) -> float:
    letters = {"lat": "NS", "lon": "EW", "heading": ""}[name]
    parts = _SEXAGESIMAL.fullmatch(text.upper())
    letter = parts and (parts["before"] or parts["after"] or "")
    if parts is None or (parts["before"] and parts["after"]) or (letter and letter not in letters):
        raise ValueError(f"its {name} {shown(text)} is not a number of degrees")
    if letter and parts["sign"]:
        raise ValueError(f"its {name} {shown(text)} has a sign and a letter: keep one of them")
    written = [part for part in parts.group("degrees", "minutes", "seconds") if part is not None]
    sixtieths = [float(part) for part in written]
    # A part of a degree is written either way, not both, and sixty minutes are the next degree.
    if any("." in part for part in written[:-1]) or any(part >= 60 for part in sixtieths[1:]):
        raise ValueError(f"its {name} {shown(text)} is not a number of degrees")
    found = sum(part / 60.0**power for power, part in enumerate(sixtieths))
    return -found if parts["sign"] == "-" or letter in ("S", "W") else found


def position(lat: object, lon: object, *, lat_ref: object = "", lon_ref: object = "") -> GeoPoint | None:
    """The point of two fields of a table; None where neither is known.

    Args:
        lat: The latitude.
        lon: The longitude.
        lat_ref: `N`, `South` or the like, where that is a column of its own, and the latitude may lack its sign.
        lon_ref: `E`, `West` or the like.

    Raises:
        ValueError: If one is no number of degrees, or only one is known; or if they look exchanged, or like metres.
        PositionError: If they are no place on earth.
    """
    north, east = degrees(lat, "lat"), degrees(lon, "lon")
    if north is None or east is None:
        if north is None and east is None:
            return None
        lacking, has = ("lat", "lon") if north is None else ("lon", "lat")
        raise ValueError(f"its {lacking} {shown(lat if north is None else lon)} is not known, but its {has} is")
    if abs(north) > 360 or abs(east) > 360:
        raise ValueError(f"{north:g} and {east:g} are metres on some map, such as UTM, and no degrees of WGS84")
    if 90 < abs(north) <= 180 and abs(east) <= 90:
        raise ValueError(f"latitude {north} is not between -90 and 90: it and longitude {east} may be exchanged")
    south, west = str(lat_ref).strip().upper() in ("S", "SOUTH"), str(lon_ref).strip().upper() in ("W", "WEST")
    return GeoPoint(-abs(north) if south else north, -abs(east) if west else east)


def time(value: object) -> datetime | None:
    """A time: as ISO 8601 has it, as EXIF has it (`2024:05:31 14:00:00`), or with dots (`31.05.2024 14:00`).

    None where nothing is known, or where a clock was never set.

    Raises:
        ValueError: If it is none, or may mean two.
    """
    if isinstance(value, datetime):
        return value
    if unknown(value) or _NEVER.fullmatch(text := str(value).translate(_PLAIN).strip()):
        return None
    told = f"its time {shown(value)}"
    parts = _YEAR_FIRST.fullmatch(text) or _DAY_FIRST.fullmatch(text)
    if parts is not None:
        text = f"{parts['year']}-{parts['month']:>02}-{parts['day']:>02}"
        if parts["hour"]:
            text += f"T{parts['hour']:>02}{parts['rest']}{parts['zone'] or ''}"
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        if re.fullmatch(r"[0-9]{4,}(?:[.,][0-9]*)?", text):
            told += " counts days or seconds from some day on, and"
        elif _EITHER_FIRST.fullmatch(text):
            told += " may begin with the day or the month, and"
        raise ValueError(f"{told} is not written as 2024-05-31T14:00:00") from None
