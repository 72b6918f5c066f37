"""A full disk, wherever a command meets it: a sentence, and what was or what comes of it, nothing halfway."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

from attack.answers import an_arena, set_up
from attack.arena import Arena
from attack.changes import CHANGES, check, held_before, prepare
from attack.outside import Scene

LONGEST = (700, 2_000, 4_000, 8_000, 12_000, 16_000, 24_000, 32_000, 50_000, 1_000_000)
"""Bytes that a file may have: from hardly more than the sentence that says so to what all that is written fits in."""


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Arena, Scene]]:
    with an_arena(tmp_path_factory.mktemp("stage")) as made:
        set_up(made[1])
        prepare(made[1], made[0])
        shutil.copytree(made[1].work, made[1].given / "begun", symlinks=True)
        yield made


@pytest.mark.parametrize("what", CHANGES)
def test_a_change_on_a_full_disk_is_made_or_not(what: str, stage: tuple[Arena, Scene]) -> None:
    arena, scene = stage
    change, codes = CHANGES[what], []
    arguments = [argument.format(work=scene.work, photos=scene.photos) for argument in change.command]
    for longest in LONGEST:
        shutil.rmtree(scene.work)
        shutil.copytree(scene.given / "begun", scene.work, symlinks=True)
        before = held_before(change, scene)
        ran = arena.run(*arguments, cwd=scene.work, longest_file=longest)
        codes.append(ran.code)
        assert ran.code in (0, 1, 2), f"{longest}: {ran}"
        if ran.code == 2:
            assert ran.err.splitlines()[-1].startswith("salad: "), f"{longest}: {ran}"
            assert not {"Traceback", "Errno", "disk I/O"} & set(ran.err.split()), f"{longest}: {ran}"
        check(change, scene, before)
        left = [path for path in scene.work.rglob("*") if path.name.endswith(".part") or path.name.startswith(".")]
        assert not left, f"{longest}: {left}"
    assert codes[0] == 2 or what in ("photos elsewhere", "pruning")  # which change a page of the table, if anything
    assert codes[-1] in (0, 1), ran
