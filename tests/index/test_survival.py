"""An index outlives what happens to it: kills, a full disk, damaged files, others at work.

Run as a program, this file is the process that the test kills: for each line it reads it forks a worker,
which changes an index until it is killed. (A fork of the test's own process would take torch's threads along.)
"""

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from earlier_indexes import as_format_1, change_row
from salad.errors import SaladError, StoreError
from salad.images.photo import Photo
from salad.index import compress
from salad.index.catalog import Catalog
from salad.index.index import Index
from salad.index.vectors import FileRows
from salad.search import compressed
from salad.search.base import Hits
from salad.search.exact import ExactSearcher

KILLS = 100 if os.environ.get("SALAD_THOROUGH") else 50
DIM = 64
HOME = Path("/photos")

Held = dict[str, str]  # content -> path


def descriptors(contents: list[str]) -> np.ndarray:
    """Each content has its own."""
    drawn = [np.random.default_rng(int(content)).standard_normal(DIM) for content in contents]
    rows = np.array(drawn).reshape(-1, DIM)
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def apply(index: Index, step: dict[str, Any]) -> None:
    if step["do"] == "add":
        photos = [Photo(HOME / path) for path, _ in step["what"]]
        contents = [content for _, content in step["what"]]
        index.add(photos, descriptors(contents), identities=contents)
    elif step["do"] == "remove":
        index.remove([HOME / step["what"]])
    elif step["do"] == "compress":
        index.compress(step["what"])
    else:
        index.compact()


def applied(held: Held, step: dict[str, Any]) -> Held:
    """What an index that held `held` must hold after a step."""
    what = step["what"]
    if step["do"] == "add":
        current, here = {content for _, content in what}, {path for path, _ in what}
        now = held | {content: path for path, content in what}
        return {content: path for content, path in now.items() if content in current or path not in here}
    if step["do"] == "remove":
        return {content: path for content, path in held.items() if not (path + "/").startswith(what + "/")}
    return held


def contents_of(index: Index) -> Held:
    """What an index holds; every descriptor must be its content's, and nothing may be damaged."""
    held: Held = {}
    for page in index.pages():
        assert page.damaged == []
        np.testing.assert_array_equal(page.descriptors, descriptors(page.identities).astype(np.float16))
        paths = [str(photo.path.relative_to(HOME)) for photo in page.photos]
        held |= dict(zip(page.identities, paths, strict=True))
    return held


def random_step(rng: random.Random, *, codes: bool = False) -> dict[str, Any]:
    do = rng.choices(["add", "remove", "compact", "compress"], [4, 2, 2, 6 if codes else 0])[0]
    if do == "compress":
        return {"do": do, "what": rng.choice([63, 64])}  # bytes: of DIM numbers next to nothing is lost
    if do == "add":
        contents = rng.sample(range(400), rng.randint(1, 60))
        return {"do": do, "what": [[f"{n % 5}/{rng.randint(0, 99)}", str(n)] for n in contents]}
    return {
        "do": do,
        "what": rng.choice(["0", "1", "2/7", f"3/{rng.randint(0, 99)}"]) if do == "remove" else "",
    }


# --- the process that is killed --------------------------------------------------------------


