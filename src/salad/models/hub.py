"""The model zoo: one table of published and bundled weights, where they lie on this machine, and fetching them.

Bundled weights are a folder inside the package. The others are fetched to `home()/weights/NAME/FILE`, where a
file downloaded by hand may be put just as well. A file whose checksum the table does not know has it recorded
beside it, in `FILE.sha256`, the first time it is used.

A download survives a bad network: bytes go to `FILE.part`, which is renamed when it is whole, so a file under its own
name is always complete. What a broken connection left is gone on with at the next attempt, if the server still
publishes the same file (`FILE.part.version` holds what it said of it). Only the standard library is needed for it.
"""

from __future__ import annotations

import contextlib
import http.client
import os
import re
import sqlite3
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any, Literal

import platformdirs

from salad.errors import FetchError, WeightsError, reason
from salad.files import sha256_of, write_whole

Progress = Callable[[int, int | None], None]
Opener = Callable[..., Any]

_CHUNK = 1 << 20  # bytes between two looks at the clock, and between two words of progress
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
        DownloadFailedError: If the file could not be had; what arrived is kept if it can be gone on with.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _one_at_a_time(target.with_name(target.name + ".lock")):
            if target.is_file():  # another process brought it while this one waited
                return
            part = target.with_name(target.name + ".part")
            total = _resume(url, part, progress, opener)
            _settle(part, target, total, sha256=sha256, size=size)
    except urllib.error.HTTPError as error:
        error.close()
        raise DownloadFailedError(f"the server answered {error.code} {error.reason}") from error
    except urllib.error.URLError as error:
        why = reason(error.reason) if isinstance(error.reason, OSError) else error.reason
        raise DownloadFailedError(f"no connection: {why}") from error
    except (OSError, http.client.HTTPException) as error:
        raise DownloadFailedError(reason(error) or "the server broke off") from error


def check(path: Path, *, sha256: str | None = None) -> None:
    """Compare a file with its checksum, else with the one recorded at its first use; record it at the first.

    Raises:
        WeightsError: If the file is another one.
    """
    found, recorded = sha256_of(path), _beside(path, "sha256")
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
            while not gate.in_transaction:  # each try waits half a second, and Ctrl-C is heard in between
                try:
                    gate.execute("BEGIN EXCLUSIVE")
                except sqlite3.OperationalError as error:
                    if "locked" not in str(error):  # no other process, but the disk
                        raise
            yield
    except sqlite3.Error as error:
        raise OSError(f"cannot lock {lock}: {error}") from error


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
    version, have = _beside(part, "version"), part.stat().st_size if part.exists() else 0
    request = urllib.request.Request(_allowed(url), headers={"User-Agent": "salad"})
    if have:
        request.add_header("Range", f"bytes={have}-")
        if version.exists():  # only of the file that the first bytes came from
            request.add_header("If-Range", version.read_text(encoding="utf-8"))
    with opener(request, timeout=_SILENCE) as response:
        _allowed(response.geturl())  # where redirects led
        goes_on = re.match(rf"bytes {have}-\d+/(\d+)$", response.headers.get("Content-Range") or "")
        if response.status == HTTPStatus.PARTIAL_CONTENT and not goes_on:
            part.unlink(missing_ok=True)
            raise OSError("the server sent another part of the file than was asked for")
        length = goes_on[1] if goes_on else response.headers.get("Content-Length")
        total = int(length) if length else None
        if not goes_on:
            have, tag = 0, response.headers.get("ETag") or ""
            # HTTP does not let a weak tag (W/"...") vouch for single bytes.
            said = tag if tag.startswith('"') else response.headers.get("Last-Modified")
            if said:
                write_whole(version, said.encode())
            else:
                version.unlink(missing_ok=True)
        with part.open("ab" if goes_on else "wb") as file:
            while chunk := response.read(_CHUNK):
                file.write(chunk)
                have += len(chunk)
                if progress is not None:
                    progress(have, total)
    return total


def _allowed(url: str) -> str:
    """Refuse anything but https, save for a server on this very machine."""
    parts = urllib.parse.urlsplit(url)
    # Also asked of where a redirect led: weights that came in plain text may be anybody's.
    if parts.scheme == "https" or (parts.scheme == "http" and parts.hostname == "127.0.0.1"):
        return url
    raise OSError(f"{url} is not an https address")


def _settle(part: Path, target: Path, total: int | None, *, sha256: str | None, size: int | None) -> None:
    """Give a part its own name if it is all there and what it should be."""
    length = part.stat().st_size
    # Short of bytes it may be gone on with; with wrong ones it may not, or every later attempt would fail too.
    if total is not None and length < total:
        raise OSError(f"the connection broke off after {length} of {total} bytes, which are kept to go on from")
    found = sha256_of(part)
    if any(due not in (None, came) for due, came in ((total, length), (size, length), (sha256, found))):
        part.unlink()
        raise OSError(f"what came has {length} bytes and checksum {found}, not {size or total} and {sha256}")
    write_whole(_beside(target, "sha256"), f"{found}  {target.name}\n".encode())
    part.replace(target)
    _beside(part, "version").unlink(missing_ok=True)


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(f"{path.name}.{suffix}")


Layout = Literal["flat", "megaloc", "hub", "own"]


