"""What a photo says of itself beside what exiftool says of it: position, heading, time and orientation.

    python -m benchmarks.exiftool [--count 2000] [--seed 7] [FOLDER ...]

Photos are drawn as benchmarks.odd_photos has them, or those of the folders are taken. The table counts agreement, and
every kind of difference with its reason; what has none is named file by file, and the command ends with 1. Files beside
a photo, which exiftool reads only when it is told to, are left out by both.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.machine import conditions, in_a_line
from benchmarks.odd_photos import make
from benchmarks.options import benchmark_parser
from salad.geo import GeoPoint, null_island
from salad.images.decode import open_image, quiet_pillow
from salad.images.finding import SUFFIXES
from salad.images.metadata import settled
from salad.images.photo import sayings

FACTS = ("position", "heading", "time", "orientation")
_PLACES = ("Composite", "XMP-exif", "XMP-drone-dji")
_TAGS = (
    *(f"{group}:GPS{name}itude" for group in (*_PLACES, "GPS") for name in ("Lat", "Long")),
    *("XMP-drone-dji:GPSLongtitude", "GPS:GPSLatitudeRef", "GPS:GPSLongitudeRef"),
    *("GPS:GPSImgDirection", "XMP-exif:GPSImgDirection", "XMP-drone-dji:GimbalYawDegree"),
    *("ExifIFD:DateTimeOriginal", "ExifIFD:CreateDate", "IFD0:ModifyDate", "XMP-exif:DateTimeOriginal"),
    *("ExifIFD:OffsetTimeOriginal", "ExifIFD:OffsetTimeDigitized", "ExifIFD:OffsetTime"),
    *("ExifIFD:SubSecTimeOriginal", "ExifIFD:SubSecTimeDigitized", "ExifIFD:SubSecTime"),
    *("GPS:GPSDateStamp", "GPS:GPSTimeStamp", "IFD0:Orientation", "XMP-tiff:Orientation"),
)


class Said(NamedTuple):
    """What one of the two says of a photo; degrees, and a time as its numbers and its offset in minutes.

    Attributes:
        position: Latitude and longitude.
        heading: 0 to 360.
        time: Year to second, and minutes from UTC.
        orientation: 1 to 8; 1 where none is said.
        opened: Whether the photo could be opened at all.
        remark: Why something is not known.
    """

    position: tuple[float, float] | None
    heading: float | None
    time: tuple[tuple[int, ...], int | None] | None
    orientation: int
    opened: bool = True
    remark: str = ""


def by_exiftool(paths: Sequence[Path]) -> dict[str, dict[str, Any]]:
    """The tags of each photo as `exiftool -n` tells them, by one process; groups are part of their names."""
    asked = ["exiftool", "-q", "-q", "-json", "-n", "-G1", "-a", *(f"-{tag}" for tag in _TAGS), "-@", "-"]
    names = "\n".join(map(str, paths))
    told = subprocess.run(asked, input=names, capture_output=True, text=True, errors="replace", check=False).stdout
    return {row["SourceFile"]: row for row in json.loads(told or "[]")}


def exiftool_version() -> str:
    """Empty where it is not installed."""
    with suppress(OSError):
        return subprocess.run(["exiftool", "-ver"], capture_output=True, text=True, check=False).stdout.strip()
    return ""


def theirs(row: Mapping[str, Any]) -> Said:
    """What exiftool's tags come to: its own composite position, then XMP's, and the like."""
    position = None
    for group in _PLACES:
        lat, lon = (_number(row.get(f"{group}:GPS{axis}itude")) for axis in ("Lat", "Long"))
        if group == "XMP-drone-dji" and lon is None:
            lon = _number(row.get(f"{group}:GPSLongtitude"))
        if position is None and lat is not None and lon is not None:
            position = lat, lon
    headings = [_number(row.get(tag)) for tag in _TAGS if "Direction" in tag or "Yaw" in tag]
    heading = next((turned for turned in headings if turned is not None), None)
    turned = _number(row.get("IFD0:Orientation", row.get("XMP-tiff:Orientation")))
    upright = int(turned) if turned is not None and 1 <= turned <= 8 else 1
    return Said(position, None if heading is None else heading % 360, _their_time(row), upright)


def _their_time(row: Mapping[str, Any]) -> tuple[tuple[int, ...], int | None] | None:
    common = row.get("ExifIFD:OffsetTime")
    gps = f"{row.get('GPS:GPSDateStamp', '')} {row.get('GPS:GPSTimeStamp', '')}Z"
    for clock, offset in (
        (row.get("ExifIFD:DateTimeOriginal"), row.get("ExifIFD:OffsetTimeOriginal") or common),
        (row.get("ExifIFD:CreateDate"), row.get("ExifIFD:OffsetTimeDigitized") or common),
        (gps if len(gps) > 15 else None, None),
        (row.get("XMP-exif:DateTimeOriginal"), None),
        (row.get("IFD0:ModifyDate"), common),
    ):
        # Read with none of our own code: the numbers in their order, if they make a time.
        found = re.match(r"((?:\d+\D+){2,5}\d+)(?:[.,]\d+)?\s*([-+]\d\d:?\d\d|Z)?$", str(clock or "").strip())
        if found is None:
            continue
        numbers = [int(number) for number in re.findall(r"\d+", found[1])][:6]
        with suppress(ValueError, OverflowError):
            moment = datetime(*numbers)  # type: ignore[arg-type]  # three to six numbers
            if moment.year >= 1826:
                return tuple(moment.timetuple()[:6]), _minutes(found[2] or str(offset or ""))
    return None


def _minutes(offset: str) -> int | None:
    found = re.fullmatch(r"([-+])(\d\d):?(\d\d)", offset.strip())
    if found is None:
        return 0 if offset.strip() == "Z" else None
    return (-1 if found[1] == "-" else 1) * (60 * int(found[2]) + int(found[3]))


def _number(value: Any) -> float | None:
    with suppress(TypeError, ValueError):
        number = float(value)
        return number if math.isfinite(number) else None
    return None


def ours(path: Path) -> Said:
    """What we say, of its name and of files beside it abstaining."""
    known = settled(said for said in sayings(path) if said.source in ("exif", "xmp", None))
    where, moment = known.where, known.time
    time = None
    if moment is not None:
        offset = moment.utcoffset()
        time = tuple(moment.timetuple()[:6]), None if offset is None else round(offset.total_seconds() / 60)
    opened, upright = False, 1
    with suppress(Exception), path.open("rb") as file:
        image = open_image(path, file)
        opened = True
        with quiet_pillow():
            turned = image.getexif().get(0x112) if image.format == "TIFF" else None  # which loading turns
            image.load()  # what stands behind the pixels is known only then
            upright = turned or image.getexif().get(0x112, 1)
    upright = upright if isinstance(upright, int) and 1 <= upright <= 8 else 1
    return Said(where and (where.lat, where.lon), known.heading, time, upright, opened, known.remark)


def agree(fact: str, one: Said, other: Said) -> bool:
    """Whether both say the same, degrees to a hundred-thousandth and modulo 360."""
    a, b = getattr(one, fact), getattr(other, fact)
    if a is None or b is None:
        return a is b
    if fact == "position":
        return abs(a[0] - b[0]) < 1e-5 and _turned(a[1], b[1]) < 1e-5
    return _turned(a, b) < 1e-4 if fact == "heading" else bool(a == b)


def _turned(a: float, b: float) -> float:
    return abs((a - b + 180) % 360 - 180)


def why(fact: str, path: Path, mine: Said, other: Said, row: Mapping[str, Any]) -> str:
    """The reason of a difference; empty where none is known."""
    reason = ""
    if not mine.opened:
        reason = "the file cannot be opened as a photo, and so is refused by name"
    elif fact == "position":
        reason = _why_position(mine, other, row)
    elif fact == "heading" and "the direction in its EXIF is not understood" in mine.remark:
        reason = "over 3,600 degrees: a placeholder, named"
    elif fact == "time" and mine.time != other.time and other.time and row.get("GPS:GPSTimeStamp") == "00:00:00":
        reason = "a GPS time of 0/0 is midnight to exiftool, and none here"
    elif fact == "orientation" and path.suffix in (".heic", ".avif"):
        reason = "HEIC and AVIF are turned by their own boxes, as their libraries do"
    elif fact == "orientation" and path.suffix == ".jp2":
        reason = "JPEG 2000 is shown as its pixels lie: no decoder turns it by an EXIF box"
    elif fact == "orientation" and path.suffix == ".jpg" and path.read_bytes().count(b"Exif\0\0") > 1:
        reason = "of two EXIF segments photos are turned by the first"
    # Of what was broken on purpose each reads as much as it can find, and neither is right.
    return reason or ("bytes were changed in it at random" if "-damaged" in path.name else "")


def _why_position(mine: Said, other: Said, row: Mapping[str, Any]) -> str:
    refs = [str(row.get(f"GPS:GPS{axis}itudeRef", "")) for axis in ("Lat", "Long")]
    if other.position and null_island(_point(*other.position)):
        return "0,0 counts as no position, named"
    if "letter" in mine.remark:
        return "a letter is missing or wrong: exiftool takes north or east, we guess nothing and name it"
    if any(re.fullmatch(r"\d+( \d+)*", ref) for ref in refs) and mine.position:
        return "letters kept as bytes: exiftool reads numbers, we the letters"
    if other.position and _point(*other.position) is None:
        return "off the earth, named"
    if "not understood" in mine.remark:
        return "a sign against its letter, or no numbers, named"
    drone = [_number(row.get(f"XMP-drone-dji:GPS{axis}itude")) for axis in ("Lat", "Long")]
    if mine.position and None not in drone and "XMP-exif:GPSLatitude" in row:
        return "XMP's minutes without letters: exiftool takes north and east, we what the drone knows"
    if "" in (row.get("GPS:GPSLatitude"), row.get("GPS:GPSLongitude")) and mine.position:
        return "0/0 seconds beside good minutes: exiftool drops the position, we the seconds"
    return ""


def _point(lat: float, lon: float) -> GeoPoint | None:
    return GeoPoint(lat, (lon + 180) % 360 - 180) if abs(lat) <= 90 and abs(lon) <= 360 else None


class Compared(NamedTuple):
    """What came of a comparison: how many agree, by fact; differences by fact and reason; those without a reason."""

    photos: int
    agreed: Counter[str]
    differences: Counter[tuple[str, str]]
    unexplained: list[str]


def compare(paths: Sequence[Path]) -> Compared:
    """Ask both about photos."""
    rows = by_exiftool(paths)
    agreed: Counter[str] = Counter()
    differences: Counter[tuple[str, str]] = Counter()
    unexplained = []
    for path in paths:
        row = rows.get(str(path), {})
        mine, other = ours(path), theirs(row)
        for fact in FACTS:
            if agree(fact, mine, other):
                agreed[fact] += 1
                continue
            reason = why(fact, path, mine, other, row)
            if reason:
                differences[fact, reason] += 1
            else:
                told = f"{getattr(mine, fact)} here ({mine.remark}), {getattr(other, fact)} by exiftool"
                unexplained.append(f"{path.name}: {fact} {told}")
    return Compared(len(paths), agreed, differences, unexplained)


def table(found: Compared) -> Iterable[str]:
    """The comparison as a table of Markdown."""
    yield "| of " + f"{found.photos:,} photos | same | differ, and why |"
    yield "|---|---|---|"
    for fact in FACTS:
        reasons = [(n, why) for (of, why), n in found.differences.most_common() if of == fact]
        told = "; ".join(f"{n}: {why}" for n, why in reasons)
        yield f"| {fact} | {found.agreed[fact]:,} | {told or 'none'} |"


def main() -> None:
    """Compare and print."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=7)
    asked = parser.parse_args()
    version = exiftool_version()
    if not version:
        sys.exit("exiftool is not installed: apt install libimage-exiftool-perl")
    with tempfile.TemporaryDirectory() as folder:
        if asked.folders:
            each = (path for given in asked.folders for path in sorted(given.rglob("*")))
            paths = [path for path in each if path.suffix.lower() in SUFFIXES]
        else:
            paths = make(Path(folder), asked.count, asked.seed)
        found = compare(paths)
    print(in_a_line(conditions("pillow", seed=None if asked.folders else asked.seed, exiftool=version)))
    print("\n".join(table(found)))
    print(*found.unexplained, sep="\n")
    sys.exit(1 if found.unexplained else 0)


if __name__ == "__main__":
    main()
