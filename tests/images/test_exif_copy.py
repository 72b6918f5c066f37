"""What a copy of a JPEG with another position keeps."""

from __future__ import annotations

import io
import string
import struct
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base

from salad.errors import PhotoError
from salad.geo import GeoPoint, Utm, from_utm, metres_between
from salad.images.exif import save_jpeg
from salad.images.exif_copy import copy_with_position, with_position
from salad.images.photo import read_photo

points = st.builds(GeoPoint, st.floats(-79.9, 83.9), st.floats(-180, 180))
zones = st.integers(-14 * 4, 14 * 4).map(lambda quarters: timezone(timedelta(minutes=15 * quarters)))
times = st.datetimes(datetime(1900, 1, 1), datetime(2100, 1, 1), timezones=st.one_of(st.none(), zones)).map(
    lambda t: t.replace(microsecond=0)
)
headings = st.floats(0, 360, exclude_max=True)
plain = st.text(string.ascii_letters + string.digits + " -_.ßжあ", max_size=12)
HERE = from_utm(Utm(545350.23, 4174054.95, 10, "S"))


anywhere = st.builds(GeoPoint, st.floats(-90, 90), st.floats(-180, 180))
SYDNEY = GeoPoint(-33.857, 151.215)
PIXELS = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
CORNER = PIXELS[:8, :8]


def jpeg(exif: bytes | None = None) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(PIXELS).save(buffer, "JPEG", **({} if exif is None else {"exif": exif}))
    return buffer.getvalue()


def scan(data: bytes) -> bytes:
    """All from the first quantisation table on: what the pixels are made of."""
    return data[data.index(b"\xff\xdb") :]


def camera(order: str) -> bytes:
    """EXIF as a camera writes it, in either byte order: tags, a maker's note, a GPS altitude, a thumbnail.

    The note names a place in the whole by its offset, as makers do; so whatever moves it breaks it.
    """
    thumbnail = io.BytesIO()
    Image.fromarray(CORNER).save(thumbnail, "JPEG")
    thumb = thumbnail.getvalue()

    def table(entries: list[tuple[int, int, int, bytes]], following: int) -> bytes:
        packed = [struct.pack(order + "HHI", tag, kind, count) + value for tag, kind, count, value in entries]
        return struct.pack(order + "H", len(entries)) + b"".join(packed) + struct.pack(order + "I", following)

    def long(value: int) -> bytes:
        return struct.pack(order + "I", value)

    note, make, altitude = 200, 220, 232
    first = [
        (Base.Make, 2, 10, long(make)),
        (Base.Orientation, 3, 1, struct.pack(order + "HH", 6, 0)),
        (IFD.Exif, 4, 1, long(70)),
        (IFD.GPSInfo, 4, 1, long(110)),
    ]
    data = bytearray(struct.pack(order + "2sHI", b"II" if order == "<" else b"MM", 42, 8)).ljust(300, b"\0")
    thumbnail_table = table([(513, 4, 1, long(300)), (514, 4, 1, long(len(thumb)))], 0)
    for at, part in (
        (8, table(first, 150)),
        (70, table([(Base.MakerNote, 7, 16, long(note))], 0)),
        (110, table([(GPS.GPSAltitudeRef, 1, 1, b"\1\0\0\0"), (GPS.GPSAltitude, 5, 1, long(altitude))], 0)),
        (150, thumbnail_table),
        (note, b"note at " + long(note) + b"\0\0\0\0"),
        (make, b"Kamera 11\0"),
        (altitude, struct.pack(order + "II", 417, 10)),
    ):
        data[at : at + len(part)] = part
    return b"Exif\0\0" + bytes(data) + thumb


@settings(max_examples=30)
@given(anywhere, anywhere, st.floats(0, 1e5))
def test_a_position_comes_back_and_nothing_else_changes(first: GeoPoint, second: GeoPoint, within: float) -> None:
    plain = jpeg()
    once = with_position(plain, first, within_m=within)
    twice = with_position(once, second)
    for data, where in ((once, first), (twice, second)):
        assert scan(data) == scan(plain)
        with Image.open(io.BytesIO(data)) as image:
            gps = image.getexif().get_ifd(IFD.GPSInfo)
        found = [
            sum(float(part) / 60**n for n, part in enumerate(gps[tag])) for tag in (GPS.GPSLatitude, GPS.GPSLongitude)
        ]
        signs = [-1 if gps[tag] in "SW" else 1 for tag in (GPS.GPSLatitudeRef, GPS.GPSLongitudeRef)]
        assert metres_between(GeoPoint(signs[0] * found[0], signs[1] * found[1]), where) < 0.001
        assert (GPS.GPSHPositioningError in gps) == (data is once)
        if data is once:
            assert float(gps[GPS.GPSHPositioningError]) == pytest.approx(within, abs=0.0051)


