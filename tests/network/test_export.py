"""`graph.onnx`: it computes what the network does, in any batch, and what does not is refused."""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch

from salad.errors import MissingExtraError, ModelError
from salad.models.model_folder import write_folder
from salad.network import export
from salad.network.aggregator_config import RouteConfig, SaladConfig
from salad.network.baseline_config import (
    BoqConfig,
    ConvApConfig,
    CosPlaceConfig,
    GemConfig,
    MixVprConfig,
    NetVladConfig,
    VladConfig,
)
from salad.network.config import ConvNextConfig, LiteConfig, ModelConfig, Preprocessing, ResNetConfig, ViTConfig
from salad.network.export import check_file, check_graph, export_file, export_graph, made_pictures
from salad.network.network import Network, build

SALAD = SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=5, hidden=8)
SIZE = Preprocessing(42, 56)
VIT = ModelConfig("vit", ViTConfig(16, 1, 2, grid=3), SALAD, SIZE)
MODELS = {
    "vit": VIT,
    "vit, registers and swiglu": dataclasses.replace(
        VIT, backbone=ViTConfig(16, 1, 2, grid=5, registers=4, swiglu=True)
    ),
    "vit, a size between patches": dataclasses.replace(VIT, preprocessing=Preprocessing(50, 60)),
    "lite": ModelConfig("lite", LiteConfig(blocks=1), SALAD, Preprocessing(24, 16)),
    "lite, odd sides": ModelConfig(
        "lite", LiteConfig(blocks=3), dataclasses.replace(SALAD, width=24), Preprocessing(48, 40)
    ),
    "resnet": ModelConfig("resnet", ResNetConfig(stages=1), dataclasses.replace(SALAD, width=256), SIZE),
    "convnext": ModelConfig("convnext", ConvNextConfig(stages=1), dataclasses.replace(SALAD, width=96), SIZE),
    "route": dataclasses.replace(VIT, aggregator=RouteConfig(16, SALAD)),
    "no dustbin": dataclasses.replace(VIT, aggregator=dataclasses.replace(SALAD, dustbin=False)),
    "a dustbin's share": dataclasses.replace(VIT, aggregator=dataclasses.replace(SALAD, dustbin_share=0.4)),
    "softmax": dataclasses.replace(VIT, aggregator=dataclasses.replace(SALAD, transport="softmax")),
    "a last layer": dataclasses.replace(VIT, aggregator=dataclasses.replace(SALAD, linear=7)),
    "gem": dataclasses.replace(VIT, aggregator=GemConfig(16)),
    "netvlad": dataclasses.replace(VIT, aggregator=NetVladConfig(16, clusters=3)),
    "vlad": dataclasses.replace(VIT, aggregator=VladConfig(16, 3)),
    "mixvpr": dataclasses.replace(VIT, aggregator=MixVprConfig(16, (3, 4), depth=1, channels=4, rows=2)),
    "convap": dataclasses.replace(VIT, aggregator=ConvApConfig(16, channels=4)),
    "boq": dataclasses.replace(VIT, aggregator=BoqConfig(16, channels=8, queries=3, blocks=1, rows=2, heads=2)),
    "cosplace": dataclasses.replace(VIT, aggregator=CosPlaceConfig(16, linear=6)),
}


def folder_of(config: ModelConfig, to: Path, *, dtype: str = "float32") -> tuple[Network, Path]:
    network = build(config, seed=3)
    if isinstance(config.aggregator, VladConfig):
        chance = torch.Generator().manual_seed(0)
        network.aggregator.start_from(torch.randn(3, 16, generator=chance), torch.zeros(0, 16))  # type: ignore[operator]  # a Vlad
    folder = write_folder(network, to, dtype=dtype)
    if dtype == "float16":
        network = network.half().float()
    return network, folder


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Network, Path]:
    network, folder = folder_of(VIT, tmp_path_factory.mktemp("exported") / "model")
    export_graph(network, folder / "model.safetensors", folder / "graph.onnx")
    return network, folder


