"""Photos that want all time or all memory of whoever opens them, each a few lines of code and small where it can be."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

EXIF_SEGMENT = b"\xff\xe1\xff\xffExif\0\0" + b"MM\0*\0\0\0\x08" + bytes(65_535 - 2 - 14)


def encoded(form: str, size: tuple[int, int] = (16, 16), **how: Any) -> bytes:
    """A sound photo."""
    buffer = io.BytesIO()
    Image.new("RGB", size, (9, 99, 199)).save(buffer, form, **how)
    return buffer.getvalue()


def sparse(head: bytes, length: int) -> Callable[[Path], None]:
    """A file of a length, of which nothing but its head takes room on the disk."""

    def write(path: Path) -> None:
        with path.open("wb") as file:
            file.write(head)
            file.truncate(length)

    return write


def written(content: Callable[[], bytes]) -> Callable[[Path], None]:
    """A file of some content, made when it is asked for."""
    return lambda path: path.write_bytes(content()) and None


def jpeg_with(segment: bytes) -> bytes:
    """A sound JPEG with something before its other segments."""
    jpeg = encoded("JPEG")
    return jpeg[:2] + segment + jpeg[2:]


def many_scans(count: int) -> bytes:
    """A progressive JPEG of 8 million pixels whose last scan comes again and again."""
    jpeg = encoded("JPEG", (4000, 2000), progressive=True)
    last = jpeg[jpeg.rindex(b"\xff\xda") : -2]
    return jpeg[:-2] + last * count + jpeg[-2:]


def riff(length: int) -> bytes:
    """The head of a WebP that says it is as long as the file."""
    return b"RIFF" + struct.pack("<I", min(length - 8, 0xFFFFFFF0)) + b"WEBPVP8 " + struct.pack("<I", 0xFFFFFF00)


def chunk(kind: bytes, content: bytes) -> bytes:
    """A chunk of a PNG."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png_with(kind: bytes, head: bytes, count: int) -> bytes:
    """A PNG of one pixel, with chunks that each unpack to 60 MB."""
    large = chunk(kind, head + zlib.compress(bytes(60_000_000), 9))
    pixel = chunk(b"IDAT", zlib.compress(bytes(2))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 1, 0, 0, 0, 0)) + large * count + pixel


def tiff_chain(tables: int, *, circular: bool) -> bytes:
    """A sound TIFF whose table of tags is followed by many others, one naming the next, the last perhaps the first."""
    tiff = bytearray(encoded("TIFF"))
    (first,) = struct.unpack_from("<I", tiff, 4)
    (count,) = struct.unpack_from("<H", tiff, first)
    own = bytes(tiff[first : first + 2 + 12 * count])
    starts = [len(tiff) + number * (len(own) + 4) for number in range(tables)]
    struct.pack_into("<I", tiff, first + len(own), starts[0])
    for following in (*starts[1:], first if circular else 0):
        tiff += own + struct.pack("<I", following)
    return bytes(tiff)


def exif_chain(depth: int) -> bytes:
    """A JPEG whose EXIF names tables within tables."""
    entry = struct.pack("<HHII", 0x8769, 4, 1, 8)
    tiff = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", depth) + entry * depth + bytes(4)
    body = b"Exif\0\0" + tiff
    return jpeg_with(b"\xff\xe1" + struct.pack(">H", 2 + len(body)) + body)


def gif_of(frames: int) -> bytes:
    """A GIF of many frames of one pixel."""
    frame = b"\x2c" + struct.pack("<HHHHB", 0, 0, 1, 1, 0) + b"\x02\x02\x44\x01\0"
    return b"GIF89a" + struct.pack("<HHBBB", 1, 1, 0xF0, 0, 0) + bytes(6) + frame * frames + b"\x3b"


def claiming(form: str, width: int, height: int) -> bytes:
    """A small AVIF or HEIC that says it is larger."""
    photo = encoded(form, (64, 64))
    size = photo.index(b"ispe") + 8
    return photo[:size] + struct.pack(">II", width, height) + photo[size + 8 :]


HOSTILE: dict[str, Callable[[Path], None]] = {
    "5 GB of nothing.webp": sparse(riff(5_000_000_000), 5_000_000_000),
    "1 GB of nothing.webp": sparse(riff(1_000_000_000), 1_000_000_000),
    "1 GB of nothing.jpg": sparse(encoded("JPEG")[:-2], 1_000_000_000),
    "fill bytes.jpg": written(lambda: b"\xff\xd8" + b"\xff" * 40_000_000),
    "fill bytes that end.jpg": written(lambda: jpeg_with(b"\xff" * 30_000_000)),
    "blanks in the header.ppm": written(lambda: b"P6" + b" " * 40_000_000 + b"1 1 255\n000"),
    "a comment without end.ppm": written(lambda: b"P6\n#" + b"x" * 40_000_000 + b"\n1 1 255\n000"),
    "800 segments of EXIF.jpg": written(lambda: jpeg_with(EXIF_SEGMENT * 800)),
    "tables within tables.jpg": written(lambda: exif_chain(5000)),
    "80 scans of 8 million pixels.jpg": written(lambda: many_scans(80)),
    "5,000 scans of 8 million pixels.jpg": written(lambda: many_scans(5000)),
    "text of 1.2 GB.png": written(lambda: png_with(b"zTXt", b"a\0\0", 20)),
    "profiles of 1.2 GB.png": written(lambda: png_with(b"iCCP", b"a\0\0", 20)),
    "a chain of tables.tif": written(lambda: tiff_chain(200_000, circular=False)),
    "a circle of tables.tif": written(lambda: tiff_chain(2, circular=True)),
    "a million frames.gif": written(lambda: gif_of(1_000_000)),
    "another program's.psd": written(lambda: b"8BPS\0\1" + bytes(6) + struct.pack(">HIIHH", 4, 300_000, 300_000, 8, 3)),
}
"""By name, what writes it."""
