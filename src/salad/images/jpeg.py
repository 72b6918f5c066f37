"""What a JPEG says of itself, part by part; and whether one that does not end has lost more than its end mark.

Cards that were pulled too early, and programs that cut a file a little short, leave JPEGs without their last two
bytes. Every viewer shows them. No decoder tells them from one cut in the middle, whose other half is grey.
"""

from __future__ import annotations

import io
import random
import re
import struct
from collections.abc import Iterator
from typing import NamedTuple

from PIL import Image, ImageChops

MAX_SCANS = 100
"""Passes over a progressive JPEG that are decoded: each costs time for every pixel, and a dozen is usual."""

_SEGMENT = re.compile(rb"\xff([^\x00\x01\xd0-\xd8\xff])")  # the head of a part; never stands within pixels
_END = b"\xff\xd9"
_SCAN, _LAST = 0xDA, 0xD9
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # parts that begin a picture: which kind, how large
_MOST_PARTS = 200  # before the picture begins
_LOST = 0.05  # share of the rows that may be missing at the lower edge
_SEEN = 1024  # pixels of a side by which that is judged


class Frame(NamedTuple):
    """What a JPEG says of its picture.

    Attributes:
        kind: The marker's second byte: 0xC0 to 0xC2 are what everybody writes, 0xC3 is without loss.
        bits: A channel has.
        width: In pixels.
        height: In pixels.
    """

    kind: int
    bits: int
    width: int
    height: int


def parts(data: bytes) -> Iterator[tuple[int, int]]:
    """The parts of a JPEG: the second byte of each one's marker, and where its content begins, with its length."""
    at = 2
    while (head := _SEGMENT.search(data, at)) and head[1][0] != _LAST:
        yield head[1][0], head.end()
        at = head.end() + int.from_bytes(data[head.end() : head.end() + 2], "big")  # a preview within is not looked at


def frame(data: bytes, start: int = 0) -> Frame | None:
    """What the JPEG that begins at `start` says of its picture; None where no whole head of one begins there."""
    at = start + 2
    for _ in range(_MOST_PARTS):  # each right behind the one before, as long as no pixels have begun
        marker, kind, length = data[at : at + 1], data[at + 1 : at + 2], int.from_bytes(data[at + 2 : at + 4], "big")
        if marker != b"\xff" or not kind or kind[0] == _SCAN:
            return None
        if kind == b"\xff":  # filling
            at += 1
            continue
        if kind[0] in _FRAMES and at + 9 <= len(data):
            bits, height, width = struct.unpack_from(">BHH", data, at + 4)
            return Frame(kind[0], bits, width, height)
        at += 2 + length
    return None


def has_too_many_scans(data: bytes) -> bool:
    """Whether a JPEG has over `MAX_SCANS` passes over its pixels; no more is looked at than tells."""
    scans = 0
    for kind, _ in parts(data):
        scans += kind == _SCAN
        if scans > MAX_SCANS:
            return True
    return False


def ended(data: bytes) -> bytes | None:
    """A JPEG that does not end, with its end mark; None where more is missing than that, or than the last few rows.

    Whatever follows a whole picture is passed over by decoders, and what follows half of one is taken for the rest of
    it. So the file is decoded twice, with noise before the end mark and without: the first row that differs is where
    it was cut.

    Raises:
        Exception: Anything at all for broken bytes.
    """
    data = data.rstrip(b"\xff")  # half of the mark may be there
    if data.endswith(_END) or not _all_is_begun(data):
        return None
    # With marks of new beginnings in between, after which a decoder takes the noise in where it waits for one.
    noise = random.Random(0).randbytes(2048).replace(b"\xff", b"\xfe")
    marked = b"".join(noise + bytes([0xFF, 0xD0 + number]) for number in range(8))
    plain, padded = _small(data + _END), _small(data + marked + _END)
    apart = ImageChops.difference(plain, padded).getbbox()
    return data + _END if apart is None or apart[1] >= plain.height * (1 - _LOST) else None


def _small(data: bytes) -> Image.Image:
    image = Image.open(io.BytesIO(data), formats=("JPEG",))
    image.draft(image.mode, (_SEEN, _SEEN))
    image.load()
    return image


def _all_is_begun(data: bytes) -> bool:
    """Whether the last passes of a JPEG are there: each channel's every number down to its last bit."""
    channels: set[int] = set()
    done: set[tuple[int, int]] = set()
    for kind, at in parts(data):
        if kind in _FRAMES:
            channels = set(data[at + 8 : at + 8 + 3 * data[at + 7] : 3])
        elif kind == _SCAN:
            count = data[at + 2]
            first, last, bits = data[at + 3 + 2 * count : at + 6 + 2 * count]
            if bits & 15 == 0:  # the lowest bit that this pass brings
                numbers = range(first, min(last, 63) + 1)
                done |= {(channel, number) for channel in data[at + 3 : at + 3 + 2 * count : 2] for number in numbers}
    return bool(channels) and len(done) == 64 * len(channels)
