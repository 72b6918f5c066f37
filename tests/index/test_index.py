"""The index on disk: what goes in comes out, whatever happens in between."""

import errno
import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.errors import PhotoError, StoreError, WrongModelError
from salad.geo import GeoPoint
from salad.images.photo import Photo
from salad.index import verify
from salad.index.index import Index
from salad.models.fake import FakeDescriber

DIM = 8


def descriptors(count: int, seed: int = 0) -> np.ndarray:
    drawn = np.random.default_rng(seed).standard_normal((count, DIM))
    return (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).astype(np.float32)


def photo(name: str, lat: float | None = None) -> Photo:
    return Photo(Path("/photos", name), GeoPoint(lat, 7.0) if lat is not None else None)


def create(folder: Path) -> Index:
    return Index.create(folder, dim=DIM, fingerprint="f1", model="fake")


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    with create(tmp_path / "city.index") as made:
        yield made


def add(index: Index, names: str, *, seed: int = 0, prefix: str = "") -> int:
    """Add a photo for each letter; its content is the letter."""
    photos = [photo(f"{prefix}{name}.jpg") for name in names]
    return index.add(photos, descriptors(len(names), seed), identities=list(names))


def names(index: Index) -> list[str]:
    return [held.path.stem for held in index.photos()]


def test_an_empty_index_finds_nothing(index: Index) -> None:
    assert index.search(descriptors(1)) == [[]]
    assert index.search(np.zeros((0, DIM))) == []


PHOTOS = st.builds(
    Photo,
    path=st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), min_size=1, max_size=20)
    .filter(lambda name: name not in (".", ".."))
    .map(lambda name: Path("/photos", name)),
    where=st.none() | st.builds(GeoPoint, st.floats(-90, 90), st.floats(-180, 180)),
    heading=st.none() | st.floats(0, 360),
    time=st.none() | st.datetimes(timezones=st.sampled_from([None, UTC, timezone(timedelta(hours=-3, minutes=-30))])),
)


@settings(max_examples=20, deadline=None)
@given(photos=st.lists(PHOTOS, max_size=6, unique_by=lambda held: held.path))
def test_what_goes_in_comes_out(photos: list[Photo]) -> None:
    rows = descriptors(len(photos))
    with TemporaryDirectory() as folder:
        with create(Path(folder, "i")) as index:
            identities = [f"{n}" for n in range(len(photos))]
            assert index.add(photos, rows, identities=identities) == len(photos)
        with Index.open(Path(folder, "i")) as index:
            assert list(index.photos()) == photos
            assert len(index) == len(photos)
            assert index.verify() == []
            for number, found in enumerate(index.search(rows, k=1)):
                assert found[0].photo == photos[number]
                assert found[0].score == pytest.approx(1, abs=2e-3)


CONTENTS = "abcdefgh"
PATHS = ["x/1", "x/2", "xy/1", "x/z/1", "y"]
CHANGES = st.one_of(
    st.tuples(st.just("add"), st.lists(st.tuples(st.sampled_from(PATHS), st.sampled_from(CONTENTS)), max_size=4)),
    st.tuples(st.just("remove"), st.sampled_from([*PATHS, "x", "xy", "nothing"])),
    st.tuples(st.just("open again"), st.none()),
)


@settings(max_examples=30, deadline=None)
@given(changes=st.lists(CHANGES, max_size=12))
def test_any_changes_agree_with_a_dictionary(changes: list[tuple[str, object]]) -> None:
    expected: dict[str, str] = {}  # content -> path
    vectors = dict(zip(CONTENTS, descriptors(len(CONTENTS)), strict=True))
    with TemporaryDirectory() as folder:
        index = create(Path(folder, "i"))
        for kind, what in changes:
            if kind == "add":
                new = {content for _, content in what} - set(expected)
                rows = np.stack([vectors[c] for _, c in what]) if what else np.zeros((0, DIM))
                assert index.add([photo(p) for p, _ in what], rows, identities=[c for _, c in what]) == len(new)
                expected.update({content: path for path, content in what})
                current, here = {c for _, c in what}, {p for p, _ in what}
                expected = {c: p for c, p in expected.items() if c in current or p not in here}
            elif kind == "remove":
                gone = {c for c, p in expected.items() if p == what or p.startswith(f"{what}/")}
                assert index.remove([Path("/photos", str(what))]) == len(gone)
                expected = {c: p for c, p in expected.items() if c not in gone}
            else:
                index.close()
                index = Index.open(Path(folder, "i"))
            held = sorted(str(held.path.relative_to("/photos")) for held in index.photos())
            assert held == sorted(expected.values())
            assert len(index) == len(expected)
            assert index.known(list(CONTENTS)) == set(expected)
        assert index.verify() == []
        for content, path in expected.items():
            (best,) = index.search(vectors[content], k=1)[0]
            assert best.photo.path == Path("/photos", path)
        index.close()


