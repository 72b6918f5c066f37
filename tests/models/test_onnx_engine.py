"""A model's graph and its weights belong together, and ONNX Runtime computes what torch does."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch

from salad.errors import ModelError, WeightsError
from salad.files import sha256_of
from salad.models.describer import Describer
from salad.models.engines import EngineName
from salad.models.hub import ZOO, path_of
from salad.models.model_folder import (
    CONFIG,
    GRAPH,
    WEIGHTS,
    add_graph,
    load,
    read_folder,
    write_calibration,
    write_folder,
)
from salad.models.onnx_engine import OnnxEngine
from salad.models.torch_engine import TorchEngine
from salad.network.aggregator_config import SaladConfig
from salad.network.config import Calibration, LiteConfig, ModelConfig, Preprocessing
from salad.network.export import made_pictures
from salad.network.network import build

TINY = ModelConfig("tiny", LiteConfig(blocks=1), SaladConfig(16, 4, 3, 5, 8), Preprocessing(24, 16))
SHIPPED = [name for name, row in ZOO.items() if row.layout == "own"]


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_folder(build(TINY, seed=5), tmp_path_factory.mktemp("exported") / "tiny", dtype="float16")
    add_graph(folder)
    return folder


@pytest.fixture
def folder(exported: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(exported, tmp_path / "tiny"))


def photos(count: int = 3) -> np.ndarray:
    return made_pictures(TINY.preprocessing, count)


def settings(folder: Path) -> dict:
    found: dict = json.loads((folder / CONFIG).read_text())
    return found


@pytest.mark.parametrize("name", SHIPPED)
def test_every_model_that_ships_runs_by_its_graph_as_by_torch(name: str) -> None:
    by_graph, by_torch = load(name), load(name, engine="torch")
    assert isinstance(by_graph.engine, OnnxEngine)
    assert isinstance(by_torch.engine, TorchEngine)
    pictures = made_pictures(by_graph.preprocessing, 2)
    found = by_graph.engine.run(pictures, by_graph.engine.outputs)
    for output, due in by_torch.engine.run(pictures, by_graph.engine.outputs).items():
        np.testing.assert_allclose(found[output], due, rtol=1e-3, atol=1e-4)
    cosines = (found["descriptor"].astype(np.float64) * by_torch.describe(list(pictures))).sum(axis=1)
    assert cosines.min() > 0.99999
    assert by_graph.fingerprint == by_torch.fingerprint


@pytest.mark.parametrize("name", SHIPPED)
def test_what_ships_is_small_and_its_own(name: str) -> None:
    folder = path_of(name)
    assert (folder / GRAPH).stat().st_size < 1 << 18
    assert set(settings(folder)["files"]) == {GRAPH, WEIGHTS}


def test_it_says_which_engine_and_why(folder: Path) -> None:
    expected = (("auto", "onnx", "ready at once"), ("onnx", "onnx", "asked for"), ("torch", "torch", "asked for"))
    for asked, name, why in expected:
        choice = load(folder, engine=asked).engine_choice
        assert choice is not None
        assert choice.name == name
        assert why in choice.why
    with pytest.raises(ModelError, match="there is no engine 'tpu': give auto, onnx"):
        load(folder, engine="tpu")  # type: ignore[arg-type]  # that is the test


def test_a_folder_without_a_graph_runs_by_torch_and_says_so(tmp_path: Path) -> None:
    folder = write_folder(build(TINY), tmp_path / "plain")
    assert "files" not in settings(folder)  # older versions refuse what they do not know
    model = load(folder)
    assert isinstance(model.engine, TorchEngine)
    assert model.engine_choice is not None
    assert "no graph.onnx" in model.engine_choice.why
    with pytest.raises(ModelError, match="this one has none: write it with 'salad weights graph'"):
        load(folder, engine="onnx")


def test_a_calibration_leaves_graph_and_checksums_alone(folder: Path) -> None:
    before = settings(folder)["files"]
    write_calibration(folder, Calibration(bias=-2.0, provenance="drawn"))
    assert settings(folder)["files"] == before
    model = load(folder)
    assert isinstance(model.engine, OnnxEngine)
    assert model.calibration is not None
    assert model.calibration.bias == -2.0


def test_a_copy_in_another_precision_takes_no_graph_along(folder: Path, tmp_path: Path) -> None:
    model = load(folder)
    copy = write_folder(model, tmp_path / "copy")
    assert sorted(path.name for path in copy.iterdir()) == [CONFIG, WEIGHTS]
    assert load(copy).fingerprint == model.fingerprint
    np.testing.assert_allclose(load(copy).describe(list(photos())), model.describe(list(photos())), atol=1e-5)


def change_a_weight(folder: Path) -> None:
    held = bytearray((folder / WEIGHTS).read_bytes())
    held[-2] ^= 1
    (folder / WEIGHTS).write_bytes(held)


def lengthen_the_header(folder: Path) -> None:
    from safetensors.numpy import load_file, save_file

    save_file(load_file(folder / WEIGHTS), folder / WEIGHTS, metadata={"note": "the same weights " * 40})


def another_graph(folder: Path) -> None:
    (folder / GRAPH).write_bytes((folder / GRAPH).read_bytes() + b"\0")


@pytest.mark.parametrize("change", [change_a_weight, lengthen_the_header, another_graph])
@pytest.mark.parametrize("engine", ["auto", "torch"])
def test_graph_and_weights_that_do_not_belong_together_are_refused(
    folder: Path, change: Callable[[Path], None], engine: EngineName
) -> None:
    change(folder)
    with pytest.raises(WeightsError, match=r"is not the file that config\.json beside it was written for"):
        load(folder, engine=engine)


def test_a_graph_written_anew_as_the_sentence_advises_is_right(folder: Path) -> None:
    lengthen_the_header(folder)
    add_graph(folder, list(photos(12)))
    model = load(folder)
    assert isinstance(model.engine, OnnxEngine)
    due = load(folder, engine="torch").describe(list(photos()))
    np.testing.assert_allclose(model.describe(list(photos())), due, atol=1e-5)


def test_a_graph_that_got_lost_is_named(folder: Path) -> None:
    (folder / GRAPH).unlink()
    with pytest.raises(WeightsError, match=r"tells of a file 'graph\.onnx', which is not there"):
        load(folder)


@pytest.mark.parametrize("files", [[], "graph", {"graph.onnx": 7}, {"../x": "0"}, {"graph.onnx": None}])
def test_checksums_of_any_shape_are_no_more_than_a_sentence(folder: Path, files: object) -> None:
    (folder / CONFIG).write_text(json.dumps({**settings(folder), "files": files}))
    if files == []:  # nothing, said in another way
        assert isinstance(load(folder).engine, TorchEngine)
        return
    with pytest.raises(WeightsError, match=r"config\.json"):
        load(folder)


def test_settings_changed_by_hand_do_not_leave_the_graph_behind(folder: Path) -> None:
    changed = settings(folder)
    changed["preprocessing"]["mean"] = [0.1, 0.2, 0.3]
    (folder / CONFIG).write_text(json.dumps(changed))
    with pytest.raises(WeightsError, match=r"was made of other settings than the config\.json beside it"):
        load(folder)


def test_a_graph_that_reaches_out_of_its_folder_is_refused(folder: Path) -> None:
    shutil.copy(folder / WEIGHTS, folder.parent / "outside.bin")
    model = onnx.load(folder / GRAPH, load_external_data=False)
    for tensor in model.graph.initializer:
        for entry in tensor.external_data:
            if entry.key == "location":
                entry.value = "../outside.bin"
    (folder / GRAPH).write_bytes(model.SerializeToString())
    _as_if_it_belonged(folder)
    with pytest.raises(WeightsError, match=r"graph\.onnx cannot be run"):
        load(folder)


@pytest.mark.parametrize("held", [b"", b"no graph at all", b"\x08\x0a" * 50])
def test_what_is_no_graph_is_a_sentence(folder: Path, held: bytes) -> None:
    (folder / GRAPH).write_bytes(held)
    _as_if_it_belonged(folder)
    with pytest.raises(WeightsError, match=r"graph\.onnx (cannot be run|was made of other settings)"):
        load(folder)


@pytest.mark.parametrize("way", ["../elsewhere.data", "n/../../elsewhere", "/no/such/data/xyz"])
@pytest.mark.parametrize("engine", ["onnx", "openvino"])
def test_a_graph_that_names_files_outside_its_folder_is_refused(folder: Path, way: str, engine: Any) -> None:
    """The weights it names are there, and would run."""
    if engine == "openvino":
        pytest.importorskip("openvino", reason="the extra fast is not installed")
    held = (folder / GRAPH).read_bytes()
    for name in ("../elsewhere.data", "../elsewhere"):
        (folder / name).write_bytes((folder / WEIGHTS).read_bytes())
    assert len(way) == len(WEIGHTS) == 17
    (folder / GRAPH).write_bytes(held.replace(WEIGHTS.encode(), way.encode()))
    _as_if_it_belonged(folder)
    with pytest.raises(WeightsError, match=r"graph\.onnx cannot be run"):
        load(folder, engine=engine)


def test_a_graph_longer_than_any_is_not_read(folder: Path) -> None:
    os.truncate(folder / GRAPH, 1 << 40)
    with pytest.raises(WeightsError, match=r"graph\.onnx is longer than"):
        load(folder)


def test_a_graph_of_another_length_of_descriptor_is_refused(folder: Path) -> None:
    """The settings that it says it was made of are changed with those beside it, and its sums agree."""
    told, held = settings(folder), (folder / GRAPH).read_bytes()
    before = json.dumps(ModelConfig.from_dict(plain(told)).counted, sort_keys=True)
    told["aggregator"]["scene_dim"] += 1
    after = json.dumps(ModelConfig.from_dict(plain(told)).counted, sort_keys=True)
    assert held.count(before.encode()) == 1
    assert len(before) == len(after)
    (folder / GRAPH).write_bytes(held.replace(before.encode(), after.encode()))
    (folder / CONFIG).write_text(json.dumps(told))
    _as_if_it_belonged(folder)
    with pytest.raises(WeightsError, match="gives descriptors of another length"):
        load(folder)


def plain(told: dict[str, Any]) -> dict[str, Any]:
    """Settings without the words of their folder."""
    return {name: value for name, value in told.items() if name not in ("format", "files")}


def _as_if_it_belonged(folder: Path) -> None:
    files = {name: sha256_of(folder / name) for name in (GRAPH, WEIGHTS)}
    (folder / CONFIG).write_text(json.dumps({**settings(folder), "files": files}))


def test_a_folder_of_links_into_a_store_loads(folder: Path, tmp_path: Path) -> None:
    """As a hub's cache lays a model out: files under their checksums, and links to them in one folder."""
    store, links = tmp_path / "blobs", tmp_path / "snapshot"
    store.mkdir()
    links.mkdir()
    for number, file in enumerate(sorted(folder.iterdir())):
        file.rename(store / f"{number}")
        (links / file.name).symlink_to(store / f"{number}")
    model = load(links)
    assert isinstance(model.engine, OnnxEngine)
    assert model.describe(list(photos())).shape == (3, model.dim)


