"""`salad compare` from its arguments to its tables; one road with real training, the others without any."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from made_results import a_result, put
from salad.ablation.run_result import read_result, run_folder
from salad.cli.compare_command import benchmark_by_rule
from salad.errors import BenchmarkError


def refused(ran: Any) -> str:
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.startswith("salad: ")
    assert ran.err.count("\n") == 1
    return str(ran.err)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty places of four photos, enough for a batch of sixteen."""
    root, chance = tmp_path_factory.mktemp("places") / "set", np.random.default_rng(0)
    for number in range(20):
        (root / f"{number:02}").mkdir(parents=True)
        scene = chance.integers(0, 256, (4, 4, 3))
        for photo in range(4):
            pixels = np.clip(scene + chance.normal(0, 20, scene.shape), 0, 255).astype(np.uint8)
            Image.fromarray(pixels).resize((32, 32)).save(root / f"{number:02}" / f"{photo}.png")
    return root


@pytest.mark.torch
def test_a_grid_is_trained_measured_and_told(cli: Any, photos: Any, data: Path, tmp_path: Path) -> None:
    to = tmp_path / "runs"
    command = (
        *("compare", "--grid", "aggregators", "--rows", "gem", "vlad", "--size", 32, "--steps", 2),
        *("--seeds", 1, "--data", data, "--to", to, "--accelerator", "cpu"),
        *("--benchmark", "town", photos.references, photos.queries, "frames:0"),
    )
    ran = cli(*command)
    assert ran.code == 0, ran.err
    assert "| GeM | " in ran.out
    assert "| VLAD without training | " in ran.out
    assert "town, frames ±0" in ran.out
    trained = read_result(to / "gem" / "seed0")
    assert trained is not None
    assert (trained.preset["recipe"]["head_steps"], trained.preset["recipe"]["tune_steps"]) == (0, 2)
    result = trained.benchmarks["town"]
    assert (result["queries"], result["references"], set(result["recall"])) == (6, 6, {"1", "5", "10", "20"})
    assert (to / "aggregators.md").read_text(encoding="utf-8") == ran.out
    again = cli(*command)  # nothing is trained twice
    assert (again.code, again.out) == (0, ran.out)
    assert "of 2 runs" not in again.err


@pytest.mark.torch
def test_heads_alone_are_compared_under_a_frozen_backbone(cli: Any, photos: Any, data: Path, tmp_path: Path) -> None:
    to = tmp_path / "runs"
    ran = cli(
        *(
            "compare",
            "--grid",
            "aggregators",
            "--rows",
            "gem",
            "average",
            "--size",
            32,
            "--steps",
            2,
            "--frozen",
        ),
        *("--seeds", 1, "--data", data, "--to", to, "--accelerator", "cpu"),
        *("--benchmark", "town", photos.references, photos.queries, "frames:0"),
    )
    assert ran.code == 0, ran.err
    trained, untrained = read_result(to / "gem" / "seed0"), read_result(to / "average" / "seed0")
    assert trained is not None
    assert untrained is not None
    assert trained.preset["recipe"]["head_steps"] == 2
    assert untrained.preset["recipe"]["head_steps"] == 0
    assert {one.preset["recipe"]["tuned_blocks"] for one in (trained, untrained)} == {0}
    assert trained.parameters["trained"] == 1  # the mean's power
    assert "32 x 32 pixels, the backbone frozen and 4 versions of each photo kept as tokens, unless" in ran.out
    refusal = refused(cli("compare", "--grid", "blocks", "--to", to, "--frozen"))
    assert "compares how many blocks are trained: leave --frozen out" in refusal


def test_the_tables_are_made_again_from_the_results_there_are(cli: Any, tmp_path: Path) -> None:
    put(tmp_path, *(a_result("small", seed, 50.0 + seed) for seed in (0, 1)), a_result("full", 0, 90.0))
    ran = cli("compare", "--grid", "sizes", "--to", tmp_path, "--table-only")
    assert ran.code == 0
    small, full = (line for line in ran.out.splitlines() if line.startswith(("| small", "| full")))
    assert "| 50.5 ± 0.7 | 70.8 | 89.3 | 61.2 | 93.0 | 88.5 | 10 | 544 | 2.5 | 60.5 | 2 |" in small
    assert "| 90.0 | 75.0 | 92.2 |" in full
    assert "starts from a.pth (SHA-256 ffffffffffff) and takes 4 steps of 16 places x 4 photos at 32 x 32" in ran.out
    assert "Seeds: 0, 1." in ran.out
    assert "20 places, 80 photos (set 20; digest d), 20% of the places held out" in ran.out
    assert "Made 2026-01-02 with salad 1, torch 2 on Any, 2 cores, 1 threads, measured on cpu." in ran.out
    assert (tmp_path / "sizes.csv").read_text(encoding="utf-8").count("\nours,") == 4
    assert ET.parse(tmp_path / "sizes.svg").getroot().tag.endswith("svg")
    assert "no result yet of medium" in ran.err


