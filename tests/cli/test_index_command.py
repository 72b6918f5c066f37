"""`salad index` over the life of a folder of photos: vanished files, interrupts, what other tools wrote."""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from salad.errors import StoreError
from salad.geo import GeoPoint
from salad.images.exif import save_jpeg
from salad.images.metadata import NOTHING_SAID
from salad.index import index_folder, transfer
from salad.index.index import Index
from salad.index.transfer import export
from salad.models.fake import FakeDescriber

MODEL = FakeDescriber(dim=256, name="salad-lite")


def held(folder: Path) -> list[str]:
    with Index.open(folder) as index:
        return sorted(photo.path.name for photo in index.photos())


@pytest.fixture
def home(photos: Any, tmp_path: Path) -> Path:
    """A folder of six photos that a test may change."""
    return Path(shutil.copytree(photos.references, tmp_path / "home"))


def drawn(path: Path, seed: int, *, where: GeoPoint | None = None) -> None:
    """A photo whose content no other seed has."""
    save_jpeg(np.random.default_rng(seed).integers(0, 256, (8, 8, 3), dtype=np.uint8), path, where=where)


def test_what_vanished_is_told_and_kept(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    city = tmp_path / "city"
    cli("index", home, "--to", city)
    gone = sorted(home.iterdir())[:2]
    for path in gone:
        path.unlink()
    ran = cli("index", home, "--to", city)
    assert ran.code == 0
    for path in gone:
        assert f"{path} is gone: --prune drops it from the index" in ran.err
    assert "it holds 6" in ran.err
    assert len(held(city)) == 6


def test_what_vanished_is_dropped_with_prune(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    city = tmp_path / "city"
    cli("index", home, "--to", city)
    gone, moved, *others = sorted(home.iterdir())
    gone.unlink()
    moved.rename(home / "moved.jpg")
    ran = cli("index", home, "--to", city, "--prune")
    assert f"{gone} is gone: it was dropped" in ran.err
    assert "0 photos added, 5 there already, 0 unreadable; it holds 5" in ran.err
    assert held(city) == sorted([*(path.name for path in others), "moved.jpg"])
    assert "is gone" not in cli("index", home, "--to", city, "--prune").err


def test_only_the_folders_given_are_pruned(cli: Any, asked: Any, photos: Any, home: Path, tmp_path: Path) -> None:
    city, other = tmp_path / "city", tmp_path / "home too"
    shutil.copytree(photos.queries, other)
    cli("index", home, other, "--to", city)
    for folder in (home, other):
        sorted(folder.iterdir())[0].unlink()
    single = sorted(home.iterdir())[0]
    assert "is gone" not in cli("index", single, "--to", city, "--prune").err
    ran = cli("index", "-", "--to", city, "--prune", stdin=f"{home}\n")
    assert ran.err.count("is gone") == 1
    assert len(held(city)) == 11


def test_a_long_list_of_the_vanished_is_cut(
    cli: Any, asked: Any, home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("salad.cli.terminal._FEW", 2)
    cli("index", home, "--to", tmp_path / "city")
    for path in sorted(home.iterdir())[:5]:
        path.unlink()
    ran = cli("index", home, "--to", tmp_path / "city", "--prune")
    assert ran.err.count("is gone: it was dropped") == 2
    assert "and 3 more are gone" in ran.err
    assert len(held(tmp_path / "city")) == 1


def test_an_empty_folder_prunes_nothing(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    cli("index", home, "--to", tmp_path / "city")
    for path in home.iterdir():
        path.unlink()
    ran = cli("index", home, "--to", tmp_path / "city", "--prune")  # a disk that is not there looks like this
    assert ran.code == 2
    assert "holds no photos" in ran.err
    assert len(held(tmp_path / "city")) == 6


def test_a_folder_whose_disk_is_away_keeps_its_photos(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    """The place where a disk is put stays, empty; beside it photos may come and go."""
    disk, city = home / "disk", tmp_path / "city"
    disk.mkdir()
    for path in sorted(home.glob("*.jpg"))[:3]:
        path.rename(disk / path.name)
    cli("index", home, "--to", city)
    for path in disk.iterdir():
        path.unlink()
    told = cli("index", home, "--to", city, "--prune")
    assert told.code == 2
    assert f"a disk may not be there: {disk} is empty, and 3 photos of it are gone" in told.err
    assert len(held(city)) == 6
    assert cli("index", home, "--to", city).code == 0  # only dropping needs to be sure
    ran = cli("index", home, "--to", city, "--prune-all")
    assert (ran.code, ran.err.count("it was dropped")) == (0, 3)
    assert len(held(city)) == 3


def test_all_photos_of_a_folder_are_not_dropped_at_once(
    cli: Any, asked: Any, photos: Any, home: Path, tmp_path: Path
) -> None:
    """What shows at the place of a disk may be other photos, which were put there while it was away."""
    city = tmp_path / "city"
    cli("index", home, "--to", city)
    for path in home.iterdir():
        path.unlink()
    shutil.copy(photos.query[0], home / "new.jpg")
    told = cli("index", home, "--to", city, "--prune")
    assert told.code == 2
    assert f"all 6 photos that the index holds of {home} are gone" in told.err
    assert len(held(city)) == 7  # what is new is in it all the same


def test_photos_that_all_moved_are_not_gone(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    cli("index", home, "--to", tmp_path / "city")
    (home / "2024").mkdir()
    for path in home.glob("*.jpg"):
        path.rename(home / "2024" / path.name)
    ran = cli("index", home, "--to", tmp_path / "city", "--prune")
    assert (ran.code, len(held(tmp_path / "city"))) == (0, 6)


def test_an_empty_folder_is_forgotten_where_all_is_to_be(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    cli("index", home, "--to", tmp_path / "city")
    for path in home.iterdir():
        path.unlink()
    assert cli("index", home, "--to", tmp_path / "city", "--prune-all").code == 0
    assert held(tmp_path / "city") == []


def test_what_of_a_table_fits_no_photo_is_told(cli: Any, asked: Any, photos: Any, tmp_path: Path) -> None:
    first, second, *_ = (path.name for path in photos.query)
    table = tmp_path / "places.csv"
    rows = ["file;latitude;longitude", "gone.jpg;1;2", f"{first.upper()};47,5;8,25", f"{second};0;0"]
    table.write_text("\n".join(rows), encoding="utf-16")
    ran = cli("index", photos.queries, "--to", tmp_path / "i", "--table", table)
    assert ran.code == 0
    assert f"{table}: of its rows 2 fit a photo and 1 none, the first of them line 2, 'gone.jpg'" in ran.err
    assert f"{table}: 1 row says 0,0, which counts as no position; the first is line 4" in ran.err
    with Index.open(tmp_path / "i") as index:
        assert {photo.path.name: photo.where for photo in index.photos() if photo.where} == {
            first: GeoPoint(47.5, 8.25)
        }


def test_what_was_passed_over_is_counted(
    cli: Any, asked: Any, home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("film.MP4", "b.mp4", "raw.cr2", "@eaDir/thumb.jpg", "shut/in.jpg", "drawn.png"):
        (home / name).parent.mkdir(exist_ok=True)
        (home / name).write_bytes(b"x")
    whole = os.scandir

    def locked(path: Any) -> Any:
        if os.fspath(path) == str(home / "shut"):
            raise PermissionError(13, "Permission denied", path)
        return whole(path)

    monkeypatch.setattr("os.scandir", locked)
    ran = cli("index", home, "--to", tmp_path / "city", "--exclude", "*.png", "--exclude", "[-]dash*")
    assert ran.code == 0
    assert "passed over: 2 .mp4, 2 by --exclude, 1 .cr2, 1 @eaDir" in ran.err
    assert f"the folder {home / 'shut'} cannot be read (Permission denied): check who may read it" in ran.err
    assert "5 photos added, 0 there already, 0 unreadable" in ran.err


def test_an_interrupt_says_how_far_it_got(
    cli: Any, asked: Any, home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    describe, calls = FakeDescriber.describe, []

    def tired(self: FakeDescriber, *arguments: Any, **settings: Any) -> Any:
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return describe(self, *arguments, **settings)

    monkeypatch.setattr(FakeDescriber, "describe", tired)
    command = ("index", home, "--to", tmp_path / "city", "--batch-size", 2)
    ran = cli(*command)
    assert ran.code == 130
    assert "4 of 6 photos were done; it holds 4" in ran.err
    assert "interrupted" in ran.err
    assert "2 photos added, 4 there already" in cli(*command).err


# --- the report ----------------------------------------------------------------------------


def test_the_report_says_which_photos_have_no_position(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    for number in range(5):
        drawn(home / f"{number}.jpg", number, where=GeoPoint(0, 0) if number == 1 else None)
    ran = cli("index", home, "--to", tmp_path / "city")
    assert f"5 photos have no position: 0.jpg ({NOTHING_SAID}), 1.jpg (its EXIF says 0,0, which counts as" in ran.err
    assert "and 2 more\n" in ran.err
    (tmp_path / "places.csv").write_text(f"path,lat,lon\n{home}/0.jpg,47.5,8.5\n")
    ran = cli("index", home, "--to", tmp_path / "city", "--table", tmp_path / "places.csv")
    assert "1 position changed; the first: 0.jpg, none -> 47.5,8.5" in ran.err
    assert "4 photos have no position" in ran.err


def test_what_is_written_beside_a_photo_later_is_seen(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    """Its content is known already, and yet it is looked beside it again."""
    drawn(home / "a.jpg", 1, where=GeoPoint(1, 2))
    cli("index", home, "--to", tmp_path / "city")
    (home / "a.jpg.xmp").write_text(
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description xmlns:exif="http://ns.adobe.com/exif/1.0/" exif:GPSLatitude="36,48.0S" '
        'exif:GPSLongitude="174,45.0E"/></rdf:RDF></x:xmpmeta>',
        encoding="utf-8",
    )
    assert (
        "1 position changed; the first: a.jpg, 1,2 -> -36.8,174.75" in cli("index", home, "--to", tmp_path / "city").err
    )
    with Index.open(tmp_path / "city") as index:
        assert [photo.source for photo in index.photos() if photo.path.name == "a.jpg"] == ["sidecar"]
    (home / "a.jpg.xmp").unlink()
    assert (
        "1 position changed; the first: a.jpg, -36.8,174.75 -> 1,2" in cli("index", home, "--to", tmp_path / "city").err
    )


def test_a_list_names_every_photo_and_what_else_was_met(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    drawn(home / "=cmd().jpg", 1)
    shutil.copy(home / "=cmd().jpg", home / "copy.jpg")
    for name in ("film.mp4", "broken.jpg", "thumbs/1.jpg"):
        (home / name).parent.mkdir(exist_ok=True)
        (home / name).write_bytes(b"x")
    assert cli("index", home, "--to", tmp_path / "city", "--list", tmp_path / "list.csv").code == 0
    with (tmp_path / "list.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["path"] for row in rows] == sorted(str(path) for path in home.iterdir())
    told = {Path(row["path"]).name: row for row in rows}
    assert [told["東京駅 2.jpg"][name] for name in ("heading", "time", "source", "state")] == [
        *("30.0", "2024-05-02T12:00:00", "exif", "added")
    ]
    assert abs(float(told["東京駅 2.jpg"]["lat"]) - 48.1018) < 1e-4
    for name, state, remark in (
        ("=cmd().jpg", "added", NOTHING_SAID),
        ("copy.jpg", "copy", "is a copy of"),
        ("broken.jpg", "unreadable", "broken.jpg"),
        ("film.mp4", "passed over", "files that end in .mp4 are not read"),
        ("thumbs", "passed over", "thumbnails"),
    ):
        assert (told[name]["state"], told[name]["lat"], remark in told[name]["remark"]) == (state, "", True)


def test_a_list_is_written_whole_or_not_at_all_and_takes_no_photos_place(
    cli: Any, asked: Any, home: Path, tmp_path: Path
) -> None:
    for name in (sorted(home.iterdir())[0], tmp_path / "no folder" / "list.csv", home):
        ran = cli("index", home, "--to", tmp_path / "city", "--list", name)
        assert (ran.code, "--list" in ran.err) == (2, True)
    assert not (tmp_path / "city").exists()  # said before any work


def test_null_island_as_devices_write_it(cli: Any, asked: Any, cases: Path, tmp_path: Path) -> None:
    """`right.txt`: exactly 0,0 in EXIF or a table is no position, and is named; one axis alone may well be zero."""
    case, city = cases / "01-null-island", tmp_path / "city"
    for table in ([], ["--table", case / "t.csv"]):
        ran = cli("index", case / "photos", "--to", city, *table)
        assert "2 photos have no position: zeroed.jpg (" in ran.err
        assert "it holds 6, 4 with a position" in ran.err
        with Index.open(city) as index:
            known = {photo.path.name: photo.as_dict() for photo in index.photos()}
        for name, lat, lon in (("zeroed.jpg", None, None), ("equator.jpg", 0, 32.5), ("greenwich.jpg", 51.48, 0)):
            assert [known[name][axis] for axis in ("lat", "lon")] == [pytest.approx(lat), pytest.approx(lon)]


def test_what_another_tool_has_at_null_island_is_told(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    cli("index", home, "--to", tmp_path / "city")
    with Index.open(tmp_path / "city") as index:
        export(index, tmp_path / "out")
    table = tmp_path / "out" / "photos.csv"
    head, first, *others = table.read_text(encoding="utf-8").splitlines(keepends=True)
    path, _, _, rest = first.split(",", 3)
    table.write_text("".join([head, f"{path},0,0,{rest}", *others]), encoding="utf-8")
    ran = cli("index", "--from", tmp_path / "out", "--to", tmp_path / "again")
    assert f"1 at 0,0, which counts as no position; the first is {Path(path).name}" in ran.err
    assert "it holds 6, 5 with a position" in ran.err


# --- --from --------------------------------------------------------------------------------


def test_an_export_comes_back_whole(cli: Any, asked: list[str], home: Path, photos: Any, tmp_path: Path) -> None:
    cli("index", home, "--to", tmp_path / "city")
    with Index.open(tmp_path / "city") as index:
        export(index, tmp_path / "out")
    asked.clear()
    ran = cli("index", "--from", tmp_path / "out", "--to", tmp_path / "again")
    assert (ran.code, asked) == (0, [])  # nothing is described, so no model is loaded
    assert "6 photos added" in ran.err
    with Index.open(tmp_path / "city") as one, Index.open(tmp_path / "again") as two:
        assert one.fingerprint == two.fingerprint
        assert list(one.photos()) == list(two.photos())
    again = cli("index", "--from", tmp_path / "out", "--to", tmp_path / "again")
    assert (again.code, "0 photos added" in again.err) == (0, True)
    found = cli("locate", photos.query[0], "--index", tmp_path / "again", "--format", "json")
    assert found.code == 0


def test_from_and_photos_are_not_mixed(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    ran = cli("index", home, "--from", tmp_path, "--to", tmp_path / "city")
    assert ran.code == 2
    assert "leave out PHOTOS" in ran.err
    assert not (tmp_path / "city").exists()


def test_what_cannot_be_taken_leaves_no_index(cli: Any, asked: Any, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    command = ("index", "--from", tmp_path / "out", "--to", tmp_path / "city", "--model", "other")
    assert cli(*command).code == 2
    np.save(tmp_path / "out" / "d.npy", np.eye(3, 8, dtype=np.float32))
    (tmp_path / "out" / "photos.csv").write_text("path,lat,lon\na.jpg,1,2\n", encoding="utf-8")
    ran = cli(*command)
    assert ran.code == 2
    assert "as many" in ran.err
    assert not (tmp_path / "city").exists()


def test_an_import_that_is_ended_midway_leaves_no_index(
    cli: Any, asked: Any, home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither where it is refused after its first commit, nor where it is killed there."""
    cli("index", home, "--to", tmp_path / "city")
    with Index.open(tmp_path / "city") as index:
        export(index, tmp_path / "out")
    command = ("index", "--from", tmp_path / "out", "--to", tmp_path / "again")
    monkeypatch.setattr(transfer, "_COMMIT", 1)  # one photo at a time
    whole, commits = Index.add, iter(range(6))

    def ended(self: Index, *given: Any, **named: Any) -> int:
        if next(commits) == 3:
            raise StoreError("the disk is gone")
        return whole(self, *given, **named)

    before = sorted(tmp_path.iterdir())
    with monkeypatch.context() as patch:
        patch.setattr(Index, "add", ended)
        ran = cli(*command)
    assert (ran.code, "the disk is gone" in ran.err) == (2, True)
    assert sorted(tmp_path.iterdir()) == before
    script = (
        "import itertools, os, sys\n"
        "from salad.index import transfer\n"
        "from salad.index.index import Index\n"
        "from salad.cli.main import main\n"
        "transfer._COMMIT, whole, commits = 1, Index.add, itertools.count()\n"
        "Index.add = lambda *given, **named: os._exit(9) if next(commits) == 3 else whole(*given, **named)\n"
        "main(sys.argv[1:])\n"
    )
    killed = subprocess.run([sys.executable, "-c", script, *map(str, command)], check=False)
    assert killed.returncode == 9
    assert not (tmp_path / "again").exists()
    assert cli(*command).code == 0
    assert held(tmp_path / "again") == held(tmp_path / "city")


def test_an_index_that_was_there_stays(cli: Any, asked: Any, home: Path, tmp_path: Path) -> None:
    cli("index", home, "--to", tmp_path / "city")
    (tmp_path / "out").mkdir()
    assert cli("index", "--from", tmp_path / "out", "--to", tmp_path / "city").code == 2
    assert len(held(tmp_path / "city")) == 6


# --- two at once ---------------------------------------------------------------------------

INDEXING = """
import sys
from salad.cli.main import main
from salad.index import index_folder, transfer
from salad.models import model_folder
from salad.models.fake import FakeDescriber
make = index_folder.make
def make_together(*arguments):
    print("ready", flush=True)
    sys.stdin.read()  # until all are
    return make(*arguments)
index_folder.make = make_together
model_folder.load = lambda *_, **__: FakeDescriber(dim=64, name="salad-lite")
main(sys.argv[1:])
"""


def test_who_comes_second_to_a_new_folder_goes_on_with_its_photos(photos: Any, tmp_path: Path) -> None:
    with ExitStack() as stack:
        command = [sys.executable, "-c", INDEXING, "index", "--to", str(tmp_path / "index")]
        pipes: Any = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        racing = [
            stack.enter_context(subprocess.Popen([*command, str(photo)], encoding="utf-8", **pipes))
            for photo in photos.reference[:4]
        ]
        assert [one.stdout.readline() for one in racing if one.stdout] == ["ready\n"] * 4
        for one in racing:
            assert one.stdin is not None
            one.stdin.close()
        said = [one.stderr.read() for one in racing if one.stderr]
        assert [one.wait(100) for one in racing] == [0] * 4, said
    with Index.open(tmp_path / "index") as index:
        assert sorted(photo.path for photo in index.photos()) == sorted(photos.reference[:4])


def test_a_folder_that_another_program_made_meanwhile_is_taken(
    cli: Any, asked: Any, photos: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = index_folder.make

    def make_second(folder: Path, header: Any) -> Path:
        make(folder, header)
        return make(folder, header)

    monkeypatch.setattr(index_folder, "make", make_second)
    ran = cli("index", photos.reference[0], "--to", tmp_path / "index")
    assert (ran.code, "it holds 1" in ran.err) == (0, True)


def test_an_import_into_a_folder_made_meanwhile_goes_into_that(
    cli: Any, asked: Any, city: Path, photos: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli("export", city, "--to", tmp_path / "out").code == 0
    make = transfer.take_as_new

    def make_second(to: Path, *arguments: Any, **settings: Any) -> int:
        assert cli("index", photos.query[0], "--to", to).code == 0
        return make(to, *arguments, **settings)

    monkeypatch.setattr(transfer, "take_as_new", make_second)
    ran = cli("index", "--from", tmp_path / "out", "--to", tmp_path / "both")
    assert (ran.code, "6 photos added" in ran.err, "it holds 7" in ran.err) == (0, True, True)
