"""Strangers' bytes: mutated photos, EXIF, `@` names, tables and lists give a value or a sentence, in good time.

About 1,500 inputs each time; with SALAD_THOROUGH set 10,000, and the slowest is printed. Photos are read by a
worker process, so that a crash, a hang or a hunger for memory is a sentence here too.
"""

from __future__ import annotations

import io
import os
import random
import signal
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from salad.errors import PhotoError, PositionError
from salad.geo import GeoPoint
from salad.images.at_names import at_name, parse_at_name
from salad.images.decode import existing
from salad.images.exif import to_exif
from salad.images.finding import listed
from salad.images.metadata import Position
from salad.images.photo_table import PhotoTable
from salad.images.workers import Pool, Workers

THOROUGH = "SALAD_THOROUGH" in os.environ
HANG = 20.0  # seconds; a slow machine is no hang, and real hangs have no end
PIXELS = 20_000_000 if THOROUGH else 4_000_000  # the limit meanwhile: time and memory grow with it
MEMORY_KIB = (100_000_000 + 25 * PIXELS) // 1024  # of the reading process: Python, and the costliest decoder
PHOTOS, EXIFS, TEXTS = (6400, 1200, 800) if THOROUGH else (720, 240, 180)  # texts: of each of three kinds

# A worker process that reads a photo as indexing does and tells what came of it.
READER = """
import pathlib, resource, time
from salad.images import decode as imagefile, worker_process as reading
from salad.errors import PhotoError
from salad.images.decode import open_rgb, squeeze
from salad.images.photo import Photo, read_photo

def highest():
    # in KiB; ru_maxrss would remember the process this one was forked from
    status = pathlib.Path("/proc/self/status")
    if status.is_file():
        return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

def tried(path, limit):
    imagefile.MAX_PIXELS = limit
    begun, said = time.perf_counter(), ""
    photo = read_photo(path)
    assert isinstance(photo, Photo)
    assert photo.heading is None or 0 <= photo.heading < 360
    try:
        pixels = squeeze(open_rgb(path), 32, 24)
        assert pixels.shape == (32, 24, 3)
    except PhotoError as error:
        said = str(error)
    memory = highest()
    return said, time.perf_counter() - begun, memory

reading.TASKS["tried"] = tried
reading.main()
"""


# --- photos to start from ------------------------------------------------------------------


def picture() -> Image.Image:
    rows, columns = np.mgrid[0:48, 0:64]
    return Image.fromarray(np.stack([rows * 5, columns * 3, rows ^ columns], axis=2).astype(np.uint8))


def tags() -> Image.Exif:
    exif = to_exif(Position(GeoPoint(48.1, -11.5), 271.25, datetime(2024, 5, 31, 14, 0, 1)))
    exif[0x0112] = 6
    exif[0x010F] = "A maker of cameras"
    read = Image.Exif()
    read.load(exif.tobytes())  # as from a file: only then can a TIFF hold its tables
    return read


