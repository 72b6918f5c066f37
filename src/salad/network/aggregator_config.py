"""Aggregators as data: what each is made of, which torch module it becomes, and the one table of them.

Nothing here imports torch: a configuration names its module as a string, which is imported when one is built.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from importlib.metadata import entry_points
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypeVar, get_args

from salad.errors import ModelError

Transport = Literal["sinkhorn", "softmax", "dual-softmax"]
WIDE = 384
"""Numbers in a token from which on an aggregator is compared at its paper's size; below, near salad-lite's."""
ENTRY_POINTS = "salad.aggregators"
"""Where installed packages name aggregators of their own: kind = "package.module:Config"."""


@dataclass(frozen=True, slots=True)
class AggregatorConfig:
    """What the configuration of every aggregator is: a frozen dataclass whose fields stand in `config.json`.

    The first field is `width`, the numbers in a token it takes, and the last one `kind`, its name in the table. What
    only few aggregators need has a default here, so that one more is one file and one line in `AGGREGATOR_KINDS`;
    docs/extending.md shows a whole one.

    Attributes:
        module: The torch module it becomes, "package.module:Class"; that takes the configuration alone.
        paper: Whose it is.
        later: Fields that came after the first models were published. At their default they are not written, so that a
            model's configuration, and with it its fingerprint, is what it was. Their defaults must never change.

    Raises:
        ModelError: If a setting makes no sense; the sentence names it and says what to give.
    """

    module: ClassVar[str]
    paper: ClassVar[str] = ""
    later: ClassVar[tuple[str, ...]] = ()

    if TYPE_CHECKING:  # at run time a property here would be taken for the default of the field of that name

        @property
        def width(self) -> int:
            """Numbers in a token it takes."""
            ...

        @property
        def kind(self) -> str:
            """Its name in the table."""
            ...

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.width

    @property
    def has_plan(self) -> bool:
        """Whether it shares tokens out by a plan whose columns sum to 1: its module has a method `plan` then."""
        return False

    @property
    def no_dustbin(self) -> str:
        """Why nothing can be said of what a dustbin took of a token; empty where it can."""
        return "its aggregator is not SALAD"

    def for_grid(self, grid: tuple[int, int]) -> Self:  # noqa: ARG002  # for those that mind
        """The same aggregator for another grid of tokens, rows and columns: the photo's sides divided by the stride."""
        return self

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """What of it is compared with other aggregators, by name, at a fair size for tokens of `width` numbers."""
        config = cls(width)  # type: ignore[call-arg]  # each that inherits has the field
        return {config.kind: config}

    def as_settings(self) -> dict[str, Any]:
        """This configuration as JSON holds it."""
        settings = dataclasses.asdict(self)
        for field in dataclasses.fields(self):
            if field.name in self.later and settings[field.name] == field.default:
                del settings[field.name]
        return settings

    @classmethod
    def from_settings(cls, settings: dict[str, Any]) -> Self:
        """Read what `as_settings` wrote.

        Raises:
            ModelError: If a setting makes no sense.
            TypeError: If a setting is missing or unknown.
        """
        return cls(**settings)

    def check_whole(self, *names: str, least: int = 1) -> None:
        """Make sure that settings are whole numbers, none below `least`.

        Raises:
            ModelError: If one is not; the sentence names it.
        """
        for name in names:
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise ModelError(
                    f"{name} of the {self.kind} aggregator is {value!r}: give a whole number, at least {least}"
                )


