"""A file that is written whole or not at all, and what tells it from every other."""

from __future__ import annotations

import hashlib
import uuid
from contextlib import suppress
from pathlib import Path


def write_whole(path: Path, content: bytes) -> None:
    """Put `content` at `path` at one stroke: written beside it, then renamed; what stood there is replaced.

    Raises:
        OSError: If it cannot be written; what stood there stays, and nothing is left beside it.
    """
    part = path.with_name(f".{uuid.uuid4().hex}.part")  # on the same disk, for only there a rename is one stroke
    try:
        part.write_bytes(content)
        part.replace(path)
    except OSError:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def sha256_of(path: Path) -> str:
    """The checksum of a file, in hexadecimal digits.

    Raises:
        OSError: If it cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
