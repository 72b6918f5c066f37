"""Sound files with something wrong in them: from each comes a value or a sentence, never a traceback, hang or crash."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from attack import mutations
from attack.arena import Arena

COUNT = 150
"""Mutations of each reader that takes no time; tests/long has a hundred times as many."""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of sound things."""
    folder = tmp_path_factory.mktemp("mutations")
    mutations.prepare(folder)
    return folder


@pytest.fixture(scope="module")
def arena(home: Path) -> Iterator[Arena]:
    made = Arena(home / "home")
    yield made
    made.close()


@pytest.mark.parametrize("reader", mutations.READERS)
def test_a_reader_stands_what_is_mutated(reader: str, home: Path, arena: Arena) -> None:
    count = int(COUNT * mutations.READERS[reader].share)
    said = arena.mutate(reader, range(count), folder=home)
    assert not said, "\n".join(said[:20])