@dataclass(frozen=True, slots=True)
class SaladConfig(AggregatorConfig):
    """The SALAD aggregator; letters are those of docs/method.md.

    Args:
        width: Numbers in a token it takes (d).
        clusters: Clusters that tokens are shared among (m), the dustbin not counted.
        cluster_dim: Numbers kept for a cluster (l).
        scene_dim: Numbers kept of the cls token (g); 0 leaves it out.
        hidden: Hidden width of its three perceptrons.
        dropout: Fraction of hidden numbers dropped in the score and feature perceptrons while training.
        linear: Width of a final linear layer, as MegaLoc has one; None for none.
        dustbin: Whether tokens may go to no cluster.
        transport: How tokens are assigned: by Sinkhorn's iteration, each by a softmax over the clusters, or by the
            product of that with a softmax over the tokens.
        iterations: Sinkhorn's rounds; the 3 belongs to published models.
        dustbin_share: What the dustbin wants of all tokens, however many there are; None for the paper's n - m of n,
            of which a larger photo loses more.
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
    module: ClassVar[str] = "salad.network.aggregators.salad:Salad"
    paper: ClassVar[str] = "Izquierdo and Civera 2024"
    later: ClassVar[tuple[str, ...]] = ("dustbin", "transport", "iterations", "dustbin_share")

    def __post_init__(self) -> None:
        self.check_whole("scene_dim", least=0)
        self.check_whole("iterations")
        if not isinstance(self.dustbin, bool):
            raise ModelError(f"dustbin of the salad aggregator is {self.dustbin!r}: give true or false")
        if self.transport not in get_args(Transport):
            raise ModelError(
                f"transport {self.transport!r} is unknown: give one of {', '.join(get_args(Transport))}"
            )
        wanted = self.dustbin_share
        if wanted is None:
            return
        if isinstance(wanted, bool) or not isinstance(wanted, int | float) or not 0 < wanted < 1:
            raise ModelError(
                f"dustbin_share of the salad aggregator is {wanted!r}: give a share between 0 and 1"
            )
        if not self.dustbin or self.transport != "sinkhorn":
            raise ModelError(
                "dustbin_share needs a dustbin and the transport sinkhorn: nothing else holds to it"
            )

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.linear or self.scene_dim + self.clusters * self.cluster_dim

    @property
    def has_plan(self) -> bool:
        """Not with a dual softmax, whose columns sum to less than 1."""
        return self.transport != "dual-softmax"

    @property
    def no_dustbin(self) -> str:
        """Why nothing can be said of what the dustbin took."""
        if not self.dustbin:
            return "it was made without one"
        return "" if self.has_plan else "its dual softmax takes no share of a token"

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """SALAD, and what its paper's ablation takes away or puts in a place."""
        whole = cls(width) if width >= WIDE else cls(width, cluster_dim=32, scene_dim=128, hidden=256)
        return {
            "salad": whole,
            "salad-no-dustbin": dataclasses.replace(whole, dustbin=False),
            "salad-no-scene": dataclasses.replace(whole, scene_dim=0),
            "salad-softmax": dataclasses.replace(whole, transport="softmax"),
            "salad-dual-softmax": dataclasses.replace(whole, transport="dual-softmax"),
        }


PRESETS: dict[str, SaladConfig] = {
    "full": SaladConfig(width=768),
    "medium": SaladConfig(width=768, clusters=32, cluster_dim=64, scene_dim=64),
    "small": SaladConfig(width=768, clusters=16, cluster_dim=32, scene_dim=32),
}
"""The paper's three aggregators: 8448, 2112 and 544 numbers."""


