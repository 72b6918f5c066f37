"""What tests/attack does in a minute, in full: all attacks on all commands, mutations by the thousand, kills."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from attack import mutations
from attack.answers import PHOTOS, an_arena, set_up, trouble
from attack.arena import Arena
from attack.attacks import Attack
from attack.outside import Scene, differences, seen
from attack.test_attacks import ALL
from attack.test_flat import stays_flat, watched
from earlier_indexes import as_format_1
from salad.index.index import Index

MUTATIONS = 100_000
KILLS = 1_000

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Arena, Scene]]:
    with an_arena(tmp_path_factory.mktemp("stage")) as made:
        yield made


@pytest.mark.parametrize("attack", ALL, ids=lambda attack: attack.name[:80].encode("ascii", "replace").decode())
def test_an_attack_is_answered_by_all_commands(attack: Attack, stage: tuple[Arena, Scene]) -> None:
    arena, scene = stage
    wrong = trouble(attack, scene, arena)
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("part", range(10))
@pytest.mark.parametrize("reader", mutations.READERS)
def test_a_reader_stands_thousands_of_mutations(reader: str, part: int, tmp_path: Path) -> None:
    shares = sum(each.share for each in mutations.READERS.values())
    count = round(MUTATIONS * mutations.READERS[reader].share / shares / 10)
    mutations.prepare(tmp_path)
    arena = Arena(tmp_path / "home")
    # Other seeds than the suite's, which are the first ones.
    said = arena.mutate(reader, range(1_000_000 + part * count, 1_000_000 + (part + 1) * count), folder=tmp_path)
    arena.close()
    assert not said, "\n".join(said[:50])


def test_ten_thousand_locates_stay_flat(tmp_path: Path) -> None:
    stays_flat(watched(tmp_path, 10_000), megabytes=16)


# --- kills of whole commands ---------------------------------------------------------------------

Held = set[str]
"""Names of photos."""


class Killed(NamedTuple):
    """A command that is killed.

    Attributes:
        command: Its arguments.
        comes_of_it: What an index that held some photos holds when the command has come to its end.
        target: The index that it changes.
    """

    command: Sequence[str]
    comes_of_it: Callable[[Held], Held] = lambda held: held
    target: str = "mine.index"


KILLED = {
    "a new index": Killed(("index", "{photos}", "--to", "{work}/new"), lambda held: ALL_PHOTOS, "new"),
    "an addition": Killed(("index", "{photos}", "--to", "{work}/mine.index"), lambda held: ALL_PHOTOS),
    "photos elsewhere": Killed(("index", "{work}/queries", "--to", "{work}/mine.index")),
    "pruning": Killed(("index", "{work}/gone", "--to", "{work}/mine.index", "--prune")),
    "a removal": Killed(("remove", "{photos}/1.jpg", "--index", "{work}/mine.index"), lambda held: held - {"1.jpg"}),
    "an upgrade": Killed(
        ("remove", "{photos}/1.jpg", "--index", "{work}/earlier.index"),
        lambda held: held - {"1.jpg"},
        "earlier.index",
    ),
    "a compaction": Killed(("compact", "{work}/mine.index")),
    "a drop of what is damaged": Killed(
        ("compact", "{work}/damaged.index", "--drop-damaged"), lambda held: held - {"2.jpg"}, "damaged.index"
    ),
    "a compression": Killed(("compress", "{work}/mine.index", "--bytes", "128")),
    "taking codes away": Killed(("compress", "{work}/mine.index", "--off")),
    "a merge": Killed(("merge", "{work}/mine.index", "{work}/other.index"), lambda held: held | {"8.jpg"}),
    "an export": Killed(("export", "{work}/mine.index", "--to", "{work}/exported")),
    "an import": Killed(("index", "--from", "{work}/sent", "--to", "{work}/new"), lambda held: held, "new"),
}
ALL_PHOTOS: Held = {f"{number}.jpg" for number in range(PHOTOS)}


def held_by(folder: Path) -> Held:
    """What an index holds, of which nothing but photo 2 may be damaged, and that only where it was before."""
    with Index.open(folder) as index:
        held = {photo.path.name for photo in index.photos()}
        damaged = [sentence for sentence in index.verify() if "2.jpg" in sentence]
        assert len(index.verify()) == len(damaged) == (folder.name == "damaged.index" and "2.jpg" in held)
        return held


@pytest.mark.parametrize("what", KILLED)
def test_a_killed_command_leaves_what_was_or_what_comes_of_it(what: str, stage: tuple[Arena, Scene]) -> None:
    arena, scene = stage
    chance, (command, comes_of_it, changed) = random.Random(what), KILLED[what]
    arguments = [argument.format(work=scene.work, photos=scene.photos) for argument in command]
    set_up(scene)
    prepare(scene, arena)
    begun, took, target = scene.given / "begun", None, scene.work / changed
    shutil.copytree(scene.work, begun, symlinks=True)
    killed = 0
    for _ in range(KILLS // len(KILLED) + 1):
        shutil.rmtree(scene.work)
        shutil.copytree(begun, scene.work, symlinks=True)
        before = held_by(target if target.exists() else scene.work / "mine.index")
        after, outside = comes_of_it(before), seen(scene.outside)
        if took is None:  # once to the end, to know how long it takes
            took = arena.run(*arguments, cwd=scene.work).seconds
            continue
        ran = arena.run(*arguments, cwd=scene.work, seconds=chance.uniform(0.0, 1.1 * took))
        killed += ran.killed
        if target.exists():
            now = held_by(target)
            least, most = (set(), after) if changed == "new" else (before & after, before | after)
            assert least <= now <= most, f"{what}: {sorted(now)} of {sorted(before)}"
        if (scene.work / "exported").exists():
            assert {path.name for path in (scene.work / "exported").iterdir()} == WHOLE_EXPORT
        again = arena.run(*arguments, cwd=scene.work)
        assert again.code in (0, 1) or "exported already exists" in again.err, again
        if what != "an export":
            assert held_by(target) == after
        assert not differences(outside, seen(scene.outside))
    assert killed > KILLS / len(KILLED) / 4


WHOLE_EXPORT = {"descriptors.npy", "photos.csv", "model.json"}


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
