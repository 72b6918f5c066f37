"""Where, which way and when a photo was taken, as its EXIF says: read and written.

The measure of reading is what exiftool says (`tests/images/test_exiftool.py`). Whatever is malformed counts as not
said: a photo with a broken tag is a photo without a position, and a remark says what was not understood.
"""

from __future__ import annotations

import io
import math
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.TiffImagePlugin import IFDRational

from salad.errors import PhotoError, reason
from salad.files import write_whole
from salad.geo import GeoPoint, around, compass
from salad.images.decode import quiet_pillow
from salad.images.metadata import Position
from salad.images.rgb import to_rgb
from salad.images.times import parse_time
from salad.tables import shown

if TYPE_CHECKING:
    from salad.images.decode import Pixels

_MICROARCSECONDS = 3_600_000_000  # in a degree; one is 30 micrometres on the ground
_WILD = 3600  # degrees of a direction, above which it is a placeholder, such as 65535
_TIMES = (  # each with its fraction of a second and its offsets from UTC, in the order in which they count
    (Base.DateTimeOriginal, Base.SubsecTimeOriginal, Base.OffsetTimeOriginal),
    (Base.DateTimeDigitized, Base.SubsecTimeDigitized, Base.OffsetTimeDigitized),
)
_NUMBERS = re.compile(r"[+-]?\d{1,12}(?:\.\d{0,15})?", re.ASCII)


# --- reading -------------------------------------------------------------------------------


def from_exif(exif: Image.Exif) -> Position:
    """What EXIF says: latitude and longitude, image direction, and when the photo was taken. Never raises.

    The time is the original's, else when it was digitised, else the GPS's own, which is UTC. A direction may be from
    magnetic north; it is taken as it stands.
    """
    gps, shot = _ifd(exif, IFD.GPSInfo), _ifd(exif, IFD.Exif)
    where, remark = _where(gps)
    heading = None
    turned = _numbers(gps.get(GPS.GPSImgDirection))[:1]
    if turned and abs(turned[0]) <= _WILD:  # not NaN
        heading = compass(turned[0])
    elif turned and not math.isnan(turned[0]):
        remark = "; ".join(filter(None, (remark, f"the direction in its EXIF is not understood ({turned[0]:g})")))
    times = (_time(shot, *tags) for tags in _TIMES)
    return Position(where, heading, next((time for time in times if time), None) or _gps_time(gps), "exif", remark)


def changed(exif: Image.Exif) -> Position:
    """When a file was changed, which is when it was taken where nobody says that; EXIF's first table holds it.

    Without a source, for it counts after all of them.
    """
    return Position(time=_time({**_ifd(exif, IFD.Exif), **_ifd(exif)}, Base.DateTime, Base.SubsecTime, Base.OffsetTime))


def _ifd(exif: Image.Exif, which: IFD | None = None) -> dict[int, Any]:
    try:
        with quiet_pillow():
            return dict(exif if which is None else exif.get_ifd(which))
    except Exception:  # a broken table may raise anything at all; it then says nothing
        return {}


def _where(gps: dict[int, Any]) -> tuple[GeoPoint | None, str]:
    """The position, or why a table that has one was not understood: without its letters it may be anywhere in four."""
    parts = (
        ("latitude", "NS", gps.get(GPS.GPSLatitude), gps.get(GPS.GPSLatitudeRef)),
        ("longitude", "EW", gps.get(GPS.GPSLongitude), gps.get(GPS.GPSLongitudeRef)),
    )
    missing = [name for name, _, value, _ in parts if value is None]
    if missing:
        return None, f"its EXIF has no {missing[0]}" if len(missing) == 1 else ""
    degrees = []
    for name, signs, value, reference in parts:
        letter = _text(reference).strip()[:1].upper()
        if letter not in signs or not letter:
            said = f"has the letter {shown(letter)} in place of" if letter else "has none of the letters"
            return None, f"the {name} in its EXIF {said} {signs[0]} or {signs[1]}"
        degrees.append(_angle(_numbers(value), letter == signs[1]))
        if not abs(degrees[-1]) <= (90 if signs == "NS" else 360):  # NaN too
            return None, f"the {name} in its EXIF is not understood ({_told(value)} {letter})"
    lat, lon = degrees
    return GeoPoint(lat, around(lon)), ""


