"""From photos to an index: nothing twice, nothing lost, nothing silent."""

import os
import signal
import sqlite3
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from salad.errors import PhotoError, StoreError, WrongModelError
from salad.geo import GeoPoint
from salad.images.exif import save_jpeg
from salad.images.metadata import NOTHING_SAID
from salad.images.photo import Photo, content_hash
from salad.images.photo_table import PhotoTable
from salad.images.worker_process import PhotoRead
from salad.images.workers import Pool, Workers
from salad.index import build
from salad.index.build import OUTDATED, Outcome, index_photos
from salad.index.changes import Changes
from salad.index.index import Index
from salad.models.fake import FakeDescriber
from tests.swapping import WAYS, at_each_step


@dataclass(frozen=True)
class CountingDescriber(FakeDescriber):
    """Remembers how many photos it was given, and raises at a chosen one."""

    batches: list[int] = field(default_factory=list)
    interrupt_at: int | None = None

    def describe(self, photos: Sequence[np.ndarray], *, batch_size: int = 16) -> np.ndarray:
        if self.interrupt_at is not None and sum(self.batches) + len(photos) > self.interrupt_at:
            raise KeyboardInterrupt
        self.batches.append(len(photos))
        return super().describe(photos, batch_size=batch_size)


def draw(path: Path, seed: int) -> Path:
    path.parent.mkdir(exist_ok=True, parents=True)
    pixels = np.random.default_rng(seed).integers(0, 256, (6, 6, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path, format="PNG")
    return path


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    with new_index(tmp_path) as made:
        yield made


def new_index(folder: Path) -> Index:
    model = FakeDescriber()
    return Index.create(folder / "i", dim=model.dim, fingerprint=model.fingerprint, model=model.name)


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    return [draw(tmp_path / "photos" / f"{n:02}.png", n) for n in range(20)]


def test_photos_are_found_by_their_own_pixels(index: Index, photos: list[Path]) -> None:
    model, seen = FakeDescriber(), []
    done = index_photos(photos, index, model, batch_size=3, progress=lambda *at: seen.append(at))
    assert (done.added, done.skipped, done.moved, done.twins, done.unreadable) == (20, 0, 0, [], [])
    for path, (best,) in zip(photos, index.search(model.describe(photos), k=1), strict=True):
        assert best.photo.path == path
        assert best.score == pytest.approx(1, abs=2e-3)
    assert [at for at, _ in seen] == sorted(at for at, _ in seen)
    assert seen[-1] == (20, 20)


def test_what_is_there_is_not_described_again(index: Index, photos: list[Path]) -> None:
    index_photos(photos[:15], index, FakeDescriber())
    model, seen = CountingDescriber(), []
    done = index_photos(photos, index, model, progress=lambda *at: seen.append(at))
    assert (done.added, done.skipped) == (5, 15)
    assert sum(model.batches) == 5
    assert seen[-1] == (20, 20)
    assert index_photos(photos, index, model).skipped == 20
    assert sum(model.batches) == 5
    assert index_photos([], index, model).added == 0


def test_unreadable_photos_are_named_and_the_rest_goes_on(index: Index, photos: list[Path]) -> None:
    empty, text, gone = (photos[0].with_name(name) for name in ("empty.jpg", "text.png", "gone.png"))
    empty.touch()
    text.write_text("no picture")
    cut = photos[0].with_name("cut.jpg")
    Image.fromarray(np.zeros((99, 99, 3), np.uint8)).save(cut)
    cut.write_bytes(cut.read_bytes()[:-300])
    seen = []
    given = [empty, *photos, text, gone, cut]
    done = index_photos(given, index, FakeDescriber(), batch_size=2, progress=lambda *at: seen.append(at))
    assert (done.added, done.skipped, len(index)) == (20, 0, 20)
    for path in (empty, text, gone, cut):
        assert [path.name in said for said in done.unreadable].count(True) == 1
    assert seen[-1] == (24, 24)


def test_copies_are_kept_once_and_named(index: Index, photos: list[Path]) -> None:
    copies = [path.with_name(f"copy-{path.name}") for path in photos]
    for path, copy in zip(photos, copies, strict=True):
        copy.write_bytes(path.read_bytes())
    done = index_photos([photos[0], copies[0], *photos[1:], *copies[1:]], index, FakeDescriber(), batch_size=1)
    assert (done.added, done.skipped, len(done.twins), done.moved) == (20, 20, 20, 0)
    assert str(copies[0]) in done.twins[0]
    assert str(photos[0]) in done.twins[0]
    assert [held.path for held in index.photos()] == photos


def test_a_moved_photo_takes_its_row_along(index: Index, photos: list[Path]) -> None:
    index_photos(photos, index, FakeDescriber())
    moved = [path.rename(path.with_name(f"moved-{path.name}")) for path in photos]
    model = CountingDescriber()
    done = index_photos(moved, index, model)
    assert (done.added, done.skipped, done.moved, model.batches) == (0, 20, 20, [])
    assert [held.path for held in index.photos()] == moved


def test_positions_come_from_a_table_and_stay(index: Index, photos: list[Path], tmp_path: Path) -> None:
    index_photos(photos[:2], index, FakeDescriber())
    table = tmp_path / "places.csv"
    table.write_text("path,lat,lon\n" + "".join(f"photos/{p.name},{n},7\n" for n, p in enumerate(photos[:3])))
    done = index_photos(photos[:3], index, FakeDescriber(), table=PhotoTable.read(table))
    assert (done.added, done.skipped, done.moved) == (1, 2, 0)
    index_photos(photos[:3], index, FakeDescriber())
    assert [held.where for held in index.photos()] == [GeoPoint(n, 7) for n in range(3)]


def test_what_a_table_said_outlives_what_the_photos_say(index: Index, tmp_path: Path) -> None:
    """Position, heading and time; until another table comes."""
    path, table = tmp_path / "a.jpg", tmp_path / "places.csv"
    save_jpeg(np.full((4, 6, 3), 128, np.uint8), path, where=GeoPoint(1, 1), heading=10.0, time=datetime(2024, 1, 1))
    for lat in (50, 60):
        table.write_text(f"path,lat,lon,heading,time\na.jpg,{lat},7,20,2023-05-01T12:00\n")
        index_photos([path], index, FakeDescriber(), table=PhotoTable.read(table))
        assert index_photos([path], index, FakeDescriber()).changes == Changes()
        (held,) = index.photos()
        assert held == Photo(path, GeoPoint(lat, 7), 20.0, datetime(2023, 5, 1, 12))
        assert held.source == "table"


def test_who_says_where_is_kept_and_no_change_of_position(index: Index, tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    save_jpeg(np.full((4, 6, 3), 128, np.uint8), path, where=GeoPoint(1, 1))
    index.add([Photo(path, GeoPoint(1, 1))], FakeDescriber().describe([path]), identities=[content_hash(path)])
    assert [held.source for held in index.photos()] == [None]  # as an earlier version wrote it
    assert not str(index_photos([path], index, FakeDescriber()).changes)
    assert [held.source for held in index.photos()] == ["exif"]


def test_photos_without_a_position_are_counted_with_the_reason(index: Index, photos: list[Path]) -> None:
    placed = photos[0].with_name("placed.jpg")
    save_jpeg(np.full((4, 6, 3), 128, np.uint8), placed, where=GeoPoint(1, 1))
    zero = photos[0].with_name("0.jpg")
    save_jpeg(np.full((4, 6, 3), 129, np.uint8), zero, where=GeoPoint(0, 0))
    for _ in range(2):  # when they are added, and when they are there already
        done = index_photos([zero, placed, *photos], index, FakeDescriber(), batch_size=4)
        assert done.unplaced == 21
        assert len(done.first_unplaced) == 3
        assert done.first_unplaced[0] == "0.jpg (its EXIF says 0,0, which counts as no position)"
        assert done.first_unplaced[1] == f"00.png ({NOTHING_SAID})"


def test_the_outcome_of_each_photo_is_told_once(index: Index, photos: list[Path]) -> None:
    copy, empty = photos[0].with_name("copy.png"), photos[0].with_name("empty.jpg")
    copy.write_bytes(photos[0].read_bytes())
    empty.touch()
    index_photos(photos[:5], index, FakeDescriber())
    moved = photos[1].rename(photos[1].with_name("moved.png"))
    given = [photos[0], copy, moved, *photos[2:], empty]
    told: list[Outcome] = []
    done = index_photos(given, index, FakeDescriber(), batch_size=3, on_photo=told.append)
    states = {each.photo.path.name: each.state for each in told}
    assert len(told) == len(given)
    assert [states[name] for name in ("00.png", "copy.png", "moved.png", "04.png", "05.png", "empty.jpg")] == [
        *("held", "copy", "held", "held", "added", "unreadable")
    ]
    counted = Counter(each.state for each in told)
    assert (counted["added"], counted["held"] + counted["copy"]) == (done.added, done.skipped)
    assert {each.why for each in told if each.state in ("copy", "unreadable")} == {*done.twins, *done.unreadable}


def test_copies_in_one_commit_are_told_as_such(index: Index, photos: list[Path]) -> None:
    copy = photos[0].with_name("copy.png")
    copy.write_bytes(photos[0].read_bytes())
    told: list[Outcome] = []
    index_photos([*photos, copy], index, FakeDescriber(), on_photo=told.append)
    assert Counter(each.state for each in told) == {"added": 20, "copy": 1}


def test_photos_at_null_island_lose_that_and_are_counted(index: Index, tmp_path: Path) -> None:
    path = tmp_path / "zero.jpg"
    save_jpeg(np.full((4, 6, 3), 128, np.uint8), path, where=GeoPoint(0, 0))
    index.add([Photo(path, GeoPoint(0, 0))], FakeDescriber().describe([path]), identities=[content_hash(path)])
    done = index_photos([path], index, FakeDescriber())
    assert str(done.changes) == "1 position changed; the first: zero.jpg, 0,0 -> none"
    assert not str(index_photos([path], index, FakeDescriber()).changes)  # told once


def test_deep_grey_that_an_earlier_salad_described_is_named(index: Index, photos: list[Path]) -> None:
    """Of these photos alone today's decoder makes another picture; once they are described anew nothing is said."""
    deep = [path.with_name(f"deep-{number}.tif") for number, path in enumerate(photos[:3])]
    for number, path in enumerate(deep):
        Image.fromarray(np.arange(number, number + 4800, 100, np.uint16).reshape(6, 8)).save(path)
    told: list[Outcome] = []
    for _ in range(2):
        assert index_photos([*photos, *deep], index, FakeDescriber(), batch_size=2).decoded_earlier == []
    with closing(sqlite3.connect(index.folder / "photos.sqlite")) as db, db:
        db.execute("DROP TABLE decoders")  # an earlier salad wrote none
    done = index_photos([*photos, *deep], index, FakeDescriber(), on_photo=told.append)
    assert done.decoded_earlier == deep
    assert [each.photo.path for each in told if OUTDATED in each.why] == deep
    index.remove(deep[:2])
    assert index_photos([*photos, *deep], index, FakeDescriber()).decoded_earlier == [deep[2]]
    index.compact()
    assert index_photos([*photos, *deep], index, FakeDescriber()).decoded_earlier == [deep[2]]


def test_many_stale_photos_are_brought_up_to_date_in_parts(
    index: Index, photos: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build, "_STALE", 3)
    index_photos(photos, index, FakeDescriber())
    moved = [path.rename(path.with_name(f"moved-{path.name}")) for path in photos]
    assert index_photos(moved, index, FakeDescriber()).moved == 20
    assert {held.path for held in index.photos()} == set(moved)


def test_an_interrupt_leaves_what_was_committed_and_the_next_run_goes_on(
    index: Index, photos: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build, "COMMIT_BATCHES", 2)
    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        index_photos(photos, index, CountingDescriber(interrupt_at=13), batch_size=3)
    assert len(index) == 12
    assert index.verify() == []
    assert threading.active_count() == before
    done = index_photos(photos, index, FakeDescriber(), batch_size=3)
    assert (done.added, done.skipped) == (8, 12)


def test_an_interrupt_commits_all_that_is_described(index: Index, photos: list[Path]) -> None:
    seen: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        index_photos(
            photos,
            index,
            CountingDescriber(interrupt_at=14),
            batch_size=2,
            progress=lambda done, _: seen.append(done),
        )
    assert len(index) == seen[-1] == 14
    assert index_photos(photos, index, FakeDescriber()).skipped == 14


def test_an_interrupt_while_committing_commits_after_all(
    index: Index, photos: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    add, calls = Index.add, []

    def tired(self: Index, *arguments: object, **settings: object) -> int:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return add(self, *arguments, **settings)

    monkeypatch.setattr(Index, "add", tired)
    monkeypatch.setattr(build, "COMMIT_BATCHES", 2)
    with pytest.raises(KeyboardInterrupt):
        index_photos(photos, index, FakeDescriber(), batch_size=3)
    assert len(index) == 12
    assert index.verify() == []


def test_an_index_that_cannot_be_written_is_not_tried_twice(
    index: Index, photos: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def full(*_: object, **__: object) -> int:
        calls.append(1)
        raise StoreError("no room")

    monkeypatch.setattr(Index, "add", full)
    with pytest.raises(StoreError, match="no room"):
        index_photos(photos, index, FakeDescriber())
    assert calls == [1]


# What a worker process runs whose decoder breaks down over some photos.
BROKEN = """
import os
from salad.images import worker_process as reading

honest = reading.TASKS["read"]
reading.TASKS["read"] = lambda path, *rest: os._exit(9) if path.name in ("03.png", "11.png") else honest(path, *rest)
reading.main()
"""


@pytest.fixture
def broken() -> Iterator[Pool]:
    made = Pool(BROKEN)
    yield made
    made.close()


def test_photos_are_read_by_processes_and_a_crash_costs_one(
    index: Index, photos: list[Path], broken: Pool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("salad.images.workers.SHARED", broken)
    table = tmp_path / "places.csv"
    table.write_text("path,lat,lon\nphotos/05.png,1,2\n")
    done = index_photos(photos, index, FakeDescriber(), table=PhotoTable.read(table), batch_size=4)
    assert (done.added, len(done.unreadable), len(index)) == (18, 2, 18)
    for name, said in zip(("03.png", "11.png"), done.unreadable, strict=True):
        assert name in said
        assert "crashes its decoder" in said
    good = [path for path in photos if path.name not in ("03.png", "11.png")]
    for path, (best,) in zip(good, index.search(FakeDescriber().describe(good), k=1), strict=True):
        assert best.photo == Photo(path, GeoPoint(1, 2) if path.name == "05.png" else None)


def test_an_interrupt_ends_the_processes(index: Index, photos: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Workers] = []
    monkeypatch.setattr("salad.index.build.Workers", lambda photos, **_: made.append(Workers(photos)) or made[0])
    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        index_photos(photos, index, CountingDescriber(interrupt_at=7), batch_size=3)
    assert len(index) == 6
    assert threading.active_count() == before
    with pytest.raises(PhotoError, match="was stopped"):
        made[0].read(photos[0])


# Indexes a folder slowly, with worker processes, telling how far it is.
SLOW = """
import sys, time
from pathlib import Path
from salad.index.build import index_photos
from salad.index.index import Index
from salad.models.fake import FakeDescriber

class Slow(FakeDescriber):
    def describe(self, photos, *, batch_size=16):
        time.sleep(0.05)
        return super().describe(photos, batch_size=batch_size)

model, folder = Slow(), Path(sys.argv[1])
index = Index.create(folder / "i", dim=model.dim, fingerprint=model.fingerprint, model=model.name)
photos = sorted((folder / "photos").iterdir())
try:
    index_photos(photos, index, model, batch_size=1, progress=lambda done, _: print(done, flush=True))
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no signals to groups of processes")
def test_ctrl_c_reaches_every_process_and_loses_nothing(photos: list[Path], tmp_path: Path) -> None:
    command = [sys.executable, "-c", SLOW, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as run:
        assert run.stdout is not None
        far = [int(run.stdout.readline()) for _ in range(5)][-1]
        os.killpg(run.pid, signal.SIGINT)
        rest = run.stdout.read()  # it ends once no process holds the pipe any more
        far = int(rest.split()[-1]) if rest.strip() else far
    assert run.returncode == 130
    with Index.open(tmp_path / "i") as index:
        held = len(index)
        assert held in (far, far + 1)  # the last may have been described and not yet told
        assert index.verify() == []
        done = index_photos(photos, index, FakeDescriber())
        assert (done.added, done.skipped) == (20 - held, held)


def test_another_model_adds_nothing(index: Index, photos: list[Path]) -> None:
    with pytest.raises(WrongModelError):
        index_photos(photos, index, FakeDescriber(seed=5))
    assert len(index) == 0


@pytest.fixture
def trips(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, bool]]:
    """Each trip to a photo: its name, and whether it was decoded."""
    made: list[tuple[str, bool]] = []
    honest = Workers.read

    def told(self: Workers, path: Path, size: tuple[int, int, str] | None = None) -> PhotoRead:
        made.append((path.name, size is not None))
        return honest(self, path, size)

    monkeypatch.setattr(Workers, "read", told)
    return made


def test_a_photo_is_read_in_one_trip_and_decoded_where_its_path_is_new(
    index: Index, photos: list[Path], trips: list[tuple[str, bool]]
) -> None:
    index_photos(photos[:10], index, FakeDescriber(), batch_size=3)
    assert sorted(trips) == [(path.name, True) for path in photos[:10]]
    trips.clear()
    index_photos(photos, index, FakeDescriber(), batch_size=3)
    assert sorted(trips) == [(path.name, number >= 10) for number, path in enumerate(photos)]


def test_a_replaced_photo_takes_two_trips_and_is_right(
    index: Index, photos: list[Path], trips: list[tuple[str, bool]]
) -> None:
    index_photos(photos, index, FakeDescriber(), batch_size=3)
    draw(photos[4], 99)
    photos[7].write_bytes(b"no photo any more")
    trips.clear()
    done = index_photos(photos, index, FakeDescriber(), batch_size=3)
    assert (done.added, done.skipped, len(done.unreadable), len(index)) == (1, 18, 1, 20)
    assert [trip for trip in sorted(trips) if trips.count((trip[0], True))] == [
        (photos[4].name, False), (photos[4].name, True), (photos[7].name, False), (photos[7].name, True),
    ]  # fmt: skip
    ((best,),) = index.search(FakeDescriber().describe([photos[4]]), k=1)
    assert best.photo.path == photos[4]
    assert best.score == pytest.approx(1, abs=2e-3)


def test_the_index_is_asked_once_a_batch(index: Index, photos: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    for name in ("find", "known", "taken"):
        honest = getattr(Index, name)
        monkeypatch.setattr(
            Index, name, lambda self, some, honest=honest: asked.append(len(some)) or honest(self, some)
        )
    index_photos(photos, index, FakeDescriber(), batch_size=5)
    assert asked == [20, 5, 5, 5, 5]  # about a page of paths, and about each batch's contents


class Meddling(FakeDescriber):
    """While it describes, somebody else has changed the index."""

    def describe(self, photos: Sequence[np.ndarray], *, batch_size: int = 16) -> np.ndarray:
        self.meddle()
        return super().describe(photos, batch_size=batch_size)


@pytest.mark.parametrize("moved", [False, True])
def test_what_somebody_else_adds_meanwhile_is_added_once(index: Index, photos: list[Path], moved: bool) -> None:
    """Between the question about a batch and its commit."""
    model = Meddling()
    others = [path.with_name(f"copy-{path.name}") if moved else path for path in photos[:6]]
    for path, other in zip(photos, others, strict=False):
        other.write_bytes(path.read_bytes())

    def meddle() -> None:
        with Index.open(index.folder) as beside:
            index_photos(others, beside, FakeDescriber())

    object.__setattr__(model, "meddle", meddle)
    done = index_photos(photos, index, model, batch_size=30)
    assert (done.added, done.skipped, done.moved, len(index)) == (14, 6, 0, 20)
    assert len(done.twins) == (6 if moved else 0)
    assert {held.path for held in index.photos()} == {*others, *photos[6:]}
    assert index.verify() == []


def test_what_somebody_else_removes_meanwhile_is_described_again(index: Index, photos: list[Path]) -> None:
    index_photos(photos, index, FakeDescriber())
    honest = index.taken

    def removed_after(paths: Sequence[Path]) -> set[Path]:
        held = honest(paths)
        with Index.open(index.folder) as beside:
            beside.remove(photos[:3])
        return held

    index.taken = removed_after  # type: ignore[method-assign]  # between the guess and the question
    done = index_photos(photos, index, FakeDescriber(), batch_size=4)
    assert (done.added, done.skipped, len(index)) == (3, 17, 20)


@pytest.mark.usefixtures("read_here")
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("held", ["nothing", "the path with other content", "a twin of it"])
def test_a_photo_saved_anew_meanwhile_is_one_of_its_versions(
    tmp_path: Path, way: Callable[[Path, bytes], None], held: str
) -> None:
    """At whatever step of ours; and when the first version comes back, it is found as what it is."""
    model = FakeDescriber()
    path, other = draw(tmp_path / "p" / "a.png", 1), draw(tmp_path / "p" / "b.png", 2)
    made = {content_hash(photo): (photo.read_bytes(), model.describe([photo])) for photo in (path, other)}
    first, second = (content for content, _ in made.values())
    other.unlink()
    beside = tmp_path / "q" / "a.png"
    for number, swapping in enumerate(at_each_step(path, first, second, way)):
        with new_index(tmp_path / str(number)) as index:
            if held != "nothing":
                here = path if held == "the path with other content" else beside
                index_photos([draw(here, 3 if here == path else 2)], index, model)
                path.write_bytes(first)
            with swapping:
                index_photos([path], index, model, batch_size=1)
            assert holds_what_it_says(index, made)
            path.write_bytes(first)
            done = index_photos([path], index, model)
            assert done.added + done.skipped == 1
            assert holds_what_it_says(index, made)
            assert index.find([content_hash(path)])[content_hash(path)].path == path
            assert index.verify() == []


def holds_what_it_says(index: Index, made: dict[str, tuple[bytes, np.ndarray]]) -> bool:
    """Whether each of these contents that the index holds has the descriptor of that very content."""
    held = index.find(list(made))
    found = {content: index.search(row, k=1)[0][0] for content, (_, row) in made.items() if content in held}
    return bool(found) and all(
        best.score == pytest.approx(1, abs=2e-3) and best.photo.path == held[content].path
        for content, best in found.items()
    )


FILES = ["a", "b", "c", "d"]
STEPS = st.lists(
    st.tuples(
        st.sampled_from(["write", "move", "copy", "delete", "index"]),
        st.sampled_from(FILES),
        st.sampled_from(FILES),
        st.integers(0, 3),
    ),
    max_size=14,
)


@settings(max_examples=30, deadline=None)
@given(steps=STEPS, batch_size=st.integers(1, 3), by_chance=st.randoms(use_true_random=False))
def test_after_indexing_each_content_is_found_where_it_is(
    steps: list[tuple[str, str, str, int]], batch_size: int, by_chance: object
) -> None:
    with TemporaryDirectory() as folder, new_index(Path(folder)) as index:
        home = Path(os.path.realpath(folder), "p")
        home.mkdir()
        for step, name, other, seed in [*steps, ("index", "", "", 0)]:
            here, there = home / name, home / other
            if step == "write":
                draw(here, seed)
            elif step == "delete":
                here.unlink(missing_ok=True)
            elif step != "index" and here.exists() and here != there:
                here.rename(there) if step == "move" else there.write_bytes(here.read_bytes())
            elif step == "index":
                files = sorted(home.iterdir())
                by_chance.shuffle(files)
                done = index_photos(files, index, FakeDescriber(), batch_size=batch_size)
                assert done.added + done.skipped == len(files)
                held = {content_hash(path): path for path in files}
                found = index.find(list(held))
                assert set(found) == set(held)
                assert all(content_hash(photo.path) == content for content, photo in found.items())
                live: list[Photo] = list(index.photos())
                assert len({photo.path for photo in live}) == len(live)
        assert index.verify() == []
