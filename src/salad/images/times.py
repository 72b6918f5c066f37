"""When a photo was taken, as cameras and programs write it in texts."""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import UTC, datetime, timedelta, timezone

_EARLIEST = 1826
"""Year of the oldest photo there is; before it lie placeholders (`0000:00:00 00:00:00`, `0001:01:01 00:00:00`)."""
_BETWEEN = r"\s*[-:/.]\s*"
_DATE = rf"(\d{{4}})(?:{_BETWEEN}(\d{{1,2}}){_BETWEEN}(\d{{1,2}})|(\d\d)(\d\d))"
_CLOCK = (
    rf"(\d{{1,2}}){_BETWEEN}(\d{{1,2}})(?:{_BETWEEN}(\d{{1,2}})(?:[.,]\s*(\d*))?)?|(\d\d)(\d\d)(\d\d)(?:[.,](\d*))?"
)
_OFFSET = r"(Z|UTC|GMT)|([+-])(\d{1,2}):?(\d\d)?"
_TIME = re.compile(rf"\s*{_DATE}(?:(?:\s*[T_]\s*|\s+|:)(?:{_CLOCK})\s*(?:{_OFFSET})?)?\s*", re.ASCII | re.IGNORECASE)
_LONGEST = 64  # letters of a time


def parse_time(text: str, *, offset: str = "", fraction: str = "") -> datetime | None:
    """The time that a text names, or None where it names none.

    `2023:07:14 10:20:30` as EXIF has it, and whatever else is met: hyphens, slashes or points between the numbers, a
    `T` before the clock, numbers padded by blanks, no seconds, no clock at all (midnight), fractions, and `Z` or an
    offset at its end. Blanks and placeholders are none, and so is every year before there were photos.

    Args:
        text: The time.
        offset: From UTC, `+12:00` or `Z`, where it stands elsewhere; one in `text` comes before it.
        fraction: Digits of a fraction of a second, where they stand elsewhere; those in `text` come before them.

    Returns:
        Local time without a time zone, unless an offset is known.
    """
    found = _TIME.fullmatch(text.split("\0")[0]) if len(text) <= _LONGEST else None
    if found is None:
        return None
    year, month, day, month_2, day_2, *clock = found.groups()[:13]
    hour, minute, second, part = clock[:4] if clock[0] is not None else clock[4:]
    part = part or re.match("[0-9]*", fraction.strip())[0]  # type: ignore[index]  # it matches always
    zone = _zone(*found.groups()[13:]) if any(found.groups()[13:]) else parse_offset(offset)
    if int(year) < _EARLIEST:
        return None
    with suppress(ValueError, OverflowError):
        return datetime(
            int(year),
            int(month or month_2),
            int(day or day_2),
            int(hour or 0),
            int(minute or 0),
            int(second or 0),
            int(part[:6].ljust(6, "0")),
            zone,
        )
    return None


def parse_offset(text: str) -> timezone | None:
    """The time zone of `+12:00`, `-0330`, `+2` or `Z`; None for any other text."""
    found = re.fullmatch(_OFFSET, text.split("\0")[0].strip()[:_LONGEST], re.ASCII | re.IGNORECASE)
    return _zone(*found.groups()) if found else None


def _zone(utc: str | None, sign: str | None, hours: str | None, minutes: str | None) -> timezone | None:
    if utc:
        return UTC
    apart = timedelta(hours=int(hours or 0), minutes=int(minutes or 0))
    # No clock on earth is further from UTC than 14 hours: what says more is no offset.
    return None if apart > timedelta(hours=14) or int(minutes or 0) > 59 else timezone(-apart if sign == "-" else apart)
