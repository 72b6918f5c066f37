"""The aggregator of the paper and the plain ones, as data; `rivals` holds what it is compared with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

from salad.errors import ModelError

Transport = Literal["sinkhorn", "softmax", "dual-softmax"]


@dataclass(frozen=True, slots=True)
class SaladConfig:
    """The SALAD aggregator; letters are those of docs/method.md.

    Args:
        width: numbers in a token it takes (d).
        clusters: clusters that tokens are shared among (m), the dustbin not counted.
        cluster_dim: numbers kept for a cluster (l).
        scene_dim: numbers kept of the scene token (g); 0 leaves it out.
        hidden: hidden width of its three perceptrons.
        dropout: share of hidden numbers dropped in the score and feature perceptrons while training.
        linear: width of a final linear layer, as MegaLoc has one; None for none.
        dustbin: whether tokens may go to no cluster.
        transport: how tokens are shared: by Sinkhorn's iteration, each by a softmax over the clusters, or by the
            product of that with a softmax over the tokens.
        iterations: Sinkhorn's rounds; the 3 belongs to published models.
        dustbin_share: what the dustbin wants of all tokens, however many there are; None for the paper's n - m of n,
            so that a larger photo loses a larger share.

    Raises:
        ModelError: one of the last four, or `scene_dim`, makes no sense.
    """

    width: int
    clusters: int = 64
    cluster_dim: int = 128
    scene_dim: int = 256
    hidden: int = 512
    dropout: float = 0.3
    linear: int | None = None
    dustbin: bool = True
    transport: Transport = "sinkhorn"
    iterations: int = 3
    dustbin_share: float | None = None
    kind: Literal["salad"] = "salad"

    def __post_init__(self) -> None:
        check_whole(self, "scene_dim", least=0)
        check_whole(self, "iterations")
        if not isinstance(self.dustbin, bool):
            raise ModelError(f"dustbin of the salad aggregator is {self.dustbin!r}: give true or false")
        if self.transport not in get_args(Transport):
            raise ModelError(
                f"transport {self.transport!r} is unknown: give one of {', '.join(get_args(Transport))}"
            )
        self._check_dustbin_share()

    def _check_dustbin_share(self) -> None:
        share = self.dustbin_share
        if share is None:
            return
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0 < share < 1:
            raise ModelError(
                f"dustbin_share of the salad aggregator is {share!r}: give a share between 0 and 1"
            )
        if not self.dustbin or self.transport != "sinkhorn":
            raise ModelError(
                "dustbin_share needs a dustbin and the transport sinkhorn: nothing else holds to it"
            )

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.linear or self.scene_dim + self.clusters * self.cluster_dim


@dataclass(frozen=True, slots=True)
class RouteConfig:
    """SALAD's descriptor beside a coarse layout of the photo: for fixed viewpoints (routes, webcams, trains).

    Where the viewpoint changes, the layout is worse than none: never a default.

    Args:
        width: numbers in a token it takes.
        salad: the SALAD aggregator it builds on, of the same width.
        grid: the layout has grid x grid cells.
        cell_dim: numbers kept for a cell.
        weight: of the layout beside the SALAD descriptor, both of length 1.

    Raises:
        ModelError: a number makes no sense, or the widths differ.
    """

    width: int
    salad: SaladConfig
    grid: int = 4
    cell_dim: int = 32
    weight: float = 1.0
    kind: Literal["salad-route"] = "salad-route"

    def __post_init__(self) -> None:
        check_whole(self, "grid", "cell_dim")
        if not isinstance(self.weight, int | float) or not math.isfinite(self.weight) or self.weight < 0:
            raise ModelError(f"weight of the layout is {self.weight!r}: give a finite number, not below 0")
        if not isinstance(self.salad, SaladConfig) or self.salad.width != self.width:
            raise ModelError(
                f"salad of the salad-route aggregator must be one for tokens of {self.width} numbers"
            )

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.salad.dim + self.grid**2 * self.cell_dim


@dataclass(frozen=True, slots=True)
class SceneConfig:
    """The scene token alone, L2-normalised: what a bare backbone says of a photo."""

    width: int
    kind: Literal["scene"] = "scene"

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.width


@dataclass(frozen=True, slots=True)
class AverageConfig:
    """The mean of the patches, L2-normalised, without weights."""

    width: int
    kind: Literal["average"] = "average"

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.width


@dataclass(frozen=True, slots=True)
class GemConfig:
    """Generalised mean of the tokens: the plain baseline, without weights or with its power learnt.

    Args:
        width: numbers in a token it takes.
        power: the mean's; where it is learnt, its start.
        learned: whether the power is a weight.
    """

    width: int
    power: float = 3.0
    learned: bool = False
    kind: Literal["gem"] = "gem"

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.width


def check_whole(config: Any, *names: str, least: int = 1) -> None:
    """Make sure that settings of an aggregator are whole numbers, none below `least`.

    Raises:
        ModelError: one is not; the sentence names it.
    """
    for name in names:
        value = getattr(config, name)
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            raise ModelError(
                f"{name} of the {config.kind} aggregator is {value!r}: give a whole number, at least {least}"
            )


PRESETS: dict[str, SaladConfig] = {
    "full": SaladConfig(width=768),
    "medium": SaladConfig(width=768, clusters=32, cluster_dim=64, scene_dim=64),
    "small": SaladConfig(width=768, clusters=16, cluster_dim=32, scene_dim=32),
}
"""The paper's three aggregators: 8448, 2112 and 544 numbers."""