def test_weights_alone_that_are_a_link_load_too(folder: Path, tmp_path: Path) -> None:
    (folder / WEIGHTS).rename(tmp_path / "elsewhere.safetensors")
    (folder / WEIGHTS).symlink_to(tmp_path / "elsewhere.safetensors")
    due = load(folder, engine="torch").describe(list(photos()))
    np.testing.assert_allclose(load(folder).describe(list(photos())), due, atol=1e-5)


def test_gradients_come_from_the_module_which_describes_from_then_on(folder: Path) -> None:
    model = load(folder)
    before = model.describe(list(photos()))
    images = torch.zeros(2, 3, 24, 16, requires_grad=True)
    model(images).sum().backward()
    assert images.grad is not None
    np.testing.assert_allclose(model.describe(list(photos())), before, atol=1e-5)
    with torch.no_grad():
        for weight in model.network.parameters():
            weight.mul_(1.5)
    assert np.abs(model.describe(list(photos())) - before).max() > 1e-3  # what is trained shows
    assert model.fingerprint != load(folder).fingerprint


def test_a_process_of_its_own_gets_an_engine_of_its_own(folder: Path) -> None:
    model = load(folder, threads=1)
    again: Describer = pickle.loads(pickle.dumps(model))  # our own
    np.testing.assert_array_equal(again.describe(list(photos())), model.describe(list(photos())))
    assert again.fingerprint == model.fingerprint


