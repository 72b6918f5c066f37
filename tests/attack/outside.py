"""The canary: what lies beside, and must be found as it was."""

from __future__ import annotations

import hashlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path

Seen = dict[str, tuple[object, ...]]
"""What is at each path: its kind and permissions, its content or where it leads, and when that was changed last."""


def seen(folder: Path) -> Seen:
    """All that lies in a folder; nothing is opened but regular files, and no link is followed."""
    found: Seen = {}
    for path in [folder, *sorted(folder.rglob("*"))]:
        now = os.lstat(path)
        what: object = None
        if stat.S_ISLNK(now.st_mode):
            what = path.readlink()
        elif stat.S_ISREG(now.st_mode):
            # A sparse file of gigabytes is told by its ends.
            with path.open("rb") as file:
                head = file.read(1 << 20)
                file.seek(max(0, now.st_size - (1 << 20)))
                what = hashlib.sha256(head + file.read(1 << 20)).hexdigest()
        found[str(path.relative_to(folder))] = (now.st_mode, now.st_size, what, now.st_mtime_ns)
    return found


def differences(before: Seen, after: Seen, *, times: bool = True) -> list[str]:
    """What was made, lost or changed, a sentence each.

    Args:
        before: What was there.
        after: What is there now.
        times: Whether being written anew with the same content counts.
    """
    length = None if times else -1
    return (
        [f"{path} is gone" for path in before.keys() - after.keys()]
        + [f"{path} was made" for path in after.keys() - before.keys()]
        + [
            f"{path} was changed"
            for path in before.keys() & after.keys()
            if before[path][:length] != after[path][:length]
        ]
    )


@dataclass(frozen=True)
class Scene:
    """Folders of one attack, beside each other.

    Attributes:
        given: What came from a stranger.
        outside: What nobody may touch: `photo.jpg`, `note.txt`, `zeros.bin` (its first byte is 0), `rows.f16`,
            `other.sqlite`, a folder `private` with `letter.txt`, and a link.
        work: Where commands run, and write what they are asked to write.
        photos: Photos with positions, that `index` is of.
        index: A sound index of them, to be copied, never to be changed.
    """

    given: Path
    outside: Path
    work: Path
    photos: Path
    index: Path
