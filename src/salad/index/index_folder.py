"""The folder of an index: made whole or not at all; and how paths of photos are written in it."""

from __future__ import annotations

import os
import re
import shutil
import uuid
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from salad.errors import StoreError, reason
from salad.files import create_file
from salad.index.catalog import Catalog
from salad.index.header import Header

VECTORS_FILE = "descriptors.f16"


def make(folder: Path, header: Header) -> Path:
    """Make an empty index in `folder`, which must not exist or be empty, at one stroke.

    Raises:
        StoreError: If the folder is in use or cannot be written; nothing is left behind.
    """
    with drafted(folder, "index") as draft:
        (draft / VECTORS_FILE).touch()
        Catalog.create(draft, matrix=VECTORS_FILE, dim=header.dim, fingerprint=header.fingerprint)
        header.write(draft)
    return folder


@contextmanager
def drafted(folder: Path, what: str) -> Iterator[Path]:
    """A folder to fill, which becomes `folder` when this ends well, and vanishes when it does not.

    Args:
        folder: An absolute path where nothing is, or an empty folder.
        what: What is made, for the sentence.

    Raises:
        StoreError: If the folder is in use or cannot be written.
    """
    draft = folder.parent / f".{folder.name}.{uuid.uuid4().hex}"
    with ExitStack() as for_as_long:
        try:
            if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
                raise StoreError(
                    f"{folder} already exists and is not empty: name another folder, or open it to add to it"
                )
            folder.parent.mkdir(parents=True, exist_ok=True)
            with _locked(
                folder.parent, wait=True
            ):  # so that nobody takes this draft for a dead one before it is locked
                _sweep_drafts(folder)
                draft.mkdir()
                for_as_long.enter_context(_locked(draft))
            yield draft
            settle(draft)  # its files' names onto the disk before its own says that all are there
            if folder.exists():
                folder.rmdir()  # an empty one: on Windows nothing is renamed over it
            draft.rename(folder)
        except OSError as error:
            raise StoreError(
                f"no {what} can be made at {folder} ({reason(error)}): name another folder, make room, or "
                "check permissions"
            ) from error
        finally:
            shutil.rmtree(draft, ignore_errors=True)


def _sweep_drafts(folder: Path) -> None:
    """Delete what was to become `folder` and whose maker was killed: nobody holds a lock on it any more."""
    name = re.compile(re.escape(f".{folder.name}.") + "[0-9a-f]{32}")
    for draft in folder.parent.iterdir():
        if name.fullmatch(draft.name) and draft.is_dir() and not draft.is_symlink():
            with _locked(draft) as is_dead:
                if is_dead:
                    shutil.rmtree(draft, ignore_errors=True)


@contextmanager
def _locked(folder: Path, *, wait: bool = False) -> Iterator[bool]:
    """Hold the lock of a folder, which goes with its process.

    Yields:
        Whether it is held: not where somebody else holds it, nor where there are no such locks.
    """
    with ExitStack() as opened:
        held = False
        with suppress(ImportError, OSError):  # Windows; a parent that may be written and not be read; a network's disk
            import fcntl

            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            opened.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            held = True
        yield held


def new_file(folder: Path, name: str, number: int) -> BinaryIO:
    """Make a file that is not there yet, called after the first free number from `number` on, and open it for writing.

    Args:
        folder: The index.
        name: Of the file, with `{}` where its number stands.
        number: The number of the commit that is to come.

    Raises:
        OSError: If no file can be made.
    """
    while True:
        with suppress(FileExistsError):
            return create_file(folder / name.format(number))
        number += 1


def size(folder: Path) -> int:
    """Bytes of the files in `folder`; one that goes away meanwhile counts nothing."""
    total = 0
    for file in folder.iterdir():
        with suppress(FileNotFoundError):
            total += file.lstat().st_size
    return total


def settle(folder: Path) -> None:
    """See the names in `folder` onto the disk, where a folder can be opened for that."""
    if os.name != "posix":  # Windows opens no folder as a file
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_gone(path: Path) -> bool:
    """Whether nothing is at `path`; what may not be looked at, or leads in a circle, may well be there."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):  # no file has a name with a NUL in it
        return True
    except OSError:
        return False
    return False


def resolved(paths: Iterable[str | Path]) -> list[Path]:
    """Absolute paths with links resolved; each folder is looked up once, for a million photos sit in few."""
    folders: dict[str, str] = {}
    found = []
    for given in paths:
        path = os.fspath(given)
        folder, name = os.path.split(path)
        if os.path.islink(path) or name in ("", ".", ".."):  # noqa: PTH114  # plain strings
            found.append(Path(os.path.realpath(path)))
            continue
        if folder not in folders:
            folders[folder] = os.path.realpath(folder)
        if isinstance(given, Path) and folders[folder] == folder:
            found.append(given)  # as it is: to make a Path costs more than all else
        else:
            found.append(Path(folders[folder], name))
    return found
