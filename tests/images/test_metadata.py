"""`@` names and EXIF, both ways, and what a copy keeps; whatever is broken says nothing and never crashes."""

from __future__ import annotations

import io
import string
import struct
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.TiffImagePlugin import IFDRational

from salad.errors import PhotoError, PositionError
from salad.geo import GeoPoint, Utm, from_utm, metres_between, shifted
from salad.images.decode import open_rgb
from salad.images.metadata import (
    Position,
    at_name,
    copy_with_position,
    from_exif,
    parse_at_name,
    save_jpeg,
    to_exif,
    with_position,
)
from salad.images.photo import read_photo

points = st.builds(GeoPoint, st.floats(-79.9, 83.9), st.floats(-180, 180))
zones = st.integers(-14 * 4, 14 * 4).map(lambda quarters: timezone(timedelta(minutes=15 * quarters)))
times = st.datetimes(datetime(1900, 1, 1), datetime(2100, 1, 1), timezones=st.one_of(st.none(), zones)).map(
    lambda t: t.replace(microsecond=0)
)
headings = st.floats(0, 360, exclude_max=True)
plain = st.text(string.ascii_letters + string.digits + " -_.ßжあ", max_size=12)
HERE = from_utm(Utm(545350.23, 4174054.95, 10, "S"))


# --- `@` names -----------------------------------------------------------------------------


@given(points, st.none() | headings, st.none() | times, plain, plain)
def test_at_names_there_and_back(
    where: GeoPoint, heading: float | None, time: datetime | None, panoid: str, note: str
) -> None:
    name = at_name(where, heading=heading, time=time, panoid=panoid, note=note)
    assert name.count("@") == 15
    told = parse_at_name(name)
    assert told is not None
    assert told.where is not None
    assert metres_between(told.where, where) < 0.2
    assert told.time == (None if time is None else time.replace(tzinfo=None))
    if heading is None:
        assert told.heading is None
    else:
        assert told.heading is not None
        assert abs((told.heading - heading + 180) % 360 - 180) <= 0.5001


def test_an_at_name_is_written_as_data_sets_write_it() -> None:
    name = at_name(HERE, heading=7.4, time=datetime(2008, 5, 1, 13, 2, 3), panoid="63x00", note="n")
    assert name == "@0545350.23@4174054.95@10@S@037.71262@-122.48547@63x00@@007@@@@20080501_130203@n@.jpg"


def test_at_names_keep_17_m_across_a_zones_edge() -> None:
    edge = GeoPoint(45, 6)
    west, east = (parse_at_name(at_name(shifted(edge, 0, side))) for side in (-8.5, 8.5))
    assert west is not None
    assert east is not None
    assert west.where is not None
    assert east.where is not None
    assert metres_between(west.where, east.where) == pytest.approx(17, abs=0.02)


@pytest.mark.parametrize("text", ["a@b", "a/b", "a\\b", "nul\0"])
def test_texts_that_would_break_the_name_are_refused(text: str) -> None:
    with pytest.raises(PositionError, match="leave out"):
        at_name(HERE, note=text)


@pytest.mark.parametrize(
    "name",
    [
        "holiday.jpg",
        "me@home.jpg",
        "@home@work.jpg",
        "@",
        "@@@.jpg",
        "@nan@inf@10@S@.jpg",
        "@1e5@4174054@10@S@.jpg",
        "@0545350.23@.jpg",
        "x@0545350.23@4174054.95@10@S@.jpg",
        "@0545350.23@4174054.95@10@S@/plain.jpg",
        "@٠545350.23@4174054.95@10@S@.jpg",
        "SanFrancisco_0000001_2011_04_000_37.7049199_-122.4719100_p0098x00.jpg",
    ],
)
def test_other_names_say_nothing(name: str) -> None:
    assert parse_at_name(name) is None


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("@0545350.23@4174054.95@10@S@@@@@@@@@@@.jpg", HERE),
        ("folder@1@2@/@0545350.23@4174054.95@10@S@.JPG", HERE),
        ("@545350.23@4174054.95@10@s", HERE),  # short, in small letters, without a suffix
        ("@0545350.23@4174054.95@@@037.5@-122.5@.jpg", GeoPoint(37.5, -122.5)),
        ("@0545350.23@4174054.95@99@S@037.5@-122.5@.jpg", GeoPoint(37.5, -122.5)),
        ("@0545350.23@4174054.95@10@S@37.5@-122.5@.jpg", HERE),  # both: the grid counts
        ("@0545350.23@4174054.95@.jpg", None),
        ("@0545350.23@4174054.95@99@S@137.5@-122.5@.jpg", None),
        ("@0545350.23@4174054.95@10@@x@-122.5@.jpg", None),
    ],
)
def test_where_an_at_name_points(name: str, where: GeoPoint | None) -> None:
    told = parse_at_name(name)
    assert told is not None
    assert told.where == where