@cache
def seeds() -> dict[str, bytes]:
    """A small sound photo of each kind that this system can write."""
    rgb, exif = picture(), tags()
    deep = Image.fromarray(np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 20)
    clear = rgb.convert("RGBA")
    clear.putalpha(99)
    several: dict[str, Any] = {"save_all": True, "append_images": [rgb.rotate(90), rgb.rotate(180)]}
    kinds: dict[str, tuple[Image.Image, str, dict[str, Any]]] = {
        "plain.jpg": (rgb, "JPEG", {"exif": exif}),
        "progressive.jpg": (rgb, "JPEG", {"progressive": True, "exif": exif}),
        "cmyk.jpg": (rgb.convert("CMYK"), "JPEG", {"icc_profile": bytes(range(256)) * 3}),
        "grey.jpg": (rgb.convert("L"), "JPEG", {"restart_marker_blocks": 2}),
        "several.mpo": (rgb, "MPO", several),
        "plain.png": (rgb, "PNG", {"exif": exif, "icc_profile": bytes(500)}),
        "palette.png": (rgb.quantize(16), "PNG", {"transparency": 3}),
        "deep.png": (deep, "PNG", {}),
        "clear.png": (clear, "PNG", several),
        "lossy.webp": (rgb, "WEBP", {"exif": exif}),
        "lossless.webp": (clear, "WEBP", {"lossless": True}),
        "several.webp": (rgb, "WEBP", several),
        "raw.tif": (rgb, "TIFF", {"exif": exif}),
        "lzw.tif": (rgb, "TIFF", {"compression": "tiff_lzw"}),
        "deflate.tif": (deep, "TIFF", {"compression": "tiff_adobe_deflate"}),
        "jpeg.tif": (rgb, "TIFF", {"compression": "jpeg"}),
        "fax.tif": (rgb.convert("1"), "TIFF", {"compression": "group4"}),
        "several.gif": (rgb.quantize(32), "GIF", {**several, "disposal": 2}),
        "plain.bmp": (rgb, "BMP", {}),
        "plain.ppm": (rgb, "PPM", {}),
        "plain.jp2": (rgb, "JPEG2000", {}),
        "plain.avif": (rgb, "AVIF", {"exif": exif}),
    }
    made = {name: written for name, kind in kinds.items() if (written := _written(*kind))}
    with suppress(ImportError):
        from pillow_heif import from_pillow

        buffer = io.BytesIO()
        from_pillow(rgb).save(buffer, quality=60, exif=exif.tobytes())
        made["plain.heic"] = buffer.getvalue()
    return made


