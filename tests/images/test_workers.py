"""Workers read photos as this process would, and one that dies or dawdles costs its photo only."""

from __future__ import annotations

import io
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from salad.errors import PhotoError
from salad.geo import GeoPoint
from salad.images import worker_process, workers
from salad.images.decode import decode, open_rgb
from salad.images.exif import save_jpeg
from salad.images.named import HeldPhoto
from salad.images.photo import content_hash, read_photo
from salad.images.worker_process import PhotoRead, read
from salad.images.workers import Pool, Workers

# A worker process in which some photos do what broken ones do to a decoder.
TRICKED = """
import os, signal, sys, time
from salad.images import worker_process as reading

honest = reading.TASKS["decode"]

def tricked(path, *rest):
    print("noise on stdout")
    if "kills" in path.name: os.kill(os.getpid(), signal.SIGKILL)
    if "once" in path.name and not path.with_name("been").exists():
        path.with_name("been").touch()
        os._exit(3)
    if "exits" in path.name: os._exit(3)
    if "hangs" in path.name: time.sleep(600)
    if "swells" in path.name: bytearray(1 << 40)
    if "lean" in path.name: assert not sys.modules.keys() & {"torch", "tyro", "numpy"}
    return honest(path, *rest)

reading.TASKS["decode"] = tricked
reading.main()
"""
SHAPE = (24, 32, "bilinear")
MANY = 64  # photos that are worth several processes


def photo(path: Path, seed: int = 0) -> Path:
    pixels = np.random.default_rng(seed).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    save_jpeg(pixels, path, where=GeoPoint(1, 2), heading=3, time=datetime(2024, 5, 31, 14, 0, 1))
    return path


@pytest.fixture
def pool() -> Iterator[Pool]:
    made = Pool()
    yield made
    made.close()


@pytest.fixture
def crew(pool: Pool) -> Iterator[Workers]:
    with Workers(MANY, at_once=2, pool=pool) as made:
        yield made


@pytest.fixture
def tricky() -> Iterator[Pool]:
    made = Pool(TRICKED)
    yield made
    made.close()


@pytest.fixture
def tricked(tricky: Pool) -> Iterator[Workers]:
    with Workers(MANY, at_once=2, seconds=60, pool=tricky) as made:
        yield made


def pids(pool: Pool) -> list[int]:
    return [one._process.pid for one in pool._free if one._process is not None]


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_processes_read_as_this_process_does(crew: Workers, pool: Pool, tmp_path: Path) -> None:
    paths = [photo(tmp_path / f"写真 @home {n}.jpg", n) for n in range(6)]
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(crew.read, paths))
        decoded = list(threads.map(lambda path: crew.decode(path, *SHAPE), paths))
    assert found == [PhotoRead(read_photo(path), content_hash(path)) for path in paths]
    for path, pixels in zip(paths, decoded, strict=True):
        assert np.array_equal(pixels, decode(path, *SHAPE))
    assert 1 <= len(pids(pool)) <= 2


def test_photos_are_shown_and_looked_at_as_by_this_process(crew: Workers, tmp_path: Path) -> None:
    path = photo(tmp_path / "a.jpg")
    shown = open_rgb(path)
    shown.thumbnail((20, 20), Image.Resampling.LANCZOS)
    held = HeldPhoto(path, content_hash(path))
    for source in (path, held):
        assert np.array_equal(crew.show(source, 20), np.asarray(shown))
        assert np.array_equal(crew.decode(source, *SHAPE), decode(path, *SHAPE))
    assert crew.show(path, 1000).shape == (40, 50, 3)
    assert crew.look(path) == read_photo(path)
    photo(path, 1)
    with pytest.raises(PhotoError, match="changed or is gone"):
        crew.decode(held, *SHAPE)


def test_their_errors_are_ours(crew: Workers, pool: Pool, tmp_path: Path) -> None:
    (tmp_path / "empty.jpg").touch()
    with pytest.raises(PhotoError, match=r"empty\.jpg is empty"):
        crew.decode(tmp_path / "empty.jpg", *SHAPE)
    for ask in (crew.read, crew.look):
        with pytest.raises(PhotoError, match="no photo at"):
            ask(tmp_path / "gone.jpg")
    assert len(pids(pool)) == 1  # whoever said so lives


def test_a_crash_costs_one_photo(tricked: Workers, tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match=r"kills\.jpg crashes its decoder \(SIGKILL\)"):
        tricked.decode(photo(tmp_path / "kills.jpg"), *SHAPE)
    with pytest.raises(PhotoError, match=r"exits\.jpg crashes its decoder \(exit code 3\)"):
        tricked.decode(photo(tmp_path / "exits.jpg"), *SHAPE)
    for name in ("good.jpg", "lean.jpg", "once.jpg"):  # an end without a cause is no fault of the photo's
        assert tricked.decode(photo(tmp_path / name), *SHAPE).shape == (24, 32, 3)
    assert (tmp_path / "been").exists()


