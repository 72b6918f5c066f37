"""Arguments that several commands share: their types, and their words in the help."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from salad.errors import ModelError, SaladError

if TYPE_CHECKING:
    from salad.index.index import Index
    from salad.models.describer import DescriberLike


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
Number = Annotated[int | None, arg(metavar="N", help_behavior_hint="")]
Metres = Annotated[float | None, arg(metavar="METRES", help_behavior_hint="")]
Share = Annotated[float | None, arg(metavar="SHARE", help_behavior_hint="")]
File = Annotated[str | None, arg(metavar="FILE", help_behavior_hint="")]
Format = Annotated[Literal["table", "json"], arg(help="For people or for programs.")]


def positive(number: int, what: str) -> int:
    """The number, which must be one.

    Raises:
        SaladError: It is 0 or less.
    """
    if number < 1:
        raise SaladError(f"{what} {number} is too few: give 1 or more")
    return number


# --- How commands open an index, and which model they load for it ---


def model_name_for(folder: Path) -> str:
    """The name in the zoo of an index's model; where there is no index yet, of the model that ships."""
    from salad.index.index import Index
    from salad.models.hub import ZOO

    if not is_index(folder):
        return SHIPPED
    with Index.open(folder) as index:
        if index.model in ZOO:
            return index.model
        raise ModelError(
            f"{folder} was made with {index.model!r}, which is not in the zoo: say where that model is with --model"
        )


def open_or_create(folder: Path, model: DescriberLike) -> Index:
    """The index in a folder, made for the model where there is none yet."""
    from salad.index.index import Index

    if is_index(folder):
        return Index.open(folder)
    return Index.create(folder, dim=model.dim, fingerprint=model.fingerprint, model=model.name)


def is_index(folder: Path) -> bool:
    """Whether there is an index in a folder."""
    from salad.index.index_folder import HEADER_FILE

    return (folder / HEADER_FILE).exists()