@pytest.fixture
def copy(exported: tuple[Network, Path], tmp_path: Path) -> tuple[Network, Path]:
    return exported[0], Path(shutil.copytree(exported[1], tmp_path / "copy"))


# An export takes seconds: these are exported at every run, all the others in the long tests.
QUICK = {"vit, registers and swiglu", "vit, a size between patches", "lite, odd sides", "route", "vlad"}


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in MODELS]
)
def test_a_graph_computes_what_the_network_does(name: str, tmp_path: Path) -> None:
    network, folder = folder_of(MODELS[name], tmp_path / "model")
    export_graph(network, folder / "model.safetensors", folder / "graph.onnx")
    check_graph(network, folder / "graph.onnx", made_pictures(network.config.preprocessing))


@pytest.mark.parametrize("dtype", ["float32", "float16"])
def test_its_weights_are_those_of_the_file_beside_it(dtype: str, tmp_path: Path) -> None:
    network, folder = folder_of(VIT, tmp_path / "model", dtype=dtype)
    graph = folder / "graph.onnx"
    export_graph(network, folder / "model.safetensors", graph)
    model = onnx.load(graph, load_external_data=False)
    held = sum(len(tensor.raw_data) for tensor in model.graph.initializer)
    outside = {tensor.name: tensor for tensor in model.graph.initializer if tensor.external_data}
    # All but the six numbers of the preprocessing and a handful of constants.
    assert held < 200
    assert {
        entry.value for tensor in outside.values() for entry in tensor.external_data if entry.key == "location"
    } == {"model.safetensors"}
    # The plan does not depend on the dustbin's score, but it is computed with it.
    assert set(outside) == {key for key in network.state_dict() if "num_batches" not in key}
    onnx.load(graph)  # offsets and lengths lie within the file


def test_a_graph_knows_nothing_of_whoever_exported_it(exported: tuple[Network, Path], tmp_path: Path) -> None:
    _, folder = exported
    held = (folder / "graph.onnx").read_bytes()
    assert b".py" not in held  # no stack trace, and no path of this machine
    assert str(tmp_path.parent).encode() not in held


def test_other_weights_are_found_out(copy: tuple[Network, Path], tmp_path: Path) -> None:
    network, folder = copy
    other = write_folder(build(VIT, seed=4), tmp_path / "other")
    shutil.copy(other / "model.safetensors", folder)
    with pytest.raises(ModelError, match=r"graph of vit is wrong, and is not kept: its descriptors are at a cosine of"):
        check_graph(network, folder / "graph.onnx", made_pictures(SIZE))


def test_weights_moved_by_a_longer_header_are_found_out(copy: tuple[Network, Path]) -> None:
    network, folder = copy
    weights = folder / "model.safetensors"
    held = weights.read_bytes()
    length = int.from_bytes(held[:8], "little")
    header = json.loads(held[8 : 8 + length])
    longer = json.dumps({"__metadata__": {"note": "the same weights " * 40}, **header}).encode()
    longer += b" " * (-len(longer) % 8)
    weights.write_bytes(len(longer).to_bytes(8, "little") + longer + held[8 + length :])
    with pytest.raises(ModelError, match="is not kept"):
        check_graph(network, folder / "graph.onnx", made_pictures(SIZE))


def test_a_batch_of_the_examples_size_alone_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Fixed(torch.nn.Module):
        """As a careless `len(x)` leaves it behind."""

        def __init__(self, network: Network) -> None:
            super().__init__()
            self.network = network

        def forward(self, photos: torch.Tensor) -> tuple[torch.Tensor, ...]:
            made = self.network.outputs(photos, self.network.config.outputs)
            return tuple(value[:2] for value in made.values())

    monkeypatch.setattr(export, "_Graph", Fixed)
    network, folder = folder_of(VIT, tmp_path / "model")
    export_graph(network, folder / "model.safetensors", folder / "graph.onnx")
    with pytest.raises(ModelError, match=r"its descriptor is of shape \[2, 17\], the network's \[7, 17\]"):
        check_graph(network, folder / "graph.onnx", made_pictures(SIZE))