def test_a_set_that_not_every_run_was_measured_on_is_left_out(cli: Any, tmp_path: Path) -> None:
    both = {name: {"protocol": "frames ±0", "recall": {"1": 40.0, "5": 90.0}} for name in ("town", "field")}
    put(tmp_path, a_result("small", 0, 50.0), a_result("full", 0, 90.0, benchmarks=both))
    ran = cli("compare", "--grid", "sizes", "--to", tmp_path, "--table-only")
    assert ran.code == 0
    head = next(line for line in ran.out.splitlines() if "paper:" in line)
    assert "town, frames" in head
    assert "field" not in head
    assert "field is left out: 1 of 2 runs were measured on it." in ran.out


def test_a_table_of_nothing_is_refused(cli: Any, tmp_path: Path) -> None:
    said = refused(cli("compare", "--grid", "blocks", "--to", tmp_path / "none", "--table-only"))
    assert "holds no outcome of a run of the grid blocks" in said


# --- what is refused, before anything is trained -------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((), "nothing to measure on: give --benchmark"),
        (("--rows", "colours"), "grid sizes has no row 'colours'"),
        (("--seeds", 0), "seeds 0 is too few"),
        (("--size", 0), "size 0 is too few"),
        (("--benchmark", "town", "gone", "lost", "frames:1"), "gone"),
        (("--benchmark", "town", "a", "b", "by eye"), "is not said by 'by eye': give frames:N"),
    ],
)
def test_bad_input_is_a_sentence(cli: Any, tmp_path: Path, arguments: tuple[Any, ...], told: str) -> None:
    said = refused(cli("compare", "--grid", "sizes", "--to", tmp_path / "runs", *arguments))
    assert told in said
    assert not (tmp_path / "runs").exists()


@pytest.mark.torch
def test_data_start_and_names_are_looked_at_first(cli: Any, photos: Any, data: Path, tmp_path: Path) -> None:
    town = ("--benchmark", "town", photos.references, photos.queries, "frames:0")
    command = ("compare", "--grid", "sizes", "--to", tmp_path / "runs", *town)
    assert "nothing to learn from" in refused(cli(*command))
    assert "two benchmarks are called 'town'" in refused(cli(*command, *town))
    learn = (*command, "--data", data)
    assert "steps 0 is too few" in refused(cli(*learn, "--steps", 0))
    assert "gone.pth" in refused(cli(*learn, "--start", tmp_path / "gone.pth"))
    assert "16 clusters need more than 16" in refused(cli(*learn, "--size", 32, "--rows", "small"))
    assert not (tmp_path / "runs").exists()


def test_a_benchmark_is_two_folders_and_a_rule(photos: Any, tmp_path: Path) -> None:
    folders = photos.references, photos.queries
    assert benchmark_by_rule("town", *folders, "frames:2").protocol == "frames ±2"
    truth = tmp_path / "gt.csv"
    truth.write_text(f"query,positives\n{photos.query[0].name},{photos.query[0].name}\n", encoding="utf-8")
    made = benchmark_by_rule("town", *folders, f"truth:{truth}")
    assert (made.name, made.protocol, len(made.queries)) == ("town", "truth gt.csv", 1)
    with pytest.raises(BenchmarkError, match="no position"):  # read, and found to have no geotags
        benchmark_by_rule("town", *folders, "radius:25")
    for rule in ("frames", "frames:", "frames:x", "radius:", "radius:far", "truth", "truth:", ":1", ""):
        with pytest.raises(BenchmarkError, match="'town': what is right is not said by"):
            benchmark_by_rule("town", *folders, rule)


def test_the_command_line_starts_without_torch() -> None:
    import subprocess
    import sys

    code = "import sys, salad.cli.compare_command, salad.ablation.comparison_tables; print('torch' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"


def test_results_are_json_that_others_can_read(tmp_path: Path) -> None:
    """What `salad evaluate --format json` says of a set stands in it, by the set's name."""
    put(tmp_path, a_result("small", 0, 50.0))
    told = json.loads((run_folder(tmp_path, "small", 0) / "result.json").read_text(encoding="utf-8"))
    assert told["benchmarks"]["town"]["recall"]["1"] == 50.0
    assert told["format"] == 1


def test_two_results_are_compared_query_by_query(cli: Any, photos: Any, tmp_path: Path) -> None:
    files = [tmp_path / f"{model}.json" for model in "ab"]
    for file in files:
        evaluate = ("evaluate", "--references", photos.references, "--queries", photos.queries, "--frames", 0)
        assert cli(*evaluate, "--save", file).code == 0
    ran = cli("compare", *files, "--format", "json")
    assert ran.code == 0, ran.err
    told = json.loads(ran.out)
    assert told["protocol"] == "frames ±0"
    assert told["recall"]["1"]["difference"] == 0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "nothing says what to compare"),
        (("--grid", "sizes"), "nothing says what to compare"),
        (("one.json",), "two results are compared, but 1 files are given"),
        (("one.json", "two.json", "--grid", "sizes"), "give one or the other"),
        (("one.json", "two.json"), "one.json"),
    ],
)
def test_what_cannot_be_compared_is_refused(cli: Any, words: tuple[str, ...], sentence: str) -> None:
    assert sentence in refused(cli("compare", *words))
