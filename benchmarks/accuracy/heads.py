"""Which trunk and which head `salad-lite` has: what each learns of sets it never saw, and of new places of sets it did.

    python -m benchmarks.accuracy.heads --leave-out sfxl-240 [--seeds 1] [--steps 300] [--rows NAME ...]
    python -m benchmarks.accuracy.heads --leave-out amos-15 vcl-10
    python -m benchmarks.accuracy.heads --leave-out sfxl-240 --rows lite2-128x64 --augment robust
    python -m benchmarks.accuracy.heads --leave-out sfxl-240 --rows lite2-128x64 --sampler cliques    # or --views 8

Whole sets are left out of the training photos. Each head is trained on cached tokens of its frozen trunk, at 224 px,
and measured on every place of the sets left out, beside places held out of those it learnt from; mean average precision
in percent, as models are chosen by. No evaluation photo takes part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.accuracy.held_out import drawn, leave_out
from benchmarks.options import RUNS, TRAIN, benchmark_parser
from salad.datasets.training_place import TrainingPlace
from salad.models.model_folder import load
from salad.network.aggregator_config import SaladConfig
from salad.network.config import LiteConfig
from salad.training.batches import ImageCache
from salad.training.recipe import LITE_HEAD, LITE_TRUNK, PRESETS, SMALL_HEAD, SMALL_PHOTO, Augment, Preset, Sampling
from salad.training.trainer import train
from salad.training.validation import precision_held_out

ROWS: dict[str, tuple[LiteConfig, SaladConfig]] = {
    "lite0-128x16": (LiteConfig(), SMALL_HEAD),
    "lite2-128x16": (LITE_TRUNK, replace(SMALL_HEAD, width=LITE_HEAD.width)),
    "lite2-128x32": (LITE_TRUNK, replace(SMALL_HEAD, width=LITE_HEAD.width, cluster_dim=32)),
    "lite2-64x128": (LITE_TRUNK, SaladConfig(LITE_HEAD.width)),
    "lite2-128x64": (LITE_TRUNK, LITE_HEAD),
}
"""Trunk, clusters and numbers of each; the last is `salad-lite`'s, and the last two are as long as the paper's."""


def preset_of(row: str, *, steps: int, seed: int, augment: Augment, sampler: Sampling, views: int) -> Preset:
    """A head on cached tokens of a frozen trunk, used at the size it is trained at; as many photos in every batch."""
    trunk, head = ROWS[row]
    known = PRESETS["head"]
    model = replace(known.model, name=row, backbone=trunk, aggregator=head, preprocessing=SMALL_PHOTO)
    places = known.recipe.batch // views
    recipe = replace(known.recipe, head_steps=steps, seed=seed, places=places, views=views)
    recipe = drawn(recipe, augment, sampler)
    return replace(known, model=model, recipe=recipe)


def measured(
    run: Path, made: Preset, known: Sequence[TrainingPlace], unknown: Sequence[TrainingPlace], tokens: Path
) -> dict[str, float]:
    """Train a row without the sets left out, and measure what was best on places held out of the others."""
    model = load(train(made, known, to=run, tokens=tokens))
    _, held_out = made.recipe.split(known)
    with ImageCache(model.preprocessing) as shelf:
        new = precision_held_out(model, held_out, shelf)
        other = precision_held_out(model, unknown, shelf)
    return {"held out": new["mean"], **other}


def spread(figures: Sequence[Mapping[str, float]]) -> str:
    """Mean and standard deviation over the seeds, on one line."""
    told = []
    for name in figures[0]:
        each = [one[name] for one in figures]
        more = f" +- {np.std(each, ddof=1):.1f}" if len(each) > 1 else ""
        told.append(f"{name} {np.mean(each):.1f}{more}")
    return "  ".join(told)


def main() -> None:
    parser = benchmark_parser(__doc__, data=TRAIN)
    parser.add_argument("--leave-out", nargs="+", required=True, metavar="SET", help="how their names begin")
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=list(ROWS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--augment", choices=("lite", "robust"), default="lite")
    parser.add_argument("--sampler", choices=("mixed", "cliques"), default="mixed")
    parser.add_argument("--views", type=int, default=4, help="photos of a place in a batch of 64")
    parser.add_argument("--to", type=Path, default=RUNS / "heads")
    asked = parser.parse_args()
    known, unknown = leave_out(parser, asked.data, asked.leave_out)
    for row in asked.rows:
        figures = []
        for seed in range(asked.seeds):
            drawn_so = f"{asked.augment}-{asked.sampler}-{asked.views}"
            run = asked.to / "-".join(asked.leave_out) / f"{row}-{drawn_so}-{seed}"
            made = preset_of(
                row,
                steps=asked.steps,
                seed=seed,
                augment=asked.augment,
                sampler=asked.sampler,
                views=asked.views,
            )
            figures.append(measured(run, made, known, unknown, asked.to / "tokens"))
        how = f"{row}, {asked.augment}, {asked.sampler}, {asked.views} views, without {', '.join(asked.leave_out)}"
        print(f"{how}: {spread(figures)}", flush=True)


if __name__ == "__main__":
    main()