@pytest.mark.parametrize(
    ("stamp", "time"),
    [
        ("2008", datetime(2008, 1, 1)),
        ("200805", datetime(2008, 5, 1)),
        ("2008053", datetime(2008, 5, 1)),  # cut within a field: what is whole counts
        ("20080531", datetime(2008, 5, 31)),
        ("20080531_", datetime(2008, 5, 31)),
        ("20080531_23", datetime(2008, 5, 31, 23)),
        ("20080531_2359", datetime(2008, 5, 31, 23, 59)),
        ("20080531_235958", datetime(2008, 5, 31, 23, 59, 58)),
        ("200", None),
        ("", None),
        ("20081301", None),
        ("00000101", None),
        ("2008-05-31", None),
        ("20080531235958", None),
        ("20080531_2359589", None),
        ("٢٠٠٨", None),
        ("YYYY", None),
    ],
)
def test_any_left_part_of_a_timestamp(stamp: str, time: datetime | None) -> None:
    told = parse_at_name(f"@0545350.23@4174054.95@10@S@@@@@370.5@@@@{stamp}@@.jpg")
    assert told == Position(HERE, 10.5, time)


@given(st.text(max_size=60) | st.lists(st.text("0123456789.-_SNa٣", max_size=16)).map(lambda f: "@" + "@".join(f)))
def test_no_name_crashes(name: str) -> None:
    told = parse_at_name(name)
    assert told is None or told.heading is None or 0 <= told.heading < 360


def test_real_names_agree_with_their_degrees(shared: Path) -> None:
    names = [path.name for path in (shared / "data/eval/sfxl-30/images/test/database").glob("@*.jpg")]
    assert len(names) > 200
    for name in names:
        told = parse_at_name(name)
        assert told is not None
        assert told.where is not None
        assert metres_between(told.where, GeoPoint(*map(float, name.split("@")[5:7]))) < 1
        assert told.time is not None


# --- EXIF ----------------------------------------------------------------------------------


def exif_of(gps: dict[int, Any] | None = None, shot: dict[int, Any] | None = None) -> Image.Exif:
    """EXIF as it comes out of a file: written to bytes and read again."""
    exif = Image.Exif()
    if gps is not None:
        exif[0x8825] = gps
    if shot is not None:
        exif[0x8769] = shot
    again = Image.Exif()
    again.load(exif.tobytes())
    return again


def dms(*numbers: float) -> tuple[IFDRational, ...]:
    return tuple(IFDRational(number) for number in numbers)


@given(st.builds(GeoPoint, st.floats(-90, 90), st.floats(-180, 180)), st.none() | headings, st.none() | times)
def test_exif_there_and_back(where: GeoPoint, heading: float | None, time: datetime | None) -> None:
    exif = Image.Exif()
    exif.load(to_exif(Position(where, heading, time)).tobytes())
    told = from_exif(exif)
    assert told.where is not None
    assert metres_between(told.where, where) < 1e-3
    assert told.time == time
    assert (told.time is None) or (told.time.utcoffset() == (time and time.utcoffset()))
    if heading is None:
        assert told.heading is None
    else:
        assert told.heading is not None
        assert abs((told.heading - heading + 180) % 360 - 180) <= 0.0051


def test_nothing_known_writes_nothing() -> None:
    assert from_exif(to_exif(Position())) == Position()
    assert not to_exif(Position())


@pytest.mark.parametrize(
    ("lat", "ref", "degrees"),
    [
        (dms(37, 30, 36), "N", 37.51),
        (dms(37, 30, 36), "S", -37.51),
        (dms(37, 30.6, 0), "n", 37.51),
        (dms(37, 30.6), "N ", 37.51),
        (dms(37.51), "S", -37.51),
    ],
)
def test_degrees_come_in_one_two_or_three_numbers(lat: Any, ref: str, degrees: float) -> None:
    told = from_exif(exif_of({1: ref, 2: lat, 3: "W", 4: dms(122, 0, 0)}))
    assert told.where is not None
    assert told.where.lat == pytest.approx(degrees)
    assert told.where.lon == -122


