"""Photos read while the model works: in threads, and many of them in processes of their own.

Decoders are C code that reads strangers' bytes: it may crash, hang or take all memory. In a worker process it does
so to that process, which costs the one photo; the process is replaced and the rest goes on. It is a plain Python
started afresh (no fork of a process that runs threads, no second run of the caller's script), it loads what is
imported here and no torch, and it ends when its pipe does, however its parent ended.
"""

from __future__ import annotations

import io
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import IO, Any, NamedTuple, Self, TypeVar

from salad.errors import PhotoError, SaladError
from salad.images.decode import Pixels, decode, existing, naming
from salad.images.photo import Photo, content_hash, read_photo
from salad.processors import processors

FEW = 32
"""Fewer photos are read in this process: others would take longer to start."""
SECONDS = 60.0
"""How long a photo may take; the largest ones take about 20."""
MEMORY = 6 << 30
"""Bytes of address space a worker process may have: twice what the largest photos need with their decoders' threads."""
READY = "ready"
"""What a worker process says first."""

_LARGEST = 2 << 30  # bytes that the largest photo takes while it is decoded
_HELD = 256 << 20  # bytes of a file that are held in memory, to be gone through several times
_KEPT = {"MALLOC_MMAP_THRESHOLD_": str(32 << 20), "MALLOC_TRIM_THRESHOLD_": str(128 << 20)}
"""What makes Linux's allocator keep the memory of a photo for the next: to hand it back each time costs a fifth."""
_STARTER = "from salad.images.workers import main; main()"

Size = tuple[int, int, str]
"""Height and width in pixels, and the resampling, as `decode` takes them."""
Popen = subprocess.Popen[bytes]
T = TypeVar("T")
R = TypeVar("R")


# --- what is done with a photo -------------------------------------------------------------


class PhotoRead(NamedTuple):
    """What one trip to a photo brings home, all of it from the same bytes.

    Attributes:
        photo: The photo as its name and EXIF tell it.
        content_hash: Which photo it is.
        pixels: uint8 `[height, width, 3]`; None where no size was asked for, and where they cannot be decoded.
        trouble: Why they cannot be decoded: a sentence, empty where they can.
    """

    photo: Photo
    content_hash: str
    pixels: Pixels | None = None
    trouble: str = ""


def read(path: Path, size: Size | None = None) -> PhotoRead:
    """Everything about a photo; its file is opened and read once.

    Args:
        path: The file.
        size: To what its pixels are squeezed; where not given, they are not decoded.

    Raises:
        PhotoError: If the file cannot be read.
    """
    path = existing(path)
    with naming(path), path.open("rb") as opened:
        # In memory, so that what is hashed is what is decoded, whoever may be writing the file meanwhile. Scans of
        # gigabytes are read twice instead, and so is the head of a photo whose pixels nobody wants.
        small = size is not None and os.fstat(opened.fileno()).st_size <= _HELD
        file: IO[bytes] = io.BytesIO(opened.read()) if small else opened
        known = PhotoRead(read_photo(path, file=file), content_hash(path, file=file))
        if size is None:
            return known
        try:
            return known._replace(pixels=decode(path, *size, file=file))
        except PhotoError as error:  # an index may hold it all the same, described where it could be decoded
            return known._replace(trouble=str(error))


TASKS: dict[str, Callable[..., Any]] = {"read": read, "decode": decode}
"""What a worker can be asked for by name; the first argument is the photo's path."""


class Workers:
    """Reads photos for the model: in as many threads as the machine can bear, each with a process of its own.

    Use it as a context manager; on an error or an interrupt what has not begun is dropped, and what has is ended.

    Args:
        photos: How many are to be read; fewer than `FEW` are read in this process, trusting the decoders.
        at_once: How many are read at a time; as many as there are processors and memory for where not given.
        seconds: How long a photo may take in a process before it is given up.
    """

    def __init__(self, photos: int, *, at_once: int | None = None, seconds: float = SECONDS) -> None:
        at_once = at_once or photos_at_once()
        self._threads = ThreadPoolExecutor(at_once, thread_name_prefix="salad-photos")
        self._processes = [] if photos < FEW else [_Process(seconds) for _ in range(at_once)]
        self._free: SimpleQueue[_Process] = SimpleQueue()
        for process in self._processes:
            self._free.put(process)

    def read(self, path: Path, size: Size | None = None) -> PhotoRead:
        """As the function `read`, in a process where there are any; whoever finds none free waits.

        Raises:
            PhotoError: If the file cannot be read, crashed two processes or took too long.
        """
        found: PhotoRead = self.ask("read", path, size)
        return found

    def decode(self, path: Path, height: int, width: int, resample: str) -> Pixels:
        """As `salad.images.decode.decode`, in a process where there are any.

        Raises:
            PhotoError: If the file cannot be read, crashed two processes or took too long.
        """
        pixels: Pixels = self.ask("decode", path, height, width, resample)
        return pixels

    def ask(self, task: str, path: Path, *rest: Any) -> Any:
        """What a task of `TASKS` gives for a photo.

        Raises:
            PhotoError: If the photo cannot be read, crashed two processes or took too long.
        """
        if not self._processes:
            return TASKS[task](path, *rest)
        process = self._free.get()
        try:
            return process.ask(task, path, *rest)
        finally:
            self._free.put(process)

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
        """End the processes at once, whatever they are doing, and the threads after them."""
        for process in self._processes:
            process.close()
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


