"""Photos whose EXIF and XMP are written in every way that is met and in many that are not, drawn from a seed.

Tags are written by hand, of any type and value, since no library would write what cameras should not. About half of the
files have bytes changed in their metadata, or are cut.
"""

from __future__ import annotations

import io
import random
import struct
import zlib
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image

BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SIGNED, REAL = 1, 2, 3, 4, 5, 7, 10, 12
_FORMS = {SHORT: "H", LONG: "I", RATIONAL: "I", SIGNED: "i", REAL: "d"}
_GREY = {256: 24, 257: 16, 258: 8, 259: 1, 262: 1, 273: 8, 277: 1, 278: 16, 279: 384}  # of 24 x 16 pixels
Tags = dict[int, "Tag"]


class Tag(NamedTuple):
    """A tag's type and its value: bytes as they are, or numbers (of fractions two for each)."""

    kind: int
    value: bytes | Sequence[float]


def text(value: str) -> Tag:
    """As a camera writes a text."""
    return Tag(ASCII, value.encode("latin-1") + b"\0")


def packed_table(tags: Tags, at: int, order: str) -> bytes:
    """A table of tags that stands at `at`, and behind it the values that are too long for it."""
    behind = at + 2 + 12 * len(tags) + 4
    head, data = struct.pack(order + "H", len(tags)), b""
    for tag, (kind, value) in sorted(tags.items()):
        if isinstance(value, bytes):
            raw, count = value, len(value)
        else:
            raw = struct.pack(f"{order}{len(value)}{_FORMS[kind]}", *value)
            count = len(value) // 2 if kind in (RATIONAL, SIGNED) else len(value)
        short = len(raw) <= 4
        entry = raw.ljust(4, b"\0") if short else struct.pack(order + "I", behind + len(data))
        head += struct.pack(order + "HHI", tag, kind, count) + entry
        data += b"" if short else raw + bytes(len(raw) % 2)
    return head + bytes(4) + data


def packed_tiff(first: Tags, shot: Tags, gps: Tags, order: str) -> bytes:
    """EXIF of three tables: the file's, the shot's and the GPS's."""
    pointed = {**first, 0x8769: Tag(LONG, [0]), 0x8825: Tag(LONG, [0])}
    shot_at = 8 + len(packed_table(pointed, 8, order))
    packed_shot = packed_table(shot, shot_at, order)
    gps_at = shot_at + len(packed_shot)
    pointed |= {0x8769: Tag(LONG, [shot_at]), 0x8825: Tag(LONG, [gps_at])}
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    return head + packed_table(pointed, 8, order) + packed_shot + packed_table(gps, gps_at, order)


# --- what is drawn -------------------------------------------------------------------------