def _angle(numbers: list[float], other_half: bool) -> float:
    """Degrees from one to three numbers (degrees, minutes, seconds), negative in the other half; NaN if they are none.

    What is written as 0/0 at the end is not known: seconds may be missing, and minutes where degrees have a fraction.
    """
    while numbers and math.isnan(numbers[-1]):
        numbers = numbers[:-1]
        if len(numbers) == 1 and numbers[0].is_integer():
            return math.nan
    if not 1 <= len(numbers) <= 3:
        return math.nan
    if other_half and max(numbers) <= 0:  # said twice
        numbers = [-number for number in numbers]
    if not min(numbers) >= 0:  # a sign against the letter, or NaN
        return math.nan
    degrees = sum(number / 60.0**place for place, number in enumerate(numbers))
    return -degrees if other_half else degrees


def _numbers(value: Any) -> list[float]:
    """The numbers of a tag, however it holds them; NaN in place of each that is none."""
    if isinstance(value, str):
        return [float(number) for number in _NUMBERS.findall(value[:100])]
    numbers = []
    for item in value if isinstance(value, tuple | list) else [] if value is None else [value]:
        try:
            number = float(item)
        except (TypeError, ValueError, ArithmeticError):
            number = math.nan
        numbers.append(number if math.isfinite(number) else math.nan)
    return numbers


def _text(value: Any) -> str:
    """The text of a tag, up to the first NUL, behind which anything may stand."""
    text = value.decode("latin-1") if isinstance(value, bytes) else value if isinstance(value, str) else ""
    return text.split("\0")[0]


def _told(value: Any) -> str:
    if isinstance(value, str | bytes):
        return shown(value, most=40)
    return " ".join("0/0" if math.isnan(number) else f"{number:g}" for number in _numbers(value)[:4])


def _time(tags: dict[int, Any], clock: int, fraction: int, offset: int) -> datetime | None:
    offsets = [_text(tags.get(tag)).strip() for tag in (offset, Base.OffsetTime)]
    return parse_time(_text(tags.get(clock)), offset=offsets[0] or offsets[1], fraction=_text(tags.get(fraction)))


def _gps_time(gps: dict[int, Any]) -> datetime | None:
    """The time of the satellites, in UTC: a date as a text, and hours, minutes and seconds as numbers."""
    day, clock = parse_time(_text(gps.get(GPS.GPSDateStamp))), _numbers(gps.get(GPS.GPSTimeStamp))
    if day is None or len(clock) != 3 or not (0 <= clock[0] <= 24 and 0 <= clock[1] <= 60 and 0 <= clock[2] <= 61):
        return None
    hours, minutes, seconds = clock
    return day.replace(tzinfo=UTC) + timedelta(hours=hours, minutes=minutes, seconds=seconds)


# --- writing -------------------------------------------------------------------------------


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


def to_exif(position: Position) -> Image.Exif:
    """The same tags for writing: the point to a millionth of a second of arc, the heading to 0.01."""
    exif = Image.Exif()
    gps: dict[int, Any] = {}
    if position.where is not None:
        lat, lon = position.where.lat, position.where.lon
        gps[GPS.GPSVersionID] = b"\x02\x03\x00\x00"
        gps[GPS.GPSLatitudeRef] = "S" if lat < 0 else "N"
        gps[GPS.GPSLatitude] = tuple(IFDRational(*fraction) for fraction in degrees_minutes_seconds(lat))
        gps[GPS.GPSLongitudeRef] = "W" if lon < 0 else "E"
        gps[GPS.GPSLongitude] = tuple(IFDRational(*fraction) for fraction in degrees_minutes_seconds(lon))
    if position.heading is not None:
        gps[GPS.GPSImgDirectionRef] = "T"
        gps[GPS.GPSImgDirection] = IFDRational(round(position.heading % 360 * 100) % 36_000, 100)
    if gps:
        exif[IFD.GPSInfo] = gps
    if position.time is not None:
        shot = {
            int(Base.DateTimeOriginal): position.time.replace(tzinfo=None).isoformat(" ", "seconds").replace("-", ":")
        }
        if (offset := position.time.utcoffset()) is not None:
            minutes = round(offset.total_seconds() / 60)
            sign = "-" if minutes < 0 else "+"
            shot[int(Base.OffsetTimeOriginal)] = f"{sign}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}"
        exif[IFD.Exif] = shot
    return exif


def degrees_minutes_seconds(degrees: float) -> list[tuple[int, int]]:
    """As EXIF writes an angle: three fractions, the seconds in millionths; its sign is a letter elsewhere."""
    whole, rest = divmod(round(abs(degrees) * _MICROARCSECONDS), _MICROARCSECONDS)
    minutes, micro = divmod(rest, _MICROARCSECONDS // 60)
    return [(whole, 1), (minutes, 1), (micro, 1_000_000)]
