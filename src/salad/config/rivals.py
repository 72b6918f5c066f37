"""The aggregators that SALAD is compared with, as data; model/aggregators/ tells how each works, and whose it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from salad.config.aggregators import check_whole
from salad.errors import ModelError


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