# --- adding, removing, replacing -------------------------------------------------------------


def test_unknown_facts_take_nothing_away(index: Index) -> None:
    known = Photo(Path("/photos/a.jpg"), GeoPoint(1, 2), 90.0, datetime(2024, 5, 1, 12))
    index.add([known], descriptors(1), identities=["a"])
    index.add([Photo(Path("/photos/b.jpg"))], descriptors(1, 9), identities=["a"])
    assert list(index.photos()) == [replace(known, path=Path("/photos/b.jpg"))]
    index.update([Photo(Path("/photos/b.jpg"), GeoPoint(3, 4)), photo("other")], ["a", "unheard of"])
    assert list(index.photos()) == [replace(known, path=Path("/photos/b.jpg"), where=GeoPoint(3, 4))]
    assert index.search(descriptors(1))[0][0].score == pytest.approx(1, abs=2e-3)  # the first descriptor stays


def test_swapped_files_are_both_kept(index: Index) -> None:
    add(index, "ab")
    assert index.add([photo("b.jpg"), photo("a.jpg")], descriptors(2), identities=["a", "b"]) == 0
    assert names(index) == ["b", "a"]


def test_removed_photos_never_come_out_and_may_come_back(index: Index) -> None:
    add(index, "abc")
    assert index.remove(["/photos/b.jpg"]) == 1
    assert index.remove(["/photos/b.jpg"]) == 0
    assert [match.row for match in index.search(descriptors(3)[1], k=9)[0]] in ([0, 2], [2, 0])
    assert add(index, "b", seed=4) == 1
    assert {match.row for match in index.search(descriptors(1), k=9)[0]} == {0, 2, 3}


def test_removing_a_folder_spares_its_namesakes(index: Index) -> None:
    for number, prefix in enumerate(["old/", "old/deep/", "older/", "old"]):
        add(index, "wxyz"[number], prefix=prefix)
    assert index.remove(["/photos/old/"]) == 2
    assert names(index) == ["y", "oldz"]
    assert index.remove(["/"]) == 2


def test_links_are_resolved_and_names_need_not_be_text(index: Index, tmp_path: Path) -> None:
    real = tmp_path / os.fsdecode(b"caf\xe9 \xff.jpg")
    real.write_bytes(b"1")
    link, loop = tmp_path / "link.jpg", tmp_path / "loop.jpg"
    link.symlink_to(real)
    loop.symlink_to(loop)
    assert index.add([Photo(link)], descriptors(1)) == 1
    assert [held.path for held in index.photos()] == [real]
    assert index.missing() == []
    assert index.remove([loop]) == 0
    assert index.remove([real]) == 1


def test_relative_paths_are_stored_absolute(index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    index.add([Photo(Path("a.jpg"))], descriptors(1), identities=["a"])
    assert [held.path for held in index.photos()] == [Path(os.path.realpath("a.jpg"))]
    assert [path.name for path in index.missing()] == ["a.jpg"]
    assert index.remove(["."]) == 1


def test_many_photos_are_listed_in_parts(index: Index) -> None:
    count = 2100
    index.add([photo(f"{n}") for n in range(count)], descriptors(count), identities=[str(n) for n in range(count)])
    assert names(index) == [str(n) for n in range(count)]


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        (np.ones((2, DIM + 1)), r"2 photos need descriptors of shape \[2, 8\], but these have \[2, 9\]"),
        (np.ones(DIM), "shape"),
        (np.ones((2, DIM)), "length 1"),
        (np.full((2, DIM), np.nan), "finite"),
    ],
)
def test_descriptors_that_do_not_fit_add_nothing(index: Index, rows: np.ndarray, sentence: str) -> None:
    with pytest.raises(StoreError, match=sentence):
        index.add([photo("a"), photo("b")], rows, identities=["a", "b"])
    assert len(index) == 0


