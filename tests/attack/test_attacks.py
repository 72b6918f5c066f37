"""Whatever a stranger made, the command line answers as it should, and nothing outside is touched."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from attack import hostile_indexes, hostile_models, hostile_photos, hostile_results, hostile_tables
from attack.answers import an_arena, trouble
from attack.arena import Arena
from attack.attacks import Attack
from attack.outside import Scene

ALL = [
    attack
    for some in (hostile_indexes, hostile_models, hostile_photos, hostile_results, hostile_tables)
    for attack in some.ALL
]
OF_A_FAMILY = 3
"""Neighbours in the list are of one family: of so many the suite takes one, besides all that several commands get."""
IN_SUITE = [
    (number, attack)
    for number, attack in enumerate(ALL)
    if attack.every or (number % OF_A_FAMILY == 0 and not attack.long)
]
NOT_YET: dict[str, tuple[str, ...]] = {
    "an index's table and files are trusted": (
        "descriptors.f16 is a link to a file outside",
        "descriptors.f16 is a link to an endless device",
        "photos.sqlite-journal is a link to a file outside",
        "photos.sqlite-journal is a link to nothing",
        "photos.sqlite-journal is a link to an endless device",
        "photos.sqlite-journal is a folder",
        "the table is a hard link to one of another index",
        "the journal is a hard link",
        "descriptors are a hard link",
        "whatever a compaction makes is there",
        "a journal whose list is photo.jpg",
        "a journal whose list is note.txt",
        "a journal whose list is other.sqlite",
        "a journal whose list is private/letter.txt",
        "a journal whose list is the descriptors",
        "dim is 257",
        "dim is 1000000000000000000",
        "index.json is lists 100,000 deep",
        "index.json is closed lists 100,000 deep",
        "index.json is objects 100,000 deep",
        "the file of 1 commits from now is today's",
        "photos is a view of the table",
        "a trigger at INSERT ON photos that moves all",
        "a trigger at UPDATE ON photos that deletes all",
        "a trigger at UPDATE ON photos that moves all",
        "a trigger at UPDATE ON photos that never ends",
        "a trigger at DELETE ON photos that moves all",
        "a trigger at UPDATE ON committed that moves all",
        "a trigger at INSERT ON codes that moves all",
        "a virtual table beside",
        "a photo at row -1",
        "lat is a number",
        "-1 rows have codes",
        "checksums of codes are a text",
    ),
    "it does not end": (
        "index.json is a pipe",
        "descriptors.f16 is a pipe",
        "photos.sqlite-journal is a pipe",
        "commits without end",
        "photos is a view without end",
        "path is 60 MB",
    ),
}
"""Attacks by name that are not yet answered as they should be, by why: whoever mends one takes it away here."""
WHY = {name: why for why, names in NOT_YET.items() for name in names}


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Arena, Scene]]:
    with an_arena(tmp_path_factory.mktemp("stage")) as made:
        yield made


def marked(number: int, attack: Attack) -> Any:
    why = WHY.get(attack.name, "")
    # What does not end is not waited for.
    marks = [pytest.mark.xfail(strict=True, reason=why, run=why != "it does not end")] if why else []
    return pytest.param(number, attack, id=attack.name[:80].encode("ascii", "replace").decode(), marks=marks)


@pytest.mark.parametrize(("number", "attack"), [marked(*one) for one in IN_SUITE])
def test_an_attack_is_answered(number: int, attack: Attack, stage: tuple[Arena, Scene]) -> None:
    arena, scene = stage
    wrong = trouble(attack, scene, arena, only=number)
    assert not wrong, "\n".join(wrong)


def test_attacks_are_told_apart_by_their_names() -> None:
    assert len({attack.name for attack in ALL}) == len(ALL)
