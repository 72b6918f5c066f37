"""What a worker process runs: it reads photos for its parent, each within limits of time and of memory.

It goes without numpy, which would be half of its start: pixels are images until they are with the parent.

The process sets the limits itself, since only it knows how far a photo has come and how large its header says that it
is; the parent's own timer stands behind them. A timer's signal and a refused allocation reach a decoder in the middle
of C code, where nothing of Python runs.
"""

from __future__ import annotations

import io
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from PIL import Image

from salad.errors import PhotoError, SaladError
from salad.images.decode import as_pixels, existing, in_memory, naming, on_disk, open_image, open_rgb, small
from salad.images.metadata import Position, rank
from salad.images.named import NamedPhoto
from salad.images.photo import Photo, content_hash, read_photo, sayings
from salad.images.rgb import is_deep_grey

if TYPE_CHECKING:
    from salad.images.decode import Pixels

READING = 60.0
"""Seconds that a file may take to come off its disk, which may be on the other side of a network."""
SECONDS, LARGEST_SECONDS = 8.0, 60.0
"""How long a photo may take once it is read, by the clock: a small one, and the largest that is opened.

The largest take 5 to 12 seconds on one core. A machine that is busy with something else may take several times that."""
MEMORY, LARGEST_MEMORY = 1_950_000_000, 2_450_000_000
"""Bytes that a process may have beyond the 50 million that it begins with: for a small photo, and for the largest."""
READY = "ready"
"""What a worker process says first."""

Size = tuple[int, int, str]
"""Height and width in pixels, and the resampling, as `decode` takes them."""
Source = Path | NamedPhoto
"""A file, or a photo that an index or a result names."""


# --- what is done with a photo -------------------------------------------------------------


class PhotoRead(NamedTuple):
    """What one trip to a photo brings home, all of it from the same bytes.

    Attributes:
        photo: The photo as its name and EXIF tell it.
        content_hash: Which photo it is.
        image: RGB of the size that was asked for; None where none was, and where it cannot be decoded.
        trouble: Why it cannot be decoded: a sentence, empty where it can.
        deep_grey: Whether it is grey of more than eight bits, which earlier decoders made another picture of.
    """

    photo: Photo
    content_hash: str
    image: Image.Image | None = None
    trouble: str = ""
    deep_grey: bool = False

    @property
    def pixels(self) -> Pixels | None:
        """The image as bytes, uint8 `[height, width, 3]`."""
        return None if self.image is None else as_pixels(self.image)


def read(path: Path, size: Size | None = None) -> PhotoRead:
    """Everything about a photo, from one reading of its file.

    Args:
        path: The file.
        size: To what its pixels are squeezed; where not given, they are not decoded.

    Raises:
        PhotoError: If the file cannot be read.
    """
    file = _taken(path)
    known = PhotoRead(read_photo(path, file=file), content_hash(path, file=file), deep_grey=_is_deep_grey(path, file))
    if size is None:
        return known
    try:
        return known._replace(image=small(path, *size, file=file, grant=LIMITS.grant))
    except PhotoError as error:  # an index may hold it all the same, described where it could be decoded
        return known._replace(trouble=str(error))


def _is_deep_grey(path: Path, file: IO[bytes]) -> bool:
    with suppress(Exception):  # whatever is wrong with it, `small` says
        return is_deep_grey(open_image(path, file))
    return False


def decode(photo: Source, height: int, width: int, resample: str) -> Image.Image:
    """As `salad.images.decode.decode`, but for the array that its caller makes of it.

    Raises:
        PhotoError: If the photo cannot be read.
    """
    return small(_path(photo), height, width, resample, file=_taken(photo), grant=LIMITS.grant)


def show(photo: Source, side: int) -> Image.Image:
    """A photo for people, whose longer side has `side` pixels at most.

    Raises:
        PhotoError: If the photo cannot be read.
    """
    shown = open_rgb(_path(photo), file=_taken(photo), grant=LIMITS.grant)
    with naming(_path(photo)):
        shown.thumbnail((side, side), Image.Resampling.LANCZOS)  # never enlarged
        return shown


