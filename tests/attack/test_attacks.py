"""Whatever a stranger made, the command line answers as it should, and nothing outside is touched."""

from __future__ import annotations

from collections.abc import Iterator

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
OF_A_FAMILY = 4
"""Neighbours in the list are of one family: of so many the suite takes one, besides all that several commands get."""
IN_SUITE = [
    (number, attack)
    for number, attack in enumerate(ALL)
    if attack.every or (number % OF_A_FAMILY == 0 and not attack.long)
]


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Arena, Scene]]:
    with an_arena(tmp_path_factory.mktemp("stage")) as made:
        yield made


@pytest.mark.parametrize(
    ("number", "attack"),
    IN_SUITE,
    ids=lambda value: value.name[:80].encode("ascii", "replace").decode() if isinstance(value, Attack) else "",
)
def test_an_attack_is_answered(number: int, attack: Attack, stage: tuple[Arena, Scene]) -> None:
    arena, scene = stage
    wrong = trouble(attack, scene, arena, only=number)
    assert not wrong, "\n".join(wrong)


def test_attacks_are_told_apart_by_their_names() -> None:
    assert len({attack.name for attack in ALL}) == len(ALL)
