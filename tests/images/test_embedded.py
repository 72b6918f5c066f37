"""EXIF and XMP wherever formats keep them, and each folder of real trouble with them."""

from __future__ import annotations

import io
import struct
import zlib
from datetime import datetime
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from salad.geo import GeoPoint, metres_between
from salad.images.embedded import LONGEST_BLOCK, embedded
from salad.images.exif import to_exif
from salad.images.metadata import Position
from salad.images.photo import Photo, read_photo

HERE, ELSEWHERE = GeoPoint(-36.8, 174.75), GeoPoint(10, 20)
NOON = datetime(2023, 7, 14, 12)
HEAD = b"Exif\0\0"
PIXELS = Image.effect_noise((64, 48), 60).convert("RGB")
PACKET = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    b'<rdf:Description xmlns:exif="http://ns.adobe.com/exif/1.0/" exif:GPSLatitude="36,48.0S" '
    b'exif:GPSLongitude="174,45.0E"/></rdf:RDF></x:xmpmeta>'
)


def tiff(where: GeoPoint | None = HERE, time: datetime | None = NOON) -> bytes:
    return to_exif(Position(where, None, time)).tobytes().removeprefix(HEAD)


def saved(kind: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    PIXELS.save(buffer, kind, **options)
    return buffer.getvalue()


def segment(data: bytes) -> bytes:
    return b"\xff\xe1" + struct.pack(">H", 2 + len(data)) + data


def jpeg(*segments: bytes) -> bytes:
    plain = saved("JPEG")
    return plain[:2] + b"".join(map(segment, segments)) + plain[2:]


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(*chunks: bytes, behind: bool) -> bytes:
    plain = saved("PNG")
    at = plain.index(b"IEND" if behind else b"IDAT") - 4
    return plain[:at] + b"".join(chunks) + plain[at:]


def profile(kind: bytes, block: bytes) -> bytes:
    """As ImageMagick writes it."""
    digits = block.hex().encode()
    lines = b"\n".join(digits[at : at + 72] for at in range(0, len(digits), 72))
    return b"\n%s\n%8d\n%s\n" % (kind, len(block), lines)


def box(kind: bytes, data: bytes, *, long: bool = False) -> bytes:
    if long:
        return struct.pack(">I4sQ", 1, kind, 16 + len(data)) + data
    return struct.pack(">I4s", 8 + len(data), kind) + data


EXIF_UUID, XMP_UUID = b"JpgTiffExif->JP2", bytes.fromhex("be7acfcb97a942e89c71999491e3afac")
ADOBE = b"http://ns.adobe.com/xap/1.0/\0"


@pytest.mark.parametrize(
    "data",
    [
        jpeg(HEAD + tiff()),
        jpeg(b"Exif\0\xff" + tiff()),
        jpeg(HEAD + tiff(None), HEAD + tiff()),
        jpeg(HEAD + tiff(), HEAD + tiff(None, None)),
        jpeg(HEAD + tiff(ELSEWHERE), HEAD + tiff()),  # of two the last counts, as exiftool has it
        jpeg(HEAD + tiff()[:60], HEAD + tiff()[60:]),  # one, cut in two
        jpeg(b"ICC", HEAD + tiff()),
        png(chunk(b"eXIf", tiff()), behind=False),
        png(chunk(b"eXIf", tiff()), behind=True),
        png(chunk(b"tEXt", b"Raw profile type exif\0" + profile(b"exif", HEAD + tiff())), behind=True),
        png(
            chunk(b"zTXt", b"Raw profile type exif\0\0" + zlib.compress(profile(b"exif", HEAD + tiff()))), behind=False
        ),
        png(
            chunk(b"zTXt", b"Raw profile type APP1\0\0" + zlib.compress(profile(b"generic profile", HEAD + tiff()))),
            behind=True,
        ),
        saved("TIFF", exif=HEAD + tiff()),
        saved("WEBP", exif=tiff()),
        saved("WEBP", exif=HEAD + tiff()),
        saved("JPEG2000") + box(b"uuid", EXIF_UUID + tiff()),
        saved("JPEG2000") + box(b"uuid", EXIF_UUID + tiff(), long=True),
        saved("JPEG2000") + box(b"free", b"") + box(b"Exif", HEAD + tiff()),
    ],
)
def test_exif_wherever_it_is_kept(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "photo"
    path.write_bytes(data)
    told = read_photo(path)
    assert told.where is not None
    assert metres_between(told.where, HERE) < 0.001
    assert (told.time, told.source, told.remark) == (NOON, "exif", "")


@pytest.mark.parametrize(
    "data",
    [
        jpeg(ADOBE + PACKET),
        jpeg(HEAD + tiff(None, None), ADOBE + PACKET),
        png(chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + PACKET), behind=False),
        png(chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0en\0XMP\0" + PACKET), behind=True),
        png(chunk(b"iTXt", b"XML:com.adobe.xmp\0\1\0\0\0" + zlib.compress(PACKET)), behind=True),
        png(chunk(b"tEXt", b"Raw profile type xmp\0" + profile(b"xmp", PACKET)), behind=False),
        png(chunk(b"tEXt", b"Raw profile type APP1\0" + profile(b"generic profile", ADOBE + PACKET)), behind=False),
        saved("TIFF", tiffinfo={700: PACKET}),
        saved("WEBP", xmp=PACKET),
        saved("JPEG2000") + box(b"uuid", XMP_UUID + PACKET),
        saved("JPEG2000") + box(b"xml ", PACKET),
        saved("GIF")[:-1] + b"!\xff\x0bXMP DataXMP" + PACKET + b"\1" + bytes(range(255, -1, -1)) + b"\0;",
        saved("GIF")[:13]
        + saved("GIF")[13 : 13 + 768]
        + b"!\xff\x0bXMP DataXMP"
        + PACKET
        + b"\1"
        + bytes(range(255, -1, -1))
        + b"\0"
        + saved("GIF")[13 + 768 :],
    ],
)
def test_xmp_wherever_it_is_kept(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "photo"
    path.write_bytes(data)
    told = read_photo(path)
    assert (told.where, told.source, told.remark) == (HERE, "xmp", "")


@pytest.mark.parametrize("kind", ["HEIF", "AVIF"])
def test_heic_and_avif(tmp_path: Path, kind: str) -> None:
    if kind == "HEIF":
        heif = pytest.importorskip("pillow_heif", reason="the extra heic is not installed")
        made = heif.from_pillow(PIXELS)
        made.save(tmp_path / "e", format="HEIF", exif=HEAD + tiff())
        made.save(tmp_path / "x", format="HEIF", xmp=PACKET)
    else:
        PIXELS.save(tmp_path / "e", "AVIF", exif=tiff())
        PIXELS.save(tmp_path / "x", "AVIF", xmp=PACKET)
    for name, source in (("e", "exif"), ("x", "xmp")):
        told = read_photo(tmp_path / name)
        assert told.where is not None
        assert metres_between(told.where, HERE) < 0.001
        assert told.source == source


def test_exif_comes_before_xmp_and_what_it_lacks_is_taken_from_there(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    heading = PACKET.replace(b'exif:GPSLatitude="', b'exif:GPSImgDirection="84.2" exif:GPSLatitude="')
    path.write_bytes(jpeg(ADOBE + heading, HEAD + tiff(ELSEWHERE)))
    told = read_photo(path)
    assert told == Photo(path, ELSEWHERE, 84.2, NOON)
    assert told.source == "exif"


@pytest.mark.parametrize("block", [HEAD + b"??*\0", HEAD + b"II*\0\xff\xff\xff\xff", HEAD])
def test_damaged_exif_is_said(tmp_path: Path, block: bytes) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png(chunk(b"eXIf", block), behind=True))
    told = read_photo(path)
    assert told == Photo(path)
    assert told.remark in ("its EXIF is damaged", "nothing in it or beside it says where it was taken")


def test_a_text_that_unpacks_to_gigabytes_is_read_as_far_as_a_block_may_be_long(tmp_path: Path) -> None:
    bomb = zlib.compressobj(9)
    packed = b"".join(bomb.compress(bytes(1 << 24)) for _ in range(40)) + bomb.flush()
    path = tmp_path / "a.png"
    path.write_bytes(png(chunk(b"iTXt", b"XML:com.adobe.xmp\0\1\0\0\0" + packed), behind=True))
    with path.open("rb") as file, Image.open(file) as image:
        found = embedded(image, file)
    assert sum(map(len, found.xmp)) <= LONGEST_BLOCK
    assert read_photo(path).remark == "the XMP in it cannot be read"


@settings(max_examples=150)
@given(st.sampled_from(["JPEG", "PNG", "TIFF", "WEBP", "GIF", "JPEG2000"]), st.data())
def test_no_damage_crashes(tmp_path_factory: pytest.TempPathFactory, kind: str, data: st.DataObject) -> None:
    whole = bytearray(saved(kind, exif=tiff(), xmp=PACKET))
    if kind == "JPEG2000":
        whole += box(b"uuid", EXIF_UUID + tiff())
    for _ in range(data.draw(st.integers(1, 6))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("damaged") / "a"
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole)))])
    told = read_photo(path)
    assert told.heading is None or 0 <= told.heading < 360
    assert told.where or told.remark