@pytest.mark.parametrize("device", ["abacus", "cpu:x"])
def test_a_device_that_is_not_here_is_a_sentence(folder: Path, device: str) -> None:
    with pytest.raises(ModelError, match=rf"the device '{device}' cannot be used here: this ONNX Runtime has .*CPU"):
        load(folder, device=device, engine="onnx")


def test_an_accelerator_is_torchs_where_torch_is(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ModelError, match="the device 'abacus' cannot be used here"):
        load(folder, device="abacus")
    monkeypatch.setattr("salad.models.engines.find_spec", lambda _: None)
    with pytest.raises(ModelError, match=r"this ONNX Runtime has .*CPU"):
        load(folder, device="abacus")


def test_a_published_file_is_torchs_alone(tmp_path: Path) -> None:
    (tmp_path / "a.ckpt").write_bytes(b"")
    with pytest.raises(ModelError, match="which torch alone runs: convert it"):
        load(tmp_path / "a.ckpt", engine="onnx")


def test_a_graph_written_again_takes_the_place_of_the_old_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (folder / GRAPH).read_bytes()
    assert add_graph(folder, list(photos(12))) == folder / GRAPH
    assert (folder / GRAPH).read_bytes() == before  # nothing in it is of the moment
    assert sorted(path.name for path in folder.iterdir()) == sorted([CONFIG, GRAPH, WEIGHTS])


