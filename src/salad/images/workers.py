"""Photos read in processes of their own, so that what a broken file does to a decoder stays there.

Decoders are C code that reads strangers' bytes: it may crash, hang or take all memory. Here it does so in a
helper, which costs the one photo; the helper is replaced and the rest goes on. A helper is a plain Python
started afresh (no fork of a process that runs threads, no second run of the caller's script) and ends when its
pipe does, however its parent ended.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any, TypeVar

from salad.errors import PhotoError, SaladError
from salad.images.decode import Pixels, decode
from salad.images.photo import Photo, content_hash, read_photo

# --- Reading a photo for somebody else: in this process, or as the whole work of another one ---
#
# `salad.images.workers` starts the other ones. They load what is imported here, the reading of photos, and no torch.


READY = "ready"
"""What a helper says first."""
MEMORY = 6 << 30
"""Bytes of address space a helper may have: twice what the largest photos need with their decoders' threads."""


def look(path: Path) -> tuple[Photo, str]:
    """A photo as its name and EXIF tell it, and its identity; no pixel is decoded.

    Raises:
        PhotoError: where it cannot be read.
    """
    return read_photo(path), content_hash(path)


TASKS: dict[str, Callable[..., Any]] = {"look": look, "decode": decode}


class Here:
    """Reads photos in this process: at once, for few of them, and trusting the decoders."""

    def look(self, path: Path) -> tuple[Photo, str]:
        """As the function `look`."""
        return look(path)

    def decode(self, path: Path, height: int, width: int, resample: str) -> Pixels:
        """As the function `decode`."""
        return decode(path, height, width, resample)

    def close(self) -> None:
        """There is nothing to let go of."""


def main() -> None:
    """What a helper runs: it answers until its pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is its parent's business
    _limit_memory(MEMORY)
    with os.fdopen(os.dup(1), "wb") as replies, Path(os.devnull).open("wb") as nothing:
        os.dup2(nothing.fileno(), 1)  # whatever a decoder prints must not get into an answer
        serve(sys.stdin.buffer, replies)


def serve(requests: IO[bytes], replies: IO[bytes]) -> None:
    """Answer one request after another, until there are no more or nobody reads the answers."""
    with suppress(EOFError, BrokenPipeError):
        put(READY, replies)
        while True:
            put(done(pickle.load(requests)), replies)


def done(request: tuple[Any, ...]) -> Any:
    """What a task of `TASKS` gives for its arguments, or the SaladError it raises."""
    task, *rest = request
    try:
        return TASKS[task](*rest)
    except SaladError as error:
        return error


def put(value: Any, stream: IO[bytes]) -> None:
    """Send a value at once."""
    pickle.dump(value, stream, protocol=5)
    stream.flush()


def _limit_memory(size: int) -> None:
    try:
        import resource
    except ImportError:  # not on Windows
        return
    with suppress(OSError, ValueError):
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        within = size if hard == resource.RLIM_INFINITY else min(size, hard)
        resource.setrlimit(resource.RLIMIT_AS, (within, hard))


SECONDS = 60.0
"""How long a photo may take; the largest ones take about 20."""
_STARTER = "from salad.images.workers import main; main()"

Process = subprocess.Popen[bytes]


class Helpers(Here):
    """Reads photos in helpers, for as many threads at a time as there are helpers; others wait their turn.

    Args:
        count: how many processes; each is started when it is first needed.
        seconds: how long a photo may take before it is given up.
    """

    def __init__(self, count: int, *, seconds: float = SECONDS) -> None:
        self._all = [_Helper(seconds) for _ in range(count)]
        self._free: SimpleQueue[_Helper] = SimpleQueue()
        for helper in self._all:
            self._free.put(helper)

    def look(self, path: Path) -> tuple[Photo, str]:
        """As `reading.look`.

        Raises:
            PhotoError: also where the photo crashed two helpers, or took too long.
        """
        photo, content = self._ask("look", path)
        return photo, content

    def decode(self, path: Path, height: int, width: int, resample: str) -> Pixels:
        """As `reading.decode`.

        Raises:
            PhotoError: also where the photo crashed two helpers, or took too long.
        """
        pixels: Pixels = self._ask("decode", path, height, width, resample)
        return pixels

    def close(self) -> None:
        """End the helpers at once, whatever they are doing."""
        for helper in self._all:
            helper.close()

    def _ask(self, *request: Any) -> Any:
        helper = self._free.get()
        try:
            return helper.ask(*request)
        finally:
            self._free.put(helper)


class _DiedError(Exception):
    """A helper ended in the middle of a photo; the message says how."""


class _Helper:
    """One process, asked by one thread at a time; started when needed, and again after it died."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._process: Process | None = None
        self._starting = threading.Lock()  # `close` may come from another thread
        self._closed = self._alone = False
        self._late = threading.Event()

    def ask(self, task: str, path: Path, *rest: Any) -> Any:
        """What the task gives, or the SaladError it raises."""
        try:
            value = self._answer(task, path, *rest)
        except _DiedError:  # perhaps not of this photo: whoever is short of memory ends any process
            try:
                value = self._answer(task, path, *rest)
            except _DiedError as error:
                raise PhotoError(
                    f"{path} crashes its decoder ({error}): fetch it again or leave it out"
                ) from error
        if isinstance(value, SaladError):
            raise value
        return value

    def close(self) -> None:
        """End the process; it is not started again."""
        self._closed = True
        with self._starting:
            if self._process is not None:
                _end(self._process)

    def _answer(self, *request: Any) -> Any:
        process = self._running()
        if process is None:
            return done(request)
        self._late.clear()
        timer = threading.Timer(self._seconds, self._give_up, [process])
        timer.daemon = True
        timer.start()
        try:
            return _exchange(process, request)
        except (OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
            raise self._told(process, request[1]) from error
        finally:
            timer.cancel()
            timer.join()

    def _running(self) -> Process | None:
        """The process, started where it does not run; None where none can be started on this system."""
        with self._starting:
            if self._closed:
                raise PhotoError("the reading of photos was stopped: run it again")
            if self._process is not None and self._process.poll() is not None:
                _end(self._process)
                self._process = None
            if self._process is None and not self._alone:
                self._process = _started()
                self._alone = self._process is None
            return self._process

    def _told(self, process: Process, path: Path) -> Exception:
        """What to say of a process whose answer did not come."""
        with suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
        cause = _cause(process.returncode)
        _end(process)
        if self._closed:
            return PhotoError(f"{path} was not read, since the reading of photos was stopped: run it again")
        if self._late.is_set():
            return PhotoError(f"{path} took over {self._seconds:g} s to read: save it anew or leave it out")
        return _DiedError(cause)

    def _give_up(self, process: Process) -> None:
        self._late.set()
        process.kill()


def _started() -> Process | None:
    """A helper that said it is ready, or None."""
    process: Process | None = None
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-c", _STARTER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=_environment(),
            start_new_session=True,  # Ctrl-C goes to every process of a session
        )
        if process.stdout is not None and pickle.load(process.stdout) == READY:
            return process
    except (OSError, ValueError, EOFError, pickle.UnpicklingError):
        pass
    if process is not None:
        _end(process)
    return None