# --- a worker process, as its parent sees it -----------------------------------------------


class _DiedError(Exception):
    """A process ended in the middle of a photo; the message says how."""


class _Process:
    """One process, asked by one thread at a time; started when needed, and again after it died."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._process: Popen | None = None
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
                raise PhotoError(f"{path} crashes its decoder ({error}): fetch it again or leave it out") from error
        if isinstance(value, SaladError):
            raise value
        return value

    def close(self) -> None:
        """End the process; it is not started again."""
        self._closed = True
        with self._starting:
            if self._process is not None:
                _end(self._process)

    def _answer(self, task: str, path: Path, *rest: Any) -> Any:
        process = self._running()
        if process is None:
            return answer((task, path, *rest))
        assert process.stdin is not None
        assert process.stdout is not None
        self._late.clear()
        timer = threading.Timer(self._seconds, self._give_up, [process])
        timer.daemon = True
        timer.start()
        try:
            send((task, path, *rest), process.stdin)
            return pickle.load(process.stdout)
        except (OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
            raise self._failed(process, path) from error
        finally:
            timer.cancel()
            timer.join()

    def _running(self) -> Popen | None:
        """The process, started where it does not run; None where none can be started on this system."""
        with self._starting:
            if self._closed:
                raise PhotoError("the reading of photos was stopped: run it again")
            if self._process is not None and self._process.poll() is not None:
                _end(self._process)
                self._process = None
            if self._process is None and not self._alone:
                self._process = self._start()
                self._alone = self._process is None
            return self._process

    @staticmethod
    def _start() -> Popen | None:
        """A process that said it is ready, or None."""
        process: Popen | None = None
        # The folders we import from, which a script may have added to; one thread for numpy, which has little to do.
        folders = os.pathsep.join(folder for folder in sys.path if folder)
        settings = {"PYTHONPATH": folders, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"} | _KEPT
        try:
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", _STARTER],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **settings},
                start_new_session=True,  # Ctrl-C goes to every process of a session
            )
            if process.stdout is not None and pickle.load(process.stdout) == READY:
                return process
        except (OSError, ValueError, EOFError, pickle.UnpicklingError):
            pass
        if process is not None:
            _end(process)
        return None

    def _failed(self, process: Popen, path: Path) -> Exception:
        """What to say of a process whose answer did not come."""
        with suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
        code = process.returncode
        _end(process)
        if self._closed:
            return PhotoError(f"{path} was not read, since the reading of photos was stopped: run it again")
        if self._late.is_set():
            return PhotoError(f"{path} took over {self._seconds:g} s to read: save it anew or leave it out")
        if code is None or code >= 0:
            return _DiedError(f"exit code {code}")
        with suppress(ValueError):
            return _DiedError(signal.Signals(-code).name)
        return _DiedError(f"signal {-code}")

    def _give_up(self, process: Popen) -> None:
        self._late.set()
        process.kill()


def _end(process: Popen) -> None:
    """Kill it where it runs still, and leave nothing of it behind."""
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with suppress(OSError):  # what was not sent is of no use any more
                stream.close()


# --- a worker process, seen from inside ----------------------------------------------------


def main() -> None:
    """What a worker process runs: it answers until its pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is its parent's business
    limit_memory(MEMORY)
    with os.fdopen(os.dup(1), "wb") as replies, Path(os.devnull).open("wb") as nothing:
        os.dup2(nothing.fileno(), 1)  # whatever a decoder prints must not get into an answer
        with suppress(EOFError, BrokenPipeError):
            send(READY, replies)
            while True:
                send(answer(pickle.load(sys.stdin.buffer)), replies)


def answer(request: tuple[Any, ...]) -> Any:
    """What a task of `TASKS` gives for its arguments, or the SaladError it raises."""
    task, *arguments = request
    try:
        return TASKS[task](*arguments)
    except SaladError as error:
        return error


def send(value: Any, stream: IO[bytes]) -> None:
    """Put a value into a pipe, at once."""
    pickle.dump(value, stream, protocol=5)
    stream.flush()


def limit_memory(size: int) -> None:
    """Let this process have no more address space than that many bytes, where the system can see to it."""
    try:
        import resource
    except ImportError:  # not on Windows
        return
    with suppress(OSError, ValueError):
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        within = size if hard == resource.RLIM_INFINITY else min(size, hard)
        resource.setrlimit(resource.RLIMIT_AS, (within, hard))