def look(path: Path) -> Photo:
    """What a photo's name and EXIF say; only the head of its file is read.

    Raises:
        PhotoError: If there is no such file.
    """
    # What cannot be opened has no EXIF, as `read_photo` has it, which also says what is not there.
    with suppress(PhotoError, OSError), on_disk(path) as file:
        file.peek(1)  # a disk may have to wake up first
        LIMITS.grant(0.0)
        return read_photo(path, file=file)
    return read_photo(path)


def said(path: Path) -> list[Position]:
    """All that a photo's name, its file and the files beside it say of it, each on its own, who wins first.

    Raises:
        PhotoError: If there is no such file.
    """
    with on_disk(existing(path)) as file:
        file.peek(1)  # as above
        LIMITS.grant(0.0)
        return sorted(sayings(path, file=file), key=lambda one: rank(one.source))


def _path(photo: Source) -> Path:
    return photo if isinstance(photo, Path) else photo.path


def _taken(photo: Source) -> io.BytesIO:
    file = in_memory(photo) if isinstance(photo, Path) else io.BytesIO(photo.read())
    LIMITS.grant(0.0)  # until its header says how large it is, a photo is a small one
    return file


TASKS: dict[str, Callable[..., Any]] = {"read": read, "decode": decode, "show": show, "look": look, "said": said}
"""What a worker can be asked for by name; the first argument is the photo's path."""


# --- within limits -------------------------------------------------------------------------


class Limits:
    """What a photo may cost this process; nothing is limited before `begin`, as where no worker runs.

    The memory is address space, which the system hands out before it is used, and so the only one it can refuse.
    """

    def __init__(self) -> None:
        self._held: int | None = None  # bytes of address space that the process begins with
        self._since: float | None = None  # when the photo came off its disk

    def begin(self) -> None:
        """From here on, in this process."""
        self._held = _address_space()
        if hasattr(signal, "SIGALRM"):  # not on Windows, where the parent's timer is all there is
            signal.signal(signal.SIGALRM, signal.SIG_DFL)  # whoever started the parent may have had it ignored
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGALRM])

    def start(self) -> None:
        """A photo begins: first it is read."""
        self._since = None
        if self._held is not None:
            self._limit(READING, MEMORY)

    def grant(self, share: float) -> None:
        """A photo was read, or its header was.

        Args:
            share: How large it is, where the largest that is opened is 1.
        """
        if self._held is None:
            return
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        seconds, memory = (
            least + (most - least) * min(share, 1.0)
            for least, most in ((SECONDS, LARGEST_SECONDS), (MEMORY, LARGEST_MEMORY))
        )
        self._limit(max(0.001, self._since + seconds - now), int(memory))

    def end(self) -> None:
        """The photo is done: what waits for the next may wait for ever."""
        if self._held is not None and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0)

    def _limit(self, seconds: float, memory: int) -> None:
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, seconds)
        limit_memory((self._held or 0) + memory)


LIMITS = Limits()
"""Of this process, as the system's own limits are."""


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


def _address_space() -> int:
    """Bytes of address space that this process has; as many as on Linux where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        return pages * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return 150_000_000


# --- from request to answer ----------------------------------------------------------------


def main() -> None:
    """Answer until the pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is its parent's business
    LIMITS.begin()
    with os.fdopen(os.dup(1), "wb") as replies, Path(os.devnull).open("wb") as nothing:
        os.dup2(nothing.fileno(), 1)  # whatever a decoder prints must not get into an answer
        with suppress(EOFError, BrokenPipeError):
            send(READY, replies)
            while True:
                folder, *request = pickle.load(sys.stdin.buffer)  # nosec B301  # from the process that started this one
                with suppress(OSError):  # one that is gone holds no photo either, as is said of the photo
                    os.chdir(folder)
                LIMITS.start()
                given = answer(*request)
                LIMITS.end()
                send(given, replies)


def answer(task: str, *arguments: Any) -> Any:
    """What a task of `TASKS` gives for its arguments, or the SaladError it raises."""
    try:
        return TASKS[task](*arguments)
    except SaladError as error:
        return error


def send(value: Any, stream: IO[bytes]) -> None:
    """Put a value into a pipe, at once."""
    pickle.dump(value, stream, protocol=5)
    stream.flush()
