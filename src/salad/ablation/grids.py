"""The paper's tables as grids of rows to train, each with the paper's own figures for it. Imports no torch.

Our figures and the paper's stand side by side, never in one column: other photos, other training, mostly another
backbone. What may be compared is the order of the rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

from salad.errors import ModelError

Grid = Literal["aggregators", "blocks", "parts", "sizes"]
ALL_BLOCKS = -1
"""Every block of the backbone, however many it has."""
PAPERS_BLOCKS = 4
"""The last blocks of the backbone that the paper trains."""
OTHER_BACKBONE = "as published, on a backbone of its own"


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """A figure of the paper.

    Args:
        protocol: the named protocol it was measured by.
        percent: R@1.
        caveat: why it takes no part in the order of the rows; nothing where it does.
    """

    protocol: str
    percent: float
    caveat: str = ""


@dataclass(frozen=True, slots=True)
class GridRow:
    """One model of a grid.

    Args:
        name: names its folder and the row on the command line.
        title: what it is called in a table.
        aggregator: a name in `compared_aggregators`.
        change: settings of that aggregator which are not its usual ones.
        blocks: the last blocks of the backbone that are trained; `ALL_BLOCKS` for every one.
        fewer_tokens: whether it is trained with smaller photos, and so with fewer tokens, than it is used with.
        fitted: whether it is not trained at all but fitted to the training photos.
        paper: the paper's figures for it.
    """

    name: str
    title: str
    aggregator: str = "salad"
    change: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    blocks: int = PAPERS_BLOCKS
    fewer_tokens: bool = False
    fitted: bool = False
    paper: tuple[PaperFigure, ...] = ()


_MSLS = ("msls-val-740",)
_THREE = ("msls-val-740", "nordland-1f", "sped")  # those that the paper compares aggregators on
_FIVE = ("msls-challenge", "msls-val-740", "nordland-1f", "pitts250k-test", "sped")  # of its first table


def _paper(protocols: tuple[str, ...], *percents: float, caveat: str = "") -> tuple[PaperFigure, ...]:
    return tuple(PaperFigure(*figure, caveat) for figure in zip(protocols, percents, strict=True))


def _head(clusters: int, cluster_dim: int, **more: int) -> dict[str, int]:
    return {"clusters": clusters, "cluster_dim": cluster_dim, **more}


# One backbone under each. Rows of the paper that stand on another backbone take no part in the order.
_AGGREGATORS = (
    GridRow("salad", "SALAD", paper=_paper(_THREE, 92.2, 76.0, 92.1)),
    GridRow("netvlad", "NetVLAD", "netvlad", paper=_paper(_THREE, 92.4, 71.8, 90.8)),
    GridRow("netvlad-linear", "NetVLAD with reduction", "netvlad-linear", paper=_paper(_THREE, 90.1, 70.1, 90.6)),
    GridRow("gem", "GeM", "gem", paper=_paper(_THREE, 85.4, 35.4, 83.0)),
    # A row without `paper` is one that we ask about and the paper does not.
    GridRow("average", "average", "average"),
    GridRow("class-token", "class token", "class-token"),
    GridRow("mixvpr", "MixVPR", "mixvpr", paper=_paper(_THREE, 90.0, 63.6, 89.8)),
    GridRow("conv-ap", "Conv-AP", "conv-ap", paper=_paper(_THREE, 83.1, 42.7, 79.2, caveat=OTHER_BACKBONE)),
    GridRow("cosplace", "CosPlace", "cosplace", paper=_paper(_THREE, 87.4, 44.2, 80.1, caveat=OTHER_BACKBONE)),
    GridRow("boq", "BoQ", "boq"),
    # AnyLoc learns nothing: its vocabulary is fitted to the photos, and the backbone stays as it is.
    GridRow("vlad", "VLAD without training", "vlad", blocks=0, fitted=True, paper=_paper(_THREE, 68.7, 16.1, 85.3)),
)

# With more than four blocks trained the paper's model gets worse: is that so on a smaller backbone too?
_BLOCKS = (
    GridRow("blocks-0", "no block", blocks=0, paper=_paper(_MSLS, 88.5)),
    GridRow("blocks-2", "the last 2", blocks=2, paper=_paper(_MSLS, 92.0)),
    GridRow("blocks-4", "the last 4", blocks=4, paper=_paper(_MSLS, 92.2)),
    GridRow("blocks-6", "the last 6", blocks=6, paper=_paper(_MSLS, 91.6)),
    GridRow("blocks-all", "all blocks", blocks=ALL_BLOCKS, paper=_paper(_MSLS, 89.2)),
)

# What each part of SALAD is good for: taken away, exchanged, or met with another number of tokens.
_PARTS = (
    GridRow("whole", "whole (3 iterations)", paper=_paper(_MSLS, 92.2)),
    GridRow("no-dustbin", "no dustbin", "salad-no-dustbin", paper=_paper(_MSLS, 91.4)),
    GridRow("no-scene", "no scene token", "salad-no-scene", paper=_paper(_MSLS, 91.8)),
    GridRow("softmax", "softmax for transport", "salad-softmax"),
    GridRow("dual-softmax", "dual softmax for transport", "salad-dual-softmax", paper=_paper(_MSLS, 91.9)),
    GridRow("iterations-1", "1 iteration", change={"iterations": 1}),
    GridRow("iterations-10", "10 iterations", change={"iterations": 10}),
    # The paper trains with 256 tokens and is used with 529; what the dustbin learns depends on their number.
    GridRow("fewer-tokens", "trained with fewer tokens", fewer_tokens=True),
    GridRow("fewer-no-dustbin", "fewer tokens and no dustbin", "salad-no-dustbin", fewer_tokens=True),
    # A cluster takes one token's worth, the dustbin all others: the fewer clusters, the more it must take.
    GridRow("few-clusters", "32 clusters of 64", change=_head(32, 64)),
    GridRow("few-no-dustbin", "32 clusters of 64, no dustbin", "salad-no-dustbin", change=_head(32, 64)),
    GridRow("many-clusters", "128 clusters of 16", change=_head(128, 16)),
    GridRow("many-no-dustbin", "128 clusters of 16, no dustbin", "salad-no-dustbin", change=_head(128, 16)),
)

# Descriptors of 544, 2,112 and 8,448 numbers.
_SIZES = (
    GridRow(
        "small",
        "small",
        change=_head(16, 32, scene_dim=32),
        paper=_paper(_FIVE, 70.8, 89.3, 61.2, 93.0, 88.5),
    ),
    GridRow(
        "medium",
        "medium",
        change=_head(32, 64, scene_dim=64),
        paper=_paper(_FIVE, 73.7, 90.5, 70.4, 94.8, 89.5),
    ),
    GridRow(
        "full",
        "full",
        change=_head(64, 128, scene_dim=256),
        paper=_paper(_FIVE, 75.0, 92.2, 76.0, 95.1, 92.1),
    ),
)

GRIDS: Mapping[str, tuple[GridRow, ...]] = MappingProxyType(
    {"aggregators": _AGGREGATORS, "blocks": _BLOCKS, "parts": _PARTS, "sizes": _SIZES}
)
"""Every row is trained with the same budget; docs/results.md has what they reach here."""


def grid_rows(grid: str, names: tuple[str, ...] = ()) -> tuple[GridRow, ...]:
    """The rows of a grid, or those of them that are named, in the grid's order.

    Raises:
        ModelError: If there is no such grid, or no such row in it.
    """
    if grid not in GRIDS:
        raise ModelError(f"there is no grid {grid!r}: choose one of {', '.join(GRIDS)}")
    rows = GRIDS[grid]
    known = [row.name for row in rows]
    unknown = next((name for name in names if name not in known), None)
    if unknown is not None:
        raise ModelError(f"the grid {grid} has no row {unknown!r}: choose among {', '.join(known)}")
    return tuple(row for row in rows if not names or row.name in names)
