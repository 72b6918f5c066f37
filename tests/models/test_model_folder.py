"""Weights on disk: our folder both ways, published files read strictly, nothing hostile run, nothing half-written."""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from salad.errors import ModelError, WeightsError
from salad.localize.locate import calibration_of
from salad.localize.voting import GENERIC
from salad.models import model_folder
from salad.models.describer import Describer
from salad.models.model_folder import CONFIG, WEIGHTS, load, read_folder, write_calibration, write_folder
from salad.network.aggregator_config import SaladConfig
from salad.network.baseline_config import SceneConfig
from salad.network.config import Calibration, LiteConfig, ModelConfig, Preprocessing, ViTConfig
from salad.network.network import build
from salad.network.weight_files import read_tensors

LITE = ModelConfig(
    "tiny",
    LiteConfig(blocks=1),
    SaladConfig(16, clusters=2, cluster_dim=3, scene_dim=4, hidden=5),
    Preprocessing(24, 24, mean=(0, 0, 0), std=(1, 1, 1)),
    provenance="a test",
    licence="CC0",
)
VIT = ModelConfig("vit", ViTConfig(16, 1, 2, grid=2), SceneConfig(16))


@pytest.fixture
def model() -> Describer:
    return Describer.of(build(LITE, seed=3))


@pytest.fixture
def folder(model: Describer, tmp_path: Path) -> Path:
    return write_folder(model, tmp_path / "own")


def _hub(path: Path, **more: Any) -> Path:
    torch.save(build(VIT).backbone.state_dict() | more, path)
    return path


