"""The page of results says what was measured, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.accuracy import results
from benchmarks.accuracy.results import shipped_section


def figure(model: str, first: float, *, of: str = "street", date: str = "2026-01-02") -> str:
    recall = {"1": first, "5": 80.0, "10": 90.0, "20": 95.0}
    told = {
        "set": of,
        "viewpoint": "changing",
        "protocol": "frames ±2",
        "queries": 1200,
        "references": 30,
        "unanswerable": 4,
        "recall": recall,
        "model": model,
        "fingerprint": f"print-{model}",
        "intervals": {k: [percent - 5, percent + 3] for k, percent in recall.items()},
        "drawn": {"by": "block", "units": 17, "length": 12, "level": 0.95, "times": 2000, "seed": 0},
        "machine": "a machine",
        "date": date,
        "seed": 0,
    }
    return json.dumps(told)


def test_a_table_a_set_with_intervals(tmp_path: Path) -> None:
    file = tmp_path / "models.jsonl"
    lines = [
        figure("mine", 10.0),
        figure("salad-lite", 40.0),
        figure("hog", 20.0, date="2026-01-05"),
        "",
        figure("hog", 30.0, of="route"),
        figure("salad-lite", 60.0),  # measured again: this one counts
    ]
    file.write_text("\n".join(lines))
    told = shipped_section(file)
    assert told.count("### ") == 2
    assert "1,200 queries, 30 references, 4 unanswerable; drawn by 17 blocks of neighbouring frames." in told
    street = told[told.index("### street") : told.index("### route")]
    rows = [line for line in street.splitlines() if line.startswith("| ") and "R@" not in line]
    assert [row.split(" | ")[0] for row in rows] == [
        "| HOG, no learning at all",
        "| **salad-lite**",
        "| mine",  # what the page does not know stands last
    ]
    assert "| **salad-lite** | 60.0 (55 to 63) | 80.0 (75 to 83) | 90.0 (85 to 93) |" in rows
    assert "2026-01-02 to 2026-01-05" in told
    assert "salad-lite `print-salad-lite`" in told


def test_a_line_that_is_no_figure_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "models.jsonl"
    file.write_text("{\n")
    with pytest.raises(ValueError, match="Expecting"):
        shipped_section(file)


def test_a_grid_without_a_result_keeps_what_the_page_says_of_it(tmp_path: Path) -> None:
    nowhere = (["parts", "sizes"], tmp_path, tmp_path / "models.jsonl", tmp_path)
    first = results.page(*nowhere)
    assert first.count("There is no result of this grid yet.") == 2
    heading = f"### {results.HEADINGS['parts']}\n"
    before = first.replace(f"{heading}\nThere is no result of this grid yet.", f"{heading}\n| a | table |")
    assert results.page(*nowhere, before=before) == before != first
