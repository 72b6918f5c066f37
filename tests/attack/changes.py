"""Commands that change an index, which leave what was or what comes of it, whatever becomes of them halfway."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from attack.answers import PHOTOS
from attack.arena import Arena
from attack.outside import Scene
from earlier_indexes import as_format_1
from salad.index.index import Index

Held = set[str]
"""Names of photos."""


class Change(NamedTuple):
    """A command that changes an index.

    Attributes:
        command: Its arguments.
        comes_of_it: What an index that held some photos holds when the command has come to its end.
        target: The index that it changes.
    """

    command: Sequence[str]
    comes_of_it: Callable[[Held], Held] = lambda held: held
    target: str = "mine.index"


CHANGES = {
    "a new index": Change(("index", "{photos}", "--to", "{work}/new"), lambda held: ALL_PHOTOS, "new"),
    "an addition": Change(("index", "{photos}", "--to", "{work}/mine.index"), lambda held: ALL_PHOTOS),
    "photos elsewhere": Change(("index", "{work}/queries", "--to", "{work}/mine.index")),
    "pruning": Change(("index", "{work}/gone", "--to", "{work}/mine.index", "--prune")),
    "a removal": Change(("remove", "{photos}/1.jpg", "--index", "{work}/mine.index"), lambda held: held - {"1.jpg"}),
    "an upgrade": Change(
        ("remove", "{photos}/1.jpg", "--index", "{work}/earlier.index"),
        lambda held: held - {"1.jpg"},
        "earlier.index",
    ),
    "a compaction": Change(("compact", "{work}/mine.index")),
    "a drop of what is damaged": Change(
        ("compact", "{work}/damaged.index", "--drop-damaged"), lambda held: held - {"2.jpg"}, "damaged.index"
    ),
    "a compression": Change(("compress", "{work}/mine.index", "--bytes", "128")),
    "taking codes away": Change(("compress", "{work}/mine.index", "--off")),
    "a merge": Change(("merge", "{work}/mine.index", "{work}/other.index"), lambda held: held | {"8.jpg"}),
    "an export": Change(("export", "{work}/mine.index", "--to", "{work}/exported")),
    "an import": Change(("index", "--from", "{work}/sent", "--to", "{work}/new"), lambda held: held, "new"),
}
ALL_PHOTOS: Held = {f"{number}.jpg" for number in range(PHOTOS)}


_WHOLE_EXPORT = {"descriptors.npy", "photos.csv", "model.json"}


def prepare(scene: Scene, arena: Arena) -> None:
    """Photos that are gone, an export, another index, one of format 1 and a damaged one, beside the sound one."""
    work = scene.work
    shutil.copy(scene.photos / "7.jpg", work / "8.jpg")
    with (work / "8.jpg").open("ab") as file:
        file.write(b"another")
    (work / "gone").mkdir()
    shutil.copy(scene.photos / "2.jpg", work / "gone" / "2.jpg")
    for command in (
        ("index", "8.jpg", "--to", "other.index"),
        ("export", "mine.index", "--to", "sent"),
    ):
        ran = arena.run(*command, cwd=work)
        assert ran.code == 0, ran
    shutil.copytree(work / "mine.index", work / "earlier.index")
    as_format_1(work / "earlier.index")
    shutil.copytree(work / "mine.index", work / "damaged.index")
    with Index.open(work / "damaged.index") as index:
        row = [photo.path.name for photo in index.photos()].index("2.jpg")
    with next((work / "damaged.index").glob("*.f16")).open("r+b") as matrix:
        matrix.seek(row * index.dim * 2)
        matrix.write(bytes(64))


def check(change: Change, scene: Scene, before: Held) -> None:
    """Whether a command that did not come to its end left what was, or what comes of it, or of new photos a part."""
    target, after = scene.work / change.target, change.comes_of_it(before)
    if target.exists():
        least, most = (set(), after) if change.target == "new" else (before & after, before | after)
        assert least <= (now := held_by(target)) <= most, f"{sorted(now)} of {sorted(before)}"
    if (scene.work / "exported").exists():
        assert {path.name for path in (scene.work / "exported").iterdir()} == _WHOLE_EXPORT


def held_before(change: Change, scene: Scene) -> Held:
    """What the index holds that a command will change, or that a new one will be made of."""
    target = scene.work / change.target
    return held_by(target if target.exists() else scene.work / "mine.index")


def held_by(folder: Path) -> Held:
    """What an index holds, of which nothing but photo 2 may be damaged, and that only where it was before."""
    with Index.open(folder) as index:
        held = {photo.path.name for photo in index.photos()}
        damaged = [sentence for sentence in index.verify() if "2.jpg" in sentence]
        assert len(index.verify()) == len(damaged) == (folder.name == "damaged.index" and "2.jpg" in held)
        return held
