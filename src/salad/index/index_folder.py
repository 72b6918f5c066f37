"""The folder of an index: made whole or not at all; and how paths of photos are written in it."""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from salad.errors import StoreError
from salad.index.catalog import CATALOG_FILE, Catalog

FORMAT_VERSION = 1
HEADER_FILE, VECTORS_FILE = "index.json", "descriptors.f16"
_KIND = "salad index"


@dataclass(frozen=True, slots=True)
class Header:
    """The model an index was made with, and the form it is written in.

    Attributes:
        model: Name of the model, for people.
        fingerprint: The model's fingerprint: weights and preprocessing, for the machine.
        dim: Numbers in a descriptor.
        created: When the index was made, UTC.
        format_version: The form of the folder, see docs/index-format.md.
    """

    model: str
    fingerprint: str
    dim: int
    created: datetime
    format_version: int = FORMAT_VERSION

    def write(self, folder: Path) -> None:
        """Write `index.json` into `folder`."""
        fields = {"kind": _KIND, **asdict(self), "created": self.created.isoformat()}
        (folder / HEADER_FILE).write_text(json.dumps(fields, indent=2) + "\n", encoding="utf-8")

    @classmethod
    def read(cls, folder: Path) -> Header:
        """Read `index.json` of `folder`.

        Raises:
            StoreError: If there is none, it is not ours, or a newer version of salad wrote it.
        """
        try:
            fields = json.loads((folder / HEADER_FILE).read_text(encoding="utf-8"))
        except (FileNotFoundError, NotADirectoryError) as error:
            raise StoreError(
                f"{folder} is not an index (it has no {HEADER_FILE}): make one with 'salad index PHOTOS --to {folder}'"
            ) from error
        except OSError as error:
            raise StoreError(
                f"{folder / HEADER_FILE} cannot be read ({error.strerror}): check its permissions"
            ) from error
        except ValueError as error:
            raise _damaged(folder) from error
        if not isinstance(fields, dict) or fields.get("kind") != _KIND:
            raise _damaged(folder)
        version = fields.get("format_version")
        if isinstance(version, int) and version > FORMAT_VERSION:
            raise StoreError(
                f"{folder} was written by a newer salad (index format {version}, this one reads up to "
                f"{FORMAT_VERSION}): upgrade salad to use it"
            )
        try:
            return cls(
                model=str(fields["model"]),
                fingerprint=str(fields["fingerprint"]),
                dim=_whole(fields["dim"]),
                created=datetime.fromisoformat(str(fields["created"])),
                format_version=_whole(version),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise _damaged(folder) from error


def _whole(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:  # JSON's true is an int to Python
        raise ValueError(value)
    return value


def _damaged(folder: Path) -> StoreError:
    return StoreError(
        f"{folder / HEADER_FILE} is damaged or not of a salad index: restore it, or index the photos again"
    )


def make(folder: Path, header: Header) -> Path:
    """Make an empty index in `folder`, which must not exist or be empty, at one stroke.

    Raises:
        StoreError: If the folder is in use or cannot be written; nothing is left behind.
    """
    with drafted(folder, "index") as draft:
        (draft / VECTORS_FILE).touch()
        Catalog.create(draft / CATALOG_FILE, matrix=VECTORS_FILE)
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
    draft = folder.with_name(f".{folder.name}.{uuid.uuid4().hex}")
    try:
        if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
            raise StoreError(f"{folder} already exists and is not empty: name another folder, or open it to add to it")
        draft.mkdir(parents=True)
        yield draft
        settle(draft)  # its files' names onto the disk before its own says that all are there
        if folder.exists():
            folder.rmdir()  # an empty one: on Windows nothing is renamed over it
        draft.rename(folder)
    except OSError as error:
        raise StoreError(
            f"no {what} can be made at {folder} ({error.strerror or error}): name another folder, make room, or "
            "check permissions"
        ) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def size(folder: Path) -> int:
    """Bytes of the files in `folder`; one that goes away meanwhile counts nothing."""
    total = 0
    for file in folder.iterdir():
        with suppress(FileNotFoundError):
            total += file.stat().st_size
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