def test_a_process_has_its_share_of_memory(tricked: Workers, tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match="crashes its decoder"):
        tricked.decode(photo(tmp_path / "swells.jpg"), *SHAPE)


def test_a_photo_that_takes_too_long_is_given_up(tricky: Pool, tmp_path: Path) -> None:
    hangs = photo(tmp_path / "hangs.jpg")
    with Workers(MANY, at_once=1, seconds=1.0, pool=tricky) as crew, pytest.raises(PhotoError, match="took over 1 s"):
        crew.decode(hangs, *SHAPE)
    with Workers(MANY, at_once=1, pool=tricky) as crew:
        assert crew.decode(photo(tmp_path / "good.jpg"), *SHAPE).shape == (24, 32, 3)


def test_one_that_died_between_photos_is_replaced(crew: Workers, pool: Pool, tmp_path: Path) -> None:
    path = photo(tmp_path / "a.jpg")
    crew.read(path)
    for pid in pids(pool):
        os.kill(pid, signal.SIGKILL)
    assert [crew.read(path).content_hash for _ in range(2)] == [content_hash(path)] * 2


def test_closing_ends_what_hangs(tricked: Workers, tricky: Pool, tmp_path: Path) -> None:
    hangs = photo(tmp_path / "hangs.jpg")
    with ThreadPoolExecutor(1) as pool:
        tricked.read(hangs)
        running = pids(tricky)
        waiting = pool.submit(tricked.decode, hangs, *SHAPE)
        while tricky._free:  # until it is asked
            time.sleep(0.01)
        tricked.close()
        with pytest.raises(PhotoError, match="was stopped"):
            waiting.result()
    assert not any(map(is_running, running))
    with pytest.raises(PhotoError, match="was stopped"):
        tricked.read(hangs)


def test_closing_wakes_who_waits_for_a_turn(tricky: Pool, tmp_path: Path) -> None:
    crew = Workers(MANY, at_once=1, pool=tricky)
    with ThreadPoolExecutor(3) as threads:
        waiting = [threads.submit(crew.decode, photo(tmp_path / f"hangs {n}.jpg"), *SHAPE) for n in range(3)]
        while not tricky._lent:
            time.sleep(0.01)
        crew.close()
        for one in waiting:
            with pytest.raises(PhotoError, match="was stopped"):
                one.result()


@pytest.mark.parametrize("starter", ["raise SystemExit", "print('no worker')", "import no_such_module"])
def test_where_none_can_be_started_this_process_reads(tmp_path: Path, starter: str) -> None:
    pool = Pool(starter)
    pool.prepare()
    path = photo(tmp_path / "a.jpg")
    with Workers(1, pool=pool) as crew:
        assert crew.read(path) == read(path)
        with pytest.raises(PhotoError, match="no photo at"):
            crew.read(tmp_path / "gone.jpg")


@pytest.mark.parametrize("how", ["no python", "within an application"])
def test_where_there_is_no_python_to_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pool: Pool, how: str
) -> None:
    if how == "no python":
        monkeypatch.setattr(sys, "executable", str(tmp_path / "no-python"))
    else:
        monkeypatch.setattr(sys, "frozen", True, raising=False)
    pool.prepare()
    with Workers(1, pool=pool) as crew:
        assert crew.read(photo(tmp_path / "a.jpg")).content_hash == content_hash(tmp_path / "a.jpg")
    assert pids(pool) == []


def test_signals_without_a_name_are_told_by_number(pool: Pool, tmp_path: Path) -> None:
    class Dead:
        stdin = stdout = None
        returncode = -250
        wait = kill = lambda self, *_: None

    process = pool.take(1, lambda: False)
    assert str(process._failed(Dead(), tmp_path, 1.0)) == "signal 250"


# --- kept from call to call ----------------------------------------------------------------


def test_processes_are_kept_for_the_next_call(pool: Pool, tmp_path: Path) -> None:
    path, seen = photo(tmp_path / "a.jpg"), set()
    for _ in range(5):
        with Workers(1, pool=pool) as crew:
            crew.read(path)
        seen.update(pids(pool))
    assert len(seen) == 1
    pool.close()
    assert not any(map(is_running, seen))
    with Workers(1, pool=pool) as crew:  # a pool that was closed begins anew
        assert crew.read(path) == read(path)


@pytest.mark.parametrize(("photos", "processes"), [(1, 1), (workers.EACH, 1), (3 * workers.EACH, 3)])
def test_few_photos_start_few(
    pool: Pool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, photos: int, processes: int
) -> None:
    monkeypatch.setattr(workers, "photos_at_once", lambda: 4)
    path = photo(tmp_path / "a.jpg")
    with Workers(photos, pool=pool) as crew:
        assert len(list(crew.in_order(crew.read, [path] * photos, ahead=photos))) == photos
        assert len(pids(pool)) <= processes


def test_one_is_started_before_there_is_a_photo(pool: Pool, tmp_path: Path) -> None:
    pool.prepare()
    (pid,) = pids(pool)
    pool.prepare()  # once is enough
    with Workers(1, pool=pool) as crew:
        crew.read(photo(tmp_path / "a.jpg"))
    assert pids(pool) == [pid]


