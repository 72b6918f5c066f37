"""A RAW photo is seen as its camera showed it, or refused as RAW; its thumbnail is never taken for it."""

from __future__ import annotations

import io
import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from salad.errors import PhotoError
from salad.images.decode import open_rgb
from salad.images.finding import find_photos
from salad.images.raw import SUFFIXES

SENSOR = (1600, 1200)
"""Width and height of the photo that the made files stand for."""


def picture(width: int, height: int, *, orientation: int | None = None) -> bytes:
    """A JPEG whose upper left quarter is white, the rest of it green."""
    image = Image.new("RGB", (width, height), (0, 160, 0))
    image.paste((255, 255, 255), (0, 0, width // 2, height // 2))
    exif = Image.Exif()
    if orientation is not None:
        exif[0x0112] = orientation
    file = io.BytesIO()
    image.save(file, "JPEG", exif=exif)
    return file.getvalue()


def raw(
    *pictures: bytes, order: str = "<", magic: bytes = b"II*\0", orientation: int = 1, tiles: tuple[bytes, ...] = ()
) -> bytes:
    """A RAW photo as cameras lay one out: a directory of the sensor's numbers, and JPEGs somewhere behind it.

    Args:
        pictures: What a camera made of it.
        order: Of bytes.
        magic: The first four.
        orientation: As its directory says.
        tiles: JPEGs that are pieces of the sensor's numbers.
    """
    entries = [(256, 4, 1, SENSOR[0]), (257, 4, 1, SENSOR[1]), (274, 3, 1, orientation)]
    behind = 8 + 2 + 12 * (len(entries) + bool(tiles)) + 4
    places = [behind + 4 * len(tiles) + sum(map(len, tiles[:number])) for number in range(len(tiles))]
    if tiles:
        entries.append((324, 4, len(tiles), behind if len(tiles) > 1 else places[0]))
    packed = b""
    for tag, kind, count, value in entries:
        number = struct.pack(f"{order}H2x", value) if kind == 3 else struct.pack(f"{order}L", value)
        packed += struct.pack(f"{order}HHL", tag, kind, count) + number
    head = magic + struct.pack(f"{order}LH", 8, len(entries)) + packed + struct.pack(f"{order}L", 0)
    head += b"".join(struct.pack(f"{order}L", place) for place in places) + b"".join(tiles)
    return head + np.random.default_rng(0).bytes(5000) + b"".join(picture + b"\0" * 99 for picture in pictures)


def refused(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(PhotoError) as caught:
        open_rgb(path)
    return str(caught.value)


@pytest.mark.parametrize("suffix", sorted(SUFFIXES))
def test_the_largest_picture_is_seen(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix.upper()}"
    path.write_bytes(raw(picture(160, 120), picture(1600, 1200), picture(640, 480)))
    assert open_rgb(path).size == (1600, 1200)
    assert open_rgb(path, at_least=(100, 100)).size[0] < 1600


@pytest.mark.parametrize(
    "data",
    [
        raw(picture(1600, 1200), magic=b"IIRO"),
        raw(picture(1600, 1200), magic=b"IIU\0"),
        raw(picture(1600, 1200), magic=b"MM\0*", order=">"),
        b"FUJIFILMCCD-RAW 0201" + b"\0" * 100 + picture(1600, 1200) + b"\0" * 3000,
        b"\0\0\0\x18ftypcrx \0\0\0\1crx isom" + b"\0" * 30 + b"CMT1" + raw()[:200] + picture(1600, 1200),
    ],
    ids=["Olympus", "Panasonic", "big-endian", "Fuji", "CR3"],
)
def test_makers_begin_their_files_in_their_own_ways(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.nef"
    path.write_bytes(data)
    assert open_rgb(path).size == (1600, 1200)


def test_a_thumbnail_is_never_taken_for_the_photo(tmp_path: Path) -> None:
    said = refused(tmp_path / "a.arw", raw(picture(160, 120), picture(640, 480)))
    assert said.endswith(
        "a.arw is a RAW photo and holds only a preview of 640 pixels: develop it to JPEG, or leave it out"
    )
    assert "holds no picture made of it: develop it" in refused(tmp_path / "a.cr2", raw())
    (tmp_path / "b.nef").write_bytes(raw(picture(800, 600)))
    assert open_rgb(tmp_path / "b.nef").size == (800, 600)  # half as wide as the sensor


def test_pieces_of_the_sensors_numbers_are_no_picture(tmp_path: Path) -> None:
    for count in (1, 4):
        said = refused(tmp_path / "a.dng", raw(picture(160, 120), tiles=(picture(1100, 1100),) * count))
        assert "a preview of 160 pixels" in said


@pytest.mark.parametrize(("orientation", "white"), [(1, (0, 0)), (3, (1, 1)), (6, (1, 0)), (8, (0, 1))])
def test_it_stands_upright(tmp_path: Path, orientation: int, white: tuple[int, int]) -> None:
    path = tmp_path / "a.nef"
    for data in (
        raw(picture(1600, 1200), orientation=orientation),
        raw(picture(1600, 1200, orientation=orientation), orientation=1),  # the JPEG's own word counts
    ):
        path.write_bytes(data)
        image = open_rgb(path)
        assert (image.height > image.width) == (orientation > 4)
        half = image.width // 2, image.height // 2
        seen = image.getpixel((white[0] * half[0] + 9, white[1] * half[1] + 9))
        assert seen == pytest.approx((255, 255, 255), abs=9)


def test_what_the_camera_turned_is_not_turned_again(tmp_path: Path) -> None:
    path = tmp_path / "a.nef"
    path.write_bytes(raw(picture(1200, 1600), orientation=6))
    assert open_rgb(path).size == (1200, 1600)
    assert open_rgb(path).getpixel((9, 9)) == pytest.approx((255, 255, 255), abs=9)


def test_a_plain_photo_under_a_raw_name_is_that_photo(tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes(picture(100, 80))
    assert open_rgb(tmp_path / "a.dng").size == (100, 80)


def test_a_dng_under_another_name_is_one(tmp_path: Path) -> None:
    tags = Image.Exif()
    tags[50706] = b"\1\4\0\0"  # the version of the form
    Image.new("L", (64, 48)).save(tmp_path / "a.tif", exif=tags)
    assert "is a RAW photo" in refused(tmp_path / "a.tif", (tmp_path / "a.tif").read_bytes())


def test_every_cut_is_said(tmp_path: Path) -> None:
    whole = raw(picture(160, 120), picture(900, 700), magic=b"MM\0*", order=">", tiles=(picture(20, 20),) * 2)
    for length in [*range(4, 120), *range(120, len(whole), 613)]:
        (tmp_path / "a.nef").write_bytes(whole[:length])
        with suppress(PhotoError):
            assert open_rgb(tmp_path / "a.nef").size == (900, 700)


def test_folders_leave_raw_photos_out(tmp_path: Path) -> None:
    """Most lie beside the JPEG that the camera saved, and would be a twin of it."""
    (tmp_path / "a.nef").write_bytes(raw(picture(1600, 1200)))
    (tmp_path / "a.jpg").write_bytes(picture(100, 80))
    assert find_photos([tmp_path]) == [tmp_path / "a.jpg"]
    assert find_photos([tmp_path / "a.nef"]) == [tmp_path / "a.nef"]


def test_the_dng_of_the_cases(tmp_path: Path) -> None:
    """A preview in the first directory, the sensor's numbers in one within it, and no JPEG: what case 22 draws."""
    preview, numbers = Image.new("RGB", (64, 48), "red").tobytes(), np.full((360, 480), 700, "<u2").tobytes()
    first = [(254, 1), (256, 64), (257, 48), (258, 8), (259, 1), (262, 2), (273, 300), (277, 3), (278, 48)]
    first += [(279, len(preview)), (330, 180)]
    second = [(254, 0), (256, 480), (257, 360), (258, 16), (259, 1), (262, 1), (273, 300 + len(preview))]
    second += [(277, 1), (278, 360), (279, len(numbers))]
    head = b"II*\0" + struct.pack("<L", 8)
    for place, entries in ((8, first), (180, second)):
        packed = b"".join(struct.pack("<HHLL", tag, 4, 1, value) for tag, value in entries)
        head = head.ljust(place, b"\0") + struct.pack("<H", len(entries)) + packed + struct.pack("<L", 0)
    data = head.ljust(300 + 18, b"\0")[:318] + preview + numbers
    assert "is a RAW photo and holds no picture made of it" in refused(tmp_path / "raw_like.dng", data)
