"""The folder of an index: made whole or not at all; and how paths of photos are written in it."""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Iterable
from pathlib import Path

from salad.errors import StoreError
from salad.index.header import Header
from salad.index.ledger import NAME, Ledger

MATRIX = "descriptors.f16"


def make(folder: Path, header: Header) -> Path:
    """Make an empty index in `folder`, which must not exist or be empty, at one stroke.

    It is made beside the folder and renamed into place.

    Raises:
        StoreError: If the folder is in use or cannot be written; nothing is left behind.
    """
    draft = folder.with_name(f".{folder.name}.{uuid.uuid4().hex}")
    try:
        if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
            raise StoreError(
                f"{folder} already exists and is not empty: name another folder, or open it to add to it"
            )
        draft.mkdir(parents=True)
        (draft / MATRIX).touch()
        Ledger.create(draft / NAME, matrix=MATRIX)
        header.write(draft)
        if folder.exists():
            folder.rmdir()
        draft.rename(folder)
    except OSError as error:
        raise StoreError(
            f"no index can be made at {folder} ({error.strerror}): name another folder, or check permissions"
        ) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return folder


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
        found.append(Path(folders[folder], name))
    return found