def _written(image: Image.Image, form: str, how: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    try:
        image.save(buffer, form, **how)
    except (KeyError, OSError):  # a Pillow without that encoder
        return b""
    return buffer.getvalue()


# --- and what strangers do to them ---------------------------------------------------------

EDGES = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


def flip(data: bytearray, by: random.Random, _: bytes) -> None:
    for _unused in range(by.choice((1, 1, 2, 4, 16))):
        data[by.randrange(len(data))] ^= 1 << by.randrange(8)


def scribble(data: bytearray, by: random.Random, _: bytes) -> None:
    start = by.randrange(len(data))
    data[start : start + by.choice((1, 4, 16, 64))] = by.randbytes(by.choice((1, 4, 16, 64)))


def number(data: bytearray, by: random.Random, _: bytes) -> None:
    """Another number where a length, a size or an offset may stand: mostly in the head."""
    form = by.choice((">H", "<H", ">I", "<I"))
    room = len(data) if by.random() < 0.3 else min(len(data), 300)
    place, width = by.randrange(max(1, room - 4)), struct.calcsize(form)
    old = int.from_bytes(data[place : place + width], "little" if form[0] == "<" else "big")
    value = by.choice((*EDGES, old + 1, old - 1, old * 2, old * 256, by.getrandbits(32)))
    data[place : place + width] = struct.pack(form, value % 256**width)


def size(data: bytearray, by: random.Random, _: bytes) -> None:
    """Another width and height where those of the photos to start from stand, up to a thousand million pixels."""
    pixels, shape = 10 ** by.uniform(3, 9), 10 ** by.uniform(-2, 2)
    width, height = round((pixels * shape) ** 0.5), round((pixels / shape) ** 0.5)
    for form, limit in ((">HH", 65_535), ("<HH", 65_535), (">II", 2**31), ("<II", 2**31)):
        new = min(width, limit), min(height, limit)
        for turned in (1, -1):
            old = struct.pack(form, *(64, 48)[::turned])
            data[:] = data.replace(old, struct.pack(form, *new[::turned]))


def truncate(data: bytearray, by: random.Random, _: bytes) -> None:
    del data[by.randrange(len(data)) :]


def cut_out(data: bytearray, by: random.Random, _: bytes) -> None:
    start = by.randrange(len(data))
    del data[start : start + by.randrange(1, 200)]


def repeat(data: bytearray, by: random.Random, _: bytes) -> None:
    start = by.randrange(len(data))
    data[start:start] = bytes(data[start : start + by.randrange(1, 200)]) * by.choice((1, 2, 50))


def splice(data: bytearray, by: random.Random, other: bytes) -> None:
    data[by.randrange(len(data)) :] = other[by.randrange(len(other)) :]


MUTATIONS: list[Callable[[bytearray, random.Random, bytes], None]] = [
    flip, flip, scribble, number, number, number, size, truncate, cut_out, repeat, splice,
]  # fmt: skip


def mutated(data: bytes, by: random.Random, other: bytes) -> bytes:
    result = bytearray(data)
    for _ in range(by.choice((1, 1, 1, 2, 3))):
        if result:
            by.choice(MUTATIONS)(result, by, other)
    if by.random() < 0.7:
        sign(result)
    return bytes(result)


def sign(data: bytearray) -> None:
    """Right checksums for a PNG's chunks: without them nothing behind the first change would be read."""
    place = 8
    while data.startswith(b"\x89PNG") and place + 12 <= len(data):
        end = place + 8 + int.from_bytes(data[place : place + 4], "big")
        if end + 4 > len(data):
            return
        data[end : end + 4] = struct.pack(">I", zlib.crc32(data[place + 4 : end]))
        place = end + 4


# --- photos --------------------------------------------------------------------------------


@dataclass
class Reader:
    """Reads one photo after another in a worker process and keeps the slowest."""

    crew: Workers
    folder: Path
    slowest: tuple[float, str] = (0.0, "")
    memory: int = 0
    opened: int = 0
    tried: int = 0

    def read(self, name: str, content: bytes) -> None:
        path = self.folder / f"fuzz{Path(name).suffix}"
        path.write_bytes(content)
        said, seconds, memory = self.crew.ask("tried", path, PIXELS)
        self.slowest = max(self.slowest, (seconds, name))
        self.memory, self.opened, self.tried = memory, self.opened + (not said), self.tried + 1
        assert not said or said.startswith(str(path)), name
        assert "\n" not in said, name

    def report(self, capsys: pytest.CaptureFixture[str]) -> None:
        with capsys.disabled():
            if THOROUGH:
                slowest = f"slowest {self.slowest[0]:.2f} s ({self.slowest[1]})"
                print(f"\n{self.tried} tried, {self.opened} opened, {slowest}, {self.memory // 1024} MiB")  # noqa: T201  # for whoever asked for the long run


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[Reader]:
    pytest.importorskip("resource", reason="only Unix measures memory so")
    pool = Pool(READER)
    with Workers(1, seconds=HANG, pool=pool) as crew:
        yield Reader(crew, tmp_path)
    pool.close()


def test_mutated_photos_open_or_are_said(reader: Reader, capsys: pytest.CaptureFixture[str]) -> None:
    names = sorted(seeds())
    for name in names:
        reader.read(name, seeds()[name])
    assert reader.opened == len(names)  # all of them are sound to begin with
    by = random.Random(20240531)
    for turn in range(PHOTOS):
        name, other = names[turn % len(names)], by.choice(names)
        reader.read(f"{turn} {name}", mutated(seeds()[name], by, seeds()[other]))
    assert reader.memory < MEMORY_KIB
    assert len(names) < reader.opened < reader.tried
    reader.report(capsys)


def test_mutated_exif_says_something_or_nothing(reader: Reader, capsys: pytest.CaptureFixture[str]) -> None:
    buffer = io.BytesIO()
    picture().save(buffer, "JPEG")
    jpeg, blob = buffer.getvalue(), tags().tobytes()
    big = b"Exif\0\0MM\0*" + struct.pack(">IH", 8, 1) + struct.pack(">HHII", 0x8825, 4, 1, 26) + bytes(90)
    by = random.Random(20240601)
    for turn in range(EXIFS):
        content = mutated(by.choice((blob, blob, big)), by, blob)
        if by.random() < 0.8 and not content.startswith(b"Exif\0\0"):
            content = b"Exif\0\0" + content[6:]
        segment = b"\xff\xe1" + struct.pack(">H", min(len(content) + 2, 65_535)) + content[:65_533]
        reader.read(f"exif {turn}.jpg", jpeg[:2] + segment + jpeg[2:])
    assert reader.opened == EXIFS  # whatever the EXIF says, the picture is there
    assert reader.memory < MEMORY_KIB
    reader.report(capsys)


# --- names, lists and tables ---------------------------------------------------------------


@contextmanager
def in_time() -> Iterator[None]:
    """A hang becomes an error."""
    if not hasattr(signal, "SIGALRM"):
        yield
        return

    def ring(*_: object) -> None:
        raise TimeoutError(f"over {HANG} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, HANG)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def sane(position: Position | None) -> None:
    if position is not None:
        assert position.heading is None or 0 <= position.heading < 360
        assert position.where is None or abs(position.where.lat) <= 90
        assert position.time is None or position.time.year >= 1


def one_sentence(error: Exception, path: Path | str = "") -> None:
    said = str(error)
    assert str(path) in said
    assert len(said.splitlines()) == 1, said


WHOLE = at_name(GeoPoint(37.7, -122.4), heading=90, time=datetime(2024, 5, 31), panoid="p", note="n")
FIELDS = st.sampled_from([*WHOLE.split("@"), "", "1e9", "-0", "nan", "٣", "00", "999999999999", "S", "20241301"])
NAMES = st.one_of(
    st.text(max_size=200),
    st.lists(st.one_of(FIELDS, st.text(max_size=12)), max_size=20).map("@".join),
    st.tuples(st.integers(0, len(WHOLE)), st.integers(0, 9), st.text(max_size=5)).map(
        lambda cut: WHOLE[: cut[0]] + cut[2] + WHOLE[cut[0] + cut[1] :]
    ),
)


@settings(max_examples=TEXTS, deadline=None)
@given(name=NAMES)
def test_any_name_says_where_or_nothing(name: str) -> None:
    with in_time():
        sane(parse_at_name(name))
        with pytest.raises(PhotoError, match="there is no photo"):
            existing(Path("no such folder here", name + "?"))


@settings(max_examples=TEXTS, deadline=None)
@given(text=st.text(max_size=400), raw=st.binary(max_size=80))
def test_any_list_gives_paths_or_a_sentence(text: str, raw: bytes) -> None:
    with in_time():
        assert all(str(path) for path in listed(io.StringIO(text)))
        try:
            listed(io.TextIOWrapper(io.BytesIO(raw), encoding="utf-8"))
        except PhotoError as error:
            one_sentence(error)


CELLS = st.one_of(
    st.sampled_from(
        ["a.jpg", "b/a.jpg", "../a.jpg", "/a.jpg", "48.1", "-11.5", "91", "1e400", "nan", "", " 7 ", "2024-05-31",
         "2024-05-31T14:00:00+02:00", '"', '"a,b"', '"a\nb"', "path", "lat", "lon", "heading", "\0", "a" * 140_000]
    ),
    st.text(max_size=12),
)  # fmt: skip
ROWS = st.lists(st.lists(CELLS, min_size=1, max_size=6).map(",".join), max_size=8)
TABLES = st.one_of(
    st.binary(max_size=300),
    st.tuples(
        st.sampled_from(
            ["path,lat,lon", "\ufeffPath, LAT ,lon,heading,time", "lat,lon", 'path,"l\nat",lat,lon', 'path,"l\nat",lon']
        ),
        ROWS,
        st.sampled_from(["\n", "\r\n", "\r"]),
    ).map(lambda parts: parts[2].join([parts[0], *parts[1]]).encode("utf-8", "surrogatepass")),
)  # fmt: skip


@settings(max_examples=TEXTS, deadline=None)
@given(content=TABLES)
def test_any_table_gives_positions_or_a_sentence(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder, in_time():
        path = Path(folder, "places.csv")
        path.write_bytes(content)
        try:
            table = PhotoTable.read(path)
        except PositionError as error:
            one_sentence(error, path)
            return
        for row in table.rows:
            sane(row.position)
            sane(table.get(row.path))
        sane(table.get(Path(folder, "a.jpg")))
        with suppress(PositionError):
            table.check_used([Path(folder, "a.jpg"), Path(folder, "b/a.jpg")])
