"""Arguments that several commands share: their types, their words in the help, and what they open."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from tyro.conf import Positional, arg

from salad.cli import terminal
from salad.errors import BenchmarkError, ModelError, SaladError, StoreError

if TYPE_CHECKING:
    from salad.datasets.benchmark import Benchmark
    from salad.images.photo_table import PhotoTable
    from salad.index.index import Index
    from salad.models.describer import DescriberLike

T = TypeVar("T")


_MOST = 1_000_000_000  # photos, steps, pixels: nobody means more, and some libraries take no more
_MOST_THREADS = 1000
_MOST_SEED = 2**63 - 1  # what every generator takes
SHIPPED = "salad-lite"  # the model in the package, which needs no download

Photos = Annotated[
    Positional[tuple[str, ...]],
    arg(
        metavar="PHOTOS",
        help="Files, folders (walked), or - for a list on stdin.",
        help_behavior_hint="(one or more)",
    ),
]
IndexFolder = Annotated[Positional[Path], arg(metavar="INDEX", help="The index: a folder.")]
# What each of these means where it is not given is said in words, not as "(default: None)".
ModelName = Annotated[str | None, arg(metavar="NAME|DIR|FILE", help_behavior_hint="")]
Table = Annotated[Path | None, arg(metavar="CSV", help_behavior_hint="")]
Folder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
Number = Annotated[int | None, arg(metavar="N", help_behavior_hint="")]
Metres = Annotated[float | None, arg(metavar="METRES", help_behavior_hint="")]
Degrees = Annotated[float | None, arg(metavar="DEGREES", help_behavior_hint="")]
Share = Annotated[float | None, arg(metavar="SHARE", help_behavior_hint="")]
File = Annotated[str | None, arg(metavar="FILE", help_behavior_hint="")]
Format = Annotated[Literal["table", "json"], arg(help="For people or for programs.")]
Engine = Annotated[
    Literal["auto", "onnx", "openvino", "torch"],
    arg(help="What runs the model; auto takes what is fastest and computes the same."),
]
Threads = Annotated[
    int | None,
    arg(
        metavar="N",
        help="Photos read, and photos described, at a time; as many as there are processors where not given.",
        help_behavior_hint="",
    ),
]


def positive(number: int, what: str) -> int:
    """The number, if it is one or more.

    Raises:
        SaladError: If it is 0 or less.
    """
    if number < 1:
        raise SaladError(f"{what} {number} is too few: give 1 or more")
    return number


def check_threads(threads: int | None) -> None:
    """Refuse a number of threads below one, or that no machine has processors for.

    Raises:
        SaladError: If it is 0 or less, or too large.
    """
    if threads is not None and positive(threads, "--threads") > _MOST_THREADS:
        raise SaladError(f"--threads {threads} is too many: give at most {_MOST_THREADS:,}")


def check_numbers(command: object) -> None:
    """Refuse numbers that nothing can be reckoned with, whichever option of a command they stand in.

    Raises:
        SaladError: If one is not finite, is too large to be meant, or is a seed below 0.
    """
    for each in fields(command):  # type: ignore[arg-type]  # every command is a dataclass, made as the parser ran
        value, option = getattr(command, each.name), f"--{each.name.strip('_').replace('_', '-')}"
        if is_dataclass(value):
            check_numbers(value)
        elif isinstance(value, float) and not math.isfinite(value):
            raise SaladError(f"{option} {value} is no number to reckon with: give a finite one")
        elif isinstance(value, int) and each.name.endswith("seed"):
            if not 0 <= value <= _MOST_SEED:
                raise SaladError(f"{option} {value} is no seed: give one from 0 to {_MOST_SEED}")
        elif isinstance(value, int) and abs(value) > _MOST:
            raise SaladError(f"{option} {value} is too {'large' if value > 0 else 'small'}: give at most {_MOST:,}")


# What follows imports as it runs: `salad --help` reads the types above, and is to be there at once.


def settle_engine(model: DescriberLike, photos: int) -> None:
    """Let a model run by the engine that is fastest here, if so many photos are worth finding out; and say which."""
    from salad.cli import terminal
    from salad.models.engine_choice import LONG, settle

    if photos < LONG:  # not worth a word either
        return
    choice = settle(model, photos=photos)
    if choice is not None:
        terminal.say(f"{model.name} runs by {choice.name}: {choice.why}")


def is_index(folder: Path) -> bool:
    """Whether there is an index in a folder."""
    from salad.index.header import HEADER_FILE

    # Asked before opening, which would complain of a folder that is yet to be made.
    return (folder / HEADER_FILE).exists()


def unless_there(folder: Path, make: Callable[[], T]) -> T | None:
    """What `make` gives that makes an index in a folder; None where one is there, or has come there meanwhile."""
    if is_index(folder):
        return None
    try:
        return make()
    except StoreError:
        if not is_index(folder):  # else another program has made one since we looked, and ours go into that
            raise
        return None


def open_or_create(folder: Path, model: DescriberLike) -> Index:
    """The index in a folder, made for the model where there is none yet."""
    from salad.index.index import Index

    made = unless_there(
        folder,
        lambda: Index.create(folder, dim=model.dim, fingerprint=model.fingerprint, model=model.name),
    )
    return Index.open(folder) if made is None else made  # an empty one is false


def model_name_for(folder: Path) -> str:
    """The name in the zoo of an index's model; where there is no index yet, of the model that ships.

    Raises:
        ModelError: If the index was made with a model that is not in the zoo: nobody knows where its weights are.
    """
    from salad.index.index import Index
    from salad.models.hub import ZOO

    if not is_index(folder):
        return SHIPPED
    with Index.open(folder) as index:
        # An index knows its model by name and fingerprint, not where somebody's own weights lie.
        if index.model in ZOO:
            return index.model
        raise ModelError(
            f"{folder} was made with {index.model!r}, which is not in the zoo: say where that model is with --model"
        )


def benchmark_of(
    references: Path,
    queries: Path,
    *,
    truth: Path | None,
    frames: int | None,
    radius: float | None,
    heading: float | None = None,
    table: Path | None = None,
) -> Benchmark:
    """Two folders, and exactly one rule for what is right.

    Args:
        references: Photos whose places are known.
        queries: Photos to recognise.
        truth: A table of what is right.
        frames: Right within so many frames.
        radius: Right within so many metres.
        heading: With `radius`, right only where both look the same way within so many degrees.
        table: With `radius`, where photos were taken that do not say so themselves.

    Raises:
        BenchmarkError: If there is no rule or more than one, or the set cannot be read.
        PositionError: If the table cannot be read, or names a photo that is not there.
        PhotoError: If a folder is missing or holds no photo.
    """
    from salad.datasets import benchmark

    # Two rules would be two protocols in one figure, and none is no protocol at all.
    rules = [rule for rule in (truth, frames, radius) if rule is not None]
    if len(rules) != 1:
        raise BenchmarkError(f"{len(rules)} rules say what is right, but it takes one: --truth, --frames or --radius")
    if radius is None and (heading is not None or table is not None):
        option = "--table" if heading is None else "--heading"
        raise BenchmarkError(f"{option} says more about a radius, and there is none: give --radius, or leave it away")
    if truth is not None:
        return benchmark.from_truth(references, queries, truth)
    if frames is not None:
        return benchmark.from_frames(references, queries, frames)
    assert radius is not None  # the one rule of the three that is left
    positions = read_positions(table)
    made = benchmark.from_radius(references, queries, radius, table=positions, heading=heading)
    check_positions(positions, made)
    return made


def read_positions(table: Path | None, photos: Sequence[Path] | None = None) -> PhotoTable | None:
    """The table of positions, where one is named; what of it does not fit `photos`, where these are given, is said."""
    from salad.images.photo_table import PhotoTable

    positions = None if table is None else PhotoTable.read(table)
    if positions is not None and photos is not None:
        positions, told = positions.fitted(photos)
        for sentence in told:
            terminal.say(sentence)
    return positions


def check_positions(positions: PhotoTable | None, benchmark: Benchmark) -> None:
    """Make sure that every row of a table names a photo of the set, so that a misspelt one is noticed."""
    if positions is not None:
        positions.check_used(photo.path for side in (benchmark.references, benchmark.queries) for photo in side)