def test_a_folder_brings_back_the_same_model(model: Describer, folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == ["config.json", "model.safetensors"]
    again = load(folder)
    assert again.config == model.config
    assert again.fingerprint == model.fingerprint
    assert not again.network.training
    torch.testing.assert_close(again.network.state_dict(), model.network.state_dict(), rtol=0, atol=0)
    assert load(str(folder)).fingerprint == model.fingerprint


def test_a_folder_of_halves_brings_back_the_rounded_weights(model: Describer, tmp_path: Path) -> None:
    folder = write_folder(model, tmp_path / "deep" / "half", dtype="float16")
    stored = load_file(folder / "model.safetensors")
    counts = {key for key in stored if key.endswith("num_batches_tracked")}
    assert counts
    assert {stored[key].dtype for key in counts} == {torch.int64}
    assert {stored[key].dtype for key in stored.keys() - counts} == {torch.float16}
    again = load(folder)
    rounded = {key: value.half().to(value.dtype) for key, value in model.network.state_dict().items()}
    torch.testing.assert_close(again.network.state_dict(), rounded, rtol=0, atol=0)
    model.network.load_state_dict(rounded)
    assert again.fingerprint == model.fingerprint


def test_what_is_there_already_is_not_overwritten(model: Describer, folder: Path) -> None:
    before = (folder / "model.safetensors").read_bytes()
    with pytest.raises(WeightsError, match="own exists already; choose another"):
        write_folder(build(LITE, seed=9), folder)
    assert (folder / "model.safetensors").read_bytes() == before
    other = build(LITE, seed=9)
    assert load(write_folder(other, folder, overwrite=True)).fingerprint == other.fingerprint
    assert [path.name for path in folder.parent.iterdir()] == ["own"]


def test_even_overwrite_takes_only_a_model_away(model: Describer, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"dear")
    with pytest.raises(WeightsError, match="exists already"):
        write_folder(model, tmp_path / "photos", overwrite=True)
    assert (tmp_path / "photos" / "a.jpg").read_bytes() == b"dear"


@pytest.mark.parametrize("error", [OSError("no space left"), SafetensorError("no space left")])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_failure_leaves_nothing_half_written(
    model: Describer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, overwrite: bool
) -> None:
    to = tmp_path / "own"
    if overwrite:
        write_folder(model, to)

    def fail(_: object, path: Path) -> None:
        path.write_bytes(b"half")
        raise error

    monkeypatch.setattr(model_folder, "save_file", fail)
    with pytest.raises(WeightsError, match=r"own: no space left"):
        write_folder(build(LITE, seed=9), to, overwrite=overwrite)
    assert [path.name for path in tmp_path.iterdir()] == (["own"] if overwrite else [])
    if overwrite:
        assert load(to).fingerprint == model.fingerprint


def test_a_parent_that_is_a_file_is_a_sentence(model: Describer, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(WeightsError, match="cannot be written to"):
        write_folder(model, tmp_path / "file" / "own")


@pytest.mark.parametrize("lost", ["config.json", "model.safetensors"])
def test_a_folder_without_its_files_is_no_model(folder: Path, lost: str) -> None:
    (folder / lost).unlink()
    with pytest.raises(WeightsError, match=f"own is not a model: it holds no {lost}"):
        load(folder)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "cannot be read"),
        ("[1, 2]", "cannot be read"),
        ("3", "cannot be read"),
        ("{}", "cannot be read"),
        ('{"format": 1}', "cannot be read"),
        ('{"format": 99}', "has format 99, this salad reads 1 and 2: upgrade"),
        (b"\xff\xfe", "cannot be read"),
    ],
)
def test_a_damaged_config_is_a_sentence(folder: Path, text: str | bytes, said: str) -> None:
    (folder / "config.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(WeightsError, match=rf"config\.json.*{said}"):
        load(folder)


@pytest.mark.parametrize(
    ("part", "setting", "value"),
    [
        ("backbone", "blocks", "many"),
        ("backbone", "blocks", 0),
        ("aggregator", "width", 17),
        ("aggregator", "clusters", -1),
        ("aggregator", "dropout", 7),
        ("aggregator", "hidden", None),
    ],
)
def test_a_config_of_no_model_that_can_be_built_is_a_sentence(
    folder: Path, part: str, setting: str, value: object
) -> None:
    data = json.loads((folder / "config.json").read_text())
    data[part][setting] = value
    (folder / "config.json").write_text(json.dumps(data))
    with pytest.raises(WeightsError, match=r"model\.safetensors does not describe a model that can be built"):
        load(folder)


@pytest.mark.parametrize(
    ("part", "setting", "value", "said"),
    [
        ("preprocessing", "height", 10**9, "at most 4096"),
        ("preprocessing", "width", 10**5, "at most 4096"),
        ("aggregator", "clusters", 10**5, "a descriptor of 300004 numbers|of another shape"),
        ("aggregator", "hidden", 10**9, "of another shape"),
        ("aggregator", "hidden", 10**18, "cannot|can be built"),
        ("aggregator", "cluster_dim", 10**12, "a descriptor of"),
        ("aggregator", "iterations", 10**12, "1000 at most"),
        ("aggregator", "linear", 10**9, "a descriptor of 1000000000 numbers"),
    ],
)
def test_a_config_without_measure_is_told_before_anything_is_built(
    folder: Path, part: str, setting: str, value: object, said: str
) -> None:
    data = json.loads((folder / "config.json").read_text())
    data[part][setting] = value
    (folder / "config.json").write_text(json.dumps(data))
    with pytest.raises(WeightsError, match=said):
        load(folder)


@pytest.mark.parametrize(
    "change",
    [{"depth": 10**6}, {"depth": 200}, {"width": 10**6}, {"grid": 10**9}, {"patch": 10**5}, {"registers": 10**9}],
)
def test_a_transformer_without_measure_is_told_before_anything_is_built(tmp_path: Path, change: dict[str, int]) -> None:
    folder = write_folder(build(VIT), tmp_path / "vit")
    data = json.loads((folder / "config.json").read_text())
    data["backbone"] |= change
    (folder / "config.json").write_text(json.dumps(data))
    with pytest.raises(WeightsError, match=r"does not fit the model|does not describe a model"):
        load(folder)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "1" * 5000, '{"format": true}', '{"format": [1]}'])
