"""Names that stand in other people's scripts and files: recorded once, held from then on (see `facts.py`)."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import salad
from pins.facts import FACTS, SHIPPED, STOPPED, draw_streets, teach
from pins.where import gone, main, recorded, salad_says

PUBLIC = "Answer Describer GeoPoint Index Match Photo Place SaladError __version__ evaluate index_photos load locate"


@pytest.mark.parametrize("name", FACTS)
def test_nothing_that_is_written_down_went_or_changed(name: str) -> None:
    now = json.loads(json.dumps(FACTS[name]()))
    assert gone(recorded(name), now) == []


def test_what_went_or_changed_is_noticed() -> None:
    before = {"a": {"b": 1, "c": [1, 2]}, "d": None}
    assert gone(before, {"a": {"b": 1, "c": [1, 2], "new": 3}, "d": None}) == []
    assert gone(before, {"a": {"b": 2, "c": [1]}}) == ["/d", "/a/b: 1 is 2", "/a/c: [1, 2] is [1]"]


def test_the_public_names() -> None:
    assert {*PUBLIC.split(), "locate_many"} <= set(salad.__all__)
    for name in salad.__all__:
        assert getattr(salad, name) is not None


@pytest.mark.parametrize("name", SHIPPED)
def test_fingerprints_of_the_models_that_ship(name: str) -> None:
    """They decide which indexes belong to a model: weights, architecture and preprocessing, names and all."""
    assert salad.load(name).fingerprint == SHIPPED[name]


def test_a_run_that_was_killed_before_the_rebuild_goes_on(tmp_path: Path) -> None:
    """Its recipe, architecture, photos, start and judge are known again, and its weights and momenta taken up."""
    to = Path(shutil.copytree(STOPPED, tmp_path / "run"))
    said: list[str] = []
    teach(to, photos=tmp_path / "set", resume=True, say=said.append)
    assert "going on from step 2" in said
    log = [json.loads(line) for line in (to / "log.jsonl").read_text(encoding="utf-8").splitlines()]
    assert [line["step"] for line in log] == [1, 2, 3, 4]
    assert (to / "model" / "model.safetensors").is_file()


class TestCommand:
    """`salad` itself: exit codes 0, 1 (nothing found) and 2 (bad input)."""

    def test_in_a_process_of_its_own(self, tmp_path: Path) -> None:
        project = tomllib.loads(Path(__file__).parents[2].joinpath("pyproject.toml").read_text(encoding="utf-8"))
        room, _, name = project["project"]["scripts"]["salad"].partition(":")
        assert getattr(import_module(room), name) is main
        for code, *arguments in (
            (0, "--version"),
            (2, "info", str(tmp_path / "none")),
            (2, "no-such-command"),
        ):
            ran = subprocess.run(
                [sys.executable, "-m", "salad", *arguments], capture_output=True, text=True, check=False
            )
            assert ran.returncode == code, ran.stderr
            assert (ran.stdout == "", ran.stderr == "") == ((False, True) if code == 0 else (True, False))

    def test_exit_codes(self, tmp_path: Path) -> None:
        table, _ = draw_streets(tmp_path)
        index, query = tmp_path / "i", tmp_path / "queries" / "0.png"
        codes = {
            ("index", tmp_path / "references", "--to", index, "--table", table): 0,
            ("locate", query, "--index", index): 0,
            ("locate", query, "--index", index, "--near", "0,0"): 1,
            ("locate", tmp_path / "none.png", "--index", index): 2,
            ("locate", query, "--index", tmp_path): 2,
            ("locate", query, "--index", index, "-k", 0): 2,
            ("locate", query): 2,
            ("verify", index): 0,
            ("verify", tmp_path): 2,
            ("remove", "/none", "--index", index): 1,
            ("info", index): 0,
            ("evaluate",): 2,
        }
        assert {asked: salad_says(*asked).code for asked in codes} == codes
        (index / "descriptors.f16").write_bytes(b"")
        assert salad_says("verify", index).code == 1
