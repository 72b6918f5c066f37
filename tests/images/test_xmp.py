"""XMP in its many spellings; whatever else it holds is passed over, and what is no XMP is said."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.geo import GeoPoint
from salad.images.metadata import Position
from salad.images.xmp import LONGEST_XMP, parse_xmp

HERE = GeoPoint(-36.8, 174.75)
SPACES = {
    "exif": "http://ns.adobe.com/exif/1.0/",
    "xmp": "http://ns.adobe.com/xap/1.0/",
    "photoshop": "http://ns.adobe.com/photoshop/1.0/",
    "drone-dji": "http://www.dji.com/drone-dji/1.0/",
    "drone-parrot": "http://www.parrot.com/drone-parrot/1.0/",
    "GPano": "http://ns.google.com/photos/1.0/panorama/",
    "Camera": "http://pix4d.com/camera/1.0",
}


def packet(properties: dict[str, str], *, as_elements: bool = False, more: str = "") -> bytes:
    """A packet as programs write it, with its properties as attributes or as elements."""
    spaces = " ".join(f'xmlns:{name}="{space}"' for name, space in SPACES.items())
    attributes = "" if as_elements else " ".join(f'{name}="{value}"' for name, value in properties.items())
    inside = "".join(f"<{name}>\n {value}\n</{name}>" for name, value in properties.items()) if as_elements else ""
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="" {spaces} {attributes}>{inside}{more}</rdf:Description></rdf:RDF></x:xmpmeta>'
        f"{' ' * 100}<?xpacket end='w'?>"
    ).encode()


@pytest.mark.parametrize("as_elements", [False, True])
@pytest.mark.parametrize(
    ("lat", "lon"),
    [
        ("36,48.0S", "174,45.0E"),
        ("36,48,0S", "174,45,0E"),
        ("36, 48, 0 s", "174, 45, 0 e"),
        ("36.8S", "174.75E"),
        ("-36.8", "174.75"),
        ("-36.80000", "+174.75"),
        ("36,48.0South", "174,45.0East"),
        ("36,48.0S", "534.75E"),
        ("36,48.0S", "185,15.0W"),
    ],
)
def test_positions_however_they_are_written(lat: str, lon: str, as_elements: bool) -> None:
    told = parse_xmp(packet({"exif:GPSLatitude": lat, "exif:GPSLongitude": lon}, as_elements=as_elements))
    if lon == "534.75E":  # more than once around
        assert told.where is None
        assert "not understood" in told.remark
    else:
        assert told == Position(HERE)
        assert (told.source, told.remark) == ("xmp", "")


@pytest.mark.parametrize(
    ("lat", "lon"),
    [
        ("36,48.0", "174,45.0E"),
        ("36,48.0E", "174,45.0S"),
        ("-36,48.0S", "174,45.0E"),
        ("36,48.0S", ""),
        ("91", "10"),
        ("nan", "inf"),
        ("1e5", "0"),
        ("٣٦.٨", "10"),
        ("9" * 200, "10"),
    ],
)
def test_a_position_that_is_not_understood_is_said_and_never_guessed(lat: str, lon: str) -> None:
    told = parse_xmp(packet({"exif:GPSLatitude": lat, "exif:GPSLongitude": lon}))
    assert told == Position()
    assert "not understood" in told.remark


@pytest.mark.parametrize("longitude", ["GpsLongitude", "GpsLongtitude", "Longitude"])
def test_what_a_drone_knows_counts_where_exifs_own_fields_are_empty_or_zero(longitude: str) -> None:
    latitude = "Latitude" if longitude == "Longitude" else "GpsLatitude"
    drone = {f"drone-dji:{latitude}": "-36.8", f"drone-dji:{longitude}": "+174.75"}
    zeros = {"exif:GPSLatitude": "0,0.0N", "exif:GPSLongitude": "0,0.0E"}
    assert parse_xmp(packet(drone)).where == HERE
    assert parse_xmp(packet(drone | zeros)).where == HERE
    assert parse_xmp(packet(zeros)).where == GeoPoint(0, 0)  # `settled` says what that is worth


@pytest.mark.parametrize(
    ("properties", "heading"),
    [
        ({"drone-dji:GimbalYawDegree": "-84.20", "drone-dji:FlightYawDegree": "111"}, 275.8),
        ({"drone-dji:FlightYawDegree": "111"}, None),  # where it flies is not where it looks
        ({"exif:GPSImgDirection": "8420/100", "drone-dji:GimbalYawDegree": "10"}, 84.2),
        ({"exif:GPSImgDirection": "450"}, 90),
        ({"exif:GPSImgDirection": "1/0", "GPano:PoseHeadingDegrees": "12.5"}, 12.5),
        ({"drone-parrot:CameraYawDegree": "-90"}, 270),
        ({"Camera:Yaw": "359.5"}, 359.5),
        ({"exif:GPSImgDirection": "north"}, None),
    ],
)
def test_headings(properties: dict[str, str], heading: float | None) -> None:
    told = parse_xmp(packet(properties)).heading
    assert told == (None if heading is None else pytest.approx(heading))


def test_times_in_their_order() -> None:
    times = {
        "exif:GPSTimeStamp": "2023-07-14T10:00:05Z",
        "xmp:CreateDate": "2023-07-14T10:00:04",
        "exif:DateTimeDigitized": "2023-07-14T10:00:03",
        "photoshop:DateCreated": "2023-07-14T10:00:02",
        "exif:DateTimeOriginal": "2023-07-14T10:00:01",
    }
    for left in range(5, 0, -1):
        held = dict(list(times.items())[:left])
        zone = UTC if left == 1 else None
        assert parse_xmp(packet(held)).time == datetime(2023, 7, 14, 10, 0, 6 - left, tzinfo=zone)
    assert parse_xmp(packet({"exif:DateTimeOriginal": "0000-00-00T00:00:00"})).time is None


def test_utf_16_padding_and_bad_letters_do_no_harm() -> None:
    plain = packet({"exif:GPSLatitude": "-36.8", "exif:GPSLongitude": "174.75"})
    for data in (
        b"\xef\xbb\xbf" + plain + b"\0\0",
        plain.decode().encode("utf-16"),
        plain.replace(b"adobe:ns:meta/", b"adobe:ns:meta/\xff"),
        b'<?xml version="1.0" encoding="UTF-8"?>' + plain,
    ):
        assert parse_xmp(data).where == HERE


def test_only_properties_of_the_photo_itself_count() -> None:
    place = "<exif:GPSLatitude>1</exif:GPSLatitude><exif:GPSLongitude>2</exif:GPSLongitude>"
    nested = f"<xmp:Other><rdf:Description>{place}</rdf:Description></xmp:Other>"
    told = parse_xmp(packet({}, more=nested))
    assert told == Position()
    assert told.remark == ""


ENTITIES = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no xml at all",
        packet({})[:200],
        ENTITIES + packet({"exif:GPSLatitude": "-36.8", "exif:GPSLongitude": "174.75"}),
        b'<!DOCTYPE x SYSTEM "file:///etc/passwd">' + packet({}),
        packet({"exif:GPSLatitude": "&b;"}),
        b"<a>" * 100_000,
        packet({}, more="<b>" * 100 + "</b>" * 100),
        b'<a xmlns:b="' + b"u" * 100_000 + b'">' + b"<b:c/>" * 100_000 + b"</a>",
        packet({}) + b" " * LONGEST_XMP,
    ],
)
def test_what_is_no_xmp_or_more_than_anybody_needs_is_said(data: bytes) -> None:
    told = parse_xmp(data, source="sidecar", told="a.xmp")
    assert told == Position()
    assert told.remark == "a.xmp cannot be read"


@given(st.binary(max_size=60), st.integers(0, 900), st.integers(0, 60))
def test_no_damage_crashes(junk: bytes, at: int, gone: int) -> None:
    whole = packet({"exif:GPSLatitude": "36,48.0S", "exif:GPSLongitude": "174,45.0E", "xmp:CreateDate": "2023-07-14"})
    told = parse_xmp(whole[:at] + junk + whole[at + gone :])
    assert told.heading is None or 0 <= told.heading < 360
