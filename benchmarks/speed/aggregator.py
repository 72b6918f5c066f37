"""SALAD's aggregator against one that builds the 4-D tensor [batch, cluster_dim, clusters, tokens].

    python -m benchmarks.speed.aggregator [--batch 8] [--rounds 15] [--json FILE]

All have the same weights and give the same descriptors (checked first); they differ in how tokens are summed
per cluster. The 4-D tensor is built in two ways: "lean" multiplies features and plan by broadcasting, so that
only their product is that large; "repeated" first repeats both to its size, as such sums are often written.
Times: the ways take turns in one process, median processor time of the rounds, for the aggregator as a whole
(nearly all of which is its perceptrons, the same in all) and for the summing alone. Memory: each way in a process
of its own, the highest resident memory above what it was once model and inputs were there.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional as F

from benchmarks.machine import conditions, in_a_line, in_fresh_process, medians, peak_memory, turns
from benchmarks.options import benchmark_parser
from salad.network.aggregator_config import PRESETS
from salad.network.aggregators.salad import Salad
from salad.network.tokens import Tokens

SEED, SIDE = 0, 23  # 529 tokens: a photo of 322 x 322 pixels
GOAL_TIME, GOAL_MEMORY = 3.0, 1 / 5


def ours_summed(features: Tensor, plan: Tensor) -> Tensor:
    """Features [B, n, l] and plan [B, m, n] -> [B, l, m], as `Salad.forward` does it."""
    return torch.einsum("bnl,bmn->blm", features, plan)


def lean_summed(features: Tensor, plan: Tensor) -> Tensor:
    """The same by way of every product of a feature and a share; in the order of axes that suits it best."""
    per_feature = features.transpose(1, 2).contiguous()
    return (per_feature.unsqueeze(2) * plan.unsqueeze(1)).sum(-1)


def repeated_summed(features: Tensor, plan: Tensor) -> Tensor:
    """The same with both factors repeated to the size of their product."""
    per_feature, dims, clusters = features.transpose(1, 2), features.shape[2], plan.shape[1]
    return (per_feature.unsqueeze(2).repeat(1, 1, clusters, 1) * plan.unsqueeze(1).repeat(1, dims, 1, 1)).sum(-1)


SUMS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "ours": ours_summed,
    "lean": lean_summed,
    "repeated": repeated_summed,
}


def aggregate(model: Salad, tokens: Tokens, way: str) -> Tensor:
    """`Salad.forward`, its sum done in one of the ways."""
    if way == "ours":
        return model(tokens)
    plan = model.plan(tokens)[:, :-1]
    clusters = SUMS[way](model.feature(tokens.patches), plan)
    parts = F.normalize(model.scene(tokens.cls), dim=1), F.normalize(clusters, dim=1).flatten(1)
    return F.normalize(torch.cat(parts, dim=1), dim=1)


def setting(batch: int) -> tuple[Salad, Tokens]:
    """The paper's full aggregator and tokens to feed it."""
    torch.manual_seed(SEED)
    config = PRESETS["full"]
    model = Salad(config).eval()
    patches, scene = torch.randn(batch, SIDE * SIDE, config.width), torch.randn(batch, config.width)
    return model, Tokens(patches, scene, (SIDE, SIDE), 14)


def milliseconds(run: Callable[[str], Tensor], *, rounds: int) -> dict[str, float]:
    """Median of each way, by the processor's time over the threads: a busy machine would stretch the clock's."""
    ways = {way: lambda _, way=way: run(way) for way in SUMS}
    spent = medians(turns(ways, rounds=rounds, clock=time.process_time))
    return {way: each / torch.get_num_threads() for way, each in spent.items()}


@torch.inference_mode()
def memory(way: str, batch: int, threads: int) -> float:
    """Mebibytes that one way needs beyond model and inputs; for a fresh process."""
    torch.set_num_threads(threads)
    model, tokens = setting(batch)
    small = Tokens(tokens.patches[:1, :81].clone(), tokens.cls[:1], (9, 9), 14)
    aggregate(model, small, way)  # brings in the libraries' code, which is nobody's tensors
    before = peak_memory()
    aggregate(model, tokens, way)
    return max((peak_memory() - before) / 2**20, 0.1)


@torch.inference_mode()
def measure(*, batch: int, rounds: int) -> dict[str, dict[str, float]]:
    """Every figure: milliseconds of the whole and of the summing, and mebibytes."""
    model, tokens = setting(batch)
    for way in SUMS:
        torch.testing.assert_close(model(tokens), aggregate(model, tokens, way), rtol=0, atol=1e-5)
    # memory first: a parent that has grown would show in its children
    needed = {way: in_fresh_process(memory, way, batch, torch.get_num_threads()) for way in SUMS}
    features, plan = model.feature(tokens.patches), model.plan(tokens)[:, :-1].contiguous()
    return {
        "aggregator, ms": milliseconds(lambda way: aggregate(model, tokens, way), rounds=rounds),
        "in bfloat16, ms": milliseconds(lambda way: _in_bfloat16(lambda: aggregate(model, tokens, way)), rounds=rounds),
        "summing alone, ms": milliseconds(lambda way: SUMS[way](features, plan), rounds=rounds),
        "peak memory, MiB": needed,
    }


def _in_bfloat16(run: Callable[[], Tensor]) -> Tensor:
    """Under autocast, as models are run where the processor has bfloat16; transport stays in float32."""
    with torch.autocast("cpu", torch.bfloat16):
        return run()


def _verdict(met: bool) -> str:
    return "met" if met else "missed"


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    torch.set_num_threads(asked.threads)
    figures = measure(batch=asked.batch, rounds=asked.rounds)
    facts = conditions(
        "torch",
        seed=SEED,
        threads=torch.get_num_threads(),
        batch=asked.batch,
        tokens=SIDE * SIDE,
        rounds=asked.rounds,
    )
    print(in_a_line(facts))
    for what, each in figures.items():
        print(f"{what:18} " + "   ".join(f"{way} {value:8.2f}" for way, value in each.items()))
    for other in ("lean", "repeated"):
        for what in ("aggregator, ms", "in bfloat16, ms", "summing alone, ms"):
            faster = figures[what][other] / figures[what]["ours"]
            print(f"{other}, {what[:-4]}: {faster:.1f} times as fast (goal {GOAL_TIME:.0f}): "
                  f"{_verdict(faster >= GOAL_TIME)}")  # fmt: skip
        share = figures["peak memory, MiB"]["ours"] / figures["peak memory, MiB"][other]
        print(f"{other}, memory: {share:.0%} (goal {GOAL_MEMORY:.0%}): {_verdict(share <= GOAL_MEMORY)}")
    if asked.json:
        asked.json.write_text(json.dumps({**facts, **figures}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
