"""The paper's rows and figures, ready to be set beside ours.

R@1 is taken from `salad.ablation.grids`, which has it for every row that is trained there; only what the paper adds to
that stands here. The MSLS challenge is left out: no named protocol judges it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from salad.ablation.grids import GRIDS, GridRow
from salad.datasets.protocols import PROTOCOLS

SOURCE = "Izquierdo and Civera, Optimal Transport Aggregation for Visual Place Recognition, CVPR 2024, arXiv 2311.15937"
SIDE = 322  # pixels of the paper's photos in evaluation, squeezed to a square
WIDTH, DEPTH = 768, 12  # DINOv2 ViT-B/14, which every row below stands on
Figures = Mapping[str, Mapping[int, float]]

_FIRST = {  # the paper's first table, R@1/R@5 in the order of `_COLUMNS`; `-` is what the grids have
    "netvlad": "82.6/89.6 32.6/47.1 90.5/96.2 78.7/88.3",
    "gem": "78.2/86.6 21.6/37.3 87.0/94.4 66.7/83.4",
    "conv-ap": "-/90.3 -/58.9 92.9/97.7 -/88.6",
    "cosplace": "-/93.0 -/59.7 92.1/97.5 -/89.6",
    "mixvpr": "88.0/92.7 58.4/74.6 94.6/98.3 85.2/92.1",
    "eigenplaces": "89.3/93.7 54.4/68.8 94.1/98.0 69.9/82.9",
    "small": "-/94.9 -/78.9 -/97.4 -/94.7",
    "medium": "-/95.4 -/85.7 -/98.3 -/94.9",
    "full": "-/96.4 -/89.2 -/98.5 -/96.2",
}
_COLUMNS = ("msls-val-740", "nordland-1f", "pitts250k-test", "sped")
_TITLES = {
    "netvlad": "NetVLAD",
    "gem": "GeM",
    "conv-ap": "Conv-AP",
    "cosplace": "CosPlace",
    "mixvpr": "MixVPR",
    "eigenplaces": "EigenPlaces",
    "small": "SALAD small",
    "medium": "SALAD medium",
    "full": "SALAD full",
}
METHODS = tuple(_FIRST)
_DIMS = {"netvlad": 24_576, "netvlad-linear": 8_192, "vlad": 49_152}
_SIZES = ("full", "medium", "small")
_ALIKE = ("conv-ap", "cosplace")  # of which the grids show the first table's figures, as asides
# aggregators whose descriptor is as long as the full model's
_LIKE_FULL = ("salad", "salad-no-dustbin", "salad-dual-softmax")


@dataclass(frozen=True, slots=True)
class Claim:
    """What the paper says of one model.

    Attributes:
        title: What it is called.
        figures: Recall in percent by protocol and by k.
        dim: Numbers in its descriptor; None where the paper does not say.
        aside: Why its figures are not to be set against ours; empty where they are.
    """

    title: str
    figures: Figures
    dim: int | None = None
    aside: str = ""


def claim(row: GridRow) -> Claim:
    """What the paper says of a row of the grids: R@1, and what its first table has more of the three sizes."""
    if row in GRIDS["sizes"]:
        return first(row.name)
    return Claim(row.title, _of_grid(row), _dim(row), next((one.caveat for one in row.paper if one.caveat), ""))


def first(method: str) -> Claim:
    """What the paper's first table says of one of `METHODS`; all but SALAD as published, on backbones of their own."""
    grid = GRIDS["sizes"] if method in _SIZES else GRIDS["aggregators"] if method in _ALIKE else ()
    row = next((row for row in grid if row.name == method), None)
    known = {} if row is None else _of_grid(row)
    figures = {
        protocol: known.get(protocol, {})
        | {k: float(text) for k, text in zip((1, 5), cell.split("/"), strict=True) if text != "-"}
        for protocol, cell in zip(_COLUMNS, _FIRST[method].split(), strict=True)
    }
    return Claim(_TITLES[method], figures, _dim(row) if row is not None and method in _SIZES else None)


def protocols() -> tuple[str, ...]:
    """The named protocols that the paper has figures of."""
    return _COLUMNS


def _of_grid(row: GridRow) -> dict[str, dict[int, float]]:
    return {one.protocol: {1: one.percent} for one in row.paper if one.protocol in PROTOCOLS}


def _dim(row: GridRow) -> int | None:
    if not row.paper and row.change:  # a head of ours, of which the paper says nothing
        return None
    sized = row.change if "clusters" in row.change else None
    if sized is None and row.aggregator in _LIKE_FULL:
        sized = next(other.change for other in GRIDS["sizes"] if other.name == "full")
    if sized is None:
        return _DIMS.get(row.name)
    return int(sized["clusters"] * sized["cluster_dim"] + sized["scene_dim"])
