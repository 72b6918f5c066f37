"""Aggregators as data: what every configuration is, SALAD's own, and the one table of all aggregators.

Nothing here imports torch: a configuration names its module as a string, which is imported when one is built.
`baseline_config` has the aggregators that SALAD is compared with.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from importlib.metadata import entry_points
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypeVar, cast, get_args

from salad.errors import ModelError

Transport = Literal["sinkhorn", "softmax", "dual-softmax"]
WIDE = 384
"""Numbers in a token from which on an aggregator is compared at its paper's size; below, near salad-lite's."""


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
        # Left out at its default: else every model that was saved before would have another fingerprint today.
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

    def check_whole(self, *names: str, least: int = 1, most: int | None = None) -> None:
        """Make sure that settings are whole numbers, none below `least`, none above `most` where that is given.

        Raises:
            ModelError: If one is not; the sentence names it.
        """
        for name in names:
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:  # True would count as 1
                raise ModelError(
                    f"{name} of the {self.kind} aggregator is {value!r}: give a whole number, at least {least}"
                )
            if most is not None and value > most:
                raise ModelError(f"{name} of the {self.kind} aggregator is {value!r}: give {most} at most")


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
        self.check_whole("iterations", most=1000)
        if not isinstance(self.dustbin, bool):
            raise ModelError(f"dustbin of the salad aggregator is {self.dustbin!r}: give true or false")
        if self.transport not in get_args(Transport):
            raise ModelError(f"transport {self.transport!r} is unknown: give one of {', '.join(get_args(Transport))}")
        wanted = self.dustbin_share
        if wanted is not None and (not isinstance(wanted, int | float) or not 0 < wanted < 1):
            raise ModelError(f"dustbin_share of the salad aggregator is {wanted!r}: give a share between 0 and 1")
        if wanted is not None and (not self.dustbin or self.transport != "sinkhorn"):
            raise ModelError("dustbin_share needs a dustbin and the transport sinkhorn: nothing else holds to it")

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        # A final layer, as MegaLoc's, decides alone, whatever was pooled before it.
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
        # Narrow tokens get a head in proportion, or it alone would be larger than the backbone beneath it.
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
    module: ClassVar[str] = "salad.network.aggregators.salad_layout:Route"
    paper: ClassVar[str] = "ours"

    def __post_init__(self) -> None:
        self.check_whole("grid", "cell_dim")
        if not isinstance(self.weight, int | float) or not math.isfinite(self.weight) or self.weight < 0:
            raise ModelError(f"weight of the layout is {self.weight!r}: give a finite number, not below 0")
        if not isinstance(self.salad, SaladConfig) or self.salad.width != self.width:
            raise ModelError(f"salad of the salad-route aggregator must be one for tokens of {self.width} numbers")

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


AGGREGATOR_KINDS: dict[str, type[AggregatorConfig] | str] = {
    "salad": SaladConfig,
    "netvlad": "salad.network.baseline_config:NetVladConfig",
    "gem": "salad.network.baseline_config:GemConfig",
    "average": "salad.network.baseline_config:AverageConfig",
    "scene": "salad.network.baseline_config:SceneConfig",
    "mixvpr": "salad.network.baseline_config:MixVprConfig",
    "conv-ap": "salad.network.baseline_config:ConvApConfig",
    "cosplace": "salad.network.baseline_config:CosPlaceConfig",
    "boq": "salad.network.baseline_config:BoqConfig",
    "vlad": "salad.network.baseline_config:VladConfig",
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
    # The default stands in the class's fields: with slots, the attribute of the class is the slot and not the value.
    kind = next(str(field.default) for field in dataclasses.fields(config) if field.name == "kind")
    if AGGREGATOR_KINDS.setdefault(kind, config) is not config:
        raise ModelError(f"there is an aggregator of kind {kind!r} already: give {config.__name__} another kind")
    return config


def aggregator_kind(kind: object) -> type[AggregatorConfig]:
    """The configuration of a kind of aggregator.

    Raises:
        ValueError: If the kind is unknown.
        ModelError: If it is known, but the package that has it cannot be imported.
    """
    # Packages are asked only for what is not ours: their list takes longer to read than a model's configuration.
    known = AGGREGATOR_KINDS if kind in AGGREGATOR_KINDS else _known()
    if kind not in known:
        raise ValueError(f"kind {kind!r} is unknown; known are {', '.join(known)}")
    config = known[str(kind)]
    try:
        return cast(type[AggregatorConfig], resolve_name(config)) if isinstance(config, str) else config
    except (ImportError, AttributeError, ValueError) as error:
        raise ModelError(f"the aggregator {kind!r} is {config}, which cannot be imported: {error}") from error


def compared_aggregators(width: int) -> dict[str, AggregatorConfig]:
    """Every aggregator that is compared, by name, at a fair size for tokens of `width` numbers."""
    return {name: one for kind in _known() for name, one in aggregator_kind(kind).compared(width).items()}


def _known() -> dict[str, type[AggregatorConfig] | str]:
    """The table, and what installed packages add to it."""
    # The table comes last: no package may put something else in the place of one of ours.
    installed = {point.name: point.value for point in entry_points(group="salad.aggregators")}
    return {**installed, **AGGREGATOR_KINDS}
