"""What OpenVINO's engine keeps besides the contract: silence, sentences, and the numbers of the others."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import salad
from salad.errors import MissingExtraError, ModelError, WeightsError
from salad.models import openvino_engine
from salad.models.model_folder import add_graph, load, write_folder
from salad.network.aggregator_config import SaladConfig
from salad.network.config import ModelConfig, Preprocessing, ViTConfig
from salad.network.export import made_pictures
from salad.network.network import build

pytestmark = pytest.mark.skipif(find_spec("openvino") is None, reason="the extra fast is not installed")

VIT = ModelConfig(
    "vit", ViTConfig(16, 1, 2, grid=3), SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=5, hidden=8),
    Preprocessing(42, 56),
)  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = write_folder(build(VIT), tmp_path / "vit")
    add_graph(made)
    return made


@pytest.mark.parametrize("name", ["salad-lite", "salad-vits"])
def test_it_describes_as_onnx_runtime_does_and_has_the_same_fingerprint(name: str) -> None:
    one, other = (salad.load(name, engine=engine, threads=1) for engine in ("openvino", "onnx"))
    photos = list(made_pictures(one.preprocessing, 3))
    cosines = (one.describe(photos) * other.describe(photos)).sum(axis=1)
    assert cosines.min() >= 0.99999
    assert one.fingerprint == other.fingerprint
    assert one.engine_choice == ("openvino", "it was asked for", False)


ALONE = """
import os, sys

reached = []
sys.addaudithook(lambda event, args: reached.append((event, args)) if event.startswith("socket.") else None)
import numpy as np
{work}
assert not reached, reached
assert not [name for name in sys.modules if name.split(".")[0] == "openvino_telemetry"]
assert not os.listdir(os.environ["HOME"]), os.listdir(os.environ["HOME"])
"""


@pytest.mark.parametrize(
    ("work", "silent"),
    [
        ("import salad; salad.load({folder!r}, engine='openvino').describe([np.zeros((42, 56, 3), np.uint8)])", True),
        (
            "import salad; from salad.models.quantize import quantized; "
            "model = salad.load({folder!r}, engine='openvino'); "
            "quantized(model, np.zeros((3, 42, 56, 3), np.uint8), precision='int8')",
            True,
        ),
        ("import openvino_telemetry", False),  # which the test would see
    ],
    ids=["describing", "quantizing", "the package itself"],
)
def test_nothing_is_written_or_sent_of_its_use(work: str, silent: bool, folder: Path, tmp_path: Path) -> None:
    """In a process of its own, since pytest's presence alone switches some of it off."""
    home = tmp_path / "home"
    home.mkdir()
    source = str(Path(salad.__file__).parents[1])
    environment = {"HOME": str(home), "USERPROFILE": str(home), "PYTHONPATH": source, "PATH": "/usr/bin:/bin"}
    code = ALONE.format(work=work.format(folder=str(folder)))
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert (done.returncode == 0) == silent, done.stderr


def test_where_it_is_missing_the_extra_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'salad-vpr\[fast\]'"):
        load(folder, engine="openvino")


def test_a_graph_of_other_settings_is_refused(folder: Path) -> None:
    settings = json.loads((folder / "config.json").read_text())
    settings["preprocessing"]["mean"] = [0.5, 0.5, 0.5]
    (folder / "config.json").write_text(json.dumps(settings))
    with pytest.raises(WeightsError, match="made of other settings than the config"):
        load(folder, engine="openvino")


def test_links_into_one_folder_are_followed(folder: Path, tmp_path: Path) -> None:
    """As the cache of Hugging Face lays files out."""
    blobs, links = tmp_path / "blobs", tmp_path / "snapshot"
    folder.rename(blobs)
    links.mkdir()
    for file in blobs.iterdir():
        file.rename(blobs / f"{file.name}-blob")
        (links / file.name).symlink_to(blobs / f"{file.name}-blob")
    photos = list(made_pictures(VIT.preprocessing, 2))
    one, other = (load(links, engine=name).describe(photos) for name in ("openvino", "onnx"))
    assert (one * other).sum(axis=1).min() >= 0.99999


def test_it_runs_on_the_processor_alone(folder: Path) -> None:
    with pytest.raises(ModelError, match="on the processor alone: give the device cpu, and not 'cuda'"):
        load(folder, engine="openvino", device="cuda")


def test_a_processor_without_the_instructions_is_a_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    properties = {"OPTIMIZATION_CAPABILITIES": ["FP16"], "FULL_DEVICE_NAME": "Abacus"}
    core = SimpleNamespace(get_property=lambda _, name: properties[name])
    monkeypatch.setattr(openvino_engine, "openvino", lambda: SimpleNamespace(Core=lambda: core))
    with pytest.raises(ModelError, match=r"computes in float32, for which this processor \(Abacus\) has no"):
        load(folder, engine="openvino")


def test_positions_are_resized_once_and_not_in_every_photo(folder: Path) -> None:
    compiled = load(folder, engine="openvino").engine.compiled
    kinds = {node.get_rt_info()["layerType"].astype(str) for node in compiled.get_runtime_model().get_ops()}
    assert "Interpolate" not in kinds
    assert "FullyConnected" in kinds


def test_photos_of_many_threads_are_never_mixed(folder: Path) -> None:
    """A request that is handed on holds the last photo's numbers: what is given away must be a copy."""
    engine = load(folder, engine="openvino").engine
    first, second = made_pictures(VIT.preprocessing, 2)[:, None]
    kept = engine.run(first)["descriptor"]
    before = kept.copy()
    engine.run(second)
    np.testing.assert_array_equal(kept, before)
