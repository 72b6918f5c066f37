"""The aggregator of the paper and the plain ones, as data; `rivals` holds what it is compared with."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
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


# --- The aggregators that SALAD is compared with, as data; model/aggregators/ tells how each works, and whose it is ---


@dataclass(frozen=True, slots=True)
class NetVladConfig:
    """NetVLAD: residuals to centroids, softly assigned.

    Args:
        width: numbers in a token it takes.
        clusters: how many centroids.
        linear: width of a final linear layer; None for none.

    Raises:
        ModelError: a number is below 1.
    """

    width: int
    clusters: int = 32
    linear: int | None = None
    kind: Literal["netvlad"] = "netvlad"

    def __post_init__(self) -> None:
        check_whole(self, "width", "clusters", *(["linear"] if self.linear is not None else []))

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.linear or self.clusters * self.width


@dataclass(frozen=True, slots=True)
class VladConfig:
    """VLAD without training, as AnyLoc uses it: residuals to a vocabulary, each token assigned to one word.

    Args:
        width: numbers in a token it takes.
        clusters: words of the vocabulary.

    Raises:
        ModelError: a number is below 1.
    """

    width: int
    clusters: int = 32
    kind: Literal["vlad"] = "vlad"

    def __post_init__(self) -> None:
        check_whole(self, "width", "clusters")

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.clusters * self.width


@dataclass(frozen=True, slots=True)
class MixVprConfig:
    """MixVPR: perceptrons across the cells of the grid, one channel at a time.

    Args:
        width: numbers in a token it takes.
        grid: rows and columns of tokens; its weights fit no other grid.
        depth: how many mixers.
        ratio: their hidden width, as a multiple of the cells.
        channels: channels kept.
        rows: numbers kept for a channel.

    Raises:
        ModelError: a number is below 1, or the grid is no pair.
    """

    width: int
    grid: tuple[int, int] = (20, 20)
    depth: int = 4
    ratio: int = 1
    channels: int = 1024
    rows: int = 4
    kind: Literal["mixvpr"] = "mixvpr"

    def __post_init__(self) -> None:
        check_whole(self, "width", "depth", "ratio", "channels", "rows")
        object.__setattr__(self, "grid", _pair(self.grid, self.kind))  # JSON knows lists alone

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.channels * self.rows


@dataclass(frozen=True, slots=True)
class ConvApConfig:
    """Conv-AP: channels mixed token by token, then averaged over the cells of a coarse grid.

    Args:
        width: numbers in a token it takes.
        channels: channels kept.
        grid: rows and columns of the averages.

    Raises:
        ModelError: a number is below 1, or the grid is no pair.
    """

    width: int
    channels: int = 2048
    grid: tuple[int, int] = (2, 2)
    kind: Literal["conv-ap"] = "conv-ap"

    def __post_init__(self) -> None:
        check_whole(self, "width", "channels")
        object.__setattr__(self, "grid", _pair(self.grid, self.kind))

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.channels * self.grid[0] * self.grid[1]


@dataclass(frozen=True, slots=True)
class CosPlaceConfig:
    """CosPlace: a generalised mean with a learnt power, then a linear layer.

    Args:
        width: numbers in a token it takes.
        linear: numbers in a descriptor.
        power: where the mean's power starts.

    Raises:
        ModelError: a number is below 1.
    """

    width: int
    linear: int = 2048
    power: float = 3.0
    kind: Literal["cosplace"] = "cosplace"

    def __post_init__(self) -> None:
        check_whole(self, "width", "linear")

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.linear


@dataclass(frozen=True, slots=True)
class BoqConfig:
    """BoQ, a bag of queries: learnt queries look at the tokens, after each of a few encoder layers.

    Args:
        width: numbers in a token it takes.
        channels: numbers in a token inside.
        queries: learnt queries of a block.
        blocks: how many blocks.
        rows: numbers kept for a channel.
        heads: attention heads, which divide the channels.

    Raises:
        ModelError: a number is below 1, or the heads do not divide the channels.
    """

    width: int
    channels: int = 384
    queries: int = 64
    blocks: int = 2
    rows: int = 32
    heads: int = 6
    kind: Literal["boq"] = "boq"

    def __post_init__(self) -> None:
        check_whole(self, "width", "channels", "queries", "blocks", "rows", "heads")
        if self.channels % self.heads:
            raise ModelError(
                f"{self.heads} heads do not divide {self.channels} channels of the boq aggregator"
            )

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.channels * self.rows


def _pair(grid: object, kind: str) -> tuple[int, int]:
    sides = tuple(grid) if isinstance(grid, list | tuple) else ()
    if len(sides) != 2 or not all(type(side) is int and side > 0 for side in sides):
        raise ModelError(
            f"grid of the {kind} aggregator is {grid!r}: give its rows and columns, at least 1 each"
        )
    return sides


# --- Every aggregator there is: by kind, as JSON names them, and by name, as they are compared ---


AggregatorConfig = (
    SaladConfig
    | SceneConfig
    | GemConfig
    | AverageConfig
    | NetVladConfig
    | VladConfig
    | MixVprConfig
    | ConvApConfig
    | CosPlaceConfig
    | BoqConfig
    | RouteConfig
)

AGGREGATOR_KINDS: dict[str, Any] = {
    "salad": SaladConfig,
    "scene": SceneConfig,
    "gem": GemConfig,
    "average": AverageConfig,
    "netvlad": NetVladConfig,
    "vlad": VladConfig,
    "mixvpr": MixVprConfig,
    "conv-ap": ConvApConfig,
    "cosplace": CosPlaceConfig,
    "boq": BoqConfig,
    "salad-route": RouteConfig,
}

WIDE = (
    384  # numbers in a token from which on an aggregator has its paper's size; below, one near salad-lite's
)


def _salad(width: int, **change: Any) -> SaladConfig:
    paper = SaladConfig(width)
    fair = paper if width >= WIDE else dataclasses.replace(paper, cluster_dim=32, scene_dim=128, hidden=256)
    return dataclasses.replace(fair, **change)


def _netvlad_linear(width: int) -> NetVladConfig:
    return NetVladConfig(width, linear=8192 if width >= WIDE else 2048)


def _mixvpr(width: int) -> MixVprConfig:
    return MixVprConfig(width, grid=(23, 23)) if width >= WIDE else MixVprConfig(width, channels=512)


def _conv_ap(width: int) -> ConvApConfig:
    return ConvApConfig(width, channels=2048 if width >= WIDE else 512)


def _cosplace(width: int) -> CosPlaceConfig:
    return CosPlaceConfig(width, linear=2048 if width >= WIDE else 512)


def _boq(width: int) -> BoqConfig:
    return BoqConfig(width) if width >= WIDE else BoqConfig(width, channels=128, queries=32, rows=16, heads=2)


def _route(width: int) -> RouteConfig:
    return RouteConfig(width, salad=_salad(width), cell_dim=64 if width >= WIDE else 32)


AGGREGATORS: dict[str, Callable[[int], AggregatorConfig]] = {
    "salad": _salad,
    "salad-no-dustbin": partial(_salad, dustbin=False),
    "salad-no-scene": partial(_salad, scene_dim=0),
    "salad-softmax": partial(_salad, transport="softmax"),
    "salad-dual-softmax": partial(_salad, transport="dual-softmax"),
    "netvlad": NetVladConfig,
    "netvlad-linear": _netvlad_linear,
    "gem": partial(GemConfig, learned=True),
    "average": AverageConfig,
    "class-token": SceneConfig,
    "mixvpr": _mixvpr,
    "conv-ap": _conv_ap,
    "cosplace": _cosplace,
    "boq": _boq,
    "vlad": VladConfig,
    "salad-route": _route,
}
"""What is compared: from the width of a token to a configuration of a fair size."""

# Settings that came after the first models were published. At their default they are not written, so that a
# model's configuration, and with it its fingerprint, is what it was. Their defaults must never change.
LATER: dict[str, tuple[str, ...]] = {
    "salad": ("dustbin", "transport", "iterations", "dustbin_share"),
    "gem": ("learned",),
}


def for_grid(config: AggregatorConfig, grid: tuple[int, int]) -> AggregatorConfig:
    """The same aggregator for another grid of tokens, which few mind.

    Args:
        config: any aggregator's.
        grid: rows and columns of the tokens it will take: the photo's sides divided by the stride.
    """
    return dataclasses.replace(config, grid=grid) if isinstance(config, MixVprConfig) else config


def as_settings(config: AggregatorConfig) -> dict[str, Any]:
    """An aggregator's configuration as JSON holds it."""
    settings = dataclasses.asdict(config)
    defaults = {field.name: field.default for field in dataclasses.fields(config)}
    for name in LATER.get(config.kind, ()):
        if settings[name] == defaults[name]:
            del settings[name]
    if isinstance(config, RouteConfig) and config.salad.dustbin_share is None:
        del settings["salad"]["dustbin_share"]  # of the one inside, the first of them that came after it
    return settings


def from_settings(settings: dict[str, Any]) -> AggregatorConfig:
    """Read what `as_settings` wrote.

    Raises:
        ModelError: a setting makes no sense.
        ValueError: the kind is unknown.
        TypeError: a setting is missing or unknown.
    """
    config: AggregatorConfig
    kind = settings.get("kind")
    if kind not in AGGREGATOR_KINDS:
        raise ValueError(f"kind {kind!r} is unknown; known are {', '.join(AGGREGATOR_KINDS)}")
    if kind == "salad-route":
        settings = {**settings, "salad": SaladConfig(**settings["salad"])}
    config = AGGREGATOR_KINDS[kind](**settings)
    return config