def test_a_photo_that_is_not_there_has_no_identity(index: Index, tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match=re.escape("none.jpg")):
        index.add([Photo(tmp_path / "none.jpg")], descriptors(1))


# --- making and opening ---------------------------------------------------------------------


def test_an_index_is_made_only_in_an_empty_place(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    create(tmp_path / "empty").close()
    create(tmp_path / "new" / "deep.index").close()
    (tmp_path / "file").write_text("x")
    for taken in ("empty", "file", "new"):
        with pytest.raises(StoreError, match="already exists and is not empty"):
            create(tmp_path / taken)
    with pytest.raises(StoreError, match=r"no index can be made at .*file"):
        create(tmp_path / "file" / "below")
    with pytest.raises(StoreError, match="dimension 0"):
        Index.create(tmp_path / "zero", dim=0, fingerprint="f", model="m")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "file", "new"]


def test_nothing_is_left_of_an_index_that_could_not_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Path, target: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "rename", full)
    with pytest.raises(StoreError, match="No space left"):
        create(tmp_path / "city.index")
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_index_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(StoreError, match="is not an index"):
            Index.open(path)


def _spoil(folder: Path, **changes: object) -> None:
    header = json.loads((folder / "index.json").read_text())
    (folder / "index.json").write_text(json.dumps(header | changes))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"format_version": 3}, "newer salad .*index format 3, this one reads up to 2.*upgrade"),
        ({"format_version": "1"}, "damaged"),
        ({"dim": 0}, "damaged"),
        ({"dim": True}, "damaged"),
        ({"created": "yesterday"}, "damaged"),
        ({"kind": "something else"}, "damaged"),
    ],
)
def test_a_header_that_cannot_be_ours_is_refused(index: Index, changes: dict[str, object], sentence: str) -> None:
    _spoil(index.folder, **changes)
    with pytest.raises(StoreError, match=sentence):
        Index.open(index.folder)


@pytest.mark.parametrize("text", ["", "[]", '{"kind": "salad index"}', "\x00"])
def test_a_damaged_header_is_refused(index: Index, text: str) -> None:
    (index.folder / "index.json").write_text(text)
    with pytest.raises(StoreError, match=r"index\.json is damaged"):
        Index.open(index.folder)


def test_a_header_that_cannot_be_read_is_refused(index: Index) -> None:
    (index.folder / "index.json").unlink()
    (index.folder / "index.json").mkdir()
    with pytest.raises(StoreError, match=r"index\.json cannot be read"):
        Index.open(index.folder)


def test_a_damaged_table_is_refused(index: Index) -> None:
    add(index, "a")
    index.close()
    (index.folder / "photos.sqlite").write_bytes(b"not a database, but long enough to be looked at" * 100)
    with pytest.raises(StoreError, match=r"photos\.sqlite is damaged"):
        Index.open(index.folder)
    (index.folder / "photos.sqlite").unlink()
    with pytest.raises(StoreError, match=r"photos\.sqlite cannot be opened"):
        Index.open(index.folder)


def test_a_table_without_its_commit_is_refused(index: Index) -> None:
    with sqlite3.connect(index.folder / "photos.sqlite") as db:
        db.execute("DELETE FROM committed")
    db.close()
    with pytest.raises(StoreError, match="no commit in it"):
        Index.open(index.folder)


def test_a_missing_matrix_is_refused(index: Index) -> None:
    add(index, "abc")
    (index.folder / "descriptors.f16").unlink()
    with pytest.raises(StoreError, match=r"descriptors\.f16 is missing"):
        Index.open(index.folder)


# --- models ---------------------------------------------------------------------------------


