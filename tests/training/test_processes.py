"""Two processes with half of each batch learn what one learns with the whole: really two, talking over gloo."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from salad.errors import ModelError
from salad.training.devices import first_process

SCRIPT = Path(__file__).with_name("observed_run.py")
Teach = Callable[..., Path]


QUIET = {"OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": "lo", "PYTHONWARNINGS": "ignore"}
RUNS: dict[str, dict[str, Any]] = {"whole": {"at_once": None}, "in parts": {"at_once": 2}}


@pytest.fixture(scope="module")
def both(photo_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of two processes, one after the other."""
    to = tmp_path_factory.mktemp("two")
    what = json.dumps({"devices": 2, "runs": RUNS})
    ran = subprocess.run(
        [sys.executable, str(SCRIPT), str(photo_folder), str(to), what],
        env=os.environ | QUIET,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return to


@pytest.mark.parametrize("name", RUNS)
def test_two_processes_learn_what_one_learns(
    photo_folder: Path,
    tmp_path: Path,
    both: Path,
    name: str,
    observed: Callable[..., list[dict[str, Any]]],
) -> None:
    """Nine photos a batch: one process has four, the other five, at once or in two parts and three."""
    alone = observed(photo_folder, tmp_path, **RUNS[name])
    halves = [torch.load(both / name / f"seen-{rank}.pt") for rank in (0, 1)]
    assert [len(seen) for seen in (alone, *halves)] == [6, 6, 6]
    for whole, mine, other in zip(alone, *halves, strict=True):
        assert (len(mine["read"]), len(other["read"])) == (4, 5)
        assert sorted(mine["read"] + other["read"]) == whole["read"]
        for half in (mine, other):
            assert half["loss"] == pytest.approx(whole["loss"], abs=1e-6)
            assert half["gradients"].keys() == whole["gradients"].keys()
            for key, gradient in whole["gradients"].items():
                torch.testing.assert_close(half["gradients"][key], gradient, rtol=0, atol=1e-6, msg=key)
    assert max(float(gradient.abs().max()) for gradient in alone[-1]["gradients"].values()) > 0.01
    one, two = (load_file(run / "last" / "model.safetensors") for run in (tmp_path, both / name))
    for key, wanted in one.items():
        torch.testing.assert_close(two[key], wanted, rtol=2e-3, atol=2e-3, msg=key)  # AdamW makes signs of crumbs
    assert len((both / name / "log.jsonl").read_text().splitlines()) == 3  # one process writes


@pytest.fixture
def machines(photo_folder: Path) -> Iterator[Callable[..., list[subprocess.Popen[str]]]]:
    """`machines([folder, ...])`: the same command on as many, each with a folder of its own; all are this one."""
    started: list[subprocess.Popen[str]] = []

    def start(folders: Sequence[Path], **settings: Any) -> list[subprocess.Popen[str]]:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = str(free.getsockname()[1])
        what = json.dumps({"nodes": len(folders), **settings})
        for rank, folder in enumerate(folders):
            where = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "NODE_RANK": str(rank)}
            started.append(
                subprocess.Popen(
                    [sys.executable, str(SCRIPT), str(photo_folder), str(folder), what],
                    env=os.environ | QUIET | where,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                )
            )
        return started[-len(folders) :]

    yield start
    _kill(started)


def _kill(machines: Sequence[subprocess.Popen[str]]) -> None:
    for machine in machines:
        machine.kill()
        if machine.stdout is not None and not machine.stdout.closed:
            machine.communicate()


def _ended(machines: Sequence[subprocess.Popen[str]]) -> None:
    for machine in machines:
        _, err = machine.communicate(timeout=120)
        assert machine.returncode == 0, err


def test_two_machines_learn_what_one_learns_and_go_on_without_a_disk_in_common(
    photo_folder: Path,
    tmp_path: Path,
    observed: Callable[..., list[dict[str, Any]]],
    machines: Callable[..., list[subprocess.Popen[str]]],
) -> None:
    """The checkpoint lies with the first machine alone; both are killed behind it, and started once more."""
    observed(photo_folder, tmp_path / "alone")
    folders = [tmp_path / "first", tmp_path / "second"]
    killed = machines(folders, wait="step 3")
    for machine in killed:
        assert machine.stdout is not None
        assert machine.stdout.readline() == "waiting\n"
    _kill(killed)
    assert torch.load(folders[0] / "last.ckpt")["step"] == 3
    assert not folders[1].exists()
    _ended(machines(folders, resume=True))
    assert [len(torch.load(folder / f"seen-{rank}.pt")) for rank, folder in enumerate(folders)] == [3, 3]
    one, two = (load_file(tmp_path / run / "last" / "model.safetensors") for run in ("alone", "first"))
    for key, wanted in one.items():
        torch.testing.assert_close(two[key], wanted, rtol=2e-3, atol=2e-3, msg=key)


def test_a_batch_that_leaves_a_process_without_a_photo_is_a_sentence(teach: Teach, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="leaves some of 7 processes without any"):
        teach(tmp_path / "run", devices=7)
    assert not (tmp_path / "run").exists()


def test_a_process_by_itself_is_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    assert first_process()
    monkeypatch.setitem(sys.modules, "lightning_fabric.utilities.rank_zero", None)
    assert first_process()
