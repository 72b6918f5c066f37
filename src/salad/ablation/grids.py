"""What is compared with what: tables of rows, each with the paper's own figures for it. Imports no torch.

Our figures and the paper's stand side by side, never in one column: other photos, other training, mostly another
backbone. What may be compared is the order of the rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, get_args

from salad.errors import ModelError

Grid = Literal["aggregators", "blocks", "parts", "sizes"]
ALL = -1
"""Every block of the backbone, however many it has."""
FOUR = 4  # the last blocks that the paper trains
SHRINK = 224 / 322
"""The paper's side of a photo in training, as a share of its side in use."""
OTHER_BACKBONE = "as published, on a backbone of its own"


@dataclass(frozen=True, slots=True)
class Theirs:
    """A figure of the paper.

    Args:
        protocol: the named protocol it was measured by.
        percent: R@1.
        aside: why it takes no part in the order of the rows; nothing where it does.
    """

    protocol: str
    percent: float
    aside: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """One model of a grid.

    Args:
        name: names its folder and the row on the command line.
        title: what it is called in a table.
        aggregator: a name in `config.AGGREGATORS`.
        change: settings of that aggregator which are not its usual ones.
        blocks: the last blocks of the backbone that are trained; `ALL` for every one.
        fewer: whether it is trained with smaller photos, and so with fewer tokens, than it is used with.
        fitted: whether it is not trained at all but fitted to the training photos.
        paper: the paper's figures for it.
    """

    name: str
    title: str
    aggregator: str = "salad"
    change: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    blocks: int = FOUR
    fewer: bool = False
    fitted: bool = False
    paper: tuple[Theirs, ...] = ()


def _three(msls: float, nordland: float, sped: float, aside: str = "") -> tuple[Theirs, ...]:
    """R@1 on the three sets that the paper compares aggregators on."""
    figures = zip(("msls-val-740", "nordland-1f", "sped"), (msls, nordland, sped), strict=True)
    return tuple(Theirs(protocol, percent, aside) for protocol, percent in figures)


def _five(challenge: float, msls: float, nordland: float, pitts: float, sped: float) -> tuple[Theirs, ...]:
    """R@1 on the five sets of the paper's first table."""
    return (
        Theirs("msls-challenge", challenge),
        *_three(msls, nordland, sped)[:2],
        Theirs("pitts250k-test", pitts),
        Theirs("sped", sped),
    )


def _msls(percent: float) -> tuple[Theirs, ...]:
    return (Theirs("msls-val-740", percent),)


def _head(clusters: int, cluster_dim: int, **more: int) -> dict[str, int]:
    return {"clusters": clusters, "cluster_dim": cluster_dim, **more}


_AGGREGATORS = (
    Row("salad", "SALAD", paper=_three(92.2, 76.0, 92.1)),
    Row("netvlad", "NetVLAD", "netvlad", paper=_three(92.4, 71.8, 90.8)),
    Row("netvlad-linear", "NetVLAD with reduction", "netvlad-linear", paper=_three(90.1, 70.1, 90.6)),
    Row("gem", "GeM", "gem", paper=_three(85.4, 35.4, 83.0)),
    Row("average", "average", "average"),
    Row("class-token", "class token", "class-token"),
    Row("mixvpr", "MixVPR", "mixvpr", paper=_three(90.0, 63.6, 89.8)),
    Row("conv-ap", "Conv-AP", "conv-ap", paper=_three(83.1, 42.7, 79.2, OTHER_BACKBONE)),
    Row("cosplace", "CosPlace", "cosplace", paper=_three(87.4, 44.2, 80.1, OTHER_BACKBONE)),
    Row("boq", "BoQ", "boq"),
    Row("vlad", "VLAD without training", "vlad", blocks=0, fitted=True, paper=_three(68.7, 16.1, 85.3)),
)

_BLOCKS = (
    Row("blocks-0", "no block", blocks=0, paper=_msls(88.5)),
    Row("blocks-2", "the last 2", blocks=2, paper=_msls(92.0)),
    Row("blocks-4", "the last 4", blocks=4, paper=_msls(92.2)),
    Row("blocks-6", "the last 6", blocks=6, paper=_msls(91.6)),
    Row("blocks-all", "all blocks", blocks=ALL, paper=_msls(89.2)),
)

_PARTS = (
    Row("whole", "whole (3 iterations)", paper=_msls(92.2)),
    Row("no-dustbin", "no dustbin", "salad-no-dustbin", paper=_msls(91.4)),
    Row("no-scene", "no scene token", "salad-no-scene", paper=_msls(91.8)),
    Row("softmax", "softmax for transport", "salad-softmax"),
    Row("dual-softmax", "dual softmax for transport", "salad-dual-softmax", paper=_msls(91.9)),
    Row("iterations-1", "1 iteration", change={"iterations": 1}),
    Row("iterations-10", "10 iterations", change={"iterations": 10}),
    Row("fewer-tokens", "trained with fewer tokens", fewer=True),
    Row("fewer-no-dustbin", "fewer tokens and no dustbin", "salad-no-dustbin", fewer=True),
    # A cluster takes one token's worth, the dustbin all others: the fewer clusters, the more it must take.
    Row("few-clusters", "32 clusters of 64", change=_head(32, 64)),
    Row("few-no-dustbin", "32 clusters of 64, no dustbin", "salad-no-dustbin", change=_head(32, 64)),
    Row("many-clusters", "128 clusters of 16", change=_head(128, 16)),
    Row("many-no-dustbin", "128 clusters of 16, no dustbin", "salad-no-dustbin", change=_head(128, 16)),
)

_SIZES = (
    Row("small", "small", change=_head(16, 32, scene_dim=32), paper=_five(70.8, 89.3, 61.2, 93.0, 88.5)),
    Row("medium", "medium", change=_head(32, 64, scene_dim=64), paper=_five(73.7, 90.5, 70.4, 94.8, 89.5)),
    Row("full", "full", change=_head(64, 128, scene_dim=256), paper=_five(75.0, 92.2, 76.0, 95.1, 92.1)),
)

GRIDS: Mapping[Grid, tuple[Row, ...]] = MappingProxyType(
    {"aggregators": _AGGREGATORS, "blocks": _BLOCKS, "parts": _PARTS, "sizes": _SIZES}
)
"""Every row is trained with the same budget; docs/results.md has what they reach here."""


def rows(grid: str, names: tuple[str, ...] = ()) -> tuple[Row, ...]:
    """The rows of a grid, or those of them that are named, in the grid's order.

    Raises:
        ModelError: there is no such grid, or no such row in it.
    """
    if grid not in get_args(Grid):
        raise ModelError(f"there is no grid {grid!r}: choose one of {', '.join(GRIDS)}")
    there = GRIDS[grid]  # type: ignore[index]  # it is one of them, as was just checked
    unknown = [name for name in names if name not in {row.name for row in there}]
    if unknown:
        raise ModelError(
            f"the grid {grid} has no row {unknown[0]!r}: choose among {', '.join(row.name for row in there)}"
        )
    return tuple(row for row in there if not names or row.name in names)
