"""Files: nothing else is opened, none is read further than it may be long, and what is written is whole.

A name may be a link to somewhere else, a pipe that nobody writes to, or a device that never ends. All are told apart
by what was opened, not by what stood there a moment before. What cannot be opened is an `OSError` whose `strerror`
says why, so that the sentences of whoever asks need no case of their own.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import stat
import uuid
from contextlib import suppress
from io import BufferedRandom, BufferedReader
from pathlib import Path
from typing import Any, BinaryIO

_CONTROLS = re.compile(r"[\x7f-\x9f\u2028\u2029]")
_WEB_PAGE = re.compile(rb"(?:\xef\xbb\xbf)?\s{0,999}<(?:!doctype html|html|head|body)", re.IGNORECASE)
_NO_FILE = "it is no regular file"
_MEMORY = 1 << 31  # bytes that what JSON says may take as Python holds it: up to 25 times the text
_TEXT_MOST = 1 << 30  # bytes of JSON that are read: a GeoJSON of a million photos has 300 MB


def open_file(path: str | Path, *, follow: bool = True) -> BufferedReader:
    """Open a regular file to be read, without waiting.

    Args:
        path: The file.
        follow: Whether `path` may be a symbolic link, as it may where the user gave it, and may not inside of a folder
            that somebody else may have made.

    Raises:
        OSError: If it cannot be opened, is a folder, a pipe or a device, or a link that is not followed.
    """
    return open(_opened(path, os.O_RDONLY, follow=follow), "rb")


def open_in_place(path: str | Path) -> BufferedRandom:
    """Open a regular file to be changed where it is; never through a link, of either kind.

    Raises:
        OSError: As `open_file`; or if it has another name, whose content would change too.
    """
    descriptor = _opened(path, os.O_RDWR, follow=False)
    if os.fstat(descriptor).st_nlink > 1:
        os.close(descriptor)
        raise _refusal(errno.EMLINK, "it is a hard link, and what else is linked to it would change too", path)
    return open(descriptor, "r+b")  # noqa: PTH123  # of no path


def _opened(path: str | Path, flags: int, *, follow: bool) -> int:
    """The descriptor of a regular file."""
    flags |= getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0) | (0 if follow else getattr(os, "O_NOFOLLOW", 0))
    try:
        if not follow and os.path.islink(path):  # noqa: PTH114  # Windows has no O_NOFOLLOW; others it serves for a word
            raise _refusal(errno.ELOOP, "it is a link", path)
        descriptor = os.open(path, flags)
    except OSError as error:
        if error.errno == errno.ENXIO:  # a socket, or a device that is not there
            raise _refusal(errno.EINVAL, _NO_FILE, path) from error
        raise
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return descriptor
    os.close(descriptor)
    raise _refusal(errno.EINVAL, "it is a folder" if stat.S_ISDIR(mode) else _NO_FILE, path)


def create_file(path: str | Path) -> BinaryIO:
    """Make a new file and open it for writing; what stands there already, be it a link to nowhere, is left alone.

    Raises:
        OSError: If something stands there, or no file can be made.
    """
    return Path(path).open("xb")


def read_file(path: str | Path, *, most: int, follow: bool = True) -> bytes:
    """All of a regular file, which may be `most` bytes long.

    Raises:
        OSError: As `open_file`; or if it is longer, or does not come to an end.
    """
    with open_file(path, follow=follow) as file:
        length = os.fstat(file.fileno()).st_size
        content = b"" if length > most else _read(file, length, most + 1)
        if length > most or len(content) > most:
            raise _refusal(errno.EFBIG, f"it is longer than {most:,} bytes", path)
        return content


def _read(file: BinaryIO, length: int, most: int) -> bytes:
    """What a file holds that was `length` bytes long when it was opened, as far as `most` bytes: it may be growing."""
    parts = [file.read(length + 1)]  # at one stroke, so that a gigabyte is held once
    while parts[-1] and (room := most - sum(map(len, parts))) > 0:
        parts.append(file.read(min(1 << 24, room)))
    return b"".join(filter(None, parts))  # of a single part that part itself, without a copy


def read_json(path: str | Path, *, most: int = _TEXT_MOST, follow: bool = True) -> Any:
    """What a JSON file holds.

    Args:
        path: The file, in UTF-8.
        most: Bytes that it may be long.
        follow: As `open_file`.

    Raises:
        OSError: If it cannot be read, or is longer.
        ValueError: If it is no JSON, no UTF-8, or nested so deeply that nobody can mean it.
    """
    return parse_json(read_file(path, most=most, follow=follow))


def parse_json(text: str | bytes) -> Any:
    """What a text of JSON holds.

    Raises:
        ValueError: If it is no JSON, no UTF-8, or nested so deeply or so large that nobody can mean it.
    """
    whole = text if isinstance(text, str) else text.decode("utf-8")
    # Looked at before it is taken apart: a list of empty lists takes 72 bytes for each three letters.
    if 72 * (whole.count("[") + whole.count("{")) + 32 * whole.count(",") + 28 * whole.count('"') > _MEMORY:
        raise ValueError("it holds more than fits into memory")
    try:
        return json.loads(whole)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def json_text(value: Any, *, indent: int | None = 2) -> str:
    """A value as JSON: names in any script stay readable, and what a terminal obeys is written by its code.

    Raises:
        TypeError: If JSON has no such value.
    """
    # Python escapes what JSON's grammar forbids, which the later half of the control characters is not.
    return _CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", json.dumps(value, ensure_ascii=False, indent=indent))


def is_web_page(head: bytes) -> bool:
    """Whether a file that begins so is what a server says to people, in place of what it was asked for."""
    return _WEB_PAGE.match(head) is not None


def write_whole(path: Path, content: bytes) -> None:
    """Put `content` at `path` at one stroke: written beside it, then renamed; what stood there is replaced.

    Raises:
        OSError: If it cannot be written; what stood there stays, and nothing is left beside it.
    """
    part = path.with_name(f".{uuid.uuid4().hex}.part")  # on the same disk, for only there a rename is one stroke
    try:
        with create_file(part) as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # or a loss of power may leave the new name with nothing in it
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        error.filename, error.filename2 = os.fspath(path), None  # of a full disk the system names no file at all
        raise


def sha256_of(path: Path) -> str:
    """The checksum of a file, in hexadecimal digits.

    Raises:
        OSError: If it cannot be read.
    """
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _refusal(number: int, reason: str, path: str | Path) -> OSError:
    return OSError(number, reason, os.fspath(path))
