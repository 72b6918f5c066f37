"""What a copy of a JPEG with another position keeps."""

from __future__ import annotations

import io
import json
import shutil
import struct
import subprocess
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base

from salad.errors import PhotoError
from salad.geo import GeoPoint, metres_between
from salad.images.exif import save_jpeg
from salad.images.exif_copy import copy_with_position, with_position
from salad.images.photo import read_photo
from salad.images.xmp import without_place

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


# --- what else says where a photo was taken --------------------------------------------------

XMP = b"http://ns.adobe.com/xap/1.0/\0"
NAMES = (
    'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:exif="http://ns.adobe.com/exif/1.0/" '
    'xmlns:drone="http://www.dji.com/drone-dji/1.0/" xmlns:ext="http://iptc.org/std/Iptc4xmpExt/2008-02-29/"'
)


def with_xmp(inside: str, attributes: str = "", *, gps: dict[int, object] | None = None) -> bytes:
    """A JPEG with a packet of XMP, and GPS tags in its EXIF."""
    packet = (
        f'<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF {NAMES}>'
        f'<rdf:Description rdf:about="" {attributes}>{inside}</rdf:Description></rdf:RDF></x:xmpmeta>'
        f"{' ' * 2000}<?xpacket end='w'?>"
    )
    exif = Image.Exif()
    exif[IFD.GPSInfo] = gps or {GPS.GPSAltitude: 90.0}
    plain = jpeg(exif.tobytes())
    content = XMP + packet.encode()
    return plain[:2] + b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content + plain[2:]


def xmp_of(data: bytes) -> bytes:
    at = data.index(XMP) - 4
    return data[at : at + 2 + struct.unpack(">H", data[at + 2 : at + 4])[0]]


@pytest.mark.parametrize(
    ("inside", "attributes", "kept"),
    [
        (
            "",
            'exif:GPSLatitude="10,0N" exif:GPSLongitude = \'20,0E\' exif:GPSAltitude="5/1"',
            b'exif:GPSAltitude="5/1"',
        ),
        (
            "<exif:GPSLatitude>10,0N</exif:GPSLatitude><exif:GPSLongitude>20,0E</exif:GPSLongitude><exif:A/>",
            "",
            b"<exif:A/>",
        ),
        ("<exif:GPSLatitude xml:lang='a>b'>10,0N</exif:GPSLatitude><exif:GPSLongitude/>", "", b"</rdf:Description>"),
        (
            "",
            'drone:GpsLatitude="+10" drone:GpsLongtitude="+20" drone:GimbalYawDegree="7"',
            b'drone:GimbalYawDegree="7"',
        ),
        ("", 'exif:GPSMapDatum="TOKYO" exif:GPSStatus="V" exif:GPSDestLatitude="1,0N"', b'exif:GPSDestLatitude="1,0N"'),
    ],
)
def test_a_position_in_xmp_gives_way(tmp_path: Path, inside: str, attributes: str, kept: bytes) -> None:
    before = with_xmp(inside, attributes)
    after = with_position(before, SYDNEY)
    assert len(xmp_of(after)) == len(xmp_of(before))
    assert xmp_of(after)[:33] == xmp_of(before)[:33]
    assert kept in xmp_of(after)
    for gone in (b"10,0N", b"20,0E", b"+10", b"+20", b"TOKYO", b'"V"', b"GPSLatitude", b"GPSLongitude", b"GpsL"):
        assert gone not in xmp_of(after)
    assert scan(after) == scan(before)
    (tmp_path / "a.jpg").write_bytes(after)
    where = read_photo(tmp_path / "a.jpg").where
    assert where is not None
    assert metres_between(where, SYDNEY) < 0.01


@pytest.mark.parametrize(
    "inside",
    [
        "<ext:LocationShown><rdf:Bag><rdf:li exif:GPSLatitude='1,0N'/></rdf:Bag></ext:LocationShown>",
        "<exif:GPSDestLatitude>1,0N</exif:GPSDestLatitude>",
        "<exif:GPSLatitude>1,0N",  # broken: nobody reads it
        "<!-- exif:GPSLatitude='1,0N' -->",
    ],
)
def test_what_xmp_says_of_other_places_stays(inside: str) -> None:
    before = with_xmp(inside)
    assert xmp_of(with_position(before, SYDNEY)) == xmp_of(before)


@given(st.binary(max_size=200) | st.text("<>/'\" =:exifGPSLatude\0", max_size=200).map(str.encode))
def test_no_packet_crashes_and_none_changes_its_length(packet: bytes) -> None:
    assert len(without_place(packet)) == len(packet)


def test_what_made_a_position_void_does_not_stay() -> None:
    before = with_xmp("", gps={GPS.GPSStatus: "V", GPS.GPSMapDatum: "TOKYO", GPS.GPSDateStamp: "2020:01:01"})
    gps = Image.open(io.BytesIO(with_position(before, SYDNEY))).getexif().get_ifd(IFD.GPSInfo)
    assert {GPS.GPSStatus, GPS.GPSMapDatum}.isdisjoint(gps)
    assert gps[GPS.GPSDateStamp] == "2020:01:01"


@pytest.mark.skipif(shutil.which("exiftool") is None, reason="exiftool is not installed")
def test_copies_of_peoples_photos_hold_one_position_to_exiftool(cases: Path, tmp_path: Path) -> None:
    photos = sorted((cases / "18-write-exif/q").rglob("*.jpg"))
    for number, photo in enumerate(photos):
        copy_with_position(photo, tmp_path / f"{number}.jpg", SYDNEY, within_m=12)
    command = ["exiftool", "-n", "-j", "-a", "-G1", "-gps:all", "-xmp:all", "-validate", "-warning", str(tmp_path)]
    told = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    assert len(told) == len(photos) == 7
    for of in told:
        places = {name: value for name, value in of.items() if name.endswith(("GPSLatitude", "GPSLongitude"))}
        assert places == {"GPS:GPSLatitude": pytest.approx(33.857), "GPS:GPSLongitude": pytest.approx(151.215)}
        assert of["GPS:GPSLatitudeRef"] == "S"
        assert of.get("GPS:GPSStatus", "A") == "A"
        assert "GPS:GPSMapDatum" not in of
        assert of["ExifTool:Validate"].startswith("0 ")  # no error
