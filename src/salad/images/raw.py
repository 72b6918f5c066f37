"""RAW photos: what a sensor saw, in a form of each maker's own, which nothing here develops.

Nearly all of them carry the picture that the camera itself made of it, as a JPEG. That is what is looked at, where it
is a picture and not the stamp that a camera's menu shows.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from salad.errors import PhotoError
from salad.images import jpeg, tiff

SUFFIXES = frozenset(
    {".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".srf", ".rw2", ".raw", ".rwl", ".orf", ".raf"}
    | {".pef", ".srw", ".x3f", ".3fr", ".fff", ".iiq", ".erf", ".mef", ".mos", ".mrw", ".kdc", ".dcr", ".gpr"}
)
"""What the names of RAW photos end in, in small letters."""
LARGE = 1024
"""Pixels of its longer side from which an embedded picture is worth while, however large the sensor: thrice what a
model takes."""

_OWN = (b"FUJIFILMCCD-RAW", b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"II\x1a\0\0\0HEAPCCDR", b"FOVb", b"\0MRM")
_CANON = (b"ftypcrx ", b"CMT1")  # what a CR3 is, and where it holds its first directory
_START = re.compile(rb"\xff\xd8(?=\xff[\xc0-\xfe])")
_MOST = 1000  # places that look like a JPEG's beginning, as one in 70 million of a sensor's bytes does
_USUAL = (0xC0, 0xC1, 0xC2)


class Embedded(NamedTuple):
    """The picture that a camera made of its RAW photo.

    Attributes:
        data: A JPEG, and whatever follows it in the file.
        orientation: How it is turned, as EXIF counts, where the JPEG says nothing itself.
    """

    data: bytes
    orientation: int


def is_raw(path: Path, data: bytes) -> bool:
    """Whether a file is a RAW photo: by how it begins; or it is a TIFF, and its name or a tag says the rest."""
    if data.startswith(_OWN) or data[4:12] == _CANON[0]:
        return True
    if not data.startswith(tiff.MAGICS):
        return False
    return path.suffix.lower() in SUFFIXES or any(tiff.DNG_VERSION in tags for tags in tiff.directories(data)[:1])


def embedded(path: Path, data: bytes) -> Embedded:
    """The largest JPEG within a RAW photo.

    Args:
        path: What sentences call it.
        data: All of the file.

    Raises:
        PhotoError: If it holds none that is half as wide as the photo itself, or `LARGE`.
    """
    start = max(0, data.find(_CANON[1]) + 4) if data[4:12] == _CANON[0] else 0
    directories = tiff.directories(data[start:] if start else data)
    width, height = max((_size(tags) for tags in directories), key=max, default=(0, 0))
    # A DNG may keep the sensor's numbers themselves as many small JPEGs, none of which is a picture.
    pieces = {place for tags in directories for key in (tiff.STRIPS, tiff.TILES) for place in _several(tags, key)}
    best, longest = 0, 0
    for number, found in enumerate(_START.finditer(data)):
        if number == _MOST:
            break
        frame = jpeg.frame(data, found.start())
        if frame and frame.kind in _USUAL and max(frame[2:]) > longest and found.start() not in pieces:
            best, longest, upright = found.start(), max(frame[2:]), frame.height > frame.width
    if not longest or longest < min(LARGE, max(width, height) / 2 or LARGE):
        held = f"holds only a preview of {longest} pixels" if longest else "holds no picture made of it"
        raise PhotoError(f"{path} is a RAW photo and {held}: develop it to JPEG, or leave it out")
    turned = directories[0].get(tiff.ORIENTATION, ()) if directories else ()
    orientation = turned[0] if turned else 1
    if orientation >= 5 and upright and width > height:  # the camera turned it already
        orientation = 1
    return Embedded(data[best:], orientation)


def _size(tags: tiff.Tags) -> tuple[int, int]:
    width, height = tags.get(tiff.WIDTH, ()), tags.get(tiff.HEIGHT, ())
    return (width[0], height[0]) if width and height else (0, 0)


def _several(tags: tiff.Tags, key: int) -> tuple[int, ...]:
    places = tags.get(key, ())
    return places if len(places) > 1 or key == tiff.TILES else ()