def test_paths_are_from_where_the_caller_is_now(crew: Workers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for seed, name in enumerate(("here", "there")):
        (tmp_path / name).mkdir()
        photo(tmp_path / name / "a.jpg", seed)
        monkeypatch.chdir(tmp_path / name)
        assert crew.read(Path("a.jpg")) == PhotoRead(read_photo(Path("a.jpg")), content_hash(tmp_path / name / "a.jpg"))


def test_several_share_no_more_processes_than_the_machine_bears(
    pool: Pool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "photos_at_once", lambda: 2)
    path = photo(tmp_path / "a.jpg")

    def one(_: int) -> str:
        with Workers(1, pool=pool) as crew:
            return crew.read(path).content_hash

    with ThreadPoolExecutor(8) as threads:
        assert set(threads.map(one, range(40))) == {content_hash(path)}
    assert 1 <= len(pids(pool)) <= 2


FORKING = """
import os, sys
from pathlib import Path
from salad.images import workers

path = Path(sys.argv[1])

def read():
    with workers.Workers(1) as crew:
        return crew.read(path).content_hash, crew._pool._free

due, free = read()
mine = free[0]._process.pid
child = os.fork()
if not child:
    assert workers.SHARED._free == []
    same, free = read()
    os._exit(0 if same == due and free[0]._process.pid != mine else 1)
assert read()[0] == due  # while the child reads too
assert os.waitpid(child, 0)[1] == 0
again, free = read()
assert (again, free[0]._process.pid) == (due, mine)
print(mine)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="only Unix forks")
def test_a_fork_has_processes_of_its_own_and_none_is_left_behind(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", "-c", FORKING, photo(tmp_path / "a.jpg")]
    ran = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert not is_running(int(ran.stdout))


# --- the other side ------------------------------------------------------------------------


def test_main_answers_until_its_pipe_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, limits = photo(tmp_path / "a.jpg"), []
    due = read(path)
    requests = pickle.dumps((".", "read", path)) + pickle.dumps(("/", "decode", tmp_path / "gone.jpg", *SHAPE))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(requests)))
    monkeypatch.setattr("resource.setrlimit", lambda *limit: limits.append(limit))
    monkeypatch.setattr(worker_process, "LIMITS", worker_process.Limits())
    read_end, write_end = os.pipe()
    stdout, handlers = os.dup(1), {which: signal.getsignal(which) for which in (signal.SIGINT, signal.SIGALRM)}
    os.dup2(write_end, 1)
    try:
        worker_process.main()
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)
        os.close(write_end)
        for which, handler in handlers.items():
            signal.signal(which, handler)
    with os.fdopen(read_end, "rb") as replies:
        answers = [pickle.load(replies) for _ in range(3)]
        assert replies.read() == b""
    assert answers[:2] == [worker_process.READY, due]
    assert isinstance(answers[2], PhotoError)
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)
    held = worker_process._address_space() + worker_process.LARGEST_MEMORY
    assert all(within <= held for _, (within, _) in limits)


def test_without_limits_it_reads_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    worker_process.limit_memory(1)


def test_one_trip_brings_all_of_a_photo_from_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, opened = photo(tmp_path / "a.jpg"), []
    due = PhotoRead(read_photo(path), content_hash(path), decode(path, *SHAPE))
    honest = os.open
    monkeypatch.setattr(os, "open", lambda path, *how: opened.append(path) or honest(path, *how))
    found = read(path, SHAPE)
    assert found[:2] == due[:2]
    assert np.array_equal(found.pixels, due.pixels)
    assert opened.count(path) == 1  # what may stand beside it is looked for too
    assert read(path) == PhotoRead(*due[:2])
    assert opened.count(path) == 2


def test_a_photo_that_cannot_be_decoded_is_known_all_the_same(tmp_path: Path) -> None:
    path = photo(tmp_path / "cut.jpg")
    path.write_bytes(path.read_bytes()[:-300])
    found = read(path, SHAPE)
    assert (found.photo, found.content_hash, found.pixels) == (read_photo(path), content_hash(path), None)
    assert "cut.jpg is damaged" in found.trouble


def test_what_is_on_its_way_is_bounded_and_in_order() -> None:
    begun: list[int] = []
    most = 0
    with Workers(0) as made:
        for number, result in enumerate(made.in_order(lambda n: begun.append(n) or n, range(50), ahead=4)):
            assert result == number
            most = max(most, len(begun) - number)
    assert most <= 5


@pytest.mark.parametrize(("memory", "count"), [(1 << 20, 1), (5 << 30, 2), (1 << 40, 8)])
def test_no_more_are_read_at_once_than_memory_allows(memory: int, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "processors", lambda: 64)
    monkeypatch.setattr(os, "sysconf", lambda name: 1 if name == "SC_PAGE_SIZE" else memory)
    assert workers.photos_at_once() == count
