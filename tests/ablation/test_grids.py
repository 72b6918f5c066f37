"""The grids as data: their names fit folders, their figures are the paper's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from salad.ablation.grids import ALL_BLOCKS, GRIDS, PAPERS_BLOCKS, grid_rows
from salad.errors import ModelError
from salad.network.aggregator_config import compared_aggregators


@pytest.mark.parametrize("grid", GRIDS)
def test_rows_are_told_apart_and_name_aggregators_there_are(grid: str) -> None:
    there = grid_rows(grid)
    for each in ("name", "title"):
        assert len({getattr(row, each) for row in there}) == len(there)
    for row in there:
        assert re.fullmatch(r"[a-z0-9-]+", row.name)  # a folder's name on every system
        made = compared_aggregators(64)[row.aggregator]
        assert all(hasattr(made, setting) for setting in row.change)
        assert row.blocks >= 0 or row.blocks == ALL_BLOCKS


def test_what_the_issue_asks_to_compare_is_compared() -> None:
    assert {row.aggregator for row in grid_rows("aggregators")} == {
        *("salad", "netvlad", "netvlad-linear", "gem", "average", "class-token", "mixvpr", "conv-ap"),
        *("cosplace", "boq", "vlad"),
    }
    assert [row.blocks for row in grid_rows("blocks")] == [0, 2, 4, 6, ALL_BLOCKS]
    parts = {row.name: row for row in grid_rows("parts")}
    assert {row.change.get("iterations", 3) for row in parts.values()} == {1, 3, 10}
    assert {row.aggregator for row in parts.values() if row.fewer_tokens} == {"salad", "salad-no-dustbin"}
    assert [row.change["clusters"] for row in grid_rows("sizes")] == [16, 32, 64]
    trained = [row for grid in GRIDS for row in grid_rows(grid) if grid != "blocks" and not row.fitted]
    assert {row.blocks for row in trained} == {PAPERS_BLOCKS}


def test_the_papers_figures_are_those_of_its_tables(shared: Path) -> None:
    """docs and grids may drift apart; the specification holds every figure once."""
    told = set(re.findall(r"\d+\.\d", (shared / "spec" / "method.md").read_text(encoding="utf-8")))
    figures = [theirs for grid in GRIDS for row in grid_rows(grid) for theirs in row.paper]
    assert len(figures) > 40
    for theirs in figures:
        assert f"{theirs.percent:.1f}" in told
    best = {row.name: row.paper[0].percent for row in grid_rows("parts") if row.paper}
    assert best == {"whole": 92.2, "no-dustbin": 91.4, "no-scene": 91.8, "dual-softmax": 91.9}


def test_rows_may_be_named_and_stand_in_the_grids_order() -> None:
    assert [row.name for row in grid_rows("blocks", ("blocks-all", "blocks-0"))] == ["blocks-0", "blocks-all"]
    with pytest.raises(ModelError, match="grid blocks has no row 'blocks-5': choose among blocks-0, "):
        grid_rows("blocks", ("blocks-5",))
    with pytest.raises(ModelError, match="no grid 'colours': choose one of aggregators, blocks"):
        grid_rows("colours")
