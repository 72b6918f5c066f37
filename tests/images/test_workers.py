"""Workers read photos as this process would, and one that dies or dawdles costs its photo only."""

from __future__ import annotations

import io
import os
import pickle
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from salad.errors import PhotoError
from salad.geo import GeoPoint
from salad.images import workers
from salad.images.metadata import save_jpeg
from salad.images.photo import content_hash, read_photo
from salad.images.workers import PhotoRead, Workers

# A worker process in which some photos do what broken ones do to a decoder.
TRICKED = """
import os, signal, sys, time
from salad.images import workers as reading

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
    if "torch" in path.name: assert "torch" not in sys.modules and "tyro" not in sys.modules
    return honest(path, *rest)

reading.TASKS["decode"] = tricked
reading.main()
"""
SHAPE = (24, 32, "bilinear")
FEW = workers.FEW


def photo(path: Path, seed: int = 0) -> Path:
    pixels = np.random.default_rng(seed).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    save_jpeg(pixels, path, where=GeoPoint(1, 2), heading=3, time=datetime(2024, 5, 31, 14, 0, 1))
    return path


@pytest.fixture
def crew() -> Iterator[Workers]:
    with Workers(FEW, at_once=2) as made:
        yield made


@pytest.fixture
def tricked(monkeypatch: pytest.MonkeyPatch) -> Iterator[Workers]:
    monkeypatch.setattr(workers, "_STARTER", TRICKED)
    with Workers(FEW, at_once=2, seconds=60) as made:
        yield made


def pids(crew: Workers) -> list[int]:
    return [one._process.pid for one in crew._processes if one._process is not None]


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_processes_read_as_this_process_does(crew: Workers, tmp_path: Path) -> None:
    paths = [photo(tmp_path / f"写真 @home {n}.jpg", n) for n in range(6)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(crew.read, paths))
        decoded = list(pool.map(lambda path: crew.decode(path, *SHAPE), paths))
    assert found == [PhotoRead(read_photo(path), content_hash(path)) for path in paths]
    for path, pixels in zip(paths, decoded, strict=True):
        assert np.array_equal(pixels, workers.decode(path, *SHAPE))
    assert len(pids(crew)) <= 2


def test_their_errors_are_ours(crew: Workers, tmp_path: Path) -> None:
    (tmp_path / "empty.jpg").touch()
    with pytest.raises(PhotoError, match=r"empty\.jpg is empty"):
        crew.decode(tmp_path / "empty.jpg", *SHAPE)
    with pytest.raises(PhotoError, match="no photo at"):
        crew.read(tmp_path / "gone.jpg")
    assert len(pids(crew)) <= 2


def test_a_crash_costs_one_photo(tricked: Workers, tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match=r"kills\.jpg crashes its decoder \(SIGKILL\)"):
        tricked.decode(photo(tmp_path / "kills.jpg"), *SHAPE)
    with pytest.raises(PhotoError, match=r"exits\.jpg crashes its decoder \(exit code 3\)"):
        tricked.decode(photo(tmp_path / "exits.jpg"), *SHAPE)
    for name in ("good.jpg", "torch.jpg", "once.jpg"):  # an end without a cause is no fault of the photo's
        assert tricked.decode(photo(tmp_path / name), *SHAPE).shape == (24, 32, 3)
    assert (tmp_path / "been").exists()


def test_a_process_has_its_share_of_memory(tricked: Workers, tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match="crashes its decoder"):
        tricked.decode(photo(tmp_path / "swells.jpg"), *SHAPE)


def test_a_photo_that_takes_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_STARTER", TRICKED)
    crew = Workers(FEW, at_once=1, seconds=1.0)
    try:
        with pytest.raises(PhotoError, match=r"hangs\.jpg took over 1 s to read"):
            crew.decode(photo(tmp_path / "hangs.jpg"), *SHAPE)
        crew._processes[0]._seconds = 60
        assert crew.decode(photo(tmp_path / "good.jpg"), *SHAPE).shape == (24, 32, 3)
    finally:
        crew.close()


def test_one_that_died_between_photos_is_replaced(crew: Workers, tmp_path: Path) -> None:
    path = photo(tmp_path / "a.jpg")
    crew.read(path)
    for pid in pids(crew):
        os.kill(pid, signal.SIGKILL)
    assert [crew.read(path).content_hash for _ in range(2)] == [content_hash(path)] * 2