def work(job: dict[str, Any]) -> None:
    """Change an index until killed, and write down every step before and after it."""
    rng = random.Random(job["seed"])
    log = os.open(job["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    with Index.open(job["folder"]) as index:
        if job["do"] == "hold":
            with index._catalog.writing():
                os.write(log, b"held\n")
                time.sleep(600)
        if job["do"] == "compress":  # many stages and blocks, so that a kill comes between some
            compress._STAGE, compressed.BLOCK = 16, 16 * 64
        while True:
            step = random_step(rng, codes=job["do"] == "compress")
            os.write(log, json.dumps(step).encode() + b"\n")
            apply(index, step)
            os.write(log, b"done\n")


def serve() -> None:
    for line in sys.stdin:
        worker = os.fork()
        if not worker:
            try:
                work(json.loads(line))
            finally:
                os._exit(1)
        sys.stdout.write(f"{worker}\n")
        sys.stdout.flush()
        os.waitpid(worker, 0)
        sys.stdout.write("gone\n")
        sys.stdout.flush()


class Victims:
    """Workers that can be killed, one at a time."""

    def __init__(self, log: Path) -> None:
        self.log = log
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        self.server = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | one_thread | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )

    def begin(self, do: str, folder: Path, *, seed: int = 0, steps: int = 0) -> int:
        """The worker's number, once it has done so many steps and begun another."""
        self.log.unlink(missing_ok=True)
        self._say(json.dumps({"do": do, "folder": str(folder), "log": str(self.log), "seed": seed}))
        worker = int(self._hear())
        while not self.log.exists() or len(self.log.read_bytes().splitlines()) <= 2 * steps:
            time.sleep(0.0005)
        return worker

    def kill(self, worker: int) -> list[str]:
        """Kill it; what it wrote down."""
        os.kill(worker, signal.SIGKILL)
        assert self._hear() == "gone"
        return self.log.read_text().splitlines()

    def close(self) -> None:
        self.server.communicate()
        assert self.server.returncode == 0

    def _say(self, line: str) -> None:
        assert self.server.stdin is not None
        self.server.stdin.write(line + "\n")
        self.server.stdin.flush()

    def _hear(self) -> str:
        assert self.server.stdout is not None
        return self.server.stdout.readline().strip()


@pytest.fixture
def victims(tmp_path: Path) -> Iterator[Victims]:
    made = Victims(tmp_path / "log")
    yield made
    made.close()


def create(folder: Path, dim: int = DIM) -> Index:
    return Index.create(folder, dim=dim, fingerprint="f1", model="fake")


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    with create(tmp_path / "city.index") as made:
        yield made


def add(index: Index, numbers: range | list[int]) -> int:
    contents = [str(number) for number in numbers]
    photos = [Photo(HOME / f"{content}.jpg") for content in contents]
    return index.add(photos, descriptors(contents), identities=contents)


def names(index: Index) -> list[str]:
    return [photo.path.stem for photo in index.photos()]


def found(index: Index, number: int) -> str:
    """The name of the photo that looks most like content `number`."""
    return index.search(descriptors([str(number)]), k=1)[0][0].photo.path.stem


def test_a_change_comes_through_behind_an_interrupted_look(index: Index) -> None:
    index._catalog._db.execute("BEGIN")  # as Ctrl-C leaves it right behind the command
    assert add(index, range(3)) == 3
    assert not index._catalog._db.in_transaction
    assert len(index) == 3


# --- kills -----------------------------------------------------------------------------------


def test_a_killed_process_leaves_exactly_what_was_committed(tmp_path: Path, victims: Victims) -> None:
    folder, rng = tmp_path / "city.index", random.Random(20)
    create(folder).close()
    held: Held = {}
    in_the_midst = 0
    for number in range(KILLS):
        worker = victims.begin("change", folder, seed=number, steps=rng.randint(0, 4))
        time.sleep(rng.uniform(0, 0.02))
        *steps, last = victims.kill(worker)
        for line in steps:
            held = held if line == "done" else applied(held, json.loads(line))
        perhaps = held
        if last != "done" and last.endswith("}"):
            perhaps, in_the_midst = applied(held, json.loads(last)), in_the_midst + 1
        with Index.open(folder) as index:
            now = contents_of(index)
            assert now in (held, perhaps), f"kill {number} (whole or not at all): {last}"
            assert index.verify() == []
            assert len(index) == len(now)
        held = now
    assert in_the_midst > KILLS / 4
    with Index.open(folder) as index:
        index.compact()
        assert contents_of(index) == held
        kept = {"index.json", "photos.sqlite", index._snapshot().rows.path.name}
    assert {file.name for file in folder.iterdir()} == kept


def outlived_with_codes(tmp_path: Path, victims: Victims, kills: int) -> None:
    """An index that is compressed and changed is killed so many times, and loses nothing, codes and answers neither."""
    folder, rng = tmp_path / "city.index", random.Random(21)
    create(folder).close()
    held: Held = {}
    in_the_midst = {"add": 0, "compress": 0}
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(compressed, "BLOCK", 16 * 64)
        patched.setattr(compressed, "_SPARE", 2)
        patched.setattr("salad.index.index.CODES_FROM", 0)
        patched.setattr("salad.index.index.CompressedSearcher", partial(compressed.CompressedSearcher, candidates=30))
        for number in range(kills):
            worker = victims.begin("compress", folder, seed=1000 + number, steps=rng.randint(0, 5))
            time.sleep(rng.uniform(0, 0.03))
            *steps, last = victims.kill(worker)
            for line in steps:
                held = held if line == "done" else applied(held, json.loads(line))
            perhaps = held
            if last != "done" and last.endswith("}"):
                perhaps, step = applied(held, json.loads(last)), json.loads(last)
                in_the_midst[step["do"]] = in_the_midst.get(step["do"], 0) + 1
            with Index.open(folder) as index, Index.open(folder, searcher=ExactSearcher) as exact:
                now = contents_of(index)
                assert now in (held, perhaps), f"kill {number} (whole or not at all): {last}"
                assert index.verify() == []
                queries = descriptors([str(content) for content in range(0, 400, 9)])
                assert index.search(queries, k=4) == exact.search(queries, k=4)
                assert index.noticed == []
            held = now
        with Index.open(folder) as index:
            index.compress()
            assert index.info().coded == index._snapshot().rows.rows
            assert index.verify() == []
        assert len(list(folder.glob("codes-*"))) == 1
    assert in_the_midst["compress"] > kills / 8
    assert in_the_midst["add"] > 0


def test_a_killed_process_leaves_codes_that_are_right(tmp_path: Path, victims: Victims) -> None:
    outlived_with_codes(tmp_path, victims, 12)


def test_a_lock_lasts_as_long_as_its_process(index: Index, victims: Victims) -> None:
    add(index, range(3))
    worker = victims.begin("hold", index.folder)
    with Index.open(index.folder, wait=0) as other:
        for change in (lambda: add(other, [7]), lambda: other.remove([HOME]), other.compact):
            with pytest.raises(StoreError, match="being written by another program: wait"):
                change()
        assert names(other) == ["0", "1", "2"]
        assert found(other, 1) == "1"
        victims.kill(worker)
        assert add(other, [7]) == 1


# --- compaction ------------------------------------------------------------------------------


def test_compaction_gives_room_back_and_changes_nothing_else(index: Index) -> None:
    add(index, range(2000))
    index.remove([HOME / f"{number}.jpg" for number in range(0, 2000, 2)])
    before, held = index.info().bytes, contents_of(index)
    done = index.compact()
    assert (done.kept, done.damaged) == (1000, [])
    assert done.freed == before - index.info().bytes > 1000 * DIM * 2
    assert contents_of(index) == held
    assert [match.row for match in index.search(descriptors(["1", "3"]), k=1)[0]] == [0]
    assert index.info().removed == 0
    assert sorted(file.name for file in index.folder.iterdir()) == [
        *("descriptors-3.f16", "index.json", "photos.sqlite")
    ]
    assert index.compact().freed == 0
    assert (index.folder / "descriptors-3.f16").exists()  # there was nothing to gain
    assert add(index, [0, 2]) == 2
    assert found(index, 2) == "2"
    assert index.verify() == []


def test_an_index_of_which_nothing_is_left_compacts(index: Index) -> None:
    assert index.compact().kept == 0
    add(index, range(3))
    index.remove([HOME])
    assert index.compact().kept == 0
    assert index.search(descriptors(["1"])) == [[]]
    assert add(index, range(2)) == 2
    assert index.verify() == []


def test_leftovers_of_a_killed_compaction_are_swept(index: Index) -> None:
    add(index, range(3))
    left = [index.folder / name for name in ("descriptors-7.f16", "descriptors-2.f16")]
    mine = [index.folder / name for name in ("descriptors-mine.f16", "notes.txt")]
    for file in left + mine:
        file.write_bytes(b"x")
    index.compact()
    assert not any(file.exists() for file in left)
    assert all(file.exists() for file in mine)
    assert names(index) == ["0", "1", "2"]


def test_readers_keep_their_view_while_others_add_remove_and_compact(index: Index) -> None:
    core = range(40)
    add(index, core)
    wrong: list[object] = []
    over = threading.Event()

    def read() -> None:
        with Index.open(index.folder) as reader:
            while not over.is_set():
                wrong.extend(number for number in (0, 17, 39) if found(reader, number) != str(number))
                wrong.extend({str(number) for number in core} - set(names(reader)))

    readers = [threading.Thread(target=read) for _ in range(3)]
    for thread in readers:
        thread.start()
    for number in range(100, 112):
        add(index, range(number, number + 30))
        index.remove([HOME / f"{other}.jpg" for other in range(number, number + 30)])
        index.compact()
    over.set()
    for thread in readers:
        thread.join()
    assert not wrong
    assert len(index) == 40


def test_a_search_that_a_compaction_overtakes_begins_again(index: Index) -> None:
    add(index, range(6))
    index.remove([HOME / "0.jpg"])
    overtaken: list[int] = []

    class Slow(ExactSearcher):
        def search(self, *arguments: Any, **settings: Any) -> Hits:
            hits = super().search(*arguments, **settings)
            if not overtaken:
                overtaken.append(index.compact().kept)
            return hits

    with Index.open(index.folder, searcher=Slow) as overtaken_index:
        assert found(overtaken_index, 4) == "4"
    assert overtaken == [5]


def test_a_list_goes_on_behind_a_compaction(index: Index, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("salad.index.catalog._PAGE", 3)
    add(index, range(12))
    listing = index.photos()
    listed = [next(listing).path.stem for _ in range(3)]
    index.remove([HOME / f"{number}.jpg" for number in (0, 2, 5)])
    index.compact()
    listed += [photo.path.stem for photo in listing]
    assert listed == [str(number) for number in range(12) if number != 5]

    listing = index.photos()
    listed = [next(listing).path.stem for _ in range(4)]
    # all of the second page, and one before it
    index.remove([HOME / f"{number}.jpg" for number in (4, 6, 7, 8)])
    index.compact()
    listed += [photo.path.stem for photo in listing]
    assert listed == ["1", "3", "4", "6", "7", "8", "9", "10", "11"]  # 7 and 8 were fetched with 6

    listing = index.photos()
    next(listing)
    index.remove([HOME / f"{number}.jpg" for number in (1, 3, 9)])  # all that the list has reached
    index.compact()
    with pytest.raises(StoreError, match="compacted while it was read: try again"):
        list(listing)


def test_pages_are_of_one_commit(index: Index, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("salad.index.verify._BLOCK", 3 * DIM)
    add(index, range(9))
    pages = index.pages()
    read = next(pages).identities
    index.remove([HOME / "4.jpg"])
    add(index, [50])
    read += next(pages).identities
    assert read == ["0", "1", "2", "3", "4", "5"]
    index.compact()
    with pytest.raises(StoreError, match="compacted while it was read: try again"):
        next(pages)


def test_verify_begins_again_behind_a_compaction(index: Index, monkeypatch: pytest.MonkeyPatch) -> None:
    from salad.index import verify

    add(index, range(6))
    index.remove([HOME / "0.jpg"])
    flip(index, 5)
    look = verify.damaged
    overtaken: list[int] = []

    def slow(*arguments: Any) -> list[int]:
        bad = look(*arguments)
        if not overtaken:
            overtaken.append(1)
            index.compact(dropping=len)
        return bad

    monkeypatch.setattr(verify, "damaged", slow)
    assert index.verify() == []  # the compaction let go of the damaged photo
    assert "5" not in names(index)


# --- a full disk -----------------------------------------------------------------------------

_FULL = """
import resource, signal, sys
from salad.errors import StoreError
from salad.index.index import Index
from pathlib import Path
from salad.images.photo import Photo
import numpy as np

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
count = 3000
with Index.open(sys.argv[1]) as index:
    try:
        if sys.argv[2] == "add":
            names = ["n" * 200 + str(n) for n in range(count)]
            rows = np.full((count, index.dim), index.dim**-0.5)
            index.add([Photo(Path("/p", name)) for name in names], rows, identities=names)
        else:
            index.compact()
    except StoreError as error:
        print(error)
"""


@pytest.mark.parametrize(
    ("what", "limit", "sentence"),
    [
        ("add", 200_000, "descriptors.f16 cannot be written (File too large): nothing was added; make room"),
        ("add", 600_000, "photos.sqlite cannot be written"),
        ("compact", 100_000, "cannot be written (File too large): nothing was changed"),
    ],
)
def test_a_full_disk_changes_nothing(index: Index, what: str, limit: int, sentence: str) -> None:
    add(index, range(1000))
    index.remove([HOME / "7.jpg"])
    held = contents_of(index)
    told = subprocess.run(
        [sys.executable, "-c", _FULL, str(index.folder), what, str(limit)],
        check=True,
        capture_output=True,
        text=True,
    )
    assert sentence in told.stdout
    assert len(told.stdout.splitlines()) == 1
    assert contents_of(index) == held
    assert index.verify() == []
    assert len(list(index.folder.glob("descriptors*"))) == 1
    assert index.compact().kept == 999
    assert add(index, range(1000)) == 1


# --- damaged files ---------------------------------------------------------------------------


def flip(index: Index, row: int, *, byte: int = 3, bits: int = 0x01) -> None:
    """Change a bit or more of a row as a failing disk would."""
    with index._snapshot().rows.path.open("r+b") as file:
        file.seek(row * DIM * 2 + byte)
        (old,) = file.read(1)
        file.seek(-1, os.SEEK_CUR)
        file.write(bytes([old ^ bits]))


@settings(max_examples=30, deadline=None)
@given(
    hits=st.dictionaries(st.integers(0, 19), st.tuples(st.integers(0, 2 * DIM - 1), st.integers(1, 255)), max_size=5),
)
def test_flipped_bytes_are_named_and_the_rest_stays_usable(
    tmp_path_factory: pytest.TempPathFactory, hits: dict[int, tuple[int, int]]
) -> None:
    with create(tmp_path_factory.mktemp("flipped") / "i") as index:
        add(index, range(20))
        for row, (byte, bits) in hits.items():
            flip(index, row, byte=byte, bits=bits)
        said = index.verify()
        assert [sentence.split(" has ")[0] for sentence in said] == [str(HOME / f"{row}.jpg") for row in sorted(hits)]
        assert all(sentence.endswith("remove it and index it again") for sentence in said)
        sound = set(range(20)) - set(hits)
        for row in sound:
            assert found(index, row) == str(row)
            (all_found,) = index.search(descriptors([str(row)]), k=20)
            assert {match.row for match in all_found} == sound
        assert index.verify() == said  # searching hides nothing
        # The way out that the sentence names.
        index.remove([HOME / f"{row}.jpg" for row in hits])
        assert add(index, range(20)) == len(hits)
        assert index.verify() == []
        assert all(found(index, row) == str(row) for row in range(20))


def test_compaction_lets_go_of_damaged_photos_only_where_it_may_and_names_them_before(index: Index) -> None:
    add(index, range(5))
    flip(index, 2)
    before = {file.name: file.read_bytes() for file in index.folder.iterdir()}
    with pytest.raises(StoreError, match=r"1 photos of .* are damaged \(/photos/2.jpg\), so nothing was changed"):
        index.compact()
    told: list[list[Path]] = []

    def dropping(paths: list[Path]) -> None:
        assert {file.name: file.read_bytes() for file in index.folder.glob("*.f16")}.items() <= before.items()
        told.append(paths)

    assert {file.name: file.read_bytes() for file in index.folder.iterdir()} == before
    assert index.compact(dropping=dropping).damaged == [HOME / "2.jpg"]
    assert told == [[HOME / "2.jpg"]]
    assert names(index) == ["0", "1", "3", "4"]
    assert index.verify() == []
    assert add(index, range(5)) == 1


@pytest.mark.parametrize("fault", ["other bytes", "an end"])
def test_a_disk_that_fails_between_two_readings_is_found_out(
    index: Index, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    """What was found right is written with the checksum it was found right by."""
    add(index, range(6))
    index.remove([HOME / "0.jpg"])
    readings, whole = [0], FileRows.blocks

    def failing(rows: FileRows, **settings: int) -> Iterator[tuple[int, Any]]:
        readings[0] += 1
        for start, block in whole(rows, **settings):
            if readings[0] == 2:
                if fault == "an end":
                    return
                block.view(np.uint16)[3, 2] ^= 1
            yield start, block

    held = contents_of(index)
    monkeypatch.setattr(FileRows, "blocks", failing)
    if fault == "an end":
        with pytest.raises(StoreError, match="cut short while it was read: nothing was changed"):
            index.compact()
        monkeypatch.undo()
        assert contents_of(index) == held
        assert index.verify() == []
    else:
        index.compact()
        monkeypatch.undo()
        assert [sentence.split(" has ")[0] for sentence in index.verify()] == [str(HOME / "3.jpg")]


def test_a_truncated_matrix_opens_and_the_rest_stays_usable(index: Index) -> None:
    add(index, range(5))
    index.remove([HOME / "4.jpg"])
    os.truncate(index.folder / "descriptors.f16", 2 * DIM * 2 + 7)
    with Index.open(index.folder) as cut:
        assert (found(cut, 0), found(cut, 1)) == ("0", "1")
        assert {match.photo.path.stem for match in cut.search(descriptors(["3"]), k=9)[0]} == {"0", "1"}
        assert names(cut) == ["0", "1", "2", "3"]  # what is known of the others is not lost
        whole, *photos = cut.verify()
        assert "is truncated: it holds 2 descriptors, 5 were committed; restore it" in whole
        assert photos == [f"{HOME / name}.jpg has lost its descriptor: remove it and index it again" for name in "23"]
        with pytest.raises(StoreError, match=r"lacks the descriptors of 2 photos.*salad compact"):
            add(cut, [9])
        assert add(cut, [0]) == 0  # nothing is written behind
        assert cut.info().photos == 4


@pytest.mark.parametrize("way", ["remove", "compact", "restore"])
def test_the_ways_out_of_a_truncated_matrix(index: Index, way: str) -> None:
    add(index, range(5))
    file = index.folder / "descriptors.f16"
    kept = file.read_bytes()
    os.truncate(file, 2 * DIM * 2 + 7)
    with Index.open(index.folder) as cut:
        if way == "remove":
            assert cut.remove([HOME / f"{name}.jpg" for name in "234"]) == 3
        elif way == "compact":
            assert [path.stem for path in cut.compact(dropping=len).damaged] == ["2", "3", "4"]
        else:
            file.write_bytes(kept)
    with Index.open(index.folder) as mended:
        assert mended.verify() == []
        assert add(mended, range(5)) == (0 if way == "restore" else 3)
        assert mended.verify() == []
        assert all(found(mended, number) == str(number) for number in range(5))
        assert mended.compact().kept == 5


def test_an_index_without_checksums_can_be_used_and_gets_them(index: Index) -> None:
    add(index, range(5))
    index.close()
    as_format_1(index.folder, sums=False)  # as salad 0.1.0 wrote it
    with Index.open(index.folder) as old:
        assert found(old, 3) == "3"
        assert old.verify() == []
        flip(old, 1, byte=1, bits=0xFF)
        assert len(old.verify()) == 1  # by its length
        assert old.remove([HOME / "1.jpg"]) == 1
        assert add(old, [8]) == 1
        flip(old, 5)
        assert [sentence.split(" has ")[0] for sentence in old.verify()] == [str(HOME / "8.jpg")]
        flip(old, 2)
        assert old.compact(dropping=len).kept == 4
        flip(old, 0)
        assert [sentence.split(" has ")[0] for sentence in old.verify()] == [str(HOME / "0.jpg")]


@settings(max_examples=60, deadline=None)
@given(hits=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8))
@example(hits=[(0.1484375, 128)])  # which SQLite's own sentence quotes, and is no text
def test_a_damaged_table_is_a_sentence(tmp_path_factory: pytest.TempPathFactory, hits: list[tuple[float, int]]) -> None:
    folder = tmp_path_factory.mktemp("spoilt") / "i"
    with create(folder) as index:
        add(index, range(30))
        index.remove([HOME / "3.jpg"])
    file = folder / "photos.sqlite"
    raw = bytearray(file.read_bytes())
    for place, byte in hits:
        raw[int(place * len(raw))] = byte
    file.write_bytes(raw)
    said = ""
    try:
        with Index.open(folder, wait=0) as index:
            assert all(str(folder) in sentence or "index" in sentence for sentence in index.verify())
            index.search(descriptors(["5"]))
            list(index.photos())
            index.info()
            index.compact(dropping=len)
            add(index, [99])
    except SaladError as error:
        said = str(error)
    assert not said or any(word in said for word in ("damaged", "truncated", "cannot be", "missing"))


@pytest.mark.parametrize(
    ("column", "value"),
    [("matrix", "../other.f16"), ("matrix", "index.json"), ("matrix", 5), ("rows", -1), ("rows", "many")],
)
def test_a_commit_that_makes_no_sense_is_refused(index: Index, column: str, value: object) -> None:
    with sqlite3.connect(index.folder / "photos.sqlite") as db:
        db.execute(f"UPDATE committed SET {column} = ?", (value,))
    db.close()
    with pytest.raises(StoreError, match=r"photos\.sqlite is damaged"):
        Index.open(index.folder)


def test_verify_says_what_it_can_of_a_table_that_cannot_be_read(index: Index, monkeypatch: pytest.MonkeyPatch) -> None:
    add(index, range(3))
    flip(index, 1)

    def unreadable(table: Catalog) -> list[str]:
        raise StoreError("the table is damaged")

    monkeypatch.setattr("salad.index.verify.catalog_trouble", unreadable)
    said = index.verify()
    assert said[0] == "the table is damaged"
    assert "1.jpg has a damaged descriptor" in said[1]


@pytest.mark.parametrize("rows", [4, 1 << 60])
def test_a_commit_of_more_rows_than_photos_is_told_and_harmless(index: Index, rows: int) -> None:
    add(index, range(3))
    with sqlite3.connect(index.folder / "photos.sqlite") as db:
        db.execute("UPDATE committed SET rows = ?", (rows,))
    db.close()
    assert f"it lists 3 photos up to row 2, but {rows} rows were committed" in index.verify()[0]
    assert found(index, 2) == "2"
    assert add(index, [3]) == 1
    assert index.verify() == []


@pytest.mark.parametrize(
    ("column", "value", "named"),
    [
        ("time", "yesterday", "time"),
        ("time", 5, "time"),
        ("lat", 99.5, "position"),
        ("lat", 1e308, "position"),
        ("lon", None, "position"),
        ("heading", "north", "heading"),
        ("heading", 360.5, "heading"),
        ("path", b"/a:\xc3", "path"),
        ("identity", b"1", "content"),
    ],
)
@pytest.mark.parametrize("checksum", [True, False], ids=["with its checksum", "without"])
def test_a_photo_that_makes_no_sense_is_named_and_can_be_used(
    index: Index, column: str, value: object, named: str, checksum: bool
) -> None:
    add(index, range(3))
    change_row(index.folder, 1, checksum=checksum, **{"lat": 1.0, "lon": 2.0, column: value})
    wrong = named if checksum else "record"
    assert [sentence for sentence in index.verify() if f"the {wrong} of " in sentence]
    (best,) = index.search(descriptors(["1"]), k=1)[0]
    assert checksum or (best.photo.where, best.photo.heading, best.photo.time) == (None, None, None)
    assert index.search(descriptors(["1"]), k=1)[0][0].row == 1
    assert [names(index)[0], names(index)[2]] == ["0", "2"]
    assert len(index.missing()) == 3


# --- what is gone ----------------------------------------------------------------------------


def test_photos_that_vanished_are_told_from_those_that_cannot_be_seen(index: Index, tmp_path: Path) -> None:
    there, loop = tmp_path / "a" / "there.jpg", tmp_path / "a" / "loop.jpg"
    gone = [tmp_path / "a" / "gone.jpg", tmp_path / "b" / "gone.jpg", there / "below a file.jpg"]
    there.parent.mkdir()
    there.touch()
    loop.symlink_to(loop)
    paths = [there, loop, *gone]
    index.add([Photo(path) for path in paths], descriptors(list("12345")), identities=list("12345"))
    assert sorted(index.missing()) == sorted(gone)
    assert index.missing([tmp_path / "b"]) == [gone[1]]
    assert index.remove_missing([tmp_path / "b"]) == [gone[1]]
    assert sorted(index.remove_missing()) == sorted(path for path in gone if path != gone[1])
    assert index.remove_missing() == []
    assert len(index) == 2


if __name__ == "__main__":
    serve()