@pytest.mark.parametrize("order", ["<", ">"])
def test_what_the_camera_wrote_stays(order: str) -> None:
    before = jpeg(camera(order))
    after = with_position(before, SYDNEY)
    assert before.endswith(scan(jpeg()))
    assert after.endswith(scan(jpeg()))
    with Image.open(io.BytesIO(after)) as image:
        exif = image.getexif()
        gps, shot = exif.get_ifd(IFD.GPSInfo), exif.get_ifd(IFD.Exif)
        assert exif[Base.Make] == "Kamera 11"
        assert exif[Base.Orientation] == 6
        assert float(gps[GPS.GPSAltitude]) == 41.7
        assert gps[GPS.GPSLatitudeRef] == "S"
        note = shot[Base.MakerNote]
        # The note says where it stands, and that is still where it stands.
        tiff = after[after.index(b"Exif\0\0") + 6 :]
        (at,) = struct.unpack(order + "8xI4x", note)
        assert tiff[at : at + 16] == note
        last = exif.get_ifd(IFD.IFD1)
        thumbnail = tiff[last[513] : last[513] + last[514]]
    with Image.open(io.BytesIO(thumbnail)) as small:
        assert small.size == (8, 8)


def test_the_original_is_only_read(tmp_path: Path) -> None:
    photo, copy = tmp_path / "a.jpg", tmp_path / "copy.jpg"
    save_jpeg(PIXELS, photo, where=GeoPoint(1, 2), heading=30.0, time=datetime(2024, 5, 1, 12))
    before = photo.read_bytes()
    copy_with_position(photo, copy, SYDNEY)
    assert photo.read_bytes() == before
    found, known = read_photo(copy), read_photo(photo)
    assert metres_between(found.where, SYDNEY) < 0.001
    assert (found.heading, found.time) == (known.heading, known.time) == (30.0, datetime(2024, 5, 1, 12))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.jpg", "copy.jpg"]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"\x89PNG\r\n\x1a\n", "is no JPEG"),
        (b"", "is no JPEG"),
        (b"\xff\xd8\xff\xe1\xff\xff" + b"Exif\0\0", "cut short"),
        (jpeg(b"Exif\0\0" + b"??*\0" + bytes(8)), "EXIF is damaged"),
        (jpeg(b"Exif\0\0" + b"II*\0\xff\xff\0\0" + bytes(8)), "EXIF is damaged"),
        (jpeg(b"Exif\0\0" + b"MM\0*\0\0\0\x08" + bytes(65496)), "so long already"),
    ],
)
def test_what_cannot_take_a_position_is_refused(tmp_path: Path, data: bytes, said: str) -> None:
    photo = tmp_path / "a [1].jpg"
    photo.write_bytes(data)
    with pytest.raises(PhotoError, match=said) as told:
        copy_with_position(photo, tmp_path / "copy.jpg", SYDNEY)
    assert str(photo) in str(told.value)
    assert [path.name for path in tmp_path.iterdir()] == ["a [1].jpg"]


def test_nothing_is_written_over(tmp_path: Path) -> None:
    photo, copy = tmp_path / "a.jpg", tmp_path / "b.jpg"
    photo.write_bytes(jpeg())
    copy.write_text("mine")
    dangling = tmp_path / "link.jpg"
    dangling.symlink_to(tmp_path / "nowhere")
    for taken in (copy, photo, dangling):
        with pytest.raises(PhotoError, match="exists already"):
            copy_with_position(photo, taken, SYDNEY)
    assert copy.read_text() == "mine"
    for missing, to in ((tmp_path / "none.jpg", tmp_path / "c.jpg"), (photo, tmp_path / "no" / "c.jpg")):
        with pytest.raises(PhotoError, match=r"no photo at|cannot be written"):
            copy_with_position(missing, to, SYDNEY)


@settings(max_examples=200)
@given(st.binary(max_size=60), st.integers(2, 400), st.integers(0, 255))
def test_damage_makes_a_sentence_or_a_copy_never_anything_else(junk: bytes, at: int, byte: int) -> None:
    whole = bytearray(jpeg(camera("<")))
    whole[at] = byte
    for data in (bytes(whole), b"\xff\xd8\xff" + junk):
        try:
            copied = with_position(data, SYDNEY)
        except PhotoError:
            continue
        assert copied.startswith(b"\xff\xd8")
