"""Fifty kills of a process that compresses an index and changes it: `tests/index/test_survival.py` has a dozen."""

from __future__ import annotations

from pathlib import Path

import pytest

from index.test_survival import Victims, outlived_with_codes


@pytest.mark.long
def test_fifty_kills_while_compressing_and_adding(tmp_path: Path) -> None:
    victims = Victims(tmp_path / "log")
    outlived_with_codes(tmp_path, victims, 50)
    victims.close()