def test_closing_ends_what_hangs(tricked: Workers, tmp_path: Path) -> None:
    hangs = photo(tmp_path / "hangs.jpg")
    with ThreadPoolExecutor(1) as pool:
        tricked.read(hangs)
        waiting = pool.submit(tricked.decode, hangs, *SHAPE)
        running = pids(tricked)
        tricked.close()
        with pytest.raises(PhotoError, match="was stopped"):
            waiting.result()
    assert not any(map(is_running, running))
    with pytest.raises(PhotoError, match="was stopped"):
        tricked.read(hangs)


@pytest.mark.parametrize("starter", ["raise SystemExit", "print('no worker')", "import no_such_module"])
def test_where_none_can_be_started_this_process_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, starter: str
) -> None:
    monkeypatch.setattr(workers, "_STARTER", starter)
    crew = Workers(FEW, at_once=1)
    path = photo(tmp_path / "a.jpg")
    assert crew.read(path) == workers.read(path)
    with pytest.raises(PhotoError, match="no photo at"):
        crew.read(tmp_path / "gone.jpg")
    crew.close()


def test_where_there_is_no_python_to_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no-python"))
    crew = Workers(FEW, at_once=1)
    assert crew.read(photo(tmp_path / "a.jpg")).content_hash == content_hash(tmp_path / "a.jpg")
    crew.close()


def test_signals_without_a_name_are_told_by_number(crew: Workers, tmp_path: Path) -> None:
    class Dead:
        stdin = stdout = None
        returncode = -250
        wait = kill = lambda self, *_: None

    assert str(crew._processes[0]._failed(Dead(), tmp_path)) == "signal 250"


# --- the other side ------------------------------------------------------------------------


def test_main_answers_until_its_pipe_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, limits = photo(tmp_path / "a.jpg"), []
    requests = pickle.dumps(("read", path)) + pickle.dumps(("decode", tmp_path / "gone.jpg", *SHAPE))
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(requests)))
    monkeypatch.setattr("resource.setrlimit", lambda *limit: limits.append(limit))
    read, write = os.pipe()
    stdout, interrupt = os.dup(1), signal.getsignal(signal.SIGINT)
    os.dup2(write, 1)
    try:
        workers.main()
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)
        os.close(write)
        signal.signal(signal.SIGINT, interrupt)
    with os.fdopen(read, "rb") as replies:
        answers = [pickle.load(replies) for _ in range(3)]
        assert replies.read() == b""
    assert answers[:2] == [workers.READY, workers.read(path)]
    assert isinstance(answers[2], PhotoError)
    assert limits[0][1][0] <= workers.MEMORY


def test_without_limits_it_reads_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    workers.limit_memory(1)


def test_reading_here_needs_no_process(tmp_path: Path) -> None:
    here, before = Workers(FEW - 1), threading.active_count()
    path = photo(tmp_path / "a.jpg")
    assert here.read(path) == workers.read(path)
    assert np.array_equal(here.decode(path, *SHAPE), workers.decode(path, *SHAPE))
    here.close()
    assert threading.active_count() == before


def test_one_trip_brings_all_of_a_photo_from_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, opened = photo(tmp_path / "a.jpg"), []
    due = PhotoRead(read_photo(path), content_hash(path), workers.decode(path, *SHAPE))
    honest = Path.open
    monkeypatch.setattr(Path, "open", lambda self, *how: opened.append(self) or honest(self, *how))
    for held in (workers._HELD, 0):  # in memory, or gone through twice
        monkeypatch.setattr(workers, "_HELD", held)
        found = workers.read(path, SHAPE)
        assert found[:2] == due[:2]
        assert np.array_equal(found.pixels, due.pixels)
        assert opened.pop() == path
        assert workers.read(path) == (*due[:2], None, "")
        assert opened.pop() == path
        assert opened == []


def test_a_photo_that_cannot_be_decoded_is_known_all_the_same(tmp_path: Path) -> None:
    path = photo(tmp_path / "cut.jpg")
    path.write_bytes(path.read_bytes()[:-300])
    found = workers.read(path, SHAPE)
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
