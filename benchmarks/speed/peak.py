"""How much of what this processor can do each model gets out of it, with each engine.

    python -m benchmarks.speed.peak [MODEL ...] [--side 1536] [--photos 4]

The peak is measured and not read off a data sheet: one large matrix product in each precision, by the same libraries,
and the best of them counts. A model's work is counted by torch's FlopCounterMode: two operations for each
multiplication of its convolutions and matrix products, and none for anything else. One thread, processor time, photos
one by one; products and models take turns within one run, and the best of the rounds counts.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.machine import conditions, in_a_line, turns
from benchmarks.options import SHIPPED, benchmark_parser
from salad.errors import SaladError
from salad.models.describer import Describer
from salad.models.engines import EngineName
from salad.models.model_folder import load
from salad.models.openvino_engine import openvino
from salad.models.quantize import Reduced, quantized
from salad.network.export import made_pictures

SEED, ROUNDS, LEARNT_ON = 7, 5, 16
ENGINES: tuple[EngineName, ...] = ("torch", "onnx", "openvino")
PRECISIONS: tuple[Reduced, ...] = ("bf16", "int8")
HINTS = {"float32": "f32", "bf16": "bf16", "int8": "f32"}  # OpenVINO's; in int8 the graph says it

Way = Callable[[int], object]


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__, models=[*SHIPPED])
    parser.add_argument("--side", type=int, default=1536, help="of the square matrices; default: %(default)s")
    parser.add_argument("--photos", type=int, default=4)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    told = conditions("torch", "onnxruntime", "openvino", seed=SEED, threads=1, side=asked.side, rounds=ROUNDS)
    print(in_a_line(told), flush=True)
    products = _products(asked.side)
    for name in asked.models:
        models = _models(name)
        work = _work(models["torch", "float32"])
        photos = made_pictures(models["torch", "float32"].preprocessing, asked.photos, seed=SEED)
        ways: dict[Any, Way] = {("product", *key): way for key, way in products.items()}
        ways |= {("model", *key): partial(_describe, model, photos) for key, model in models.items()}
        best = {key: min(taken) for key, taken in turns(ways, rounds=ROUNDS, clock=time.process_time).items()}
        peaks = {
            precision: max(2 * asked.side**3 / best["product", *key] for key in products if key[1] == precision)
            for precision in {key[1] for key in products}
        }
        print(f"\n{name}: {work / 1e9:.2f} thousand million operations a photo\n")
        print("| engine | precision | ms a photo | 10^9 operations a second | measured peak | share |")
        print("|---|---|---:|---:|---:|---:|")
        for engine, precision in models:
            seconds = best["model", engine, precision] / len(photos)
            rate, peak = work / seconds, peaks[precision]
            print(
                f"| {engine} | {precision} | {1000 * seconds:.1f} | {rate / 1e9:.0f} | {peak / 1e9:.0f} | "
                f"{100 * rate / peak:.0f} % |",
                flush=True,
            )


def _describe(model: Describer, photos: np.ndarray, _: int) -> None:
    for photo in photos:
        model.engine.run(photo[None])


def _models(name: str) -> dict[tuple[str, str], Describer]:
    """The model by every engine and in every precision that this machine has."""
    made = {(engine, "float32"): load(name, engine=engine, threads=1) for engine in ENGINES}
    given = made["openvino", "float32"]
    learnt = made_pictures(given.preprocessing, LEARNT_ON, seed=SEED)
    for precision in PRECISIONS:
        try:
            other = quantized(given, learnt, precision=precision)
            other.engine.run(learnt[:1])
        except SaladError as error:
            print(f"{name} in {precision}: passed over, {error}")
            continue
        made["openvino", precision] = other
    return made


def _work(model: Describer) -> float:
    """Operations of one photo."""
    photo = made_pictures(model.preprocessing, 1, seed=SEED)
    # The counter knows no fused attention on processors, but what it is the fusion of.
    with FlopCounterMode(display=False) as counter, sdpa_kernel(SDPBackend.MATH), torch.no_grad():
        model.network.outputs(photo, ["descriptor"])
    return float(counter.get_total_flops())


def _products(side: int) -> dict[tuple[str, str], Way]:
    """A product of two square matrices by each library and in each precision."""
    chance = np.random.default_rng(SEED)
    one, other = (chance.standard_normal((side, side)).astype(np.float32) for _ in range(2))
    left, right = torch.from_numpy(one), torch.from_numpy(other)
    session = _onnx_product(other)
    ways: dict[tuple[str, str], Way] = {
        ("torch", "float32"): lambda _: left @ right,
        ("onnx", "float32"): lambda _: session.run(None, {"x": one}),
    }
    able = openvino().Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")
    for precision in ("float32", *PRECISIONS):
        if {"float32": "FP32", "bf16": "BF16", "int8": "INT8"}[precision] in able:
            request = _openvino_product(one, other, precision)
            ways["openvino", precision] = lambda _, request=request: request.infer()
    return ways


def _onnx_product(weight: np.ndarray) -> onnxruntime.InferenceSession:
    shape = list(weight.shape)
    takes, gives = (onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape) for name in ("x", "y"))
    node = onnx.helper.make_node("MatMul", ["x", "w"], ["y"])
    graph = onnx.helper.make_graph([node], "product", [takes], [gives], [onnx.numpy_helper.from_array(weight, "w")])
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "product.onnx"
        model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 20)], ir_version=10)
        onnx.save(model, file)
        return onnxruntime.InferenceSession(file, options)


def _openvino_product(given: np.ndarray, weight: np.ndarray, precision: str) -> Any:
    """A request that multiplies each time it is run."""
    ov = openvino()
    from openvino import opset13 as ops

    takes = ops.parameter(given.shape, np.float32)
    left, right = takes, ops.constant(weight)
    if precision == "int8":
        left = ops.fake_quantize(left, *(np.float32(bound) for bound in (-4, 4, -4, 4)), levels=256)
        right = ops.fake_quantize(right, *(np.float32(bound) for bound in (-4, 4, -4, 4)), levels=255)
    model = ov.Model([ops.matmul(left, right, False, False)], [takes])
    settings = {"INFERENCE_PRECISION_HINT": HINTS[precision], "INFERENCE_NUM_THREADS": 1, "NUM_STREAMS": 1}
    request = ov.compile_model(model, "CPU", settings).create_infer_request()
    request.set_input_tensor(ov.Tensor(given))
    return request


if __name__ == "__main__":
    main()