def test_a_config_that_would_end_python_is_a_sentence(folder: Path, text: str) -> None:
    (folder / "config.json").write_text(text)
    with pytest.raises(WeightsError, match=r"config\.json (cannot be read|has format)"):
        load(folder)


def test_a_config_or_weights_longer_than_any_are_not_read(folder: Path) -> None:
    weights = (folder / WEIGHTS).read_bytes()
    os.truncate(folder / WEIGHTS, 1 << 40)
    with pytest.raises(WeightsError, match=r"model\.safetensors is longer than 8,589,934,592 bytes"):
        load(folder)
    (folder / WEIGHTS).write_bytes(weights)
    os.truncate(folder / CONFIG, 1 << 40)
    with pytest.raises(WeightsError, match=r"config\.json cannot be read: it is longer"):
        load(folder)


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices with names are POSIX's")
@pytest.mark.parametrize("name", [CONFIG, WEIGHTS])
def test_a_file_of_a_model_that_is_none_is_not_waited_for(folder: Path, name: str) -> None:
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(WeightsError, match=f"is not a model: it holds no {name}"):
        load(folder)
    (folder / name).unlink()
    (folder / name).symlink_to("/dev/zero")
    with pytest.raises(WeightsError, match=f"is not a model: it holds no {name}"):
        load(folder)


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices with names are POSIX's")
@pytest.mark.parametrize("name", ["a.pth", "a.safetensors"])
def test_a_published_file_that_is_none_is_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(WeightsError, match="it is no regular file"):
        load(tmp_path / name)


def test_published_tensors_that_are_larger_than_their_file_are_refused(tmp_path: Path) -> None:
    """One number seen a billion times: its shape is read as the model's width, and memory taken for that."""
    vast = {key: torch.zeros(1).expand(10**5, 10**4) for key in build(VIT).backbone.state_dict()}
    torch.save(vast, tmp_path / "a.pth")
    with pytest.raises(WeightsError, match="more numbers than fit into its"):
        load(tmp_path / "a.pth")


