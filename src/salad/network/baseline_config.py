"""The aggregators that SALAD is compared with, as data; the module each becomes tells how it works, and whose it is."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, Literal, Self

from salad.errors import ModelError
from salad.network.aggregator_config import WIDE, AggregatorConfig


@dataclass(frozen=True, slots=True)
class SceneConfig(AggregatorConfig):
    """The cls token alone, L2-normalised: what a bare backbone says of a photo."""

    width: int
    kind: Literal["scene"] = "scene"
    module: ClassVar[str] = "salad.network.aggregators.pooling:Scene"
    paper: ClassVar[str] = "Oquab et al. 2023 (DINOv2)"

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """Under the name the field has for it."""
        return {"class-token": cls(width)}


@dataclass(frozen=True, slots=True)
class AverageConfig(AggregatorConfig):
    """The mean of the patches, L2-normalised, without weights."""

    width: int
    kind: Literal["average"] = "average"
    module: ClassVar[str] = "salad.network.aggregators.pooling:Average"


@dataclass(frozen=True, slots=True)
class GemConfig(AggregatorConfig):
    """Generalised mean of the tokens: the plain baseline, without weights or with its power learnt.

    Args:
        width: Numbers in a token it takes.
        power: The mean's; where it is learnt, its start.
        learned: Whether the power is a weight.
    """

    width: int
    power: float = 3.0
    learned: bool = False
    kind: Literal["gem"] = "gem"
    module: ClassVar[str] = "salad.network.aggregators.pooling:Gem"
    paper: ClassVar[str] = "Radenović et al. 2018"
    later: ClassVar[tuple[str, ...]] = ("learned",)

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """With its power learnt, as its paper has it."""
        return {"gem": cls(width, learned=True)}


@dataclass(frozen=True, slots=True)
class NetVladConfig(AggregatorConfig):
    """NetVLAD: residuals to centroids, softly assigned.

    Args:
        width: Numbers in a token it takes.
        clusters: How many centroids.
        linear: Width of a final linear layer; None for none.
    """

    width: int
    clusters: int = 32
    linear: int | None = None
    kind: Literal["netvlad"] = "netvlad"
    module: ClassVar[str] = "salad.network.aggregators.netvlad:NetVlad"
    paper: ClassVar[str] = "Arandjelović et al. 2016"

    def __post_init__(self) -> None:
        self.check_whole("width", "clusters", *(["linear"] if self.linear is not None else []))

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.linear or self.clusters * self.width

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """As it is, and with a linear layer that brings it to SALAD's length."""
        return {"netvlad": cls(width), "netvlad-linear": cls(width, linear=8192 if width >= WIDE else 2048)}


@dataclass(frozen=True, slots=True)
class VladConfig(AggregatorConfig):
    """VLAD without training, as AnyLoc uses it: residuals to a vocabulary, each token assigned to one word.

    Args:
        width: Numbers in a token it takes.
        clusters: Words of the vocabulary.
    """

    width: int
    clusters: int = 32
    kind: Literal["vlad"] = "vlad"
    module: ClassVar[str] = "salad.network.aggregators.vlad:Vlad"
    paper: ClassVar[str] = "Keetha et al. 2023 (AnyLoc)"

    def __post_init__(self) -> None:
        self.check_whole("width", "clusters")

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.clusters * self.width


@dataclass(frozen=True, slots=True)
class MixVprConfig(AggregatorConfig):
    """MixVPR: perceptrons across the cells of the grid, one channel at a time.

    Args:
        width: Numbers in a token it takes.
        grid: Rows and columns of tokens; its weights fit no other grid.
        depth: How many mixers.
        ratio: Their hidden width, as a multiple of the cells.
        channels: Channels kept.
        rows: Numbers kept for a channel.
    """

    width: int
    grid: tuple[int, int] = (20, 20)
    depth: int = 4
    ratio: int = 1
    channels: int = 1024
    rows: int = 4
    kind: Literal["mixvpr"] = "mixvpr"
    module: ClassVar[str] = "salad.network.aggregators.mixvpr:MixVpr"
    paper: ClassVar[str] = "Ali-bey et al. 2023"

    def __post_init__(self) -> None:
        self.check_whole("width", "depth", "ratio", "channels", "rows")
        object.__setattr__(self, "grid", _pair(self.grid, self.kind))  # JSON knows lists alone

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.channels * self.rows

    def for_grid(self, grid: tuple[int, int]) -> Self:
        """Mixers for these cells."""
        return dataclasses.replace(self, grid=grid)

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """For DINOv2's 322 pixels where tokens are wide."""
        return {"mixvpr": cls(width, grid=(23, 23)) if width >= WIDE else cls(width, channels=512)}


