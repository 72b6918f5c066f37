"""How large models are: the numbers they learn, and the table of aggregators in docs/method.md."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import nn

from salad.network.aggregator_config import compared_aggregators
from salad.network.aggregators.base import build_aggregator


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
    """The size of one of `compared_aggregators` for tokens of `width` numbers, without making its weights."""
    config = compared_aggregators(width)[name]
    with torch.device("meta"):  # shapes without numbers: the largest has 201 million of them
        return Size(parameters(build_aggregator(config), trained_only=True), config.dim)


def table(*widths: int) -> str:
    """The aggregators as Markdown: whose they are, and for each width what they learn and give."""
    titles = [
        "name",
        "paper",
        *(title for d in widths for title in (f"trained, d = {d}", f"numbers, d = {d}")),
    ]
    rows, before = [titles, ["---", "---", *["---:"] * 2 * len(widths)]], ""
    for name, config in compared_aggregators(widths[0]).items():
        # A kind's variants follow it in the table, and are of the same paper.
        paper = "the same" if config.kind == before else config.paper
        sizes = [size_of(name, width) for width in widths]
        rows.append([f"`{name}`", paper, *(f"{number:,}" for size in sizes for number in size)])
        before = config.kind
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