@pytest.mark.parametrize(
    "gps",
    [
        {1: "N", 2: dms(37, 30, 36)},
        {1: "N", 3: "E"},
        {2: dms(37, 30, 36), 4: dms(122, 0, 0)},
        {1: "X", 2: dms(37, 30, 36), 3: "W", 4: dms(122, 0, 0)},
        {1: "", 2: dms(37, 30, 36), 3: "W", 4: dms(122, 0, 0)},
        {1: "N", 2: dms(97, 30, 36), 3: "W", 4: dms(122, 0, 0)},
        {1: "N", 2: (IFDRational(0, 0),) * 3, 3: "W", 4: (IFDRational(0, 0),) * 3},
        {1: "N", 2: dms(1, 2, 3, 4), 3: "W", 4: dms(122, 0, 0)},
    ],
)
def test_a_broken_position_is_none(gps: dict[int, Any]) -> None:
    assert from_exif(exif_of(gps)).where is None


class Cursed(dict[int, Any]):
    """An EXIF whose tables raise when they are read."""

    def get_ifd(self, tag: int) -> dict[int, Any]:
        raise KeyError(tag)


def test_tables_that_cannot_be_read_say_nothing() -> None:
    assert from_exif(Cursed()) == Position()


@pytest.mark.parametrize(
    ("direction", "heading"),
    [(90.25, 90.25), (0, 0), (360, 0), (360.5, None), (65535, None)],
)
def test_image_direction_is_the_heading(direction: float, heading: float | None) -> None:
    assert from_exif(exif_of({17: IFDRational(direction)})).heading == heading


@pytest.mark.parametrize(
    ("text", "offset", "time"),
    [
        ("2020:01:02 03:04:05", None, datetime(2020, 1, 2, 3, 4, 5)),
        ("2020:01:02 03:04:05\0", "", datetime(2020, 1, 2, 3, 4, 5)),
        (
            "2020:01:02 03:04:05",
            "-03:30",
            datetime(2020, 1, 2, 3, 4, 5, tzinfo=timezone(-timedelta(hours=3.5))),
        ),
        ("2020:01:02 03:04:05", "later", datetime(2020, 1, 2, 3, 4, 5)),
        ("0000:00:00 00:00:00", "+01:00", None),
        ("    :  :     :  :  ", None, None),
        ("yesterday", None, None),
    ],
)
def test_original_time_with_its_offset(text: str, offset: str | None, time: datetime | None) -> None:
    told = from_exif(exif_of(shot={0x9003: text} | ({} if offset is None else {0x9011: offset})))
    assert told.time == time
    assert time is None or (told.time is not None and told.time.tzinfo == time.tzinfo)


@given(
    st.dictionaries(
        st.sampled_from([1, 2, 3, 4, 16, 17]),
        st.text(max_size=6)
        | st.binary(max_size=6)
        | st.none()
        | st.floats()
        | st.lists(st.one_of(st.floats(), st.text(max_size=2), st.just(IFDRational(0, 0))), max_size=4).map(tuple),
    )
)
def test_no_tag_crashes(gps: dict[int, Any]) -> None:
    class Given:
        def get_ifd(self, tag: int) -> dict[int, Any]:
            return gps

    told = from_exif(Given())
    assert told.heading is None or 0 <= told.heading < 360


# --- writing -------------------------------------------------------------------------------


def test_save_jpeg_takes_images_of_any_mode_and_replaces(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    save_jpeg(Image.new("RGBA", (8, 8), (0, 0, 0, 0)), path)
    assert (np.asarray(open_rgb(path)) == 255).all()
    save_jpeg(np.zeros((8, 8, 3), np.uint8), str(path), quality=50)
    assert not np.asarray(open_rgb(path)).any()
    assert [p.name for p in tmp_path.iterdir()] == ["a.jpg"]


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    image = Image.new("RGB", (8, 8))
    (tmp_path / "file").touch()
    (tmp_path / "folder.jpg").mkdir()
    for path in (tmp_path / "gone/a.jpg", tmp_path / "file/a.jpg", tmp_path / "folder.jpg"):
        with pytest.raises(PhotoError, match="cannot be written"):
            save_jpeg(image, path)
    with pytest.raises(PhotoError, match="cannot be written"):
        save_jpeg(Image.new("L", (70_000, 1)), tmp_path / "wide.jpg")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.jpg"]


# --- a copy with another position --------------------------------------------------------

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
