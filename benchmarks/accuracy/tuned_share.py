"""How far to go from the weights before the backbone was trained to those after: measured on photos of another kind.

    python -m benchmarks.accuracy.tuned_share --leave-out amos-15 vcl-10 [--steps 300] [--to runs/tuned-share]
    python -m benchmarks.accuracy.tuned_share --leave-out amos-15 vcl-10 --augment robust    # or --sampler cliques

Whole sets are left out of the training photos, and what was trained without them is measured on every place of theirs,
beside places held out of the sets it did learn from. Places held out of known sets want all the way; unknown sets want
less, and the share that ships is one where neither loses. No evaluation photo takes part.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch

from benchmarks.accuracy.held_out import drawn, leave_out, told
from benchmarks.options import RUNS, TRAIN, benchmark_parser
from salad.models.describer import Describer
from salad.network.network import build
from salad.training.batches import ImageCache
from salad.training.checkpoint import CHECKPOINT, TrainingState
from salad.training.recipe import PRESETS
from salad.training.trainer import train
from salad.training.validation import precision_held_out

SHARES = (0.0, 0.3, 0.5, 0.7, 0.85, 1.0)


def main() -> None:
    parser = benchmark_parser(__doc__, data=TRAIN)
    parser.add_argument("--leave-out", nargs="+", required=True, metavar="SET", help="how their names begin")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--augment", choices=("lite", "robust"), default="lite")
    parser.add_argument("--sampler", choices=("mixed", "cliques"), default="mixed")
    parser.add_argument("--to", type=Path, default=RUNS / "tuned-share")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    known, unknown = leave_out(parser, asked.data, asked.leave_out)
    preset = PRESETS["salad-lite"]
    steps = asked.steps - preset.recipe.head_steps
    recipe = replace(preset.recipe, tune_steps=steps, full_steps=0, tuned_share=0.0, seed=asked.seed)
    recipe = drawn(recipe, asked.augment, asked.sampler)
    run = asked.to / "-".join((*asked.leave_out, asked.augment, asked.sampler))
    train(replace(preset, recipe=recipe), known, to=run)
    saved = torch.load(run / CHECKPOINT, map_location="cpu", weights_only=True)
    _, held_out = recipe.split(known)
    print(
        f"{asked.steps} steps, {asked.augment}, {asked.sampler}, seed {asked.seed}; "
        f"precision on {', '.join(asked.leave_out)} | on places held out"
    )
    with ImageCache(preset.model.preprocessing) as shelf:
        for share in SHARES:
            state = TrainingState(build(preset.model), tuned_share=share)
            state.load_state_dict(saved)
            kept = Describer.of(state.kept().eval())
            there = [precision_held_out(kept, some, shelf) for some in (unknown, held_out)]
            print(f"share {share:.2f}: {' | '.join(map(told, there))}", flush=True)


if __name__ == "__main__":
    main()