@dataclass(frozen=True, slots=True)
class ZooEntry:
    """One row of the zoo.

    Attributes:
        name: What users call it.
        url: Where the file is published; None for weights inside the package.
        file: The file's name in the cache, or the folder's name inside the package.
        layout: How the file names its tensors; `own` is this package's folder format.
        dim: Numbers in what the model gives: a descriptor, or a bare backbone's token. None where the
            weights' own config says it.
        licence: What to show when the weights are loaded or fetched.
        sha256: The file's checksum, where its publisher states one.
        bytes: The file's length, where known.
        image_size: Side in pixels of the square a photo is squeezed to by default.
        note: What it is good for, in a sentence.
    """

    name: str
    url: str | None
    file: str
    layout: Layout
    dim: int | None
    licence: str
    sha256: str | None = None
    bytes: int | None = None
    image_size: int = 322
    note: str = ""


def _bundled(name: str, dim: int, note: str, *, image_size: int) -> ZooEntry:
    """Make the row of a model of ours, which lies inside the package."""
    return ZooEntry(
        name=name,
        url=None,
        file=name,
        layout="own",
        dim=dim,
        licence="Apache-2.0; trained on research photos, see docs/model-card.md",
        image_size=image_size,
        note=note,
    )


_ENTRIES = (
    _bundled("salad-lite", 8448, "small, ships with the package, runs on any laptop", image_size=320),
    _bundled(
        "salad-lite-route",
        8960,
        "the same beside a 4 x 4 layout: for routes, webcams and trains alone, where the camera looks the same "
        "way again",
        image_size=320,
    ),
    _bundled(
        "salad-vits",
        8448,
        "ships with the package too: surer with webcams and phones in any light, slower, worse on thumbnails",
        image_size=322,
    ),
    ZooEntry(
        name="dinov2-salad",
        url="https://github.com/serizba/salad/releases/download/v1.0.0/dino_salad.ckpt",
        file="dino_salad.ckpt",
        layout="flat",
        dim=8448,
        licence="weights from a GPL-3.0 repository; trained on GSV-Cities, whose data are CC BY-NC-ND 4.0",
        note="the paper's full model: DINOv2 ViT-B/14 and SALAD",
    ),
    ZooEntry(
        name="megaloc",
        url="https://huggingface.co/gberton/MegaLoc/resolve/main/model.safetensors",
        file="model.safetensors",
        layout="megaloc",
        dim=8448,
        licence="MIT",
        note="DINOv2 ViT-B/14 and a larger SALAD, trained on five data sets at once",
    ),
    *(
        ZooEntry(
            name=f"dinov2-vit{size}14{'-reg' if registers else ''}",
            url=f"https://dl.fbaipublicfiles.com/dinov2/dinov2_vit{size}14/{file}",
            file=file,
            layout="hub",
            dim=dim,
            licence="Apache-2.0",
            note=f"DINOv2 backbone{' with 4 registers' if registers else ''}, to train a SALAD head on",
        )
        for size, dim in (("s", 384), ("b", 768), ("l", 1024), ("g", 1536))
        for registers in (False, True)
        for file in [f"dinov2_vit{size}14_{'reg4_' if registers else ''}pretrain.pth"]
    ),
)

ZOO: dict[str, ZooEntry] = {entry.name: entry for entry in _ENTRIES}


def home() -> Path:
    """Give the folder for what is fetched: `SALAD_HOME` if set, else the platform's cache folder."""
    # Asked at every call and not once: tests and notebooks set it when the package is imported already.
    chosen = os.environ.get("SALAD_HOME")
    return Path(chosen).expanduser() if chosen else platformdirs.user_cache_path("salad")


def entry(name: str) -> ZooEntry:
    """Look up a row of the zoo.

    Raises:
        WeightsError: If there is no such row.
    """
    if name not in ZOO:
        raise WeightsError(f"no weights are called '{name}': the zoo has {', '.join(ZOO)}")
    return ZOO[name]


def path_of(name: str) -> Path:
    """Say where weights of the zoo lie, or will lie once fetched."""
    row = entry(name)
    if row.url is None:
        return Path(__file__).resolve().parents[1] / "weights" / row.file
    return home() / "weights" / row.name / row.file


def fetch(name: str, *, progress: Progress | None = None, opener: Opener = urllib.request.urlopen) -> Path:
    """Make sure that weights of the zoo are on this machine.

    Whole files on disk are used without a network, their checksum compared every time.

    Args:
        name: A name in `ZOO`.
        progress: Told the bytes on disk and the bytes there will be (None where the server does not say).
        opener: What opens a request; by default the standard library.

    Returns:
        The file, or for bundled weights the folder.

    Raises:
        FetchError: If the download failed; the message says which file to put where by hand.
        WeightsError: If there are no such weights, or the file on disk is not the one it was.
    """
    row, path = entry(name), path_of(name)
    # Bundled weights are part of the installation: nothing is fetched in their place, or an index would not know them.
    if row.url is None:
        if not path.is_dir():
            raise WeightsError(f"the bundled weights '{name}' are not at {path}: install the package again")
        return path
    if not path.is_file():
        try:
            download(row.url, path, sha256=row.sha256, size=row.bytes, progress=progress, opener=opener)
        except DownloadFailedError as error:
            raise FetchError(
                f"could not fetch '{name}' ({error}): try again, or download {row.url} "
                f"on a machine with a network and put it at {path}"
            ) from error
    # Every time, and for a file put there by hand too: so a damaged disk is told from a bad model.
    check(path, sha256=row.sha256)
    return path
