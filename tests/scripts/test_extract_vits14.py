"""`salad-vits` starts from an ONNX graph: a small one of the same make gives a whole backbone back."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from salad.network.backbones.base import build_backbone
from salad.network.config import ViTConfig
from salad.training.start import OF_THE_LAST_NORM

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
WIDTH, GRID = 8, 3
PARTS = ("query", "key", "value")


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    reads = SimpleNamespace(numpy_helper=SimpleNamespace(to_array=lambda stored: stored.values))
    monkeypatch.setitem(sys.modules, "onnx", reads)
    monkeypatch.syspath_prepend(str(SCRIPTS))
    module = importlib.import_module("extract_vits14")
    monkeypatch.setattr(module, "WIDTH", WIDTH)
    yield module
    del sys.modules["extract_vits14"]


def _graph(weights: dict[str, np.ndarray], blocks: int) -> SimpleNamespace:
    """The tensors of a backbone as the exporter left them: factors turned over, under names of operations."""
    stored: dict[str, np.ndarray] = {
        "backbone.embeddings.cls_token": weights["cls_token"],
        "backbone.embeddings.patch_embeddings.projection.weight": weights["patch_embed.proj.weight"],
        "backbone.embeddings.patch_embeddings.projection.bias": weights["patch_embed.proj.bias"],
        "onnx::Concat_1": weights["pos_embed"][:, :1],
        "onnx::Reshape_1962": weights["pos_embed"][:, 1:],
    }
    nodes = [SimpleNamespace(name="/backbone/embeddings/Concat_6", op_type="Concat", input=["seen", "onnx::Concat_1"])]

    def multiplied(name: str, matrix: np.ndarray) -> None:
        stored[f"onnx::MatMul_{len(stored)}"] = matrix.T
        nodes.append(SimpleNamespace(name=f"{name}/MatMul", op_type="MatMul", input=["seen", list(stored)[-1]]))

    for number in range(blocks):
        block, layer = f"blocks.{number}.", f"backbone.encoder.layer.{number}."
        node = f"/backbone/encoder/layer.{number}"
        for which, name in enumerate(PARTS):
            rows = slice(which * WIDTH, (which + 1) * WIDTH)
            multiplied(f"{node}/attention/attention/{name}", weights[f"{block}attn.qkv.weight"][rows])
            stored[f"{layer}attention.attention.{name}.bias"] = weights[f"{block}attn.qkv.bias"][rows]
        multiplied(f"{node}/attention/output/dense", weights[f"{block}attn.proj.weight"])
        stored[f"{layer}attention.output.dense.bias"] = weights[f"{block}attn.proj.bias"]
        for name in ("fc1", "fc2"):
            multiplied(f"{node}/mlp/{name}", weights[f"{block}mlp.{name}.weight"])
            stored[f"{layer}mlp.{name}.bias"] = weights[f"{block}mlp.{name}.bias"]
        for name in ("norm1", "norm2"):
            for part in ("weight", "bias"):
                stored[f"{layer}{name}.{part}"] = weights[f"{block}{name}.{part}"]
        for which in (1, 2):
            stored[f"{layer}layer_scale{which}.lambda1"] = weights[f"{block}ls{which}.gamma"]
    initializer = [SimpleNamespace(name=name, values=values) for name, values in stored.items()]
    return SimpleNamespace(initializer=initializer, node=nodes)


def test_the_sound_blocks_come_back_to_the_last_tensor(script: Any) -> None:
    torch.manual_seed(0)
    spoilt = script.BLOCKS  # one block more than what is taken
    backbone = build_backbone(ViTConfig(WIDTH, spoilt + 1, 2, grid=GRID))
    weights = {key: torch.randn_like(value).numpy() for key, value in backbone.state_dict().items()}
    found = script.tensors(_graph(weights, spoilt + 1))
    sound = {key for key in weights if not key.startswith(f"blocks.{spoilt}.")}
    assert set(found) == sound - OF_THE_LAST_NORM
    for name, values in found.items():
        np.testing.assert_array_equal(values, weights[name], err_msg=name)
