"""The JSON that Google Takeout puts beside each photo: what its album says of where and when it was taken."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import PurePath
from typing import Any

from salad.errors import PositionError
from salad.files import parse_json
from salad.geo import GeoPoint, null_island
from salad.images.metadata import Position

LONGEST_JSON = 1 << 20
"""Bytes of the longest file that is read; people and comments make some long."""
_CUT = 46  # letters of a name before `.json`
_MORE = ".supplemental-metadata"  # what Takeout adds to the name since 2024, before it is cut
_NUMBERED = re.compile(r"(.*)(\(\d{1,5}\))(\.\w+)", re.DOTALL)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def takeout_names(name: str) -> list[str]:
    """What the JSON beside a photo may be called, the likelier first.

    It is the photo's name and `.json`, or since 2024 `.supplemental-metadata.json`, cut to 46 letters before the
    ending; for a second photo of one name, `a(1).jpg`, the number stands behind: `a.jpg(1).json`. A photo edited in
    the album, `a-edited.jpg`, has the JSON of the photo that it was made of.
    """
    bases = [(name, "")]
    if found := _NUMBERED.fullmatch(name):
        bases.insert(0, (found[1] + found[3], found[2]))
    path = PurePath(name)
    if path.stem.endswith("-edited"):
        bases.append((path.stem.removesuffix("-edited") + path.suffix, ""))
    names = [f"{(base + more)[:_CUT]}{number}.json" for base, number in bases for more in (_MORE, "")]
    return list(dict.fromkeys(names))


def parse_takeout(data: bytes, name: str) -> Position | None:
    """What such a JSON says of a photo, or None where it is another JSON, or another photo's.

    The position is the album's own, which its owner may have corrected, and where that is 0,0 (as Takeout writes none)
    the one that the photo came with. The time is in UTC.

    Args:
        data: The file.
        name: The photo's name: a name that was cut may be two photos', and the title inside tells them apart.
    """
    try:
        held = parse_json(data.removeprefix(b"\xef\xbb\xbf"))
    except ValueError:
        return Position(source="takeout", remark="the JSON beside it cannot be read")
    if not isinstance(held, dict) or not held.keys() & {"geoData", "geoDataExif", "photoTakenTime"}:
        return None
    title = held.get("title")
    if isinstance(title, str) and not _same(title, name):
        return None
    points = [point for key in ("geoData", "geoDataExif") if (point := _point(held.get(key))) is not None]
    where = next((point for point in points if not null_island(point)), points[0] if points else None)
    return Position(where, None, _time(held.get("photoTakenTime")), "takeout")


def _same(title: str, name: str) -> bool:
    """Whether a photo may have that title: its name may be cut, numbered, and have `_` for what names cannot hold."""
    stem = PurePath(name).stem
    ours = {_plain(stem), _plain(re.sub(r"\(\d{1,5}\)$|-edited$", "", stem))}
    theirs = {_plain(title), _plain(PurePath(title).stem)}
    return not ours.isdisjoint(theirs) or any(
        len(our) >= _CUT - len(".jpeg") and their.startswith(our) for our in ours for their in theirs
    )


def _plain(text: str) -> str:
    return re.sub(r"\W", "_", text).casefold()


def _point(held: Any) -> GeoPoint | None:
    lat, lon = (held.get(key) for key in ("latitude", "longitude")) if isinstance(held, dict) else (None, None)
    with suppress(PositionError, TypeError, ValueError, OverflowError):
        return GeoPoint(float(lat), float(lon))  # type: ignore[arg-type]  # None is a TypeError
    return None


def _time(held: Any) -> datetime | None:
    seconds = held.get("timestamp") if isinstance(held, dict) else None
    with suppress(ValueError, TypeError, OverflowError):
        since = float(seconds)  # type: ignore[arg-type]  # as above
        return _EPOCH + timedelta(seconds=since) if since and math.isfinite(since) else None
    return None
