"""How large models are: the numbers they learn, and the table of aggregators in docs/method.md."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import nn

from salad.network.aggregator_config import AGGREGATORS
from salad.network.aggregators.base import build_aggregator

PAPERS: dict[str, str] = {
    "salad": "Izquierdo and Civera 2024",
    "salad-no-dustbin": "the same, its ablation",
    "salad-no-scene": "the same, its ablation",
    "salad-softmax": "the same; each token alone",
    "salad-dual-softmax": "the same, its ablation",
    "netvlad": "Arandjelović et al. 2016",
    "netvlad-linear": "the same, with a linear layer",
    "gem": "Radenović et al. 2018",
    "average": "",
    "class-token": "Oquab et al. 2023 (DINOv2)",
    "mixvpr": "Ali-bey et al. 2023",
    "conv-ap": "Ali-bey et al. 2022",
    "cosplace": "Berton et al. 2022",
    "boq": "Ali-bey et al. 2024",
    "vlad": "Keetha et al. 2023 (AnyLoc)",
    "salad-route": "ours",
}
"""Whose each of `AGGREGATORS` is."""


class Size(NamedTuple):
    """How large an aggregator is.

    Args:
        trained: numbers it learns.
        dim: numbers in a descriptor.
    """

    trained: int
    dim: int


def parameters(module: nn.Module, *, trained_only: bool = False) -> int:
    """The numbers a module learns; buffers, as of a normalisation's statistics or a vocabulary, do not count.

    Args:
        module: a model or a part of one.
        trained_only: leave out what is frozen.
    """
    return sum(weight.numel() for weight in module.parameters() if weight.requires_grad or not trained_only)


def size_of(name: str, width: int) -> Size:
    """The size of one of `AGGREGATORS` for tokens of `width` numbers, without making its weights."""
    config = AGGREGATORS[name](width)
    with torch.device("meta"):
        return Size(parameters(build_aggregator(config), trained_only=True), config.dim)


def table(*widths: int) -> str:
    """The aggregators as Markdown: whose they are, and for each width what they learn and give."""
    titles = [
        "name",
        "paper",
        *(title for d in widths for title in (f"trained, d = {d}", f"numbers, d = {d}")),
    ]
    rows = [titles, ["---", "---", *["---:"] * 2 * len(widths)]]
    for name in AGGREGATORS:
        sizes = [size_of(name, width) for width in widths]
        rows.append([f"`{name}`", PAPERS[name], *(f"{number:,}" for size in sizes for number in size)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
