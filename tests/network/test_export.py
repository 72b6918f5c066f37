"""`graph.onnx`: it computes what the network does, in any batch, and what does not is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import torch

from salad.models.model_folder import write_folder
from salad.network.aggregator_config import RouteConfig, SaladConfig
from salad.network.baseline_config import (
    GemConfig,
    NetVladConfig,
    VladConfig,
)
from salad.network.config import ConvNextConfig, LiteConfig, ModelConfig, Preprocessing, ResNetConfig, ViTConfig
from salad.network.export import check_graph, export_graph, made_pictures
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


@pytest.mark.parametrize("name", MODELS)
def test_a_graph_computes_what_the_network_does(name: str, tmp_path: Path) -> None:
    network, folder = folder_of(MODELS[name], tmp_path / "model")
    export_graph(network, folder / "model.safetensors", folder / "graph.onnx")
    check_graph(network, folder / "graph.onnx", made_pictures(network.config.preprocessing))
