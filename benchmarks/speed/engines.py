"""How fast each engine runs each model in each precision, and how near its descriptors stay to torch's.

    python -m benchmarks.speed.engines [MODEL ...] [--batches 1 8 16] [--photos 16] [--threads 1] [--device cpu]

Processor time on one thread, in ratios to torch in float32 within the same run; the ways take turns, and the best of
the rounds counts. In brackets the mean cosine of the descriptors to torch's. `vitb14` is DINOv2's ViT-B/14 under a
SALAD head at 322 pixels with random weights: its speed is a trained one's, its cosines say nothing and are left out.

Photos are drawn (480 x 360 JPEG), and int8 is calibrated on others drawn alike, so anyone can repeat the speeds.
Cosines on a drawn town are lower than on photos; those of docs/engines.md come of `benchmarks.accuracy.precisions`.

`--device cuda` compares torch and ONNX Runtime on a CUDA card, by the clock. It has never been run.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import torch

from benchmarks.machine import conditions, in_a_line, turns
from benchmarks.options import SHIPPED, benchmark_parser
from salad.demo.town.town import draw_town
from salad.errors import SaladError
from salad.models.describer import Describer
from salad.models.engines import EngineName
from salad.models.model_folder import add_graph, load, write_folder
from salad.models.quantize import Reduced, quantized
from salad.network.aggregator_config import SaladConfig
from salad.network.config import VITS, ModelConfig, Preprocessing
from salad.network.network import build

SEED, ROUNDS, LEARNT_ON = 7, 4, 64
RANDOM = "vitb14"
ENGINES: tuple[EngineName, ...] = ("torch", "onnx", "openvino")
PRECISIONS: tuple[Reduced, ...] = ("bf16", "int8")


def main() -> None:
    """Measure and print, a model at a time."""
    asked = _asked()
    torch.set_num_threads(asked.threads)
    told = conditions(
        *("torch", "onnxruntime", "openvino", "nncf"),
        seed=SEED,
        threads=asked.threads,
        photos=f"{asked.photos} of 480 x 360",
        rounds=ROUNDS,
        device=asked.device,
    )
    print(in_a_line(told), flush=True)
    print(
        "| model | batch | " + " | ".join(("torch, ms a photo", "engine and precision: times as fast (cosine)")) + " |"
    )
    print("|---|---:|---:|---|")
    with tempfile.TemporaryDirectory() as folder:
        town = draw_town(Path(folder) / "town", seed=SEED, references=asked.photos + LEARNT_ON, queries=1).references
        for name in asked.models:
            where = _untrained(Path(folder) / name) if name == RANDOM else name
            base = load(where, engine="torch", device=asked.device)
            pixels = base.squeezed(town)
            shown, learnt = pixels[: asked.photos], pixels[asked.photos :]
            ways = dict(_ways(where, learnt, asked.threads, asked.device))
            _report(name, ways, shown, asked.batches, asked.device)


def _asked() -> argparse.Namespace:
    parser = benchmark_parser(__doc__, models=[*SHIPPED, RANDOM])
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 8, 16])
    parser.add_argument("--photos", type=int, default=16)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    return parser.parse_args()


def _untrained(folder: Path) -> Path:
    """A ViT-B/14 with random weights, and its graph."""
    head = SaladConfig(768, clusters=64, cluster_dim=128, scene_dim=256, hidden=512)
    network = build(ModelConfig(RANDOM, VITS[RANDOM], head, Preprocessing(322, 322)), seed=SEED)
    write_folder(network, folder, dtype="float16")
    add_graph(folder)
    return folder


def _ways(where: str | Path, learnt: np.ndarray, threads: int, device: str) -> Iterator[tuple[str, Describer]]:
    """Every engine and precision that this machine has, with a sentence for those it has not."""
    for engine in ENGINES if device == "cpu" else ENGINES[:2]:
        yield engine, load(where, engine=engine, threads=threads, device=device)
    if device != "cpu":
        return
    for precision in PRECISIONS:
        try:
            made = quantized(load(where, engine="openvino", threads=threads), learnt, precision=precision)
            made.engine.run(learnt[:1])
        except SaladError as error:
            print(f"{where} in {precision}: passed over, {error}")
            continue
        yield f"openvino {precision}", made


def _report(name: str, ways: dict[str, Describer], photos: np.ndarray, batches: list[int], device: str) -> None:
    described = {way: model.describe(list(photos)) for way, model in ways.items()}
    cosines = {way: float((rows * described["torch"]).sum(axis=1).mean()) for way, rows in described.items()}
    clock = time.process_time if device == "cpu" else time.perf_counter
    for batch in batches:
        # Four photos one by one are told from one another well enough, where sixteen of a large model take a minute.
        some = photos[: max(4, batch)]
        runs = {way: partial(_run, model, some, batch) for way, model in ways.items()}
        best = {way: min(seconds) / len(some) for way, seconds in turns(runs, rounds=ROUNDS, clock=clock).items()}
        cells = [
            f"{way} **{best['torch'] / best[way]:.2f}**" + ("" if name == RANDOM else f" ({cosines[way]:.5f})")
            for way in ways
            if way != "torch"
        ]
        print(f"| {name} | {batch} | {1000 * best['torch']:.1f} | {', '.join(cells)} |", flush=True)


def _run(model: Describer, photos: np.ndarray, batch: int, _: int) -> None:
    for start in range(0, len(photos), batch):
        model.engine.run(photos[start : start + batch])


if __name__ == "__main__":
    main()
