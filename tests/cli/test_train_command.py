"""`salad train`: what may be given, what is refused in a sentence, and a dry run that writes nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import pytest

from salad.cli.train_command import TrainCommand
from salad.network.aggregator_config import SaladConfig
from salad.network.config import LiteConfig, ModelConfig, Preprocessing
from salad.training.recipe import PRESETS, Preset, Recipe

Cli = Callable[..., Any]
TINY = ModelConfig(
    "tiny",
    LiteConfig(blocks=1),
    SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=4, hidden=8),
    Preprocessing(32, 32),
)


@pytest.fixture
def data(training_photos: Path) -> Path:
    return training_photos


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = Recipe(
        head_steps=1,
        tune_steps=3,
        tuned_blocks=1,
        places=2,
        views=2,
        warmup=1,
        precision="32-true",
        held_out=0.5,
    )
    monkeypatch.setitem(PRESETS, "tiny", Preset(TINY, "", recipe))


def _sentence(ran: Any) -> str:
    assert ran.code == 2, ran.err
    assert "Traceback" not in ran.err
    assert not ran.out
    last: str = ran.err.splitlines()[-1]
    assert last.startswith("salad: ")
    return last


def test_every_setting_reaches_the_recipe() -> None:
    given: dict[str, Any] = {
        "places": 3,
        "views": 5,
        "at_once": 7,
        "size": 28,
        "head_rate": 0.5,
        "trunk_rate": 0.25,
        "augment": "none",
        "sampler": "cliques",
        "mine_every": 9,
        "held_out": 0.25,
        "measure_every": 11,
        "save_every": 13,
        "precision": "16-mixed",
        "seed": 17,
        "split_seed": 5,
        "tuned_blocks": 0,
        "cache_versions": 19,
        "full_steps": 2,
        "weight_decay": 0.125,
        "warmup": 1,
        "last": 0.5,
        "decay_over": 3,
        "average": 0.75,
        "clip": 2.0,
        "mirror": False,
        "clique": 6,
        "tuned_share": 0.5,
    }
    by_stage = {"head_steps", "tune_steps", "epochs"}  # of these, the next test
    assert given.keys() | by_stage == {field.name for field in fields(Recipe)} - {"version"}
    recipe = TrainCommand(preset="tiny", **given)._preset().recipe
    assert {name: getattr(recipe, name) for name in given} == given
    assert (recipe.head_steps, recipe.tune_steps) == (1, 3)
    assert TrainCommand(preset="tiny")._preset() is not None
    assert TrainCommand(preset="tiny")._preset().recipe == PRESETS["tiny"].recipe


def test_steps_are_shared_or_given_by_stage() -> None:
    shared = TrainCommand(preset="tiny", steps=8)._preset().recipe
    assert (shared.head_steps, shared.tune_steps) == (2, 6)
    apart = TrainCommand(preset="paper", tune_steps=8)._preset().recipe
    assert (apart.head_steps, apart.tune_steps, apart.epochs) == (0, 8, None)
    assert TrainCommand(preset="paper", epochs=2)._preset().recipe.epochs == 2


@pytest.mark.torch
def test_a_benchmark_of_ones_own_is_the_judge(cli: Cli, tmp_path: Path, data: Path) -> None:
    truth = tmp_path / "truth.csv"
    truth.write_text("query,positives\n0.png,0.png;1.png\n")
    sides = ("--references", data / "a", "--queries", data / "b", "--truth", truth)
    ran = cli("train", "--preset", "tiny", "--data", data, "--to", tmp_path / "run", *sides, "--accelerator", "cpu")
    assert ran.code == 0, ran.err
    told = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in told] == [1, 4]
    assert all(line["benchmark"]["mean"] == line["benchmark"]["R@1"] for line in told)


@pytest.mark.torch
def test_a_run_can_be_insisted_on(cli: Cli, tmp_path: Path, data: Path) -> None:
    command = ("train", "--preset", "tiny", "--data", data, "--to", tmp_path / "run", "--accelerator", "cpu")
    assert "no run in" in _sentence(cli(*command, "--resume"))
    assert not (tmp_path / "run").exists()
    ran = cli(*command)
    assert (ran.code, ran.out) == (0, f"{tmp_path / 'run' / 'model'}\n")
    assert "has ended after 4 steps" in _sentence(cli(*command, "--resume"))
    assert "another recipe" in _sentence(cli(*command, "--seed", 9))


@pytest.mark.torch
def test_a_run_begun_with_kornias_changes_goes_on_with_them(cli: Any, tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    written = {name: value for name, value in asdict(PRESETS["paper"].recipe).items() if name != "version"}
    (run / "config.json").write_text(json.dumps({"recipe": written}), encoding="utf-8")
    told = cli("train", "--data", tmp_path, "--to", run, "--preset", "paper", "--dry-run", "--accelerator", "cpu")
    assert "kornia's RandAugment, as the run was begun" in told.err


@pytest.mark.torch
def test_a_dry_run_tells_and_writes_nothing(
    cli: Cli, tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = cli("train", "--preset", "tiny", "--data", data, "--to", "run", "--dry-run", "--accelerator", "cpu")
    assert ran.code == 0, ran.err
    for told in (
        "2 places x 2 photos at 32 x 32",
        "weights trained",
        "MB a process",
        "minutes",
        "4 photos of noise",
    ):
        assert told in ran.out
    assert "nothing was written" in ran.err
    assert list(tmp_path.iterdir()) == []
    assert "name it with --data" in cli("train", "--preset", "tiny", "--dry-run", "--accelerator", "cpu").out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--preset", "nope"], "no preset 'nope'"),
        (["--places", "1"], "places of the recipe is 1"),
        (["--steps", "0"], "0 steps teach nothing"),
        (["--steps", "5", "--head-steps", "2"], "--steps counts both stages"),
        (["--head-rate", "nan"], "--head-rate nan is no number to reckon with"),
        (["--held-out", "1.5"], "held_out of the recipe is 1.5"),
        (["--devices", "0"], "devices 0 is too few"),
        (["--nodes", "-1"], "nodes -1 is too few"),
        (["--sampler", "cliques"], "batches of cliques need mine_every"),
        (["--cache-versions", "2"], "only under a frozen backbone"),
        (["--truth", "truth.csv"], "name its folders with --references and --queries"),
        (["--references", "here"], "--queries is missing"),
        *(
            pytest.param(*case, marks=pytest.mark.torch)
            for case in (
                (["--devices", "9", "--accelerator", "cpu"], "without any"),
                (["--epochs", "2"], "epochs are counted by the sampler one-city alone"),
                (["--start", "megaloc"], "megaloc is a published model"),
                (["--accelerator", "abacus"], "training cannot run on 1 of 'abacus'"),
            )
        ),
    ],
)
def test_bad_values_are_refused_in_a_sentence(
    cli: Cli, tmp_path: Path, data: Path, arguments: list[str], said: str
) -> None:
    ran = cli("train", "--preset", "tiny", "--data", data, "--to", tmp_path / "run", *arguments)
    assert said in _sentence(ran)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("missing", ["--data", "--to"])
def test_without_data_or_folder_there_is_no_run(cli: Cli, tmp_path: Path, data: Path, missing: str) -> None:
    given = {"--data": data, "--to": tmp_path / "run"}
    del given[missing]
    rest = [part for pair in given.items() for part in pair]
    assert f"{missing} is missing" in _sentence(cli("train", "--preset", "tiny", *rest))


@pytest.mark.parametrize("arguments", [["--augment", "sepia"], ["--precision", "8"], ["--sampler", "all"]])
def test_a_word_there_is_not_is_refused(cli: Cli, data: Path, tmp_path: Path, arguments: list[str]) -> None:
    ran = cli("train", "--data", data, "--to", tmp_path / "run", *arguments)
    assert ran.code == 2
    assert not (tmp_path / "run").exists()


@pytest.mark.torch
class TestPrecision:
    """bf16 where the processor multiplies it; elsewhere torch would take minutes for a step."""

    @pytest.fixture(autouse=True)
    def without_bfloat16(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("salad.training.devices._has_bfloat16", lambda: False)
        preset = PRESETS["tiny"]
        monkeypatch.setitem(PRESETS, "tiny", replace(preset, recipe=replace(preset.recipe, precision="bf16-mixed")))

    def test_it_is_float32_without_the_instructions_and_that_is_said(
        self, cli: Cli, data: Path, tmp_path: Path
    ) -> None:
        given = ("train", "--preset", "tiny", "--data", data, "--to", tmp_path / "run", "--accelerator", "cpu")
        ran = cli(*given)
        assert ran.code == 0, ran.err
        assert "numbers are held in 32-true, for this processor has no instructions for bf16-mixed" in ran.err
        assert json.loads((tmp_path / "run" / "config.json").read_text())["recipe"]["precision"] == "32-true"
        assert cli(*given).code == 0  # the same run, which has ended

    def test_a_run_goes_on_as_it_was_begun(self, tmp_path: Path) -> None:
        (tmp_path / "config.json").write_text('{"recipe": {"precision": "bf16-mixed"}}')
        command = TrainCommand(preset="tiny", to=tmp_path, accelerator="cpu")
        assert command._here(PRESETS["tiny"]).recipe.precision == "bf16-mixed"

    def test_what_is_asked_for_is_what_is_done(self) -> None:
        command = TrainCommand(preset="tiny", precision="bf16-mixed", accelerator="cpu")
        assert command._here(command._preset()).recipe.precision == "bf16-mixed"

    @pytest.mark.parametrize("held", ["", "[]", '{"recipe": {"precision": "half"}}'])
    def test_a_damaged_config_says_nothing_of_it(self, held: str, tmp_path: Path) -> None:
        (tmp_path / "config.json").write_text(held)
        command = TrainCommand(preset="tiny", to=tmp_path, accelerator="cpu")
        assert command._here(PRESETS["tiny"]).recipe.precision == "32-true"

    def test_an_accelerator_keeps_what_the_preset_says(self) -> None:
        command = TrainCommand(preset="tiny", accelerator="gpu")
        assert command._here(PRESETS["tiny"]).recipe.precision == "bf16-mixed"
