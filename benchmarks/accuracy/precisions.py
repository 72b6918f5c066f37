"""What a model loses in bf16 and in int8: R@1 on every evaluation set, and the cosine of its descriptors.

    python -m benchmarks.accuracy.precisions [MODEL ...] [--train ../shared/data/train] [--data ../shared/data/eval]

int8 is calibrated on photos of `--train`, by chance, with the parameters of `salad.models.quantize`, which were chosen
there too; nothing here was chosen by the evaluation sets. The models are judged as `salad locate` uses them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.accuracy.recall import SETS
from benchmarks.machine import conditions, in_a_line
from benchmarks.options import EVAL, TRAIN, benchmark_parser
from salad.evaluation.evaluate_benchmark import evaluate
from salad.images.finding import find_photos
from salad.models.describer import Describer
from salad.models.model_folder import load
from salad.models.quantize import quantized

SEED, LEARNT_ON, COMPARED = 0, 300, 64


def main() -> None:
    """Measure and print, a line as soon as it is known."""
    parser = benchmark_parser(__doc__, data=EVAL, models=["salad-lite", "salad-vits"])
    parser.add_argument("--train", type=Path, default=TRAIN, metavar="DIR", help="default: %(default)s")
    parser.add_argument("--sets", nargs="+", default=[each.name for each in SETS])
    parser.add_argument("--learnt-on", type=int, default=LEARNT_ON)
    asked = parser.parse_args()
    told = conditions("openvino", "nncf", seed=SEED, calibrated_on=asked.learnt_on, cosines_of=COMPARED)
    print(in_a_line(told), flush=True)
    sets = [each for each in SETS if each.name in asked.sets and (asked.data / each.name).is_dir()]
    print("| R@1 | mean cosine (least) | " + " | ".join(each.name for each in sets) + " |")
    print("|---" * (len(sets) + 2) + "|")
    for name in asked.models:
        for way, model, cosines in _precisions(name, asked):
            found = [evaluate(each.read(asked.data), model, ks=(1,)).recall[1] for each in sets]
            near = f"{cosines.mean():.4f} ({cosines.min():.4f})"
            print(f"| {name}, {way} | {near} | " + " | ".join(f"{each:.1f}" for each in found) + " |", flush=True)


def _precisions(name: str, asked: argparse.Namespace) -> list[tuple[str, Describer, np.ndarray]]:
    """The model in float32, bf16 and int8, and the cosines of descriptors to the first's."""
    model = load(name, engine="openvino")
    photos = find_photos([str(asked.train)])
    chance = np.random.default_rng(SEED)
    drawn = [photos[row] for row in chance.permutation(len(photos))[: asked.learnt_on + COMPARED]]
    learnt, compared = model.squeezed(drawn[COMPARED:]), list(model.squeezed(drawn[:COMPARED]))
    due, made = model.describe(compared), [("float32", model)]
    made += [("bf16", quantized(model, learnt, precision="bf16")), ("int8", quantized(model, learnt, precision="int8"))]
    return [(way, each, (each.describe(compared) * due).sum(axis=1)) for way, each in made]


if __name__ == "__main__":
    main()
