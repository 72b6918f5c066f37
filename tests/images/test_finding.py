"""Finding photos on disks as people have them, and what was passed over on the way."""

from __future__ import annotations

import errno
import io
import os
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.errors import PhotoError
from salad.images.finding import NOT_WALKED, SUFFIXES, Found, PassedOver, find_photos, look_through
from salad.images.photo import read_photo


def files(root: Path, *names: str) -> list[Path]:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"x")
    return [root / name for name in names]


def test_folders_are_walked_in_order_and_only_photos_taken(tmp_path: Path) -> None:
    expected = files(tmp_path, "a @b/2.JPG", "a @b/x y.png", "b/c/写真.webp", "b/é.jpeg", "z.HEIC")
    files(tmp_path, "notes.txt", ".hidden.jpg", ".cache/1.jpg", "b/._é.jpeg", "b/jpg")
    (tmp_path / "folder.jpg").mkdir()
    assert find_photos([tmp_path]) == expected
    assert find_photos([str(tmp_path)]) == expected


def test_links_are_followed_but_not_in_circles(tmp_path: Path) -> None:
    [photo] = files(tmp_path, "real/1.jpg")
    (tmp_path / "real/loop").symlink_to(tmp_path / "real")
    (tmp_path / "walk").mkdir()
    (tmp_path / "walk/there").symlink_to(tmp_path / "real")
    (tmp_path / "walk/gone.jpg").symlink_to(tmp_path / "nowhere")
    assert find_photos([tmp_path / "real"]) == [photo]
    # a photo that cannot be opened is found all the same, so that it is named and not passed over in silence
    assert find_photos([tmp_path / "walk"]) == [tmp_path / "walk/gone.jpg", tmp_path / "walk/there/1.jpg"]


def test_each_photo_once_in_the_order_of_sources(tmp_path: Path) -> None:
    one, two = files(tmp_path, "1.jpg", "2.jpg")
    assert find_photos([two, tmp_path, one]) == [two, one]


def test_a_file_given_by_name_is_taken_whatever_its_suffix(tmp_path: Path) -> None:
    assert find_photos(files(tmp_path, "scan.dat")) == [tmp_path / "scan.dat"]


def test_a_list_on_standard_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, two, three = files(tmp_path, "a b.jpg ", "folder/2.jpg", "3.jpg")
    text = f"\ufeff{one}\r\n\n{two.parent}\n"
    assert find_photos(["-", three], stdin=io.StringIO(text)) == [one, two, three]
    monkeypatch.setattr(sys, "stdin", io.StringIO(str(three)))
    assert find_photos(["-"]) == [three]


def test_a_list_that_is_no_text() -> None:
    with pytest.raises(PhotoError, match="not text"):
        find_photos(["-"], stdin=io.TextIOWrapper(io.BytesIO(b"\xff\xfe\xfa"), encoding="utf-8"))


def test_missing_sources_and_empty_folders_are_said(tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match=r"no photo at .*gone\.jpg"):
        find_photos([tmp_path / "gone.jpg"])
    with pytest.raises(PhotoError, match="holds no photos"):
        find_photos([tmp_path])
    with pytest.raises(PhotoError, match="no photos are named"):
        find_photos([])
    with pytest.raises(PhotoError, match="no photos are named"):
        find_photos(["-"], stdin=io.StringIO("\n"))


def test_names_that_no_system_takes_and_links_to_themselves_are_said(tmp_path: Path) -> None:
    (tmp_path / "self.jpg").symlink_to("self.jpg")
    (tmp_path / "to.jpg").symlink_to("fro.jpg")
    (tmp_path / "fro.jpg").symlink_to("to.jpg")
    loops = find_photos([tmp_path])  # found, so that each is named and not passed over in silence
    assert [path.name for path in loops] == ["fro.jpg", "self.jpg", "to.jpg"]
    for path in (*loops, tmp_path / ("x" * 5000), tmp_path / "a\0b.jpg", tmp_path / "fro.jpg" / "a.jpg"):
        with pytest.raises(PhotoError, match="no photo at"):
            find_photos([path])
        with pytest.raises(PhotoError, match="no photo at"):
            read_photo(path)


