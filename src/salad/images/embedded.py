"""Where the formats of photos keep EXIF and XMP: the blocks of both that a file holds, none of its pixels decoded.

Pillow finds most of them. What it passes over is looked up here: a second EXIF segment of a JPEG, what stands behind a
PNG's pixels or in its `Raw profile` texts, the boxes of JPEG 2000 and the extensions of GIF.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO

from PIL import Image

from salad.images.decode import quiet_pillow

LONGEST_BLOCK = 1 << 24
"""Bytes of the longest block that is read, unpacked: EXIF may hold a preview and a maker's note."""
_MOST = 10_000  # parts of a file that are stepped over
_EXIF = re.compile(rb"(?:Exif\0.){0,2}(?=II\*\0|MM\0\*|II\+\0|MM\0\+)", re.DOTALL)
_ADOBE = b"http://ns.adobe.com/xap/1.0/\0"
_XMP_TAG = 700  # of a TIFF
_EXIF_BOX, _XMP_BOX = b"JpgTiffExif->JP2", bytes.fromhex("be7acfcb97a942e89c71999491e3afac")  # UUIDs in JPEG 2000
_BOXES = frozenset({b"uuid", b"xml ", b"Exif"})


@dataclass(slots=True)
class Embedded:
    """What was found in a file, in its order.

    Attributes:
        exif: EXIF, each as Pillow reads it.
        xmp: XMP packets.
        damaged: Blocks of EXIF that make no sense.
    """

    exif: list[Image.Exif] = field(default_factory=list)
    xmp: list[bytes] = field(default_factory=list)
    damaged: int = 0

    def add_exif(self, block: bytes) -> None:
        """Add a block of EXIF, with or without the words before it."""
        exif = Image.Exif()
        try:
            start = _EXIF.match(block)
            with quiet_pillow():
                exif.load(block[start.end() :] if start else block)
        except Exception:  # a broken table may raise anything at all
            self.damaged += 1
        else:
            self.exif.append(exif)


def embedded(image: Image.Image, file: IO[bytes]) -> Embedded:
    """The EXIF and XMP in a file.

    Args:
        image: The file as `salad.images.decode.open_image` opens it.
        file: The same file, open.

    Raises:
        Exception: Anything at all for a broken file.
    """
    found = Embedded()
    if image.format in ("JPEG", "MPO"):
        _in_jpeg(image, found)
    elif image.format == "PNG":
        _in_png(file, found)
    elif image.format == "JPEG2000":
        _in_boxes(file, found)
    elif image.format == "GIF":
        _in_gif(file, found)
    elif image.format == "TIFF":
        with quiet_pillow():
            found.exif.append(Image.Image.getexif(image))
        packet = getattr(image, "tag_v2", {}).get(_XMP_TAG)
        found.xmp += [packet] if isinstance(packet, bytes) else []
    else:  # WebP, HEIC, AVIF, whose libraries hand over one block of each
        for name, add in (("exif", found.add_exif), ("xmp", found.xmp.append)):
            block = image.info.get(name)
            if isinstance(block, bytes) and block:
                add(block)
    return found


def _in_jpeg(image: Image.Image, found: Embedded) -> None:
    """Every segment of EXIF; one that begins with no head of its own continues what came before."""
    blocks: list[bytes] = []
    for name, segment in getattr(image, "applist", []):
        if name != "APP1":
            continue
        if segment.startswith(_ADOBE):
            found.xmp.append(segment[len(_ADOBE) :])
        elif segment.startswith(b"Exif\0"):
            if blocks and not _EXIF.match(segment):
                blocks[-1] += segment[6:]
            else:
                blocks.append(segment)
    for block in blocks:
        found.add_exif(block)


def _in_png(file: IO[bytes], found: Embedded) -> None:
    """All chunks, those behind the pixels too."""
    for kind, length in _chunks(file):
        if kind not in (b"eXIf", b"zxIf", b"tEXt", b"zTXt", b"iTXt") or length > LONGEST_BLOCK:
            continue
        data = file.read(length)
        if kind == b"eXIf":
            found.add_exif(data)
            continue
        name, _, text = data.partition(b"\0")
        with suppress(zlib.error):
            if name == b"XML:com.adobe.xmp" and kind == b"iTXt":
                packed, _, rest = text[:1], text[1:2], text[2:]
                packet = rest.split(b"\0", 2)[-1]  # behind a language and a translated name
                found.xmp.append(_unpacked(packet) if packed == b"\1" else packet)
            elif name.lower().startswith(b"raw profile type "):
                _in_profile(name[17:].lower(), _unpacked(text[1:]) if kind == b"zTXt" else text, found)


def _chunks(file: IO[bytes]) -> Iterator[tuple[bytes, int]]:
    """The kind and the length of each chunk of a PNG; the file stands at what it holds."""
    at = 8
    for _ in range(_MOST):
        file.seek(at)
        head = file.read(8)
        if len(head) < 8 or head[4:] == b"IEND":
            return
        length = int.from_bytes(head[:4], "big")
        yield head[4:], length
        at += 12 + length


def _unpacked(data: bytes) -> bytes:
    return zlib.decompressobj().decompress(data, LONGEST_BLOCK)


def _in_profile(kind: bytes, text: bytes, found: Embedded) -> None:
    """What ImageMagick keeps in hexadecimal digits, below a line with its name and one with its length."""
    parts = text.strip().split(b"\n", 2)
    try:
        block = bytes.fromhex(parts[2].decode("ascii"))
    except (IndexError, ValueError):
        return
    if block.startswith(_ADOBE) or kind == b"xmp":
        found.xmp.append(block.removeprefix(_ADOBE))
    elif kind in (b"exif", b"app1"):
        found.add_exif(block)


def _in_boxes(file: IO[bytes], found: Embedded) -> None:
    """The boxes of JPEG 2000 that hold EXIF or XMP; a bare stream of its pixels has none."""
    at = 0
    for _ in range(_MOST):
        file.seek(at)
        head = file.read(16)
        if len(head) < 8:
            return
        length, kind = struct.unpack(">I4s", head[:8])
        inner = 8
        if length == 1:  # a length of 64 bits follows
            length, inner = int.from_bytes(head[8:], "big"), 16
        if length < inner:  # 0: to the end, as pixels may stand last
            return
        if kind in _BOXES and length <= LONGEST_BLOCK:
            file.seek(at + inner)
            data = file.read(length - inner)
            if kind == b"Exif":
                found.add_exif(data)
            elif data.startswith(_EXIF_BOX):
                found.add_exif(data[16:])
            elif data.startswith(_XMP_BOX):
                found.xmp.append(data[16:])
            elif kind == b"xml " and b"<x:xmpmeta" in data:
                found.xmp.append(data)
        at += length


def _in_gif(file: IO[bytes], found: Embedded) -> None:
    """The extension `XMP DataXMP`, whose packet ends with what makes it blocks of a GIF."""
    file.seek(10)
    flags = file.read(3)[0]
    file.seek(13 + (3 << (flags & 7) + 1 if flags & 0x80 else 0))
    for _ in range(_MOST):
        kind = file.read(1)
        if kind == b"!" and file.read(1) == b"\xff" and file.read(12) == b"\x0bXMP DataXMP":
            packet, _, _ = file.read(LONGEST_BLOCK).partition(b"\1\xff\xfe")
            found.xmp.append(packet)
            return
        if kind == b",":
            flags = file.read(9)[8]
            file.seek((3 << (flags & 7) + 1 if flags & 0x80 else 0) + 1, 1)
        elif kind != b"!":
            return
        while (length := file.read(1)) and length != b"\0":
            file.seek(length[0], 1)
