"""Photos read while the model works, by processes of their own, whether it is one photo or a million.

Decoders are C code that reads strangers' bytes: it may crash, hang or take all memory. In a worker process it does
so to that process, which costs the one photo; the process is replaced and the rest goes on. It is a plain Python
started afresh (no fork of a process that runs threads, no second run of the caller's script), it loads what
`worker_process.py` imports and no torch, and it ends when its pipe does, however its parent ended.

To start one takes as long as to decode several photos. So there are no more than the photos are worth, `prepare`
starts the first while a model loads, and all are kept for the next call.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from salad.errors import PhotoError, SaladError
from salad.images.decode import Pixels, as_pixels
from salad.images.metadata import Position
from salad.images.photo import Photo
from salad.images.worker_process import READY, PhotoRead, Size, Source, answer, send
from salad.processors import processors

SECONDS = 70.0
"""How long a photo may take in all; a process gives it less (`worker_process.SECONDS`), and this stands behind that."""
EACH = 16
"""Photos for which one process more is worth its start."""

_LARGEST = 2 << 30  # bytes that the largest photo takes while it is decoded
_ANSWER = 1 << 20  # bytes that a pipe holds: pixels go through in one piece, not in five with a change of process each
_AGAIN = 60.0  # seconds after which it is tried again whether a process can be started
_STARTER = "from salad.images.worker_process import main; main()"
_SETTINGS = {
    # One thread for numpy, which has little to do.
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    # Linux's allocator keeps the memory of a photo for the next: to hand it back each time costs a fifth.
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(128 << 20),
    # And has one arena, since each takes 64 MB of the address space that a photo's decoder is held to.
    "MALLOC_ARENA_MAX": "1",
}

Popen = subprocess.Popen[bytes]
T = TypeVar("T")
R = TypeVar("R")


class Workers:
    """Reads photos for the model: in as many threads as they are worth, each of which asks a process.

    Use it as a context manager; on an error or an interrupt what has not begun is dropped, and what has is ended.

    Args:
        photos: How many are to be read.
        at_once: How many are read at a time at most; as many as there are processors and memory for where not given.
        seconds: How long a photo may take before it is given up.
        pool: Where the processes come from; the one that all share where not given.
    """

    def __init__(
        self, photos: int, *, at_once: int | None = None, seconds: float = SECONDS, pool: Pool | None = None
    ) -> None:
        worth = photos if at_once else -(-photos // EACH)
        self._most = max(1, min(worth, at_once or photos_at_once()))
        self._seconds = seconds
        self._pool = pool or SHARED
        self._threads = ThreadPoolExecutor(self._most, thread_name_prefix="salad-photos")
        self._turns = threading.BoundedSemaphore(self._most)  # others than our threads may ask
        self._lock = threading.Lock()  # of the two below: `close` may come from another thread
        self._closed = False
        self._busy: set[_Process] = set()

    def read(self, path: Path, size: Size | None = None) -> PhotoRead:
        """Everything about a photo, from one reading of its file; its pixels where a size is given.

        Raises:
            PhotoError: If the file cannot be read, crashed two processes or took too long.
        """
        found: PhotoRead = self.ask("read", path, size)
        return found

    def decode(self, photo: Source, height: int, width: int, resample: str) -> Pixels:
        """As `salad.images.decode.decode`.

        Raises:
            PhotoError: If the photo cannot be read, crashed two processes or took too long.
        """
        return as_pixels(self.ask("decode", photo, height, width, resample))

    def show(self, photo: Source, side: int) -> Pixels:
        """A photo for people, `[height, width, 3]`, whose longer side has `side` pixels at most.

        Raises:
            PhotoError: If the photo cannot be read, crashed two processes or took too long.
        """
        return as_pixels(self.ask("show", photo, side))

    def look(self, path: Path) -> Photo:
        """What a photo's name and EXIF say; only the head of its file is read.

        Raises:
            PhotoError: If there is no such file, or it crashed two processes or took too long.
        """
        photo: Photo = self.ask("look", path)
        return photo

    def said(self, path: Path) -> list[Position]:
        """All that a photo's name, its file and the files beside it say of it, each on its own, who wins first.

        Raises:
            PhotoError: If there is no such file, or it crashed two processes or took too long.
        """
        found: list[Position] = self.ask("said", path)
        return found

    def ask(self, task: str, photo: Source, *rest: Any) -> Any:
        """What a task of `worker_process.TASKS` gives for a photo; where no process is free, it waits for one.

        Raises:
            PhotoError: If the photo cannot be read, crashed two processes or took too long.
        """
        with self._turns:
            process = self._pool.take(self._most, lambda: self._closed)
            try:
                with self._lock:
                    self._busy.add(process)
                return process.ask(task, photo, *rest, seconds=self._seconds, stopped=lambda: self._closed)
            finally:
                with self._lock:
                    self._busy.discard(process)
                self._pool.give(process)

    def submit(self, work: Callable[..., R], *arguments: Any) -> Future[R]:
        """Have a thread do this work."""
        return self._threads.submit(work, *arguments)

    def in_order(self, work: Callable[[T], R], items: Iterable[T], *, ahead: int) -> Iterator[R]:
        """`map` by threads that keeps the order and never has more than `ahead` items on their way."""
        source = iter(items)
        waiting: deque[Future[R]] = deque()
        while True:
            waiting.extend(self.submit(work, item) for item in islice(source, ahead - len(waiting)))
            if not waiting:
                return
            yield waiting.popleft().result()

    def close(self) -> None:
        """End at once what still reads for these workers, and their threads after it; other processes are kept."""
        with self._lock:
            self._closed = True
            busy = list(self._busy)
        for process in busy:
            process.end()
        self._pool.wake()
        self._threads.shutdown(cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def photos_at_once() -> int:
    """How many photos are read at a time: one a processor, and each with memory for the largest photo there is."""
    count = min(8, processors())
    with suppress(AttributeError, OSError, ValueError):  # no such call, or no such number, on this system
        count = min(count, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // _LARGEST)
    return max(1, count)


def prepare() -> None:
    """Start a process for the photos to come, without waiting for it: a model may be loaded meanwhile."""
    SHARED.prepare()


# --- the processes that wait for photos ----------------------------------------------------


class Pool:
    """Worker processes, kept from one call to the next; whoever is in need of one takes it, and gives it back.

    Args:
        starter: What a process runs.
    """

    def __init__(self, starter: str = _STARTER) -> None:
        self._starter = starter
        self._changed = threading.Condition()
        self._free: list[_Process] = []
        self._lent = 0

    def take(self, most: int, given_up: Callable[[], bool]) -> _Process:
        """A process; waits while `most` are lent, to whomever, or until it is given up.

        Raises:
            PhotoError: If it was given up.
        """
        with self._changed:
            self._changed.wait_for(lambda: given_up() or self._lent < max(most, photos_at_once()))
            if given_up():
                raise PhotoError("the reading of photos was stopped: run it again")
            self._lent += 1
            # The one that came back last: so that few photos start few.
            return self._free.pop() if self._free else _Process(self._starter)

    def give(self, process: _Process) -> None:
        """Take back a process."""
        with self._changed:
            self._lent -= 1
            kept = len(self._free) < photos_at_once()
            if kept:
                self._free.append(process)
            self._changed.notify()
        if not kept:
            process.end()

    def wake(self) -> None:
        """Have those who wait look whether they still want to."""
        with self._changed:
            self._changed.notify_all()

    def prepare(self) -> None:
        """Start a process where none waits."""
        with self._changed:
            if not self._free:
                self._free.append(_Process(self._starter))
            self._free[-1].begin()

    def close(self) -> None:
        """End the processes that wait; who asks again gets new ones."""
        with self._changed:
            free, self._free = self._free, []
        for process in free:
            process.end()

    def forget(self) -> None:
        """After a fork, in the child: the processes are the parent's, and so is what comes out of their pipes."""
        free, self._free, self._lent = self._free, [], 0
        self._changed = threading.Condition()  # the old one may be held by a thread that is not here
        for process in free:
            process.forget()


