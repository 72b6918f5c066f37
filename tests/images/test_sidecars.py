"""What stands beside a photo: which file wins, and what of them is never opened."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from PIL import Image

from salad.geo import GeoPoint
from salad.images.exif import save_jpeg
from salad.images.photo import read_photo
from salad.images.sidecars import read_sidecars
from salad.images.workers import Workers

PHOTO = Image.new("RGB", (16, 16), "grey")


def xmp(lat: float, lon: float) -> str:
    return (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description xmlns:e="http://ns.adobe.com/exif/1.0/" e:GPSLatitude="{lat}" e:GPSLongitude="{lon}"/>'
        "</rdf:RDF></x:xmpmeta>"
    )


def takeout(lat: float, lon: float) -> str:
    return json.dumps({"title": "a.jpg", "geoData": {"latitude": lat, "longitude": lon}})


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    path = tmp_path / "a.jpg"
    save_jpeg(PHOTO, path)
    return path


def test_which_of_them_wins(photo: Path) -> None:
    assert read_photo(photo).where is None
    photo.with_name("a.jpg.json").write_text(takeout(1, 1))
    assert (read_photo(photo).where, read_photo(photo).source) == (GeoPoint(1, 1), "takeout")
    save_jpeg(PHOTO, photo, where=GeoPoint(2, 2))
    assert (read_photo(photo).where, read_photo(photo).source) == (GeoPoint(2, 2), "exif")
    photo.with_name("a.xmp").write_text(xmp(3, 3))
    assert (read_photo(photo).where, read_photo(photo).source) == (GeoPoint(3, 3), "sidecar")
    photo.with_name("a.jpg.xmp").write_text(xmp(4, 4))
    assert (read_photo(photo).where, read_photo(photo).source) == (GeoPoint(4, 4), "sidecar")


def test_a_sidecar_that_says_nothing_leaves_it_to_the_next(photo: Path) -> None:
    photo.with_name("a.jpg.xmp").write_text(xmp(0, 0))
    photo.with_name("a.XMP").write_text(xmp(3, 3))
    told = read_photo(photo)
    assert told.where == GeoPoint(3, 3)
    assert "0,0" in told.remark


def test_workers_see_them_too(photo: Path) -> None:
    photo.with_name("a.xmp").write_text(xmp(3, 3))
    with Workers(1) as workers:
        read, looked = workers.read(photo).photo, workers.look(photo)
    for told in (read, looked):
        assert (told.where, told.source) == (GeoPoint(3, 3), "sidecar")


@pytest.mark.parametrize("name", ["a.jpg.xmp", "a.xmp", "a.jpg.json"])
def test_a_pipe_a_folder_and_what_is_too_long_are_named_and_left(photo: Path, name: str) -> None:
    beside = photo.with_name(name)
    os.mkfifo(beside)
    assert f"{name} beside it cannot be read" in read_photo(photo).remark
    beside.unlink()
    beside.mkdir()
    assert f"{name} beside it cannot be read (it is a folder)" in read_photo(photo).remark
    beside.rmdir()
    beside.write_bytes(b" " * ((1 << 20) + 1))
    assert f"{name} beside it cannot be read (it is longer" in read_photo(photo).remark


def test_a_name_too_long_for_anything_to_be_called_after_it(tmp_path: Path) -> None:
    assert list(read_sidecars(tmp_path / f"{'a' * 250}.jpg")) == []
    assert list(read_sidecars(tmp_path / "nowhere" / "a.jpg")) == []


def test_a_name_without_an_ending_has_its_own_sidecar(tmp_path: Path) -> None:
    path = tmp_path / ".photo"
    save_jpeg(PHOTO, path)
    (tmp_path / ".photo.xmp").write_text(xmp(3, 3))
    assert read_photo(path).where == GeoPoint(3, 3)
