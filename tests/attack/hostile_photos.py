"""Photos that somebody made to be opened: they say more than they hold, hold more than they say, or have no end."""

from __future__ import annotations

import io
import os
import socket
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from attack.attacks import Attack, Command
from attack.outside import Scene

ALONE: tuple[Command, ...] = (("locate", "{given}", "--index", "{index}"), ("index", "{given}", "--to", "{work}/new"))
"""A photo among no others; the folder that it is in, so that its name's end says what it is."""
MEMORY = 2_200 << 20  # what is promised, and Python


def picture(side: int = 64) -> Image.Image:
    """One that compresses to little."""
    return Image.fromarray(np.tile(np.arange(side, dtype=np.uint8)[None, :, None], (side, 1, 3)))


def saved(form: str, image: Image.Image | None = None, **settings: object) -> bytes:
    """A photo in a format's own bytes."""
    out = io.BytesIO()
    (image or picture()).save(out, form, **settings)
    return out.getvalue()


def photo(name: str, content: Callable[[], bytes], *, size: int = 0) -> Callable[[Scene], object]:
    """A photo of some bytes, that says it has `size` of them where that is more."""

    def make(scene: Scene) -> None:
        with (scene.given / name).open("wb") as file:
            file.write(content())
            if size:
                file.truncate(size)

    return make


