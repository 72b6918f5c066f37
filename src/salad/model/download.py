"""Downloading one large file over https, so that it survives a bad network.

Bytes go to `FILE.part`, which is renamed when it is whole: a file under its own name is always complete. What
a broken connection left is gone on with at the next attempt, if the server still publishes the same file
(`FILE.part.version` holds what it said of it). Standard library only.
"""

from __future__ import annotations

import contextlib
import hashlib
import http.client
import re
import sqlite3
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

from salad.errors import WeightsError
from salad.wholefile import write_whole

Progress = Callable[[int, int | None], None]
Opener = Callable[..., Any]

_CHUNK = 1 << 20
_SILENCE = 60.0  # seconds without a byte after which a connection counts as broken


class DownloadFailedError(Exception):
    """A download failed, for the reason given; whoever asked for the file says what to do instead."""


def download(
    url: str,
    target: Path,
    *,
    sha256: str | None = None,
    size: int | None = None,
    progress: Progress | None = None,
    opener: Opener = urllib.request.urlopen,
) -> None:
    """Bring a file from an https address to `target`, and record its checksum in `TARGET.sha256`.

    Processes that want the same file take turns, and the later ones find the work done.

    Args:
        url: The address; plain http is taken only from this very machine.
        target: Where to put the file; its folder is made.
        sha256: The checksum it must have, where known.
        size: The length in bytes it must have, where known.
        progress: Told the bytes here and the bytes there will be (None where the server does not say).
        opener: What opens a request.

    Raises:
        DownloadFailedError: The file could not be had; what arrived is kept if it can be gone on with.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _one_at_a_time(target.with_name(target.name + ".lock")):
            if target.is_file():
                return
            part = target.with_name(target.name + ".part")
            total = _resume(url, part, progress, opener)
            _settle(part, target, total, sha256=sha256, size=size)
    except urllib.error.HTTPError as error:
        error.close()
        raise DownloadFailedError(f"the server answered {error.code} {error.reason}") from error
    except urllib.error.URLError as error:
        raise DownloadFailedError(f"no connection: {error.reason}") from error
    except (OSError, http.client.HTTPException) as error:
        raise DownloadFailedError(str(error) or type(error).__name__) from error


def check(path: Path, *, sha256: str | None = None) -> None:
    """Compare a file with its checksum, else with the one recorded at its first use; record it at the first.

    Raises:
        WeightsError: The file is another one.
    """
    found, recorded = _sha256(path), _beside(path, "sha256")
    if sha256 is None and not recorded.exists():
        with contextlib.suppress(OSError):  # a shared cache may be read-only, and its files good all the same
            write_whole(recorded, f"{found}  {path.name}\n".encode())
        return
    due = sha256 or recorded.read_text(encoding="utf-8").split(" ")[0]
    if found != due:
        raise WeightsError(
            f"{path} has checksum {found} where {due} was due: it is damaged or another file, "
            f"so delete it together with {recorded.name} and fetch it again"
        )


@contextlib.contextmanager
def _one_at_a_time(lock: Path) -> Iterator[None]:
    """Hold a lock that every platform lets go of when a process dies: that of an empty SQLite file."""
    try:
        with contextlib.closing(sqlite3.connect(lock, timeout=0.5, isolation_level=None)) as gate:
            while not _taken(gate):
                pass  # each try waits half a second, and Ctrl-C is heard in between
            yield
    except sqlite3.Error as error:
        raise OSError(f"cannot lock {lock}: {error}") from error


def _taken(gate: sqlite3.Connection) -> bool:
    """Try to take a lock; false where another process holds it."""
    try:
        gate.execute("BEGIN EXCLUSIVE")
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            return False
        raise
    return True


def _resume(url: str, part: Path, progress: Progress | None, opener: Opener) -> int | None:
    """Receive what `part` lacks; give the whole length, None where the server does not say."""
    try:
        return _receive(url, part, progress, opener)
    except urllib.error.HTTPError as error:
        if error.code != HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE or not part.exists():
            raise
        error.close()
        have = part.stat().st_size
        if error.headers.get("Content-Range") == f"bytes */{have}":
            return have  # it was whole already, and only its renaming had been cut off
        part.unlink()  # longer than what is published now
        return _receive(url, part, progress, opener)


def _receive(url: str, part: Path, progress: Progress | None, opener: Opener) -> int | None:
    """Ask once for what `part` lacks, and append it, or all of it where the server starts over."""
    have = part.stat().st_size if part.exists() else 0
    with opener(_request(url, part, have), timeout=_SILENCE) as response:
        _allowed(response.geturl())  # where redirects led
        goes_on = re.match(rf"bytes {have}-\d+/(\d+)$", response.headers.get("Content-Range") or "")
        if response.status == HTTPStatus.PARTIAL_CONTENT and not goes_on:
            part.unlink(missing_ok=True)
            raise OSError("the server sent another part of the file than was asked for")
        length = goes_on[1] if goes_on else response.headers.get("Content-Length")
        total = int(length) if length else None
        if not goes_on:
            have = 0
            _remember_version(part, response)
        with part.open("ab" if goes_on else "wb") as file:
            while chunk := response.read(_CHUNK):
                file.write(chunk)
                have += len(chunk)
                if progress is not None:
                    progress(have, total)
    return total


def _request(url: str, part: Path, have: int) -> urllib.request.Request:
    """Ask for the bytes from `have` on, provided that the file is still the one the first bytes came from."""
    request = urllib.request.Request(_allowed(url), headers={"User-Agent": "salad"})
    if have:
        request.add_header("Range", f"bytes={have}-")
        if _beside(part, "version").exists():
            request.add_header("If-Range", _beside(part, "version").read_text(encoding="utf-8"))
    return request


def _allowed(url: str) -> str:
    """Refuse anything but https, save for a server on this very machine."""
    parts = urllib.parse.urlsplit(url)
    if parts.scheme == "https" or (parts.scheme == "http" and parts.hostname == "127.0.0.1"):
        return url
    raise OSError(f"{url} is not an https address")


def _remember_version(part: Path, response: Any) -> None:
    """Keep what tells this version of the published file from a later one, where the server says it."""
    tag = response.headers.get("ETag") or ""
    # HTTP does not let a weak tag (W/"...") vouch for single bytes.
    version = tag if tag.startswith('"') else response.headers.get("Last-Modified")
    if version:
        write_whole(_beside(part, "version"), version.encode())
    else:
        _beside(part, "version").unlink(missing_ok=True)


def _settle(part: Path, target: Path, total: int | None, *, sha256: str | None, size: int | None) -> None:
    """Give a part its own name if it is all there and what it should be."""
    length = part.stat().st_size
    if total is not None and length < total:
        raise OSError(
            f"the connection broke off after {length} of {total} bytes, which are kept to go on from"
        )
    found = _sha256(part)
    if any(due not in (None, came) for due, came in ((total, length), (size, length), (sha256, found))):
        part.unlink()
        raise OSError(f"what came has {length} bytes and checksum {found}, not {size or total} and {sha256}")
    write_whole(_beside(target, "sha256"), f"{found}  {target.name}\n".encode())
    part.replace(target)
    _beside(part, "version").unlink(missing_ok=True)


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(f"{path.name}.{suffix}")


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
