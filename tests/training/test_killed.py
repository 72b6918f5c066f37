"""A run that is killed for good, really, and goes on: the same weights as one that never was."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from salad.errors import TrainingError
from salad.training import checkpoint

SCRIPT = Path(__file__).with_name("observed_run.py")
Teach = Callable[..., Path]
CHANCE = {"augment": "lite", "measure_every": 3}  # what is random falls out the same


def _killed(photos: Path, to: Path, where: str) -> None:
    """Start a run and kill it as soon as it says that it is there."""
    settings = json.dumps(CHANCE | {"wait": where})
    command = [sys.executable, str(SCRIPT), str(photos), str(to), settings]
    env = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}
    with subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == "waiting\n"
        run.kill()
        assert run.wait() == -signal.SIGKILL


def test_a_run_killed_at_any_time_ends_as_it_would_have(
    photo_folder: Path, tmp_path: Path, observed: Callable[..., object]
) -> None:
    """Killed after step 3 and, gone on, with half of the fifth checkpoint on disk."""
    observed(photo_folder, tmp_path / "whole", **CHANCE)
    cut = tmp_path / "cut"
    _killed(photo_folder, cut, "step 3")
    assert torch.load(cut / "last.ckpt", weights_only=True)["step"] == 3
    _killed(photo_folder, cut, "saving 5")
    assert torch.load(cut / "last.ckpt", weights_only=True)["step"] == 4
    assert not (cut / "model").exists()
    observed(photo_folder, cut, **CHANCE)
    for which in ("model", "last"):
        whole, found = (load_file(run / which / "model.safetensors") for run in (tmp_path / "whole", cut))
        assert [key for key in whole if not torch.equal(whole[key], found[key])] == []
    assert not list(cut.glob("*.part"))


def test_a_full_disk_loses_no_checkpoint(teach: Teach, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    teach(tmp_path, recipe={"tune_steps": 0})
    before = (tmp_path / "last.ckpt").read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint.torch, "save", full)
        with pytest.raises(TrainingError, match=r"checkpoint of step 9 cannot be written .* No space left"):
            checkpoint.save_checkpoint(tmp_path, {"step": 9})
    assert (tmp_path / "last.ckpt").read_bytes() == before
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 not really", b"x" * 1000])
def test_a_checkpoint_that_is_damaged_is_a_sentence(teach: Teach, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "last.ckpt").write_bytes(content)
    with pytest.raises(TrainingError, match=r"last\.ckpt is damaged: .*remove the file to begin anew"):
        teach(tmp_path)
    assert (tmp_path / "last.ckpt").read_bytes() == content


def test_some_other_file_of_tensors_is_a_sentence(teach: Teach, tmp_path: Path) -> None:
    torch.save({"state_dict": {}}, tmp_path / "last.ckpt")
    with pytest.raises(TrainingError, match=r"last\.ckpt is no checkpoint of a run"):
        teach(tmp_path)


def test_a_checkpoint_of_an_older_version_is_gone_on_with(teach: Teach, tmp_path: Path) -> None:
    """One that knows neither today's settings nor data, start, judge, seconds, cliques and scale."""
    teach(tmp_path)
    path = tmp_path / "last.ckpt"
    saved = torch.load(path, weights_only=True)
    old = {"recipe", "architecture", "step", "model", "average", "best", "optimizer"}
    saved = {key: value for key, value in saved.items() if key in old}
    for setting in ("augment", "sampler", "mirror", "clip", "decay_over", "epochs"):
        del saved["recipe"][setting]
    torch.save(saved, path)
    (tmp_path / "config.json").unlink()
    said: list[str] = []
    teach(tmp_path, say=said.append)
    assert "going on from step 4" in said
    assert (tmp_path / "config.json").is_file()


def test_a_line_torn_by_a_kill_is_dropped(tmp_path: Path) -> None:
    whole = ['{"step": 1}', '{"step": 2}', '{"step": 3}']
    (tmp_path / "log.jsonl").write_text("\n".join(whole) + '\n{"st')
    checkpoint.trim_log(tmp_path, 2)
    assert (tmp_path / "log.jsonl").read_text().splitlines() == whole[:2]
    checkpoint.trim_log(tmp_path / "nothing", 2)


def test_other_processes_than_before_are_told(teach: Teach, tmp_path: Path) -> None:
    teach(tmp_path)
    path = tmp_path / "last.ckpt"
    torch.save(torch.load(path, weights_only=True) | {"processes": 4}, path)
    said: list[str] = []
    teach(tmp_path, say=said.append)
    assert any("began on 4 processes and goes on on 1" in line for line in said)