SHARED = Pool()
"""The processes of this process: the one thing here that outlives a call, so that calls need not wait for a start."""
atexit.register(SHARED.close)
if hasattr(os, "register_at_fork"):  # not on Windows, where nothing forks
    os.register_at_fork(after_in_child=SHARED.forget)


# --- a worker process, as its parent sees it -----------------------------------------------


class _DiedError(Exception):
    """A process ended in the middle of a photo; the message says how."""


class _Process:
    """One process, asked by one thread at a time; started when needed, and again after it died."""

    def __init__(self, starter: str) -> None:
        self._starter = starter
        self._process: Popen | None = None
        self._is_ready = False
        self._alone_until = 0.0  # where none can be started: when to try again
        self._starting = threading.Lock()  # `end` may come from another thread
        self._late = threading.Event()

    def ask(self, task: str, photo: Source, *rest: Any, seconds: float, stopped: Callable[[], bool]) -> Any:
        """What the task gives, or the SaladError it raises.

        Args:
            task: By its name.
            photo: Which photo.
            rest: The task's other arguments.
            seconds: How long it may take.
            stopped: Whether nobody waits for it any more, as somebody says who then calls `end`.
        """
        asked = (task, photo, *rest)
        path = photo if isinstance(photo, Path) else photo.path
        try:
            value = self._answer(asked, path, seconds, stopped)
        except _DiedError:  # perhaps not of this photo: whoever is short of memory ends any process
            try:
                value = self._answer(asked, path, seconds, stopped)
            except _DiedError as error:
                raise PhotoError(f"{path} crashes its decoder ({error}): fetch it again or leave it out") from error
        if isinstance(value, SaladError):
            raise value
        return value

    def begin(self) -> None:
        """Start the process without waiting for it."""
        with self._starting:
            if self._process is None:
                self._process = self._start()

    def end(self) -> None:
        """End the process, whatever it is doing; it is started again where it is asked again."""
        with self._starting:
            if self._process is not None:
                _end(self._process)
                self._process = None

    def forget(self) -> None:
        """Let go of a process of somebody else's, which goes on."""
        if self._process is not None:
            self._process.returncode = 0  # or Python would complain that it was not waited for
            _close(self._process)
            self._process = None

    def _answer(self, asked: tuple[Any, ...], path: Path, seconds: float, stopped: Callable[[], bool]) -> Any:
        process = self._running(stopped)
        if process is None:
            return answer(*asked)
        assert process.stdin is not None
        assert process.stdout is not None
        self._late.clear()
        timer = threading.Timer(seconds, self._give_up, [process])
        timer.daemon = True
        timer.start()
        begun = time.monotonic()
        try:
            send((os.curdir if path.is_absolute() else _here(), *asked), process.stdin)
            return pickle.load(process.stdout)  # nosec B301  # from a process that runs as who runs this one
        except (OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
            failed = self._failed(process, path, time.monotonic() - begun)
            if stopped():
                failed = PhotoError(f"{path} was not read, since the reading of photos was stopped: run it again")
            raise failed from error
        finally:
            timer.cancel()
            timer.join()

    def _running(self, stopped: Callable[[], bool]) -> Popen | None:
        """The process, started where it does not run; None where none can be started on this system."""
        with self._starting:
            if stopped():
                raise PhotoError("the reading of photos was stopped: run it again")
            if self._process is not None and self._process.poll() is not None:
                _end(self._process)
                self._process = None
            if self._process is None and time.monotonic() >= self._alone_until:
                self._process = self._start()
            if self._process is not None and not self._is_ready:
                self._is_ready = _says_ready(self._process)
                if not self._is_ready:
                    _end(self._process)
                    self._process = None
            if self._process is None and time.monotonic() >= self._alone_until:
                self._alone_until = time.monotonic() + _AGAIN
            return self._process

    def _start(self) -> Popen | None:
        """A process that will say that it is ready; None where none can be started."""
        self._is_ready = False
        if getattr(sys, "frozen", False):  # an application that has Python within it, which would start itself
            return None
        # The folders we import from, which a script may have added to.
        folders = os.pathsep.join(os.path.abspath(folder) for folder in sys.path if folder)  # noqa: PTH100  # texts
        try:
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", self._starter],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": folders, **_SETTINGS},
                start_new_session=True,  # Ctrl-C goes to every process of a session
            )
        except (OSError, ValueError):
            return None
        with suppress(ImportError, AttributeError, OSError):  # Linux's; and a user may have only so many of them
            import fcntl

            assert process.stdout is not None
            fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, _ANSWER)
        return process

    def _failed(self, process: Popen, path: Path, seconds: float) -> Exception:
        """What to say of a process whose answer did not come in so many seconds."""
        with suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
        code = process.returncode
        self._bury(process)
        if self._late.is_set() or (hasattr(signal, "SIGALRM") and code == -signal.SIGALRM):
            return PhotoError(f"{path} took over {int(seconds)} s to read: save it anew or leave it out")
        if code is None or code >= 0:
            return _DiedError(f"exit code {code}")
        with suppress(ValueError):
            return _DiedError(signal.Signals(-code).name)
        return _DiedError(f"signal {-code}")

    def _bury(self, process: Popen) -> None:
        with self._starting:
            _end(process)
            if self._process is process:
                self._process = None

    def _give_up(self, process: Popen) -> None:
        self._late.set()
        process.kill()


def _here() -> str:
    """The folder that relative paths start from, which may have changed since a process was started."""
    try:
        return os.getcwd()  # noqa: PTH109  # a text is what goes through the pipe
    except OSError:  # it was removed: nothing is below it
        return os.curdir


def _says_ready(process: Popen) -> bool:
    try:
        return process.stdout is not None and pickle.load(process.stdout) == READY  # nosec B301  # as below
    except (OSError, ValueError, EOFError, pickle.UnpicklingError):
        return False


def _end(process: Popen) -> None:
    """Kill it where it runs still, and leave nothing of it behind."""
    process.kill()
    process.wait()
    _close(process)


def _close(process: Popen) -> None:
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with suppress(OSError):  # what was not sent is of no use any more
                stream.close()
