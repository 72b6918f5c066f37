"""What tests/attack does in a minute, in full: all attacks on all commands, mutations by the thousand, kills."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from attack import mutations
from attack.answers import PHOTOS, an_arena, set_up, trouble
from attack.arena import Arena
from attack.attacks import Attack
from attack.outside import Scene, differences, seen
from attack.test_attacks import ALL
from attack.test_flat import stays_flat, watched
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
KILLED: dict[str, tuple[Sequence[str], Callable[[Held], Held]]] = {
    # What is killed, and what an index that held some photos holds when it has come to its end.
    "a new index": (("index", "{photos}", "--to", "{work}/new"), lambda held: ALL_PHOTOS),
    "an addition": (("index", "{photos}", "--to", "{work}/mine.index"), lambda held: ALL_PHOTOS),
    "photos elsewhere": (("index", "{work}/queries", "--to", "{work}/mine.index"), lambda held: held),
    "pruning": (("index", "{work}/gone", "--to", "{work}/mine.index", "--prune"), lambda held: held),
    "a removal": (("remove", "{photos}/1.jpg", "--index", "{work}/mine.index"), lambda held: held - {"1.jpg"}),
    "a compaction": (("compact", "{work}/mine.index"), lambda held: held),
    "a compression": (("compress", "{work}/mine.index", "--bytes", "128"), lambda held: held),
    "taking codes away": (("compress", "{work}/mine.index", "--off"), lambda held: held),
    "a merge": (("merge", "{work}/mine.index", "{work}/other.index"), lambda held: held | {"8.jpg"}),
    "an export": (("export", "{work}/mine.index", "--to", "{work}/exported"), lambda held: held),
    "an import": (("index", "--from", "{work}/sent", "--to", "{work}/new"), lambda held: held),
}
ALL_PHOTOS: Held = {f"{number}.jpg" for number in range(PHOTOS)}


def held_by(folder: Path) -> Held:
    """What an index holds, which must be sound."""
    with Index.open(folder) as index:
        assert index.verify() == []
        return {photo.path.name for photo in index.photos()}


@pytest.mark.parametrize("what", KILLED)
def test_a_killed_command_leaves_what_was_or_what_comes_of_it(what: str, stage: tuple[Arena, Scene]) -> None:
    arena, scene = stage
    chance, (command, comes_of_it) = random.Random(what), KILLED[what]
    arguments = [argument.format(work=scene.work, photos=scene.photos) for argument in command]
    set_up(scene)
    prepare(scene, arena)
    begun, took = scene.given / "begun", None
    shutil.copytree(scene.work, begun, symlinks=True)
    killed = 0
    for _ in range(KILLS // len(KILLED) + 1):
        shutil.rmtree(scene.work)
        shutil.copytree(begun, scene.work, symlinks=True)
        before, outside = held_by(scene.work / "mine.index"), seen(scene.outside)
        if took is None:  # once to the end, to know how long it takes
            took = arena.run(*arguments, cwd=scene.work).seconds
            continue
        ran = arena.run(*arguments, cwd=scene.work, seconds=chance.uniform(0.0, 1.1 * took))
        killed += ran.killed
        target = scene.work / "new" if what in ("a new index", "an import") else scene.work / "mine.index"
        after = comes_of_it(before)
        if target.exists():
            now = held_by(target)
            least, most = (set(), after) if target.name == "new" else (before & after, before | after)
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
    """Photos that are gone, an export, and another index, beside the sound one."""
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
