"""What tests/attack does in a minute, in full: all attacks on all commands, mutations by the thousand, kills."""

from __future__ import annotations

import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from attack import mutations
from attack.answers import an_arena, set_up, trouble
from attack.arena import Arena
from attack.attacks import Attack
from attack.changes import CHANGES, check, held_before, held_by, prepare
from attack.outside import Scene, differences, seen
from attack.test_attacks import ALL
from attack.test_flat import stays_flat, watched

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


@pytest.mark.parametrize("what", CHANGES)
def test_a_killed_command_leaves_what_was_or_what_comes_of_it(what: str, stage: tuple[Arena, Scene]) -> None:
    arena, scene = stage
    chance, change = random.Random(what), CHANGES[what]
    arguments = [argument.format(work=scene.work, photos=scene.photos) for argument in change.command]
    set_up(scene)
    prepare(scene, arena)
    begun, took = scene.given / "begun", None
    shutil.copytree(scene.work, begun, symlinks=True)
    killed = 0
    for _ in range(KILLS // len(CHANGES) + 1):
        shutil.rmtree(scene.work)
        shutil.copytree(begun, scene.work, symlinks=True)
        before, outside = held_before(change, scene), seen(scene.outside)
        if took is None:  # once to the end, to know how long it takes
            took = arena.run(*arguments, cwd=scene.work).seconds
            continue
        ran = arena.run(*arguments, cwd=scene.work, seconds=chance.uniform(0.0, 1.1 * took))
        killed += ran.killed
        check(change, scene, before)
        again = arena.run(*arguments, cwd=scene.work)
        assert again.code in (0, 1) or "exported already exists" in again.err, again
        if what != "an export":
            assert held_by(scene.work / change.target) == change.comes_of_it(before)
        assert not differences(outside, seen(scene.outside))
    assert killed > KILLS / len(CHANGES) / 4
