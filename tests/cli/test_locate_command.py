"""`salad locate` with its filters, its limits and the files it writes beside its answer."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from salad.geo import GeoPoint, metres_between, shifted
from salad.images.exif import save_jpeg
from salad.images.photo import read_photo

HOME = GeoPoint(48.1, 11.5)  # of the city: a street every 200 m, its heading 30 degrees further each time
GPX = "{http://www.topografix.com/GPX/1/1}"


def refused(ran: Any, said: str) -> None:
    """One sentence that holds `said`, nothing on stdout, exit 2."""
    assert (ran.code, ran.out, ran.err.count("\n")) == (2, "", 1)
    assert said in ran.err


@pytest.mark.parametrize(
    ("options", "holds"),
    [
        (["--near", f"{HOME.lat},{HOME.lon}"], {0, 1, 2}),
        (["--near", f"{HOME.lat},{HOME.lon}", "--within", "250"], {0, 1}),
        (["--box", "48.0,11,48.1027,12"], {0, 1}),
        (["--since", "2024-05-05"], {4, 5}),
        (["--until", "2024-05-02"], {0, 1}),
        (["--until", "2024-05-02T11:59"], {0}),
        (["--heading", "0", "--heading-within", "31"], {0, 1}),
        (["--since", "2024-05-02", "--heading", "0"], {1}),
    ],
)
def test_only_photos_that_keep_to_the_options_are_found(
    cli: Any, city: Path, photos: Any, options: list[str], holds: set[int]
) -> None:
    ran = cli("locate", photos.query[0], "--index", city, "-k", 6, "--format", "json", *options)
    names = [path.name for path in photos.reference]
    assert {names.index(Path(match["path"]).name) for match in ran.json()[0]["matches"]} == holds


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--since", "2024-05-02T11:00+02:00"], True),
        (["--until", "2024-05-02T11:00Z", "--since", "2024-05-01"], True),
        (["--since", "2024-05-02T11:00"], False),
        (["--since", "2024-05-02", "--until", "2024-05-03"], False),
    ],
)
def test_a_clock_and_a_moment_are_compared_and_that_is_said(
    cli: Any, city: Path, photos: Any, options: list[str], told: bool
) -> None:
    """The photos of the town have no zone."""
    ran = cli("locate", photos.query[0], "--index", city, *options)
    assert ("6 photos of" in ran.err and "by the clock on the wall" in ran.err) == told


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--near", "48.1"], "--near 48.1 cannot be read"),
        (["--near", "x,y"], "write LAT,LON"),
        (["--near", "98,11"], "latitude 98"),
        (["--box", "1,2,3"], "SOUTH,WEST,NORTH,EAST"),
        (["--box", "9,2,3,4"], "box"),
        (["--since", "spring"], "--since spring is no date"),
        (["--min-confidence", "1.5"], "--min-confidence 1.5"),
        (["--min-confidence", "nan"], "--min-confidence nan"),
        (["--radius", "0"], "--radius 0.0"),
        (["--gpx", "track.jpg"], "end it in .gpx"),
        (["--gpx", "no-such-folder/track.gpx"], "no-such-folder"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    cli: Any, city: Path, photos: Any, asked: list[str], options: list[str], said: str
) -> None:
    refused(cli("locate", photos.query[0], "--index", city, *options), said)
    assert asked == []  # before any work


def test_a_place_may_lie_far_south(cli: Any, city: Path, photos: Any) -> None:
    ran = cli("locate", photos.query[0], "--index", city, "--near", "-33.5,-70.25", "--format", "json")
    assert (ran.code, ran.json()[0]["matches"]) == (1, [])


def test_the_limit_is_the_callers(cli: Any, city: Path, photos: Any) -> None:
    command = ("locate", photos.query[0], "--index", city, "--format", "json", "--min-confidence")
    (known,), (unknown,) = cli(*command, 0).json(), cli(*command, 1).json()
    assert known["place"]["confidence"] < 1
    assert unknown["place"] is None
    assert unknown["others"][0] == known["place"]


def test_the_radius_is_the_callers(cli: Any, city: Path, photos: Any) -> None:
    ran = cli("locate", photos.query[0], "--index", city, "-k", 6, "--format", "json", "--radius", 5000)
    assert ran.json()[0]["place"]["support"] == 6


@pytest.mark.parametrize("form", ["kml", "geojson", "csv", "json"])
def test_every_format_holds_every_photo(cli: Any, city: Path, photos: Any, form: str) -> None:
    ran = cli("locate", photos.queries, "--index", city, "--format", form)
    assert ran.code == 0
    assert all(ran.out.count(str(path)) >= 1 for path in photos.query)


# --- copies --------------------------------------------------------------------------------


def test_copies_know_their_place_and_originals_stay(cli: Any, city: Path, photos: Any, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in photos.query}
    ran = cli("locate", photos.queries, "--index", city, "--write-exif", tmp_path / "new" / "placed")
    assert ran.code == 0
    assert "6 copies written" in ran.err
    assert {path: path.read_bytes() for path in photos.query} == before
    for number, path in enumerate(photos.query):
        copy = tmp_path / "new" / "placed" / path.name
        assert metres_between(read_photo(copy).where, shifted(HOME, 200.0 * number, 0)) < 1
        with Image.open(copy) as one, Image.open(path) as other:
            assert np.array_equal(np.asarray(one), np.asarray(other))
    again = cli("locate", photos.query[0], "--index", city, "--write-exif", tmp_path / "new" / "placed")
    assert "exists already" in again.err
    assert "0 copies written" in again.err
    assert again.code == 2  # what was asked for was not done
    assert len(again.out.splitlines()) == 2  # and yet the place found is told
    nothing = cli("locate", photos.query[0], "--index", city, "--write-exif", tmp_path / "b", "--min-confidence", 1)
    assert nothing.code == 1


def test_copies_keep_their_folders(cli: Any, city: Path, photos: Any, tmp_path: Path) -> None:
    for number, inner in enumerate(("drive/a.jpg", "drive/in/a.jpg", "drive/in/on/a.jpg", "b.jpg")):
        (tmp_path / inner).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(photos.query[number], tmp_path / inner)
    ran = cli("locate", tmp_path / "drive", tmp_path / "b.jpg", "--index", city, "--write-exif", tmp_path / "to")
    assert "4 copies written" in ran.err
    copies = sorted(path.relative_to(tmp_path / "to").as_posix() for path in (tmp_path / "to").rglob("*.jpg"))
    assert copies == ["a.jpg", "b.jpg", "in/a.jpg", "in/on/a.jpg"]


def test_copies_are_never_written_among_originals(cli: Any, city: Path, photos: Any, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(photos.queries, target_is_directory=True)
    for folder in (photos.queries, link, photos.query[0]):
        refused(cli("locate", photos.query[0], "--index", city, "--write-exif", folder), "--write-exif")
    beside = tmp_path / "a.jpg"  # a link to an original elsewhere: its own folder counts, and the original's
    beside.symlink_to(photos.query[0])
    for folder in (tmp_path, photos.queries):
        refused(cli("locate", beside, "--index", city, "--write-exif", folder), "--write-exif")
    assert sorted(photos.queries.iterdir()) == sorted(photos.query)


def test_what_is_unknown_or_no_jpeg_is_not_copied(cli: Any, city: Path, photos: Any, tmp_path: Path) -> None:
    png = tmp_path / "a.png"
    with Image.open(photos.query[0]) as image:
        image.save(png)
    ran = cli("locate", png, photos.query[1], "--index", city, "--write-exif", tmp_path / "to")
    assert f"{png} gets no copy with a position: it is no JPEG" in ran.err
    assert [path.name for path in (tmp_path / "to").iterdir()] == [photos.query[1].name]
    cli("locate", photos.query[1], "--index", city, "--write-exif", tmp_path / "no", "--min-confidence", 1)
    assert list((tmp_path / "no").iterdir()) == []


# --- tracks --------------------------------------------------------------------------------


def test_a_track_follows_the_time_of_the_photos(cli: Any, city: Path, photos: Any, tmp_path: Path) -> None:
    folder, track = tmp_path / "walk", tmp_path / "walk.gpx"
    folder.mkdir()
    for number, path in enumerate(photos.reference):
        shutil.copy(path, folder / f"{9 - number}.jpg")
    track.write_text("an older one")
    ran = cli("locate", folder, "--index", city, "--gpx", track)
    assert (ran.code, ran.err.count("\n")) == (0, 1)
    assert "6 photos do not know the time zone of their clock, so the track does not tell their time" in ran.err
    points = list(ElementTree.parse(track).iter(f"{GPX}trkpt"))
    assert [point.findtext(f"{GPX}name") for point in points] == [f"{9 - n}.jpg" for n in range(6)]
    assert not any(point.findtext(f"{GPX}time") for point in points)  # they tell no zone
    for number, point in enumerate(points):
        where = GeoPoint(float(point.attrib["lat"]), float(point.attrib["lon"]))
        assert metres_between(where, shifted(HOME, 200.0 * number, 0)) < 1
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == ["walk.gpx"]


def test_a_track_without_times_says_so(cli: Any, city: Path, photos: Any, tmp_path: Path) -> None:
    track = tmp_path / "walk.GPX"
    ran = cli("locate", photos.query[3], photos.query[1], "--index", city, "--gpx", track)
    assert "2 photos do not know their time, so the track is in the order given" in ran.err
    names = [point.findtext(f"{GPX}name") for point in ElementTree.parse(track).iter(f"{GPX}trkpt")]
    assert names == [photos.query[3].name, photos.query[1].name]


def test_a_track_that_cannot_be_written_leaves_the_old_one(
    cli: Any, city: Path, photos: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    track = tmp_path / "walk.gpx"
    track.write_text("an older one")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    ran = cli("locate", photos.query[0], "--index", city, "--gpx", track)
    assert ran.code == 2
    assert "No space left" in ran.err
    assert [path.read_text() for path in tmp_path.glob("*.gpx")] == ["an older one"]
    assert not list(tmp_path.glob(".*.part"))


def test_an_unreadable_copy_folder_is_a_sentence(cli: Any, city: Path, photos: Any, tmp_path: Path) -> None:
    save_jpeg(np.zeros((8, 8, 3), np.uint8), tmp_path / "file.jpg")
    ran = cli("locate", photos.query[0], "--index", city, "--write-exif", tmp_path / "file.jpg" / "to")
    assert ran.code == 2
    assert "Traceback" not in ran.err