def chunk(kind: bytes, content: bytes) -> bytes:
    """A part of a PNG."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(*parts: bytes, width: int = 8, height: int = 8, pixels: bytes | None = None) -> bytes:
    """A grey PNG with other parts before its pixels."""
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    raw = zlib.compress(bytes((width + 1) * height)) if pixels is None else pixels
    return b"\x89PNG\r\n\x1a\n" + head + b"".join(parts) + chunk(b"IDAT", raw) + chunk(b"IEND", b"")


def bomb(size: int) -> bytes:
    """So many zeros in a thousandth of the room."""
    packer = zlib.compressobj(9)
    block = bytes(1 << 20)
    return b"".join(packer.compress(block) for _ in range(size >> 20)) + packer.flush()


def segments(marker: int, content: bytes, count: int) -> bytes:
    """A JPEG with so many segments of one kind before all others."""
    raw = saved("JPEG")
    one = struct.pack(">BBH", 0xFF, marker, len(content) + 2) + content
    return raw[:2] + one * count + raw[2:]


def scans(count: int, side: int) -> bytes:
    """A progressive JPEG whose last pass comes so many times."""
    raw = saved("JPEG", picture(side), progressive=True, quality=30)
    last = raw.rindex(b"\xff\xda")
    return raw[:last] + raw[last:-2] * count + raw[-2:]


def tiff(entries: list[tuple[int, int, int, int]], *, following: int = 0, more: bytes = b"") -> bytes:
    """A TIFF of one directory: tags, kinds, counts and values or places; and where the next directory is."""
    body = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + body + struct.pack("<I", following) + more


def exif(block: bytes) -> bytes:
    """A JPEG with that as its EXIF."""
    return saved("JPEG", exif=b"Exif\0\0" + block)


def grey(width: int, height: int) -> list[tuple[int, int, int, int]]:
    """What a TIFF says of pixels that it has not."""
    return [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1), (273, 4, 1, 8),
            (277, 3, 1, 1), (278, 4, 1, height), (279, 4, 1, width * height % 2**32)]  # fmt: skip


def _directories(count: int) -> bytes:
    """A TIFF whose directories follow each other, none with a photo."""
    raw = bytearray(b"II*\0" + struct.pack("<I", 8))
    for number in range(count):
        raw += struct.pack("<HHHIII", 1, 305, 2, 1, 0, 8 + 18 * (number + 1))
    return bytes(raw) + struct.pack("<HI", 0, 0)


def _gif(frames: int, *, width: int = 8, height: int = 8) -> bytes:
    """A GIF of many frames, in each a pixel."""
    raw = saved("GIF", picture(8).convert("P"))
    at = raw.index(b"\x2c")
    head = raw[:6] + struct.pack("<HH", width, height) + raw[10:at]
    return head + raw[at:-1] * frames + b";"


def files() -> Iterator[tuple[str, Callable[[Scene], object], bool]]:
    """Photos whose answer is a sentence or a picture, at once: what, how it is made, and whether it must be refused."""
    for end, head in {
        "webp": b"RIFF\xf8\xff\xff\xffWEBPVP8 \xf0\xff\xff\xff",
        "jpg": saved("JPEG")[:200],
        "png": b"\x89PNG\r\n\x1a\n",
        "tif": b"II*\0",
        "heic": b"\0\0\0\x18ftypheic\0\0\0\0heic",
        "avif": b"\0\0\0\x18ftypavif\0\0\0\0avif",
        "jp2": b"\0\0\0\x0cjP  \r\n\x87\n",
    }.items():
        yield f"5 GB, none of them on the disk.{end}", photo(f"big.{end}", lambda head=head: head, size=5 << 30), True
    yield (
        "a PNG of 2^31 pixels a side",
        photo("a.png", lambda: png(width=2**31 - 1, height=2**31 - 1, pixels=b"")),
        True,
    )
    yield "a PNG of 0 pixels", photo("a.png", lambda: png(width=0, height=0, pixels=b"")), True
    yield "a PNG one pixel high", photo("a.png", lambda: png(width=199_000_000, height=1, pixels=b"")), True
    yield "a PNG whose pixels are a gigabyte", photo("a.png", lambda: png(pixels=bomb(1 << 30))), False
    for kind in (b"zTXt", b"iCCP"):
        packed = kind + b"\0\0" + bomb(1 << 29)
        yield f"a PNG whose {kind.decode()} is half a gigabyte", photo(
            "a.png", lambda kind=kind, packed=packed: png(chunk(kind, packed))), False  # fmt: skip
    yield "a PNG whose iTXt is half a gigabyte", photo(
        "a.png", lambda: png(chunk(b"iTXt", b"k\0\1\0\0\0" + bomb(1 << 29)))), False  # fmt: skip
    yield "a PNG of 200,000 texts", photo("a.png", lambda: png(chunk(b"tEXt", b"k\0v") * 200_000)), False
    yield "a TIFF whose directories go in a circle", photo("a.tif", lambda: tiff(grey(8, 8), following=8)), False
    yield "a TIFF of 20,000 directories", photo("a.tif", lambda: _directories(20_000)), False
    yield "a TIFF of 100,000 pixels a side", photo("a.tif", lambda: tiff(grey(100_000, 100_000))), True
    yield "a TIFF whose strips are elsewhere", photo("a.tif", lambda: tiff(
        [*grey(64, 64)[:5], (273, 4, 1 << 30, 8), *grey(64, 64)[6:]])), True  # fmt: skip
    yield "a TIFF with a tag of 4 GB", photo("a.tif", lambda: tiff([*grey(8, 8), (700, 1, 2**32 - 1, 8)])), False
    yield "a GIF of 65,535 pixels a side", photo("a.gif", lambda: _gif(1, width=65535, height=65535)), True
    yield "a GIF of 200,000 frames", photo("a.gif", lambda: _gif(200_000)), False
    yield "a BMP of 2^31 pixels", photo("a.bmp", lambda: b"BM" + struct.pack(
        "<IIIIiiHHIIiiII", 60, 0, 54, 40, 2**31 - 1, 2**31 - 1, 1, 24, 0, 0, 0, 0, 0, 0)), True  # fmt: skip
    yield "a PPM of 10^9 pixels a side", photo("a.ppm", lambda: b"P6 1000000000 1000000000 255\n"), True
    yield "a PPM of 10^4000 pixels a side", photo("a.ppm", lambda: b"P6 " + b"9" * 4000 + b" 9 255\n"), True
    yield "a PPM of a negative size", photo("a.ppm", lambda: b"P6 -8 -8 255\n" + bytes(192)), True
    yield "a JPEG of EXIF that goes in a circle", photo("a.jpg", lambda: exif(
        tiff([(34665, 4, 1, 8), (34853, 4, 1, 8), (40965, 4, 1, 8)], following=8))), False  # fmt: skip
    yield "a JPEG with EXIF of 2^32 numbers", photo("a.jpg", lambda: exif(
        tiff([(306, 2, 2**32 - 1, 8), (34853, 4, 1, 8)]))), False  # fmt: skip
    yield "a JPEG with positions of n / 0", photo("a.jpg", lambda: exif(_nowhere())), False
    yield "a JPEG turned by 2^31", photo("a.jpg", lambda: exif(tiff([(274, 4, 1, 2**31)]))), False
    yield "a JPEG of 5,000 comments", photo("a.jpg", lambda: segments(0xFE, b"x" * 100, 5_000)), False
    yield "a JPEG with XMP that grows", photo("a.jpg", lambda: segments(
        0xE1, b"http://ns.adobe.com/xap/1.0/\0" + _laughs(), 1)), False  # fmt: skip
    yield "a JPEG with XMP 10,000 deep", photo("a.jpg", lambda: segments(
        0xE1, b"http://ns.adobe.com/xap/1.0/\0" + b"<a>" * 10_000, 1)), False  # fmt: skip
    yield "a JPEG of 2,000 passes", photo("a.jpg", lambda: scans(2_000, 64)), True
    yield (
        "a page of PostScript",
        photo("a.jpg", lambda: b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage"),
        True,
    )
    yield "a JPEG with no pixels", photo("a.jpg", lambda: saved("JPEG")[:300]), True
    yield "text", photo("a.jpg", lambda: b"not a photo\n" * 99), True
    yield "nothing", photo("a.jpg", lambda: b""), True
    yield "a pipe", lambda scene: os.mkfifo(scene.given / "a.jpg"), True
    yield "a link to an endless device", lambda scene: (scene.given / "a.jpg").symlink_to("/dev/zero"), True
    yield "a link to itself", lambda scene: (scene.given / "a.jpg").symlink_to("a.jpg"), True
    yield "a socket", _socket, True


def _nowhere() -> bytes:
    """EXIF whose degrees are divided by 0."""
    degrees = struct.pack("<6I", 1, 0, 2**32 - 1, 0, 0, 0)
    place = 8 + 2 + 12 + 4
    after = place + 2 + 4 * 12 + 4
    gps = struct.pack("<H", 4) + b"".join(
        struct.pack("<HHI4s", *entry)
        for entry in (
            (1, 2, 2, b"N\0\0\0"),
            (2, 5, 3, struct.pack("<I", after)),
            (3, 2, 2, b"E\0\0\0"),
            (4, 5, 3, struct.pack("<I", after)),
        )
    )
    return tiff([(34853, 4, 1, place)], more=gps + struct.pack("<I", 0) + degrees)


def _laughs() -> bytes:
    """XML that is ten times as long with each line."""
    lines = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10 if n else "ha" * 10}">' for n in range(12))
    return f"<?xml version='1.0'?><!DOCTYPE x [{lines}]><x>&l11;</x>".encode()


def _socket(scene: Scene) -> None:
    here = Path.cwd()
    os.chdir(scene.given)  # a socket's whole path may have but 108 letters
    try:
        with socket.socket(socket.AF_UNIX) as opened:
            opened.bind("a.jpg")
    finally:
        os.chdir(here)


def slow() -> Iterator[tuple[str, Callable[[Scene], object], bool]]:
    """Photos that take seconds or hundreds of megabytes to make or to refuse."""
    yield "a JPEG of 300 MB of fill bytes", photo("a.jpg", lambda: b"\xff\xd8" + b"\xff" * (300 << 20)), True
    yield "a JPEG of fill bytes before its end", photo(
        "a.jpg", lambda: saved("JPEG")[:-2] + b"\xff" * (300 << 20) + b"\xd9"), False  # fmt: skip
    yield "a PPM of 300 MB of blanks", photo("a.ppm", lambda: b"P6" + b" " * (300 << 20)), True
    yield "a PPM of 300 MB of remarks", photo("a.ppm", lambda: b"P6 #" + b"x" * (300 << 20)), True
    yield "a JPEG of 800 segments of EXIF", photo(
        "a.jpg", lambda: segments(0xE1, b"Exif\0\0" + bytes(65_000), 800)), False  # fmt: skip
    yield "a JPEG of 800 segments of XMP", photo(
        "a.jpg", lambda: segments(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + bytes(65_000), 800)), False  # fmt: skip
    yield "a JPEG of 255 segments of colours", photo(
        "a.jpg", lambda: segments(0xE2, b"ICC_PROFILE\0\1\xff" + bytes(65_000), 255)), False  # fmt: skip
    yield "a JPEG of 4,000 passes over 4,000 pixels a side", photo("a.jpg", lambda: scans(4_000, 4_000)), True
    yield "a PNG of 14,000 pixels a side, all one", photo("a.png", lambda: _plain("PNG", 14_000)), False
    yield "a WebP of 16,383 pixels a side, all one", photo("a.webp", lambda: _plain("WEBP", 16_383)), True
    yield "a JPEG of 13,000 pixels a side", photo("a.jpg", lambda: _plain("JPEG", 13_000)), False
    yield "a GIF of two million frames", photo("a.gif", lambda: _gif(2_000_000)), False
    yield "a TIFF of two million directories", photo("a.tif", lambda: _directories(2_000_000)), False
    yield "a PNG of two million texts", photo("a.png", lambda: png(chunk(b"tEXt", b"k\0v") * 2_000_000)), False


def _plain(form: str, side: int) -> bytes:
    return saved(form, Image.new("L" if form == "PNG" else "RGB", (side, side)))


ALL = [
    Attack(
        f"a photo is {what}",
        make,
        "refused" if refused else "harmless",
        # The name of its file is in the sentence.
        "given/" if refused else "",
        commands=ALONE,
        memory=MEMORY,
        every=what.endswith(".webp"),
        long=long,
    )
    for some, long in ((files, False), (slow, True))
    for what, make, refused in some()
]