def test_another_model_is_refused_with_the_way_out(tmp_path: Path) -> None:
    mine, other = FakeDescriber(DIM, name="mine"), FakeDescriber(DIM, name="other", seed=1)
    with Index.create(tmp_path / "i", dim=DIM, fingerprint=mine.fingerprint, model=mine.name) as index:
        index.check_model(mine)
        with pytest.raises(WrongModelError, match=r"made with mine .* in hand is other .*--model mine.*--to"):
            index.check_model(other)


# --- crashes --------------------------------------------------------------------------------


def test_leftovers_are_ignored_and_written_over(index: Index) -> None:
    add(index, "ab")
    matrix = index.folder / "descriptors.f16"
    with matrix.open("ab") as file:
        file.write(b"\xff" * 1000)
    with Index.open(index.folder) as again:
        assert len(again.search(descriptors(1), k=9)[0]) == 2
        add(again, "c", seed=3)
        assert again.search(descriptors(1, 3), k=1)[0][0].row == 2
        assert again.verify() == []


_DIES = """
import os, sys
from pathlib import Path
import numpy as np
from salad.index.catalog import Catalog
from salad.index.index import Index
from salad.images.photo import Photo

if sys.argv[2] == "before the commit":
    Catalog.commit_rows = lambda self, rows: os._exit(9)
elif sys.argv[2] == "before the table":
    Catalog.insert = lambda self, photos, identities, sums, row: os._exit(9)
index = Index.open(sys.argv[1])
names = [f"{n}" for n in range(5000)]
index.add([Photo(Path("/photos", n)) for n in names], np.tile(np.eye(8)[0], (5000, 1)), identities=names)
os._exit(9)
"""


@pytest.mark.parametrize(
    ("when", "held"), [("before the table", 2), ("before the commit", 2), ("after the commit", 5002)]
)
def test_a_killed_process_leaves_what_was_committed(index: Index, when: str, held: int) -> None:
    add(index, "ab")
    process = subprocess.run([sys.executable, "-c", _DIES, str(index.folder), when], check=False)
    assert process.returncode == 9
    assert (index.folder / "descriptors.f16").stat().st_size == 5002 * DIM * 2  # the rows were written
    with Index.open(index.folder) as again:
        assert len(again) == held == len(list(again.photos()))
        assert again.verify() == []
        assert {match.photo.path.stem for match in again.search(descriptors(2), k=1)[0]} <= {"a", "b"}
        assert add(again, "c", seed=3) == 1
        assert again.search(descriptors(1, 3), k=1)[0][0].photo.path.stem == "c"


def test_a_full_disk_adds_nothing(index: Index, monkeypatch: pytest.MonkeyPatch) -> None:
    add(index, "ab")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(StoreError, match="No space left on device"):
            add(index, "cd")
    assert names(index) == ["a", "b"]
    assert (index.folder / "descriptors.f16").stat().st_size == 2 * DIM * 2
    assert add(index, "cd") == 2


def test_a_full_table_is_a_sentence(index: Index) -> None:
    pages = index._catalog._db.execute("PRAGMA page_count").fetchone()[0]
    index._catalog._db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(StoreError, match="make room on the disk"):
        index.add(
            [photo("n" * 200 + str(n)) for n in range(500)],
            descriptors(500),
            identities=list(map(str, range(500))),
        )
    assert len(index) == 0


# --- others at the same index ---------------------------------------------------------------


def test_one_writer_at_a_time_and_readers_beside_it(index: Index) -> None:
    add(index, "ab")
    other = Index.open(index.folder, wait=0)
    with index._catalog.writing():
        assert names(other) == ["a", "b"]
        assert len(other.search(descriptors(1))[0]) == 2
        for change in (lambda: add(other, "c"), lambda: other.remove(["/photos/a.jpg"])):
            with pytest.raises(StoreError, match="being written by another program: wait"):
                change()
    assert add(other, "c", seed=2) == 1
    assert names(index) == ["a", "b", "c"]
    assert len(index) == 3  # an open index sees what others commit
    other.close()


def test_threads_share_an_index(index: Index) -> None:
    add(index, "abcd")
    wrong: list[object] = []

    def search() -> None:
        for _ in range(20):
            found = index.search(descriptors(4), k=1)
            wrong.extend(f for n, f in enumerate(found) if f[0].row != n)

    threads = [threading.Thread(target=search) for _ in range(4)]
    for thread in threads:
        thread.start()
    for number in range(10):
        add(index, f"{number}", seed=50 + number)
    for thread in threads:
        thread.join()
    assert not wrong
    assert len(index) == 14