def test_a_packed_file_is_not_unpacked(tmp_path: Path) -> None:
    _hub(tmp_path / "a.pth")
    with (
        zipfile.ZipFile(tmp_path / "a.pth") as plain,
        zipfile.ZipFile(tmp_path / "b.pth", "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        for name in plain.namelist():
            packed.writestr(name, plain.read(name))
    with pytest.raises(WeightsError, match="packed, or too long"):
        load(tmp_path / "b.pth", heads=2)


@pytest.mark.parametrize("name", ["blocks.999999.norm1.weight", "blocks." + "9" * 5000 + ".x"])
def test_blocks_without_end_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(WeightsError, match=r"a\.pth"):
        load(_hub(tmp_path / "a.pth", **{name: torch.zeros(1)}), heads=2)
    with pytest.raises(WeightsError, match=r"b\.pth"):
        load(_hub(tmp_path / "b.pth", pos_embed=torch.zeros(1, 0, 16)), heads=2)


def test_a_config_of_another_shape_is_told_by_tensor(folder: Path) -> None:
    data = json.loads((folder / "config.json").read_text())
    data["aggregator"]["clusters"] = 3
    (folder / "config.json").write_text(json.dumps(data))
    with pytest.raises(WeightsError, match=r"of another shape: aggregator\.score\.3\.bias, aggregator\.score"):
        load(folder)


@pytest.mark.parametrize("cut", [0, 5, 200, -7])
def test_damaged_safetensors_are_a_sentence(folder: Path, cut: int) -> None:
    path = folder / "model.safetensors"
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(WeightsError, match=r"model\.safetensors is no safetensors file that can be read"):
        load(folder)


def test_numbers_that_arrays_have_no_type_for_are_a_sentence(folder: Path) -> None:
    path = folder / "model.safetensors"
    path.unlink()
    save_file({"aggregator.dustbin": torch.ones(3, dtype=torch.bfloat16)}, path)
    with pytest.raises(WeightsError, match=r"model\.safetensors holds numbers of a type that is not known here"):
        load(folder)


def test_missing_and_unknown_tensors_are_listed(folder: Path, tmp_path: Path) -> None:
    path = folder / "model.safetensors"
    tensors = load_file(path)
    del tensors["aggregator.dustbin"], tensors["aggregator.scene.0.bias"]
    save_file({**tensors, "aggregator.extra": torch.zeros(1)}, path)
    with pytest.raises(
        WeightsError,
        match=r"missing: aggregator\.dustbin, aggregator\.scene\.0\.bias; unknown: aggregator\.extra",
    ):
        read_folder(folder)


def test_a_published_file_is_read_strictly(tmp_path: Path) -> None:
    assert load(_hub(tmp_path / "a.pth"), heads=2).config.name == "a"
    assert load(_hub(tmp_path / "b.pth", mask_token=torch.zeros(1, 16)), heads=2).dim == 16
    with pytest.raises(WeightsError, match=r"c\.pth does not fit .*; unknown: backbone\.head\.weight"):
        load(_hub(tmp_path / "c.pth", **{"head.weight": torch.zeros(1)}), heads=2)
    cut = build(VIT).backbone.state_dict()
    del cut["norm.bias"]
    torch.save(cut, tmp_path / "d.pth")
    with pytest.raises(WeightsError, match=r"d\.pth does not fit .*; missing: backbone\.norm\.bias"):
        load(tmp_path / "d.pth", heads=2)


def test_a_file_of_strange_tensors_is_named(tmp_path: Path) -> None:
    torch.save({"fc.weight": torch.zeros(2, 2)}, tmp_path / "resnet.pth")
    with pytest.raises(WeightsError, match=r"resnet\.pth: its tensors \(fc\.weight .*belong to no layout"):
        load(tmp_path / "resnet.pth")


@pytest.mark.parametrize("heads", [3, -2])
def test_heads_that_cannot_be_are_a_sentence(tmp_path: Path, heads: int) -> None:
    with pytest.raises(WeightsError, match=rf"a\.pth .*{heads} attention heads do not divide a width of 16"):
        load(_hub(tmp_path / "a.pth"), heads=heads)


def test_a_published_file_comes_as_safetensors_too(tmp_path: Path) -> None:
    save_file(build(VIT).backbone.state_dict(), tmp_path / "a.safetensors")
    torch.save({"state_dict": build(VIT).backbone.state_dict(), "epoch": 3}, tmp_path / "a.ckpt")
    prints = {load(tmp_path / name, heads=2).fingerprint for name in ("a.safetensors", "a.ckpt")}
    assert prints == {build(VIT).fingerprint}


class Hostile:
    """What unpickling would run."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"echo harm > '{self.path}'",)


@pytest.mark.parametrize("where", ["whole", "state_dict", "hyper_parameters", "plain"])
def test_hostile_pickles_are_refused_and_not_run(tmp_path: Path, where: str) -> None:
    harm, path = tmp_path / "harm", tmp_path / "a.ckpt"
    fine: dict[str, Any] = {"state_dict": build(VIT).backbone.state_dict()}
    if where == "plain":
        path.write_bytes(pickle.dumps(Hostile(harm)))
    else:
        torch.save(Hostile(harm) if where == "whole" else fine | {where: Hostile(harm)}, path)
    with pytest.raises(WeightsError, match=r"a\.ckpt is no file of weights that can be read safely"):
        load(path)
    assert not harm.exists()


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04broken"])
def test_a_file_of_no_weights_is_a_sentence(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.pth").write_bytes(content)
    with pytest.raises(WeightsError, match=r"a\.pth is (no file of weights|empty|cut short)"):
        load(tmp_path / "a.pth")


@pytest.mark.parametrize("content", [[torch.zeros(1)], {"cls_token": 3}, torch.zeros(2), {"state_dict": [1]}])
def test_what_is_not_named_tensors_is_a_sentence(tmp_path: Path, content: object) -> None:
    torch.save(content, tmp_path / "a.pth")
    with pytest.raises(WeightsError, match=r"a\.pth holds something else than named tensors"):
        read_tensors(tmp_path / "a.pth")


def test_a_name_nobody_knows_lists_those_there_are() -> None:
    with pytest.raises(WeightsError, match=r"no model 'dino-salat'.*salad-lite.*dinov2-salad"):
        load("dino-salat")


@pytest.mark.parametrize("device", ["banana", "cpu:x", "xpu:99"])
def test_a_device_that_is_not_here_is_a_sentence(folder: Path, device: str) -> None:
    with pytest.raises(ModelError, match=f"the device '{device}' cannot be used here"):
        load(folder, device=device)


def test_a_device_may_be_torchs_own_word(folder: Path) -> None:
    assert load(folder, device=torch.device("cpu")).device == "cpu"


def test_zoo_names_lead_to_fetched_files_and_bundled_folders(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where nothing has a model's name
    files = {"salad-lite": folder, "dinov2-vits14": _hub(tmp_path / "fetched.pth")}
    monkeypatch.setattr(model_folder.hub, "fetch", lambda name: files[name])
    assert load("salad-lite").config == dataclasses.replace(LITE)
    published = load("dinov2-vits14", heads=2)
    assert (published.name, published.config.provenance) == ("dinov2-vits14", "fetched.pth, layout hub")


def test_whoever_may_read_the_config_may_read_the_weights(tmp_path: Path) -> None:
    folder = write_folder(build(ModelConfig("tiny", LiteConfig(blocks=1), SceneConfig(16))), tmp_path / "model")
    modes = {path.stat().st_mode & 0o777 for path in folder.iterdir()}
    assert len(modes) == 1


# --- a calibration travels with its model, and leaves descriptors and fingerprint alone ------

MINE = Calibration(sharpness=30.0, bias=-3.25, radius=0.5, min_confidence=0.625, provenance="drawn")


def test_it_is_written_beside_the_weights_and_read_back(model: Describer, tmp_path: Path) -> None:
    folder = write_folder(model, tmp_path / "m")
    weights = (folder / WEIGHTS).read_bytes()
    assert read_folder(folder).calibration is None
    for calibration in (MINE, replace(MINE, top=1.0)):
        write_calibration(folder, calibration)
        again = read_folder(folder)
        assert again.calibration == calibration
        assert again.config == replace(model.config, calibration=calibration)
        assert again.fingerprint == model.fingerprint
    assert (folder / WEIGHTS).read_bytes() == weights
    assert sorted(path.name for path in folder.iterdir()) == sorted([CONFIG, WEIGHTS])


def test_a_copy_of_a_calibrated_model_is_calibrated(model: Describer, tmp_path: Path) -> None:
    folder = write_folder(model, tmp_path / "m")
    write_calibration(folder, MINE)
    assert read_folder(write_folder(read_folder(folder), tmp_path / "copy")).calibration == MINE


def test_places_are_judged_by_the_models_own_else_by_a_generic_one(model: Describer, tmp_path: Path) -> None:
    assert calibration_of(model) is GENERIC
    folder = write_folder(model, tmp_path / "m")
    write_calibration(folder, MINE)
    assert calibration_of(read_folder(folder)) == MINE


def test_what_is_no_model_takes_none(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="holds no config"):
        write_calibration(tmp_path, MINE)
    assert list(tmp_path.iterdir()) == []


def test_on_a_full_disk_the_old_one_stays(model: Describer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_folder(model, tmp_path / "m")
    write_calibration(folder, MINE)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(WeightsError, match="No space left"):
        write_calibration(folder, GENERIC)
    monkeypatch.undo()
    assert read_folder(folder).calibration == MINE
    assert sorted(path.name for path in folder.iterdir()) == sorted([CONFIG, WEIGHTS])
