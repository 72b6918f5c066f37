"""How commands open an index, and which model they load for it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from salad.cli.arguments import SHIPPED
from salad.errors import ModelError

if TYPE_CHECKING:
    from salad.index import Index
    from salad.model.describer import Describes


def model_of(folder: Path) -> str:
    """The name in the zoo of an index's model; where there is no index yet, of the model that ships."""
    from salad.index import Index as Opened
    from salad.model.zoo import ZOO

    if not is_index(folder):
        return SHIPPED
    with Opened.open(folder) as index:
        if index.model in ZOO:
            return index.model
        raise ModelError(
            f"{folder} was made with {index.model!r}, which is not in the zoo: say where that model is with --model"
        )


def opened(folder: Path, model: Describes) -> Index:
    """The index in a folder, made for the model where there is none yet."""
    from salad.index import Index as Opened

    if is_index(folder):
        return Opened.open(folder)
    return Opened.create(folder, dim=model.dim, fingerprint=model.fingerprint, model=model.name)


def is_index(folder: Path) -> bool:
    """Whether there is an index in a folder."""
    from salad.index.header import NAME

    return (folder / NAME).exists()