@dataclass(frozen=True, slots=True)
class ConvApConfig(AggregatorConfig):
    """Conv-AP: channels mixed token by token, then averaged over the cells of a coarse grid.

    Args:
        width: Numbers in a token it takes.
        channels: Channels kept.
        grid: Rows and columns of the averages.
    """

    width: int
    channels: int = 2048
    grid: tuple[int, int] = (2, 2)
    kind: Literal["conv-ap"] = "conv-ap"
    module: ClassVar[str] = "salad.network.aggregators.convap:ConvAp"
    paper: ClassVar[str] = "Ali-bey et al. 2022"

    def __post_init__(self) -> None:
        self.check_whole("width", "channels")
        object.__setattr__(self, "grid", _pair(self.grid, self.kind))

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.channels * self.grid[0] * self.grid[1]

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """Of 8,192 or 2,048 numbers."""
        return {"conv-ap": cls(width, channels=2048 if width >= WIDE else 512)}


@dataclass(frozen=True, slots=True)
class CosPlaceConfig(AggregatorConfig):
    """CosPlace: a generalised mean with a learnt power, then a linear layer.

    Args:
        width: Numbers in a token it takes.
        linear: Numbers in a descriptor.
        power: Where the mean's power starts.
    """

    width: int
    linear: int = 2048
    power: float = 3.0
    kind: Literal["cosplace"] = "cosplace"
    module: ClassVar[str] = "salad.network.aggregators.cosplace:CosPlace"
    paper: ClassVar[str] = "Berton et al. 2022"

    def __post_init__(self) -> None:
        self.check_whole("width", "linear")

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.linear

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """Of 2,048 or 512 numbers."""
        return {"cosplace": cls(width, linear=2048 if width >= WIDE else 512)}


@dataclass(frozen=True, slots=True)
class BoqConfig(AggregatorConfig):
    """BoQ, a bag of queries: learnt queries look at the tokens, after each of a few encoder layers.

    Args:
        width: Numbers in a token it takes.
        channels: Numbers in a token inside.
        queries: Learnt queries of a block.
        blocks: How many blocks.
        rows: Numbers kept for a channel.
        heads: Attention heads, which divide the channels.
    """

    width: int
    channels: int = 384
    queries: int = 64
    blocks: int = 2
    rows: int = 32
    heads: int = 6
    kind: Literal["boq"] = "boq"
    module: ClassVar[str] = "salad.network.aggregators.boq:Boq"
    paper: ClassVar[str] = "Ali-bey et al. 2024"

    def __post_init__(self) -> None:
        self.check_whole("width", "channels", "queries", "blocks", "rows", "heads")
        if self.channels % self.heads:
            raise ModelError(f"{self.heads} heads do not divide {self.channels} channels of the boq aggregator")

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.channels * self.rows

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """As its paper has it, or a third as wide."""
        paper = cls(width)
        narrow = cls(width, channels=128, queries=32, rows=16, heads=2)
        return {"boq": paper if width >= WIDE else narrow}


def _pair(grid: object, kind: str) -> tuple[int, int]:
    # A text is a sequence too, of which each letter would be a side.
    sides = tuple(grid) if isinstance(grid, list | tuple) else ()
    if len(sides) != 2 or not all(type(side) is int and side > 0 for side in sides):
        raise ModelError(f"grid of the {kind} aggregator is {grid!r}: give its rows and columns, at least 1 each")
    return sides