# --- folders of real trouble, beside the checkout ------------------------------------------


def in_folder(shared: Path, name: str) -> dict[str, Photo]:
    folder = shared / "cases" / name / "photos"
    if not folder.is_dir():
        pytest.skip(f"there is no {folder}: it is not part of the repository")
    return {p.name: read_photo(p) for p in sorted(folder.iterdir()) if p.suffix not in (".xmp", ".json")}


def near(photo: Photo) -> bool:
    return photo.where is not None and metres_between(photo.where, HERE) < 0.01


def test_null_island(shared: Path) -> None:
    photos = in_folder(shared, "01-null-island")
    for name in ("zeroed.jpg", "zeroed_void.jpg"):
        assert photos[name].where is None
        assert "0,0" in photos[name].remark
    assert photos["equator.jpg"].where == GeoPoint(0, 32.5)
    assert metres_between(photos["greenwich.jpg"].where or HERE, GeoPoint(51.48, 0)) < 0.01


def test_oddities_of_gps(shared: Path) -> None:
    photos = in_folder(shared, "02-exif-gps-oddities")
    for name, photo in photos.items():
        assert photo.where or photo.remark not in ("", "nothing in it or beside it says where it was taken"), name
    for name in ("seconds_0over0.jpg", "decmin_seconds_0over0.jpg", "ref_garbage_after_nul.jpg", "ref_word.jpg"):
        assert near(photos[name]), name
    assert photos["direction_450.jpg"].heading == 90
    assert photos["direction_minus90.jpg"].heading == 270
    assert "none of the letters" in photos["no_refs.jpg"].remark


def test_xmp_and_sidecars(shared: Path) -> None:
    photos = in_folder(shared, "04-xmp-and-sidecars")
    assert all(near(photo) for photo in photos.values())
    assert photos["drone_exif_ok_heading_xmp.jpg"].heading == pytest.approx(275.8)


def test_formats(shared: Path) -> None:
    photos = in_folder(shared, "05-formats")
    for name in ("exif_after.png", "raw_profile_after.png", "raw_profile_app1.png", "exif_twice_second_has_gps.jpg"):
        assert near(photos[name]), name
