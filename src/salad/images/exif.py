"""Where, which way and when a photo was taken, as its EXIF says: read and written.

Whatever is malformed counts as not said: a photo with a broken tag is a photo without a position.
"""

from __future__ import annotations

import io
import math
from contextlib import nullcontext, suppress
from datetime import datetime
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.TiffImagePlugin import IFDRational

from salad.errors import PhotoError, PositionError, reason
from salad.files import write_whole
from salad.geo import GeoPoint
from salad.images.decode import on_disk, open_image, quiet_pillow
from salad.images.metadata import Position
from salad.images.rgb import to_rgb

if TYPE_CHECKING:
    from salad.images.decode import Pixels

_EXIF_TIME = "%Y:%m:%d %H:%M:%S"
_MICROARCSECONDS = 3_600_000_000  # in a degree; one is 30 micrometres on the ground


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
    time = None
    for text, form in ((clock, _EXIF_TIME), (clock + offset, _EXIF_TIME + "%z")):
        with suppress(ValueError):
            time = datetime.strptime(text, form)
    return Position(where, heading, time, "exif")


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


def degrees_minutes_seconds(degrees: float) -> list[tuple[int, int]]:
    """As EXIF writes an angle: three fractions, the seconds in millionths; its sign is a letter elsewhere."""
    whole, rest = divmod(round(abs(degrees) * _MICROARCSECONDS), _MICROARCSECONDS)
    minutes, micro = divmod(rest, _MICROARCSECONDS // 60)
    return [(whole, 1), (minutes, 1), (micro, 1_000_000)]
