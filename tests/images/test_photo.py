"""What is known of a photo, and which it is."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from salad.errors import PhotoError
from salad.geo import GeoPoint, metres_between, shifted
from salad.images.at_names import at_name
from salad.images.decode import open_rgb
from salad.images.exif import save_jpeg
from salad.images.photo import Photo, content_hash, read_photo
from salad.images.photo_table import PhotoTable

HERE = GeoPoint(37.7126, -122.4855)
GREY = np.full((4, 6, 3), 128, np.uint8)


def files(root: Path, *names: str) -> list[Path]:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"x")
    return [root / name for name in names]


def test_save_and_read_again_to_the_centimetre(tmp_path: Path) -> None:
    path, time = tmp_path / "写真 @home.jpg", datetime(2024, 5, 31, 14, 0, 1)
    save_jpeg(GREY, path, where=HERE, heading=271.25, time=time)
    photo = read_photo(path)
    assert photo.where is not None
    assert metres_between(photo.where, HERE) < 0.05
    assert (photo.path, photo.heading, photo.time) == (path, 271.25, time)


def test_an_at_sign_in_a_folder_says_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "@0545350.23@4174054.95@10@S@"
    folder.mkdir()
    save_jpeg(GREY, folder / "a.jpg")
    assert read_photo(folder / "a.jpg") == Photo(folder / "a.jpg")


def test_table_then_name_then_exif_each_for_what_it_knows(tmp_path: Path) -> None:
    by_name, by_table = shifted(HERE, 100, 0), GeoPoint(1, 2)
    path = tmp_path / at_name(by_name, heading=90)
    save_jpeg(GREY, path, where=HERE, heading=10, time=datetime(2020, 1, 1))
    photo = read_photo(path)
    assert photo.where is not None
    assert metres_between(photo.where, by_name) < 0.1
    assert (photo.heading, photo.time) == (90, datetime(2020, 1, 1))

    (tmp_path / "places.csv").write_text(f"path,lat,lon\n{path.name},1,2\nother.jpg,3,4\n")
    table = PhotoTable.read(tmp_path / "places.csv")
    assert read_photo(path, table) == Photo(path, by_table, 90, datetime(2020, 1, 1))
    save_jpeg(GREY, tmp_path / "third.jpg", where=HERE, heading=0.0)
    assert read_photo(tmp_path / "third.jpg", table).heading == 0


@pytest.mark.parametrize("content", [b"", b"not an image", b"\xff\xd8\xff\xe1\x00\x10Exif\0\0garbage"])
def test_a_photo_that_cannot_be_opened_has_no_exif_but_its_name_counts(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / at_name(HERE)
    path.write_bytes(content)
    assert read_photo(path).where is not None
    (tmp_path / "plain.jpg").write_bytes(content)
    assert read_photo(tmp_path / "plain.jpg") == Photo(tmp_path / "plain.jpg")


@pytest.mark.parametrize("suffix", [".png", ".webp", ".tif"])
def test_other_formats_carry_exif_too(tmp_path: Path, suffix: str) -> None:
    save_jpeg(GREY, tmp_path / "a.jpg", where=HERE, heading=12)
    with Image.open(tmp_path / "a.jpg") as image:
        image.save(tmp_path / f"a{suffix}", exif=image.getexif())
    photo = read_photo(tmp_path / f"a{suffix}")
    assert photo.where is not None
    assert metres_between(photo.where, HERE) < 0.05


def test_reading_what_is_known_decodes_no_pixels(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    save_jpeg(noise, tmp_path / "whole.jpg", where=HERE)
    cut = (tmp_path / "whole.jpg").read_bytes()[:-500]
    (tmp_path / "cut.jpg").write_bytes(cut)
    assert read_photo(tmp_path / "cut.jpg").where is not None
    with pytest.raises(PhotoError):
        open_rgb(tmp_path / "cut.jpg")


@pytest.mark.parametrize("read", [read_photo, content_hash, open_rgb])
def test_what_is_not_a_file_is_said(tmp_path: Path, read: object) -> None:
    assert callable(read)
    for path, says in (
        (tmp_path / "gone.jpg", "no photo at"),
        (tmp_path, "is a folder"),
        (Path("/dev/null"), "is not a file"),
        (tmp_path / ("long" * 100 + ".jpg"), "no photo at"),
        (Path("nul\0.jpg"), "no photo at"),
    ):
        with pytest.raises(PhotoError, match=says):
            read(path)


def test_identity_is_the_content_whatever_the_name(tmp_path: Path) -> None:
    one, two, three = files(tmp_path, "1.jpg", "2.png", "3.jpg")
    three.write_bytes(b"y")
    assert content_hash(one) == content_hash(two) != content_hash(three)
    assert len(content_hash(one)) == 32
    assert int(content_hash(one), 16) >= 0
