"""What a run came to: written whole, read back, told apart from another run's."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.ablation.run_result import (
    RESULT_FILE,
    RunResult,
    equal_terms,
    first_difference,
    read_result,
    read_results,
    run_folder,
    write_result,
)
from salad.errors import ModelError

RESULT = RunResult(
    row="gem",
    seed=1,
    preset={
        "model": {"backbone": {"kind": "lite0"}, "preprocessing": {"height": 32}},
        "recipe": {"head_steps": 1, "tune_steps": 3, "seed": 1, "tuned_blocks": 4, "size": None, "places": 2},
    },
    start={"name": "a.pth", "sha256": "ff"},
    data={"places": 2, "photos": 8, "cities": {"x": 2}, "digest": "d"},
    dim=4,
    parameters={"all": 10, "trained": 7},
    milliseconds=1.5,
    held_out={"x": 50.0, "mean": 50.0},
    benchmarks={"town": {"protocol": "frames ±1", "recall": {"1": 75.0, "5": 100.0}}},
    seconds={"training": 1.0, "measuring": 2.0},
    fingerprint="0123",
    versions={"salad": "1"},
    machine={"cores": 2},
    finished="2026-01-02",
)


def test_an_outcome_is_read_as_it_was_written(tmp_path: Path) -> None:
    assert read_result(tmp_path) is None
    write_result(RESULT, tmp_path)
    assert read_result(tmp_path) == RESULT
    assert [path.name for path in tmp_path.iterdir()] == [RESULT_FILE]
    more = replace(
        RESULT, benchmarks=RESULT.benchmarks | {"street": {"protocol": "radius 25 m", "recall": {"1": 10.0}}}
    )
    write_result(more, tmp_path)
    assert read_result(tmp_path) == more
    assert list(more.benchmarks) == ["town", "street"]


@pytest.mark.parametrize("text", ["{", "[]", "{}", "null", '{"format": 2}', '{"format": 1, "row": "gem"}'])
def test_a_damaged_outcome_is_a_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / RESULT_FILE).write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match=r"result\.json .*: remove its folder to have it run again"):
        read_result(tmp_path)


def test_all_outcomes_are_found_by_row_and_in_the_order_of_their_seeds(tmp_path: Path) -> None:
    for row, seed in (("gem", 10), ("gem", 2), ("boq", 0)):
        folder = run_folder(tmp_path, row, seed)
        folder.mkdir(parents=True)
        write_result(replace(RESULT, row=row, seed=seed), folder)
    run_folder(tmp_path, "boq", 1).mkdir()  # a run that has not come to an end
    found = read_results(tmp_path, ("boq", "gem", "salad"))
    assert {row: [one.seed for one in some] for row, some in found.items()} == {
        "boq": [0],
        "gem": [2, 10],
        "salad": [],
    }


TREES = st.recursive(
    st.none() | st.integers() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(max_size=3), TREES, max_size=4))
def test_nothing_differs_from_itself_not_even_through_json(tree: dict[str, Any]) -> None:
    assert first_difference(tree, tree) is None
    assert first_difference(tree, json.loads(json.dumps(tree))) is None


def test_a_difference_names_the_setting_and_both_values() -> None:
    one = {"recipe": {"steps": 3, "mean": (1, 2)}, "seed": 0}
    assert first_difference(one, {"recipe": {"steps": 3, "mean": [1, 2]}, "seed": 0}) is None
    assert first_difference(one, {"recipe": {"steps": 4, "mean": [1, 2]}, "seed": 1}) == "recipe.steps: 3, not 4"
    assert first_difference(one, {"recipe": {"steps": 3}, "seed": 0}) == "recipe.mean: [1, 2], not None"


def test_the_terms_leave_out_what_belongs_to_a_row_or_a_seed() -> None:
    recipe = RESULT.preset["recipe"]

    def with_recipe(**change: Any) -> dict[str, Any]:
        return equal_terms(replace(RESULT, preset=RESULT.preset | {"recipe": recipe | change}))

    wanted = equal_terms(RESULT)
    assert wanted["steps"] == 4
    assert with_recipe(seed=5, tuned_blocks=0, size=24, head_steps=0, tune_steps=4) == wanted
    assert with_recipe(head_steps=2) != wanted
    assert with_recipe(places=3) != wanted
    assert "steps" not in with_recipe(head_steps=0, tune_steps=0)
    assert equal_terms(replace(RESULT, data=RESULT.data | {"digest": "e"})) != wanted
    assert equal_terms(replace(RESULT, start={"name": "a.pth", "sha256": "fe"})) != wanted
