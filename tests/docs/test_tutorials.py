"""The four tutorials run from their first command to their last, on a small drawn town."""

from __future__ import annotations

from collections.abc import Callable

import pytest


@pytest.mark.parametrize("name", ["mapper", "robotics", "sfm", pytest.param("researcher", marks=pytest.mark.torch)])
def test_a_tutorial_runs(name: str, pages: dict[str, str], follow: Callable[[str], int]) -> None:
    assert follow(pages[f"docs/tutorials/{name}.md"]) >= 6
