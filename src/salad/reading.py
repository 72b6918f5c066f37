"""Reading a photo for somebody else: in this process, or as the whole work of another one.

`salad.helpers` starts the other ones. They load what is imported here, the reading of photos, and no torch.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from salad.errors import SaladError
from salad.photos import Photo, identity, open_rgb, read_photo, squeeze

Pixels = NDArray[np.uint8]

READY = "ready"
"""What a helper says first."""
MEMORY = 6 << 30
"""Bytes of address space a helper may have: twice what the largest photos need with their decoders' threads."""


def look(path: Path) -> tuple[Photo, str]:
    """A photo as its name and EXIF tell it, and its identity; no pixel is decoded.

    Raises:
        PhotoError: where it cannot be read.
    """
    return read_photo(path), identity(path)


def decode(path: Path, height: int, width: int, resample: str) -> Pixels:
    """A photo's pixels, squeezed: uint8 `[height, width, 3]`; large JPEGs are decoded no larger than needed.

    That takes a third of the time, and moves a descriptor less than saving the JPEG at another quality does
    (cosine 0.998 to the full decoding where 80 in place of 90 makes 0.995).

    Raises:
        PhotoError: where it cannot be read.
    """
    return squeeze(open_rgb(path, at_least=(height, width)), height, width, resample)


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
