"""The tables of a grid: from results to lines, and every figure in writing, once."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any

import pytest

from made_results import a_result, put
from salad.ablation.comparison import BenchmarkColumn, ModelLine
from salad.ablation.comparison_tables import csv_table, markdown_table, model_lines, order_sentences, write_tables
from salad.ablation.grids import PaperFigure, grid_rows
from salad.ablation.run_result import check_equal_terms
from salad.errors import ModelError

TOWN = BenchmarkColumn("town", "frames ±1")


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def test_markdown_has_every_figure_with_its_spread_and_the_papers_beside_it(
    three_models: tuple[ModelLine, ...],
) -> None:
    told = markdown_table(three_models, notes=["A sentence."])
    table = [cells(line) for line in told.splitlines() if line.startswith("|")]
    assert table[0] == [
        *("", "town, frames ±1", "street, radius 25 m", "paper: msls-val-740"),
        *("trained parameters", "ms a photo", "seeds"),
    ]
    assert len({len(row) for row in table}) == 1
    assert table[2] == ["SALAD", "**81.0 ± 1.4**", "40.5 ± 0.7", "92.2", "123,456", "12.3", "2"]
    assert table[3] == ["GeM \\| <b>", "60.5 ± 0.7", "**50.5 ± 0.7**", "85.4", "1", "–", "2"]
    assert table[4] == ["CosPlace", "65.0 ± 14.1", "–", "87.4\\*", "–", "–", "2"]
    assert "\nA sentence.\n" in told
    assert "\\* on another backbone; left out of the order." in told
    assert "Bold: leads every other row" in told


def test_the_order_is_told_set_by_set(three_models: tuple[ModelLine, ...]) -> None:
    town, street = order_sentences(three_models)
    assert town == "- town, frames ±1: of 1 pairs that the paper puts in an order, 1 stand in it here."
    assert street == (
        "- street, radius 25 m: of 1 pairs that the paper puts in an order, 0 stand in it here; the other way "
        "round by more than the spread: GeM | <b> before SALAD by 10.0 ± 1.0."
    )
    near = [
        ModelLine("a", {TOWN: {1: [5.0]}}, {"x": PaperFigure("x", 1.0)}),
        ModelLine("b", {TOWN: {1: [4.0]}}, {"x": PaperFigure("x", 2.0)}),
    ]
    assert order_sentences(near)[0].endswith("within the spread or with none known: a before b by 1.0.")
    assert order_sentences([ModelLine("a", {TOWN: {1: [5.0]}})]) == []


def test_what_cannot_be_said_is_not() -> None:
    assert markdown_table([]) == "There is no result yet."
    alone = markdown_table([ModelLine("a", {TOWN: {1: [5.0]}}, seeds=1), ModelLine("b", {TOWN: {1: [90.0]}}, seeds=1)])
    assert "of one seed" in alone
    assert "**" not in alone
    assert "paper" not in alone
    level = markdown_table(
        [ModelLine("a", {TOWN: {1: [5.0, 6.0]}}, seeds=2), ModelLine("b", {TOWN: {1: [6.0, 5.0]}}, seeds=2)]
    )
    assert "none is bold" in level
    assert "**" not in level


def test_csv_has_a_line_a_figure(three_models: tuple[ModelLine, ...]) -> None:
    rows = list(csv.DictReader(io.StringIO(csv_table(three_models))))
    assert len(rows) == 9
    first = rows[0]
    assert (first["source"], first["model"], first["set"], first["protocol"], first["k"]) == (
        *("ours", "SALAD", "town", "frames ±1", "1"),
    )
    assert (first["percent"], first["deviation"], first["seeds"]) == ("81.000", "1.414", "2")
    assert first["trained parameters"] == "123456"
    theirs = [row for row in rows if row["source"] == "paper"]
    assert [(row["model"], row["percent"], row["aside"]) for row in theirs] == [
        ("SALAD", "92.2", ""),
        ("GeM | <b>", "85.4", ""),
        ("CosPlace", "87.4", "on another backbone"),
    ]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"recipe": {"tune_steps": 4}}, "steps: 5, not 4"),
        ({"recipe": {"views": 5}}, "recipe.views: 5, not 4"),
        ({"start": {"name": "b.pth", "sha256": "0"}}, "start.name: b.pth, not a.pth"),
        ({"data": {"places": 1, "photos": 4, "cities": {}, "digest": "e"}}, "data: e, not d"),
    ],
)
def test_one_table_holds_equal_terms_only(tmp_path: Path, change: dict[str, Any], told: str) -> None:
    put(tmp_path, a_result("small", 0, 50.0), a_result("full", 0, 90.0, **change))
    with pytest.raises(ModelError, match="equal terms only") as refusal:
        write_tables(tmp_path, "sizes", grid_rows("sizes"))
    assert told in str(refusal.value)
    assert not (tmp_path / "sizes.md").exists()


def test_a_run_of_no_steps_stands_beside_the_others() -> None:
    none = {"head_steps": 0, "tune_steps": 0}
    check_equal_terms({"gem": [a_result("gem", 0, 1.0)], "vlad": [a_result("vlad", 0, 1.0, recipe=none)]})
    check_equal_terms({"vlad": [a_result("vlad", 0, 1.0, recipe=none)], "gem": [a_result("gem", 0, 1.0)]})
    other = a_result("vlad", 0, 1.0, recipe=none | {"places": 2})
    with pytest.raises(ModelError, match=r"vlad.seed0 was not run on the terms of .*gem.seed0"):
        check_equal_terms({"vlad": [other], "gem": [a_result("gem", 0, 1.0)]})


def test_two_protocols_are_two_columns() -> None:
    other = {"town": {"protocol": "frames ±2", "recall": {"1": 70.0}}}
    results = {
        "small": [a_result("small", 0, 50.0), a_result("small", 1, 0.0, benchmarks=other, held_out={})],
        "medium": [],
        "full": [],
    }
    (line,) = model_lines(grid_rows("sizes"), results, {"town"})
    assert {str(column): by_k[1] for column, by_k in line.recalls.items()} == {
        "town, frames ±0": [50.0],
        "town, frames ±2": [70.0],
    }
    assert line.facts["precision held out"] == 60.0
    assert line.published["sped"].percent == 88.5