@pytest.fixture
def as_nobody() -> Iterator[None]:
    """Root may write anywhere, so become somebody who may not."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    with TemporaryDirectory() as outside:  # pytest's own folders are closed to others
        folder = Path(outside, "city.index")
        with create(folder) as index:
            add(index, "ab")
            index.search(descriptors(1))
        Path(outside).chmod(0o755)
        for file in folder.iterdir():
            file.chmod(0o444)
        folder.chmod(0o555)
        yield folder
        folder.chmod(0o755)
        shutil.rmtree(folder)


def test_a_read_only_folder_can_be_searched(read_only: Path, as_nobody: None) -> None:
    with Index.open(read_only) as index:
        assert names(index) == ["a", "b"]
        assert len(index.search(descriptors(1))[0]) == 2
        assert index.verify() == []
        with pytest.raises(StoreError, match=r"cannot be written .*permissions|may write to its folder"):
            add(index, "c")


def test_a_matrix_that_vanished_adds_nothing(index: Index) -> None:
    (index.folder / "descriptors.f16").unlink()
    with pytest.raises(StoreError, match=r"descriptors\.f16 is missing: restore it"):
        add(index, "a")
    assert index.known(["a"]) == set()


# --- tending --------------------------------------------------------------------------------


def test_verify_names_photos_with_damaged_descriptors(index: Index) -> None:
    add(index, "abcd")
    index.remove(["/photos/d.jpg"])
    with (index.folder / "descriptors.f16").open("r+b") as file:
        for row in (1, 3):  # the removed one is nobody's trouble
            file.seek(row * DIM * 2)
            file.write(b"\xff" * 4)
    (said,) = index.verify()
    assert re.match(r".*b\.jpg has a damaged descriptor: remove it", said)


def test_verify_tells_when_table_and_commit_disagree(index: Index) -> None:
    add(index, "abcd")
    with sqlite3.connect(index.folder / "photos.sqlite") as db:
        db.execute("DELETE FROM photos WHERE row = 2")
    db.close()
    (said,) = index.verify()
    assert "3 photos up to row 3, but 4 rows were committed" in said


def test_verify_tells_of_a_damaged_table(index: Index) -> None:
    add(index, "abcd")
    with sqlite3.connect(index.folder / "photos.sqlite") as db:
        db.execute("PRAGMA writable_schema = ON")
        db.execute("UPDATE sqlite_schema SET sql = replace(sql, 'removed = 0', 'removed = 1') WHERE name = 'live_path'")
    db.close()
    with Index.open(index.folder) as again:
        assert any("is damaged" in said for said in again.verify())


def test_info_counts(index: Index) -> None:
    index.add([photo("a", 1.0), photo("b", 3.0), photo("c")], descriptors(3), identities=list("abc"))
    index.remove(["/photos/b"])
    info = index.info()
    assert (info.photos, info.with_position, info.dim, info.model, info.fingerprint) == (
        2,
        1,
        DIM,
        "fake",
        "f1",
    )
    assert info.box == (1.0, 7.0, 1.0, 7.0)
    assert info.bytes == sum(file.stat().st_size for file in index.folder.iterdir())
    assert info.created.tzinfo is not None
    assert info.format_version == 2


def test_a_box_may_cross_the_date_line() -> None:
    assert verify.box([]) is None
    assert verify.box([(-17, 179), (-18, -179)]) == (-18, 179, -17, -179)
    assert verify.box([(0, -10), (5, 20), (1, 3)]) == (0, -10, 5, 20)
    assert verify.box([(0, 180), (0, -180)]) in ((0, 180, 0, -180), (0, -180, 0, 180), (0, 180, 0, 180))


@given(st.lists(st.tuples(st.floats(-90, 90), st.floats(-180, 180)), min_size=1, max_size=8))
def test_a_box_holds_its_points(points: list[tuple[float, float]]) -> None:
    south, west, north, east = verify.box(points)
    for lat, lon in points:
        assert south <= lat <= north
        assert west <= lon <= east if west <= east else lon >= west or lon <= east
