"""A canary: what lies beside the folder that a test works in, and must lie there afterwards as it did.

No command has any business outside of the folders it is given. Things of every kind lie there, with the names and the
permissions that a slip would find first; whatever is written, made, taken away or turned over beside the folder shows.
"""

from __future__ import annotations

import os
import sqlite3
import stat
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Self

Seen = tuple[int, int, bytes]
"""Of a thing: its type and permissions, when it was changed last (0 of a folder), and its bytes or where it leads."""


@dataclass(frozen=True)
class Canary:
    """What lies in a folder, save for one thing in it.

    Attributes:
        folder: Where it all lies.
        room: The name of what in it is not looked at: there the test works.
        before: What was there, by path.
    """

    folder: Path
    room: str
    before: dict[str, Seen]

    @classmethod
    def beside(cls, room: Path) -> Self:
        """Lay things out beside a folder, which is made if need be, and look at them."""
        room.mkdir(exist_ok=True)
        lay_out(room.parent)
        return cls(room.parent, room.name, seen(room.parent, room.name))

    def changes(self) -> list[str]:
        """What is no longer as it was, each with the path of the thing; none, if all is well."""
        now = seen(self.folder, self.room)
        gone = [f"{path} is gone" for path in self.before if path not in now]
        new = [f"{path} is new" for path in now if path not in self.before]
        return (
            gone + new + [f"{path} was changed" for path, thing in now.items() if self.before.get(path, thing) != thing]
        )


def lay_out(folder: Path) -> None:
    """Put files, folders and links into a folder, as they lie about where people keep photos and indexes."""
    with closing(sqlite3.connect(folder / "photos.sqlite")) as database:
        database.execute("CREATE TABLE photos (path)")
    for name in ("photo.jpg", "places.csv", "index.json", "descriptors.f16", "photos.sqlite-journal", "=1+1.txt"):
        (folder / name).write_bytes(f"what {name} holds is somebody's own\n".encode() * 20)
    (folder / "private").mkdir(mode=0o700)
    (folder / "private" / "key").write_bytes(bytes(range(256)))
    (folder / "private" / "key").chmod(0o400)
    (folder / "draft").mkdir()
    (folder / "link").symlink_to("photo.jpg")
    (folder / "link-to-nowhere").symlink_to("nothing")
    (folder / "link-to-a-folder").symlink_to("private")


def seen(folder: Path, room: str = "") -> dict[str, Seen]:
    """Everything in a folder and its folders, save for `room` in it, by path."""
    things: dict[str, Seen] = {}
    for here, folders, files in os.walk(folder):
        if Path(here) == folder:
            folders[:] = [name for name in folders if name != room]
        for name in (*folders, *files):
            path = Path(here, name)
            known = path.lstat()
            if stat.S_ISLNK(known.st_mode):
                things[str(path)] = (known.st_mode, known.st_mtime_ns, os.fsencode(path.readlink()))
            elif stat.S_ISREG(known.st_mode):
                things[str(path)] = (known.st_mode, known.st_mtime_ns, path.read_bytes())
            else:
                things[str(path)] = (known.st_mode, 0, b"")
    return things