@pytest.fixture
def lock(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """`lock(folder)` makes it one that may not be listed, also by root, whom no permission keeps out."""
    whole, locked = os.scandir, set[str]()

    def listed(path: Any) -> Any:
        if os.fspath(path) in locked:
            raise PermissionError(errno.EACCES, "Permission denied", os.fspath(path))
        return whole(path)

    monkeypatch.setattr("os.scandir", listed)
    return lambda folder: locked.add(str(folder))


def test_a_folder_that_cannot_be_read_is_named_and_the_rest_goes_on(
    tmp_path: Path, lock: Callable[[Path], None]
) -> None:
    one, two, _ = files(tmp_path, "1.jpg", "a/b/2.jpg", "lost+found/3.jpg")
    lock(tmp_path / "lost+found")
    told: list[str] = []
    assert find_photos([tmp_path], on_unreadable=told.append) == [one, two]
    assert told == [f"the folder {tmp_path / 'lost+found'} cannot be read (Permission denied): check who may read it"]
    with pytest.raises(PhotoError, match=r"lost\+found cannot be read \(Permission denied\)"):
        find_photos([tmp_path])  # who takes no sentences must not go on without the photos


def test_where_nothing_can_be_read_that_is_said(tmp_path: Path, lock: Callable[[Path], None]) -> None:
    files(tmp_path, "1.jpg")
    lock(tmp_path)
    with pytest.raises(PhotoError, match=r"cannot be read \(Permission denied\)"):
        find_photos([tmp_path], on_unreadable=print)


@pytest.mark.parametrize(
    "folder", ["@eaDir", "#recycle", "$RECYCLE.BIN", "__MACOSX", "Thumbnails", ".Trash-1000", ".git"]
)
def test_thumbnails_and_what_was_thrown_away_are_left_out(tmp_path: Path, folder: str) -> None:
    photo, inside = files(tmp_path, "a/1.jpg", f"a/{folder}/b/2.jpg")
    found = look_through([tmp_path])
    assert found.photos == [photo]
    assert [each.kind for each in found.passed_over] == ([] if folder.startswith(".") else [folder])
    assert find_photos([tmp_path / "a" / folder]) == [inside]  # unless it is named itself


def test_what_is_no_photo_is_counted_by_its_ending(tmp_path: Path) -> None:
    names = ("1.jpg", "1.jpg.xmp", "1.json", "2.CR2", "b/3.cr2", "4.mp4", "README", "x.averylongsuffix", ".hidden.mov")
    files(tmp_path, *names)
    found = look_through([tmp_path, tmp_path / "b"], allow_empty=True)
    assert found.counted() == "2 .cr2, 2 without an ending, 1 .mp4"
    assert {Path(each.path).name: each.why for each in found.passed_over}[
        "4.mp4"
    ] == "files that end in .mp4 are not read"
    with pytest.raises(PhotoError, match=r"holds no photos.*passed over: 1 \.cr2"):
        look_through([tmp_path / "b"])


def test_many_kinds_are_cut_short() -> None:
    found = Found(passed_over=[PassedOver(f"x.{n}", f".{n}", "") for n in range(20)])
    assert found.counted().endswith("12 of other kinds")


@pytest.mark.parametrize(
    ("patterns", "left"),
    [
        ((), ["a/1.jpg", "a/raw/2.png", "b/1.jpg", "b/3.png", "raw.jpg"]),
        (("*.png",), ["a/1.jpg", "b/1.jpg", "raw.jpg"]),
        (("raw",), ["a/1.jpg", "b/1.jpg", "b/3.png", "raw.jpg"]),
        (("raw/",), ["a/1.jpg", "b/1.jpg", "b/3.png", "raw.jpg"]),
        (("a/*",), ["b/1.jpg", "b/3.png", "raw.jpg"]),
        (("b/[12].jpg", "?aw.*"), ["a/1.jpg", "a/raw/2.png", "b/3.png"]),
        (("1.JPG",), ["a/1.jpg", "a/raw/2.png", "b/1.jpg", "b/3.png", "raw.jpg"]),
    ],
)
def test_patterns_leave_out_names_and_paths(tmp_path: Path, patterns: tuple[str, ...], left: list[str]) -> None:
    every = files(tmp_path, "a/1.jpg", "a/raw/2.png", "b/1.jpg", "b/3.png", "raw.jpg")
    found = look_through([tmp_path], exclude=patterns)
    assert [path.relative_to(tmp_path).as_posix() for path in found.photos] == left
    assert all(f"--exclude {pattern}" in str(found.passed_over) for pattern in patterns if len(left) < len(every))


def test_a_pattern_holds_for_files_that_are_named_too(tmp_path: Path) -> None:
    one, two = files(tmp_path, "1.jpg", "2.jpg")
    assert look_through([one, two], exclude=["2*"]).photos == [one]
    with pytest.raises(PhotoError, match=r"all that was named is left out \(1 by --exclude\)"):
        look_through([two], exclude=["2*"])


def test_a_disk_as_it_was_found(cases: Path, tmp_path: Path, lock: Callable[[Path], None]) -> None:
    """`right.txt`: lost+found is named and passed over, the rest is found; thumbnails and bins are left out."""
    disk = Path(shutil.copytree(cases / "08-folders" / "disk", tmp_path / "disk"))
    (disk / "lost+found").mkdir(exist_ok=True)
    lock(disk / "lost+found")
    found = look_through([disk])
    names = ["IMG_0001.JPG", "IMG_0002.JPG", "IMG_0006.HIF", "pano.insp", "IMG_0003.JPG"]
    assert [path.name for path in found.photos] == names
    assert list(found.unreadable) == [str(disk / "lost+found")]
    kinds = {each.kind for each in found.passed_over}
    assert {"@eaDir", "#recycle", "$RECYCLE.BIN", "__MACOSX", ".mp4", ".dng", ".jxl"} <= kinds


NAMES = st.sampled_from(
    ["a.jpg", "b.PNG", "c.mp4", "d", ".e.jpg", "f.xmp", "@eaDir", "g", "#recycle", "h.jpg", ".i", "thumbs"]
)


@given(paths=st.lists(st.lists(NAMES, min_size=1, max_size=4).map("/".join), max_size=12))
def test_every_file_is_a_photo_or_passed_over_or_hidden(paths: list[str]) -> None:
    """What was found, counted, hidden or lies in a folder that was left out is all there is, each once."""
    with TemporaryDirectory() as name:
        root = Path(name)
        for path in paths:
            with suppress(OSError):  # a file stands where a folder should
                files(root, path)
        found = look_through([root], allow_empty=True)
        walked = {str(path) for path in found.photos} | {each.path for each in found.passed_over}
        assert len(walked) == len(found.photos) + len(found.passed_over)
        for file in (path for path in root.rglob("*") if path.is_file()):
            parts = file.relative_to(root).parts
            hidden = any(part.startswith(".") for part in parts)
            beside = file.suffix == ".xmp"
            inside = any(part.lower() in NOT_WALKED for part in parts[:-1])
            assert (str(file) in walked) == (not (hidden or beside or inside)), file
        assert all(path.suffix.lower() in SUFFIXES for path in found.photos)