def _environment() -> dict[str, str]:
    """Our own, with the folders we import from, and one thread for numpy, which has little to do there."""
    folders = os.pathsep.join(folder for folder in sys.path if folder)
    return {**os.environ, "PYTHONPATH": folders, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def _exchange(process: Process, request: tuple[Any, ...]) -> Any:
    assert process.stdin is not None
    assert process.stdout is not None
    put(request, process.stdin)
    return pickle.load(process.stdout)


def _end(process: Process) -> None:
    """Kill it where it runs still, and leave nothing of it behind."""
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with suppress(OSError):  # what was not sent is of no use any more
                stream.close()


def _cause(code: int | None) -> str:
    if code is None or code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return signal.Signals(-code).name
    return f"signal {-code}"


# --- The hands that read photos while the model works: threads, each with a helper process where there are many ---


T = TypeVar("T")
R = TypeVar("R")

FEW = 32
"""Fewer photos are read in threads: helpers would take longer to start."""
_LARGEST = 2 << 30  # bytes that the largest photo takes while it is decoded


@contextmanager
def workers() -> Iterator[Executor]:
    """Threads for reading photos; on an error or an interrupt what they have not begun is dropped."""
    pool = ThreadPoolExecutor(_hands(), thread_name_prefix="salad-photos")
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def reader_for(photos: int) -> Iterator[Here]:
    """What reads that many photos for the threads: helpers, unless there are few."""
    reader = Here() if photos < FEW else Helpers(_hands())
    try:
        yield reader
    finally:
        reader.close()


def _hands() -> int:
    """How many photos are read at a time: one a core, and each with memory for the largest photo there is."""
    hands = min(8, os.cpu_count() or 1)
    with suppress(AttributeError, OSError, ValueError):  # no such call, or no such number, on this system
        hands = min(hands, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // _LARGEST)
    return max(1, hands)


def in_order(pool: Executor, work: Callable[[T], R], items: Iterable[T], *, ahead: int) -> Iterator[R]:
    """`map` over `pool` that keeps the order and never has more than `ahead` items in hand."""
    source = iter(items)
    waiting: deque[Future[R]] = deque()
    while True:
        waiting.extend(pool.submit(work, item) for item in islice(source, ahead - len(waiting)))
        if not waiting:
            return
        yield waiting.popleft().result()