@dataclass(frozen=True, slots=True)
class RouteConfig(AggregatorConfig):
    """SALAD's descriptor beside a coarse layout of the photo: for fixed viewpoints (routes, webcams, trains).

    Where the viewpoint changes, the layout is worse than none: never a default.

    Args:
        width: Numbers in a token it takes.
        salad: The SALAD aggregator it builds on, of the same width.
        grid: The layout has grid x grid cells.
        cell_dim: Numbers kept for a cell.
        weight: Of the layout beside the SALAD descriptor, both of length 1.
    """

    width: int
    salad: SaladConfig
    grid: int = 4
    cell_dim: int = 32
    weight: float = 1.0
    kind: Literal["salad-route"] = "salad-route"
    module: ClassVar[str] = "salad.network.aggregators.route:Route"
    paper: ClassVar[str] = "ours"

    def __post_init__(self) -> None:
        self.check_whole("grid", "cell_dim")
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

    @property
    def has_plan(self) -> bool:
        """As the SALAD inside."""
        return self.salad.has_plan

    @property
    def no_dustbin(self) -> str:
        """As the SALAD inside."""
        return self.salad.no_dustbin

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """SALAD as it is compared, beside a layout."""
        salad = SaladConfig.compared(width)["salad"]
        return {"salad-route": cls(width, salad, cell_dim=64 if width >= WIDE else 32)}

    def as_settings(self) -> dict[str, Any]:
        """This configuration as JSON holds it."""
        settings = dataclasses.asdict(self)
        # Routes were first written when SALAD had the other later fields already: of those inside, this one alone
        # came after.
        if self.salad.dustbin_share is None:
            del settings["salad"]["dustbin_share"]
        return settings

    @classmethod
    def from_settings(cls, settings: dict[str, Any]) -> Self:
        """Read what `as_settings` wrote."""
        return cls(**{**settings, "salad": SaladConfig(**settings["salad"])})


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
        return {
            "netvlad": cls(width),
            "netvlad-linear": cls(width, linear=8192 if width >= WIDE else 2048),
        }


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
            raise ModelError(
                f"{self.heads} heads do not divide {self.channels} channels of the boq aggregator"
            )

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.channels * self.rows

    @classmethod
    def compared(cls, width: int) -> dict[str, Self]:
        """As its paper has it, or a third as wide."""
        return {
            "boq": cls(width) if width >= WIDE else cls(width, channels=128, queries=32, rows=16, heads=2)
        }


def _pair(grid: object, kind: str) -> tuple[int, int]:
    sides = tuple(grid) if isinstance(grid, list | tuple) else ()
    if len(sides) != 2 or not all(type(side) is int and side > 0 for side in sides):
        raise ModelError(
            f"grid of the {kind} aggregator is {grid!r}: give its rows and columns, at least 1 each"
        )
    return sides


AGGREGATOR_KINDS: dict[str, type[AggregatorConfig] | str] = {
    "salad": SaladConfig,
    "netvlad": NetVladConfig,
    "gem": GemConfig,
    "average": AverageConfig,
    "scene": SceneConfig,
    "mixvpr": MixVprConfig,
    "conv-ap": ConvApConfig,
    "cosplace": CosPlaceConfig,
    "boq": BoqConfig,
    "vlad": VladConfig,
    "salad-route": RouteConfig,
}
"""Every aggregator by its kind: a configuration, or where one is ("package.module:Config"), imported when asked for."""

Config = TypeVar("Config", bound=AggregatorConfig)


def register_aggregator(config: type[Config]) -> type[Config]:
    """Make one more aggregator known to this process, under the `kind` its configuration has by default.

    An installed package does without: it names its aggregators in the entry points `salad.aggregators`.

    Raises:
        ModelError: If another aggregator has that kind.
    """
    kind = next(str(field.default) for field in dataclasses.fields(config) if field.name == "kind")
    if AGGREGATOR_KINDS.setdefault(kind, config) is not config:
        raise ModelError(
            f"there is an aggregator of kind {kind!r} already: give {config.__name__} another kind"
        )
    return config


def aggregator_kind(kind: object) -> type[AggregatorConfig]:
    """The configuration of a kind of aggregator.

    Raises:
        ValueError: If the kind is unknown.
        ModelError: If it is known, but the package that has it cannot be imported.
    """
    known = _known()
    if kind not in known:
        raise ValueError(f"kind {kind!r} is unknown; known are {', '.join(known)}")
    config = known[str(kind)]
    if not isinstance(config, str):
        return config
    try:
        made: type[AggregatorConfig] = resolve_name(config)
    except (ImportError, AttributeError, ValueError) as error:
        raise ModelError(f"the aggregator {kind!r} is {config}, which cannot be imported: {error}") from error
    return made


def compared_aggregators(width: int) -> dict[str, AggregatorConfig]:
    """Every aggregator that is compared, by name, at a fair size for tokens of `width` numbers."""
    return {name: one for kind in _known() for name, one in aggregator_kind(kind).compared(width).items()}


def _known() -> dict[str, type[AggregatorConfig] | str]:
    """The table, and what installed packages add to it; their entry points are read anew, which takes milliseconds."""
    installed = {point.name: point.value for point in entry_points(group=ENTRY_POINTS)}
    return {**installed, **AGGREGATOR_KINDS}