def test_a_wrong_graph_leaves_the_model_as_it_was(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def wrong(*_: object) -> None:
        raise ModelError("the graph is wrong")

    monkeypatch.setattr("salad.network.export.check_graph", wrong)
    with pytest.raises(ModelError, match="the graph is wrong"):
        add_graph(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_graph_needs_a_model_and_photos_need_not_be_readable(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="is not a model"):
        add_graph(tmp_path)
    (tmp_path / "broken.jpg").write_bytes(b"no photo")
    assert add_graph(folder, [tmp_path / "broken.jpg"]).is_file()


def test_reading_a_model_twice_reads_no_torch(folder: Path) -> None:
    model = read_folder(folder)
    assert "torch" in sys.modules  # for this test file asked for it, so look at the engine instead
    assert model.engine.weights().keys() == load(folder, engine="torch").engine.weights().keys()


def test_photos_of_a_batch_have_a_thread_each_and_a_lone_one_has_all(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []
    honest = OnnxEngine._made

    def counted(self: OnnxEngine, *, threads: int) -> Any:
        made.append(threads)
        return honest(self, threads=threads)

    monkeypatch.setattr(OnnxEngine, "_made", counted)
    engine = load(folder, engine="onnx", threads=3).engine
    pictures = photos(7)
    alone = [engine.run(pictures[row : row + 1]) for row in range(7)]
    assert made == [3]
    together = engine.run(pictures)
    assert made == [3, 1]
    again = engine.run(pictures[:1])  # and no third session for the last photo of many
    assert made == [3, 1]
    for row, one in enumerate(alone):
        np.testing.assert_allclose(together["descriptor"][row], one["descriptor"][0], atol=1e-6)
    np.testing.assert_array_equal(again["descriptor"][0], together["descriptor"][0])


def test_the_weights_are_read_once_for_the_fingerprint(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model, due = load(folder, engine="onnx"), load(folder, engine="torch").fingerprint
    assert model.fingerprint == due
    monkeypatch.setattr(model.engine, "_read", None)
    assert model.fingerprint == due


def test_the_fingerprint_follows_a_module_that_is_trained(folder: Path) -> None:
    model = load(folder, engine="onnx")
    before = model.fingerprint
    with torch.no_grad():
        next(iter(model.network.parameters())).add_(1)
    assert model.fingerprint != before