def drawn_angle(draw: random.Random, most: int) -> Tag:
    """A latitude or a longitude, in one of the ways of `kinds`; the plain one as often as all others."""
    degrees, minutes, seconds = draw.randrange(most), draw.randrange(60), draw.randrange(60_000)
    whole = degrees + minutes / 60 + seconds / 3.6e6
    kinds: list[Tag] = [
        Tag(RATIONAL, [degrees, 1, minutes * 1000 + draw.randrange(1000), 1000, 0, 1]),
        Tag(RATIONAL, [round(whole * 1e7), 10**7]),
        Tag(RATIONAL, [degrees, 1, round(minutes * 1e4), 10**4]),
        Tag(RATIONAL, [degrees, 1, minutes, 1, 0, 0]),
        Tag(RATIONAL, [round(whole * 1e6), 10**6, 0, 0, 0, 0]),
        Tag(RATIONAL, [0, 0, 0, 0, 0, 0]),
        Tag(RATIONAL, [0, 1, 0, 1, 0, 1]),
        Tag(RATIONAL, [degrees, 1, minutes, 1, seconds, 0]),
        Tag(SIGNED, [-degrees, 1, -minutes, 1, 0, 1]),
        Tag(SIGNED, [-degrees, 1, minutes, 1, 0, 1]),
        Tag(SHORT, [degrees, minutes, seconds // 1000]),
        Tag(LONG, [degrees, minutes, seconds // 1000]),
        Tag(REAL, [whole]),
        text(f"{whole:.5f}"),
        Tag(RATIONAL, [degrees + most, 1, minutes, 1, 0, 1]),
        Tag(RATIONAL, [degrees * 10, 1, 99, 1, 99, 1]),
        Tag(RATIONAL, [0xFFFFFFFF, 1] * 3),
        Tag(RATIONAL, [degrees, 1, minutes, 1, 60, 1]),
    ]
    plain = Tag(RATIONAL, [degrees, 1, minutes, 1, seconds, 1000])
    return plain if draw.random() < 0.5 else draw.choice(kinds)


def drawn_letter(draw: random.Random, signs: str, word: tuple[str, str]) -> Tag | None:
    """The letter for a half of the earth, or what stands in its place; None where nothing does."""
    half = draw.randrange(2)
    letter = signs[half].encode()
    others: list[Tag | None] = [
        None,
        Tag(ASCII, letter.lower() + b"\0"),
        Tag(ASCII, letter + b"\0x"),
        Tag(ASCII, letter + b"\0\0\0"),
        Tag(ASCII, letter),
        text(word[half]),
        Tag(BYTE, letter + b"\0"),
        Tag(UNDEFINED, letter + b"\0"),
        text(""),
        text("X"),
        text({"NS": "E", "EW": "S"}[signs]),
    ]
    return Tag(ASCII, letter + b"\0") if draw.random() < 0.6 else draw.choice(others)


def drawn_time(draw: random.Random) -> str:
    """A time as a text, or what stands in its place."""
    day = f"{draw.randrange(1900, 2030)}:{draw.randrange(1, 13):02}:{draw.randrange(1, 29):02}"
    clock = f"{draw.randrange(24):02}:{draw.randrange(60):02}:{draw.randrange(60):02}"
    others = [
        f"{day.replace(':', '-')} {clock}",
        f"{day.replace(':', '/')} {clock}",
        f"{day.replace(':', '-')}T{clock}",
        f"{day} {clock}.{draw.randrange(1000)}",
        f"{day} {clock}+0{draw.randrange(10)}:30",
        f"{day} {clock}Z",
        f"{day} {clock[:5]}",
        day,
        f"{day}:{clock}",
        f"{day} {clock}\0\0junk",
        "0000:00:00 00:00:00",
        "0001:01:01 00:00:00",
        "    :  :     :  :  ",
        "",
        f"{day[:4]}:13:45 {clock}",
        f"{day} 25:61:61",
        "yesterday",
    ]
    return f"{day} {clock}" if draw.random() < 0.6 else draw.choice(others)


def drawn_tiff(draw: random.Random, *, photo: bool = False) -> bytes:
    """EXIF of which each part is there or not; as a photo it is a TIFF with pixels, which are what stands at byte 8."""
    first: Tags = {0x10F: text("Kamera")}
    if photo:
        first |= {tag: Tag(LONG, [value]) for tag, value in _GREY.items()}
    shot: Tags = {}
    gps: Tags = {0: Tag(BYTE, b"\2\3\0\0")}
    if draw.random() < 0.7:
        first[0x112] = Tag(SHORT, [draw.choice([*range(1, 9), 0, 9])])
    if draw.random() < 0.4:
        first[0x132] = text(drawn_time(draw))
    for clock, fraction, offset in ((0x9003, 0x9291, 0x9011), (0x9004, 0x9292, 0x9012)):
        if draw.random() < 0.6:
            shot[clock] = text(drawn_time(draw))
            if draw.random() < 0.3:
                shot[fraction] = text(draw.choice(["5", "25", "123456", "", "  "]))
            if draw.random() < 0.3:
                shot[offset] = text(draw.choice(["+02:00", "-03:30", "Z", "   :  ", "+12:00", ""]))
    if draw.random() < 0.2:
        shot[0x9010] = text(draw.choice(["+02:00", "-03:30", ""]))
    if draw.random() < 0.9:
        gps[2], gps[4] = drawn_angle(draw, 90), drawn_angle(draw, 180)
        for tag, letter in (
            (1, drawn_letter(draw, "NS", ("North", "South"))),
            (3, drawn_letter(draw, "EW", ("East", "West"))),
        ):
            if letter is not None:
                gps[tag] = letter
    for tag in (2, 4):
        if draw.random() < 0.05:
            gps.pop(tag, None)
    if draw.random() < 0.5:
        turned = draw.randrange(36_000)
        gps[17] = draw.choice(
            [Tag(RATIONAL, [turned, 100])] * 6
            + [
                Tag(RATIONAL, [36_000, 100]),
                Tag(RATIONAL, [450, 1]),
                Tag(SIGNED, [-90, 1]),
                Tag(RATIONAL, [0, 0]),
                Tag(SHORT, [turned // 100]),
                Tag(RATIONAL, [65535, 1]),
            ]
        )
        gps[16] = text(draw.choice("TM"))
    if draw.random() < 0.3:
        gps[29] = text(draw.choice(["2020:01:02", "2020-01-02", "0000:00:00", ""]))
        gps[7] = draw.choice([Tag(RATIONAL, [9, 1, 8, 1, 7500, 1000]), Tag(RATIONAL, [0, 0] * 3)])
    return packed_tiff(first, shot, gps, draw.choice("<>")) + bytes(400 if photo else 0)


def drawn_xmp(draw: random.Random) -> bytes:
    """A packet with some of Exif's fields, a drone's or a panorama's, as attributes or as elements."""
    lat, lon = draw.uniform(-90, 90), draw.uniform(-180, 180)
    north, east = "S" if lat < 0 else "N", "W" if lon < 0 else "E"
    held: dict[str, str] = {}
    if draw.random() < 0.6:
        held["exif:GPSLatitude"], held["exif:GPSLongitude"] = draw.choice(
            [
                (f"{int(abs(lat))},{abs(lat) % 1 * 60:.6f}{north}", f"{int(abs(lon))},{abs(lon) % 1 * 60:.6f}{east}"),
                (f"{int(abs(lat))},30,15{north}", f"{int(abs(lon))},15,30{east}"),
                (f"{lat:.6f}", f"{lon:.6f}"),
                (f"{abs(lat):.6f}{north}", f"{abs(lon):.6f}{east}"),
                ("0,0.0N", "0,0.0E"),
                (f"{int(abs(lat))},30.0", f"{int(abs(lon))},30.0"),
                ("", ""),
                ("north", "east"),
            ]
        )
    if draw.random() < 0.4:
        held |= {"drone-dji:GpsLatitude": f"{lat:+.6f}", "drone-dji:GpsLongitude": f"{lon:+.6f}"}
    if draw.random() < 0.4:
        held["drone-dji:GimbalYawDegree"] = f"{draw.uniform(-180, 180):+.2f}"
    if draw.random() < 0.2:
        held["exif:GPSImgDirection"] = draw.choice(["8420/100", "84.2", "450", "1/0", "x"])
    if draw.random() < 0.4:
        held["exif:DateTimeOriginal"] = drawn_time(draw).split("\0")[0].replace(":", "-", 2).replace(" ", "T")
    spaces = (
        'xmlns:exif="http://ns.adobe.com/exif/1.0/" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
        'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"'
    )
    if draw.random() < 0.5:
        attributes, inside = " ".join(f'{name}="{value}"' for name, value in held.items()), ""
    else:
        attributes, inside = "", "".join(f"<{name}>{value}</{name}>" for name, value in held.items())
    return (
        f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF {spaces}><rdf:Description rdf:about="" {attributes}>{inside}'
        "</rdf:Description></rdf:RDF></x:xmpmeta>"
    ).encode()


def mutated(draw: random.Random, block: bytes) -> bytes:
    """The same with some bytes changed; the head, without which it is nothing, stays."""
    changed = bytearray(block)
    for _ in range(draw.randrange(1, 7)):
        changed[draw.randrange(8, len(changed))] = draw.choice([0, 1, 255, 127, draw.randrange(256)])
    return bytes(changed)


# --- in files ------------------------------------------------------------------------------

_HEAD, _ADOBE = b"Exif\0\0", b"http://ns.adobe.com/xap/1.0/\0"


def in_jpeg(draw: random.Random, plain: bytes, exif: bytes, xmp: bytes) -> bytes:
    """Segments in either order; of EXIF sometimes two."""
    segments = [_HEAD + exif] if exif else []
    segments += [_ADOBE + xmp] if xmp else []
    draw.shuffle(segments)
    if exif and draw.random() < 0.2:
        segments.insert(0, _HEAD + packed_tiff({0x10F: text("Nobody")}, {}, {}, "<"))
    packed = [b"\xff\xe1" + struct.pack(">H", 2 + len(segment)) + segment for segment in segments]
    return plain[:2] + b"".join(packed) + plain[2:]


def in_png(draw: random.Random, plain: bytes, exif: bytes, xmp: bytes) -> bytes:
    """Chunks before or behind the pixels; EXIF also in ImageMagick's texts."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    chunks = b""
    if exif:
        lines = b"\nexif\n%8d\n%s\n" % (len(_HEAD + exif), (_HEAD + exif).hex().encode())
        profile = b"Raw profile type exif\0\0" + zlib.compress(lines)
        chunks += chunk(b"zTXt", profile) if draw.random() < 0.3 else chunk(b"eXIf", exif)
    chunks += chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + xmp) if xmp else b""
    at = plain.index(draw.choice([b"IDAT", b"IEND"])) - 4
    return plain[:at] + chunks + plain[at:]


def in_jp2(plain: bytes, exif: bytes, xmp: bytes) -> bytes:
    """Boxes behind the pixels."""
    uuids = ((b"JpgTiffExif->JP2", exif), (bytes.fromhex("be7acfcb97a942e89c71999491e3afac"), xmp))
    boxes = [struct.pack(">I4s", 24 + len(data), b"uuid") + kind + data for kind, data in uuids if data]
    return plain + b"".join(boxes)


def by_library(image: Image.Image, kind: str, exif: bytes, xmp: bytes) -> bytes:
    """WebP or HEIC, as their libraries write them: both take EXIF as it is, which AVIF's writes anew."""
    buffer = io.BytesIO()
    options: dict[str, Any] = ({"exif": exif} if exif else {}) | ({"xmp": xmp} if xmp else {})
    if kind == "heic":
        import pillow_heif  # type: ignore[import-untyped]  # it ships no types

        pillow_heif.from_pillow(image).save(buffer, **options)
    else:
        image.save(buffer, kind, **options)
    return buffer.getvalue()


KINDS = ("jpg",) * 8 + ("png",) * 3 + ("jp2", "webp", "tif") + (("heic",) if find_spec("pillow_heif") else ())


def make(folder: Path, count: int, seed: int) -> list[Path]:
    """Write `count` photos of 24 x 16 pixels, called after their number, whether they are damaged, and their kind."""
    image = Image.new("RGB", (24, 16), "grey")
    plain = {}
    for kind, name in (("jpg", "JPEG"), ("png", "PNG"), ("jp2", "JPEG2000")):
        buffer = io.BytesIO()
        image.save(buffer, name)
        plain[kind] = buffer.getvalue()
    made = []
    for number in range(count):
        draw = random.Random(f"{seed} {number}")
        kind = draw.choice(KINDS)
        exif = drawn_tiff(draw, photo=kind == "tif") if draw.random() < 0.85 or kind == "tif" else b""
        xmp = drawn_xmp(draw) if draw.random() < 0.35 and kind != "tif" else b""
        damaged = draw.random() < 0.5
        if damaged:
            exif, xmp = (mutated(draw, block) if block and draw.random() < 0.7 else block for block in (exif, xmp))
        if kind == "jpg":
            data = in_jpeg(draw, plain[kind], exif, xmp)
        elif kind == "png":
            data = in_png(draw, plain[kind], exif, xmp)
        elif kind == "jp2":
            data = in_jp2(plain[kind], exif, xmp)
        elif kind == "tif":
            data = exif
        else:
            data = by_library(image, kind, exif, xmp)
        if damaged and draw.random() < 0.2:
            data = data[: draw.randrange(len(data) // 2, len(data))]
        path = folder / f"{number:05}-{'damaged' if damaged else 'whole'}.{kind}"
        path.write_bytes(data)
        made.append(path)
    return made
