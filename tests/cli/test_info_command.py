"""`salad info`: of an index what it holds, of a photo what is known of it and who says so."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from salad.geo import GeoPoint
from salad.images.at_names import at_name
from salad.images.exif import save_jpeg
from salad.images.metadata import NOTHING_SAID
from tests.earlier_indexes import change_row

GREY = np.full((8, 8, 3), 128, np.uint8)
XMP = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:exif="http://ns.adobe.com/exif/1.0/" exif:GPSLatitude="36,48.0S" exif:GPSLongitude="174,45.0E"/>
</rdf:RDF></x:xmpmeta>"""


def test_a_photo_tells_what_each_source_says_and_whose_word_counts(cli: Any, tmp_path: Path) -> None:
    photo = tmp_path / "a.jpg"
    save_jpeg(GREY, photo, where=GeoPoint(1, 2), heading=90.0, time=datetime(2024, 5, 31, 14))
    (tmp_path / "a.jpg.xmp").write_text(XMP, encoding="utf-8")
    told = cli("info", photo, "--format", "json").json()
    assert (told["path"], told["source"], told["heading"]) == (str(photo), "sidecar", 90.0)
    assert (told["lat"], told["lon"]) == (pytest.approx(-36.8), pytest.approx(174.75))
    assert told["time"] == "2024-05-31T14:00:00"
    said = {one["source"]: one for one in told["said"]}
    assert list(said) == ["sidecar", "exif"]  # who wins first
    assert (said["exif"]["lat"], said["exif"]["lon"]) == (pytest.approx(1), pytest.approx(2))
    ran = cli("info", photo)
    lines = ran.out.splitlines()
    assert [line.split("  ")[0] for line in lines[1:]] == ["what counts, by sidecar", "sidecar", "exif"]
    assert ran.code == 0
    assert all("-36.800000, 174.750000" in line for line in lines[1:3])


def test_a_photo_that_says_nothing_says_so(cli: Any, tmp_path: Path) -> None:
    save_jpeg(GREY, tmp_path / "a.jpg")
    told = cli("info", tmp_path / "a.jpg", "--format", "json").json()
    assert (told["lat"], told["source"], told["remark"], told["said"]) == (None, None, NOTHING_SAID, [])
    assert NOTHING_SAID in cli("info", tmp_path / "a.jpg").out


def test_null_island_is_told_and_the_next_source_counts(cli: Any, tmp_path: Path) -> None:
    photo = tmp_path / at_name(GeoPoint(1, 2))
    save_jpeg(GREY, photo, where=GeoPoint(0, 0))
    assert cli("info", photo, "--format", "json").json()["source"] == "name"
    plain = photo.rename(tmp_path / "[red]a.jpg")
    ran = cli("info", plain)
    assert "its EXIF says 0,0, which counts as no position" in ran.out


@pytest.mark.parametrize("content", [b"", b"no photo", b"\xff\xd8\xff\xe1"])
def test_what_cannot_be_opened_says_nothing_of_itself(cli: Any, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    ran = cli("info", tmp_path / "a.jpg", "--format", "json")
    assert (ran.code, ran.json()["lat"]) == (0, None)


def test_what_is_neither_is_refused(cli: Any, tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "gone.jpg"):
        ran = cli("info", path)
        assert (ran.code, ran.out, len(ran.err.splitlines())) == (2, "", 1)


def test_an_index_tells_what_it_holds_at_null_island(cli: Any, city: Path) -> None:
    assert "0,0" not in cli("info", city).err
    change_row(city, 2, checksum=True, lat=0.0, lon=0.0)
    ran = cli("info", city, "--format", "json")
    assert ran.json()["with_position"] == 5
    assert "1 at 0,0, which counts as no position" in ran.err