@pytest.mark.parametrize("output", ["patches", "plan"])
def test_every_output_is_compared(output: str, exported: tuple[Network, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    network, folder = exported
    right = network.outputs

    def otherwise(photos: Any, names: Any) -> Any:
        return {name: value * 1.01 if name == output else value for name, value in right(photos, names).items()}

    monkeypatch.setattr(network, "outputs", otherwise)
    with pytest.raises(ModelError, match=rf"its {output} is [0-9.e-]+ away from the network's"):
        check_graph(network, folder / "graph.onnx", made_pictures(SIZE))


def test_what_is_no_graph_is_a_sentence(tmp_path: Path) -> None:
    network = build(VIT)
    (tmp_path / "graph.onnx").write_bytes(b"no graph")
    with pytest.raises(ModelError, match="graph of vit cannot be run, and is not kept"):
        check_graph(network, tmp_path / "graph.onnx", made_pictures(SIZE))


def test_a_network_that_cannot_be_followed_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network, folder = folder_of(VIT, tmp_path / "model")

    def forks(tokens: Any) -> torch.Tensor:
        return tokens.cls if float(tokens.cls.sum()) > 0 else -tokens.cls

    monkeypatch.setattr(network.aggregator, "forward", forks)
    with pytest.raises(ModelError, match="the model vit cannot be exported"):
        export_graph(network, folder / "model.safetensors", folder / "graph.onnx")
    assert not (folder / "graph.onnx").exists()


def test_without_the_exporter_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(MissingExtraError, match="exporting a model needs the 'torch' extra"):
        export_graph(build(VIT), tmp_path / "model.safetensors", tmp_path / "graph.onnx")


def test_made_pictures_fill_the_range_and_are_the_same_again() -> None:
    pictures = made_pictures(SIZE, 3)
    assert pictures.shape == (3, 42, 56, 3)
    assert pictures.dtype == np.uint8
    assert (pictures.min(), pictures.max()) == (0, 255)
    np.testing.assert_array_equal(pictures, made_pictures(SIZE, 3))
    assert (pictures != made_pictures(SIZE, 3, seed=1)).mean() > 0.5
    # Rough as photos are: neighbours are alike, and what is far apart is not.
    near = np.abs(np.diff(pictures.astype(int), axis=2)).mean()
    far = np.abs(pictures[:, :, 28:].astype(int) - pictures[:, :, :28]).mean()
    assert near < 0.6 * far


def test_neither_the_exporter_nor_a_mode_shows_afterwards(tmp_path: Path, capfd: Any) -> None:
    network, folder = folder_of(VIT, tmp_path / "model")
    before = set(folder.iterdir())
    network.train()
    export_graph(network, folder / "model.safetensors", folder / "graph.onnx")
    assert network.training
    network.eval()
    check_graph(network, folder / "graph.onnx", made_pictures(SIZE))  # dropout is not in the graph
    assert set(folder.iterdir()) - before == {folder / "graph.onnx"}
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("normalised", [False, True])
def test_one_file_keeps_the_contract_of_colmap_and_gives_what_the_network_gives(
    normalised: bool, tmp_path: Path
) -> None:
    network, file = build(VIT, seed=3), tmp_path / "model.onnx"
    photos = made_pictures(network.config.preprocessing)
    export_file(network, file, normalised=normalised)
    check_file(network, file, photos, normalised=normalised)
    with pytest.raises(ModelError, match=r"the graph of model\.onnx is wrong, and is not kept: its descriptors are at"):
        check_file(network, file, photos, normalised=not normalised)
    graph = onnx.load(file, load_external_data=False).graph
    (takes,), (gives,) = graph.input, graph.output
    size = network.config.preprocessing
    assert (takes.name, gives.name) == ("images", "descriptor")
    shape = takes.type.tensor_type.shape.dim
    assert shape[0].dim_param
    assert [side.dim_value for side in shape[1:]] == [3, size.height, size.width]
    assert gives.type.tensor_type.shape.dim[1].dim_value == network.config.aggregator.dim
    assert not any(tensor.external_data for tensor in graph.initializer)
    assert [path.name for path in tmp_path.iterdir()] == ["model.onnx"]
