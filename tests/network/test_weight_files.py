"""Weights are found in whatever trainers put around them, and what is no file of weights is called what it is."""

from __future__ import annotations

import subprocess
import sys
import urllib.error
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from salad.errors import FetchError, WeightsError
from salad.models import hub
from salad.network.weight_files import PREFIXES, WRAPPERS, read_tensors

FLAT = {
    "backbone.model.cls_token": torch.ones(1, 1, 4),
    "backbone.model.norm.weight": torch.arange(4.0),
    "aggregator.dust_bin": torch.tensor(1.0),
}


def saved(path: Path, value: Any, **how: Any) -> Path:
    torch.save(value, path, **how)
    return path


def prefixed(*prefixes: str) -> dict[str, Tensor]:
    return {"".join(prefixes) + key: value for key, value in FLAT.items()}


def same(path: Path) -> bool:
    found = read_tensors(path)
    return found.keys() == FLAT.keys() and all(torch.equal(found[key], FLAT[key]) for key in FLAT)


@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_weights_are_found_under_a_trainers_name(tmp_path: Path, wrapper: str) -> None:
    beside = {"optimizer": {"lr": 0.1}, "epoch": 3}
    assert same(saved(tmp_path / "a.pth", {**beside, wrapper: FLAT}))
    assert same(saved(tmp_path / "b.pth", {**beside, wrapper: {"state_dict": prefixed("module.")}}))


@pytest.mark.parametrize("prefix", PREFIXES)
def test_a_name_before_all_names_is_left_out(tmp_path: Path, prefix: str) -> None:
    assert same(saved(tmp_path / "a.pth", prefixed(prefix)))
    assert same(saved(tmp_path / "b.pth", {"state_dict": prefixed("_orig_mod.", "module.", prefix)}))
    save_file(prefixed(prefix), tmp_path / "c.safetensors")
    assert same(tmp_path / "c.safetensors")


def test_a_name_before_some_names_is_their_own(tmp_path: Path) -> None:
    assert same(saved(tmp_path / "a.pth", FLAT))  # backbone.model. is no prefix
    mixed = {**prefixed("model."), "loss.proxies": torch.ones(3)}
    assert read_tensors(saved(tmp_path / "b.pth", mixed)).keys() == mixed.keys()


def said_of(path: Path) -> str:
    with pytest.raises(WeightsError) as caught:
        read_tensors(path)
    said = str(caught.value)
    assert said.startswith(str(path))
    assert not any(word in said for word in ("Error", "Errno", "Unpickling", "pickle", "None"))
    return said


@pytest.mark.parametrize("suffix", [".ckpt", ".pth", ".safetensors"])
def test_a_web_page_is_called_one(tmp_path: Path, suffix: str) -> None:
    page = tmp_path / f"a{suffix}"
    page.write_text("<!DOCTYPE html><html>Virus scan warning</html>")
    assert "is a web page, not weights" in said_of(page)


def _as_zip(path: Path) -> None:
    saved(path, {"state_dict": {f"{number}": torch.rand(9, 9) for number in range(9)}})


def _as_pickle(path: Path) -> None:
    saved(path, {"a": torch.rand(99, 99)}, _use_new_zipfile_serialization=False)


def _as_safetensors(path: Path) -> None:
    save_file({"a": torch.rand(99, 99)}, path)


@pytest.mark.parametrize(
    ("save", "name"), [(_as_zip, "a.ckpt"), (_as_pickle, "a.pth"), (_as_safetensors, "a.safetensors")]
)
def test_a_cut_file_is_called_that(tmp_path: Path, save: Callable[[Path], None], name: str) -> None:
    path = tmp_path / name
    save(path)
    whole = path.read_bytes()
    for share in (0.3, 0.5, 0.9, 0.999):
        path.write_bytes(whole[: int(len(whole) * share)])
        assert said_of(path).endswith("is cut short: fetch it again")
    path.write_bytes(b"")
    assert said_of(path).endswith("is empty: fetch it again")


def test_what_holds_something_else_is_said_by_what_it_holds(tmp_path: Path) -> None:
    said = said_of(saved(tmp_path / "a.pth", {"teacher": FLAT, "epoch": 3}))
    assert "holds something else than named tensors (epoch, teacher ...)" in said
    assert "save the model's state_dict alone" in said_of(saved(tmp_path / "b.pth", nn.Linear(2, 2)))
    (tmp_path / "c.pth").write_bytes(b"hello" * 99)
    assert "no file of weights that can be read safely: fetch it again" in said_of(tmp_path / "c.pth")


@pytest.mark.parametrize(
    "error",
    [
        ConnectionRefusedError(111, "Connection refused"),
        urllib.error.URLError(ConnectionRefusedError(111, "Connection refused")),
        ConnectionResetError(),
    ],
)
def test_a_failed_download_is_told_without_the_systems_numbers(
    tmp_path: Path, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setenv("SALAD_HOME", str(tmp_path))
    with pytest.raises(FetchError) as caught:
        hub.fetch("megaloc", opener=refuse)
    assert not any(word in str(caught.value) for word in ("Errno", "Error", "111"))
    assert "could not fetch 'megaloc'" in str(caught.value)


def test_checkpoints_as_trainers_save_them(tmp_path: Path, shared: Path) -> None:
    """Case 15, made by its own script: each is read, or the sentence names what was found."""
    script = shared / "cases" / "15-checkpoints" / "make.py"
    if not script.is_file():
        pytest.skip("the cases are not beside this checkout")
    subprocess.run([sys.executable, script], cwd=tmp_path, check=True)  # tensors of a few kilobytes
    files = tmp_path / "files"
    read = ["release.ckpt", "lightning.ckpt", "dataparallel.pth", "compiled.pth", "wrapped_model.ckpt", "net.pth"]
    read += ["model_state_dict.pth", "model_key.pth", "dp_model_state_dict.pth", "lightning_compiled.ckpt", "half.ckpt"]
    due = read_tensors(files / "release.safetensors").keys()
    for name in read:
        assert read_tensors(files / name).keys() == due
    assert said_of(files / "cut.ckpt").endswith("is cut short: fetch it again")
    assert "is a web page" in said_of(files / "page.ckpt")
    said_of(files / "whole_module.pth")
    assert "teacher" in said_of(files / "teacher.pth")
