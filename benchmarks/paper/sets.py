"""Finding the paper's data sets below one folder, whatever layouts they came in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from salad.datasets.benchmark import Benchmark
from salad.datasets.protocols import LAYOUTS, layouts_in, protocol_called, read
from salad.datasets.readers.base import Protocol
from salad.errors import BenchmarkError

CALLED = {  # what people call the folders, beside the stems of their files
    "msls-val-740": ("msls", "mapillary"),
    "pitts250k-test": ("pittsburgh",),
}
ANYBODYS = (
    "drives",
    "@ names",
)  # layouts that do not tell one set from another: there the folder's name has to


def find_set(name: str, data: Path | None, *, any_size: bool = False) -> Benchmark:
    """The set of a protocol, in a folder or in one right below it.

    Args:
        name: The protocol's.
        data: The folder of all sets.
        any_size: Take a set of other counts too; its protocol then says how many there are.

    Raises:
        BenchmarkError: If it is not there, with what was looked for; or is another set, with what differs.
    """
    asked = protocol_called(name)
    refused: BenchmarkError | None = None
    for folder in () if data is None else _candidates(asked, data):
        try:
            return read(name, folder, any_size=any_size)
        except BenchmarkError as error:
            refused = refused or error
    raise refused or BenchmarkError(_absent(asked, data))


def _candidates(asked: Protocol, data: Path) -> Sequence[Path]:
    """Folders that may hold the set, those that are called after it first."""
    try:
        below = sorted(folder for folder in data.iterdir() if folder.is_dir())
    except OSError as error:
        raise BenchmarkError(
            f"the folder {data} cannot be read ({error.strerror}): name the one that holds the data sets"
        ) from error
    folders = [*sorted(below, key=lambda folder: not _is_called(asked, folder)), data]
    return [folder for folder in folders if _may_hold(asked, folder)]


def _may_hold(asked: Protocol, folder: Path) -> bool:
    found = [layout.name for layout, _ in layouts_in(folder, asked)]
    return any(name not in ANYBODYS for name in found) or (bool(found) and _is_called(asked, folder))


def _is_called(asked: Protocol, folder: Path) -> bool:
    name = folder.resolve().name.lower().replace("-", "_")
    return any(word in name for word in _words(asked))


def _words(asked: Protocol) -> tuple[str, ...]:
    return (*CALLED.get(asked.name, ()), *asked.stems)


def _absent(asked: Protocol, data: Path | None) -> str:
    looked = ", or ".join(text for name in asked.layouts for text in LAYOUTS[name].looked_for(asked))
    where = "no folder was given" if data is None else f"it is neither in {data} nor in a folder of it"
    called = " or ".join(f"'{word}'" for word in _words(asked)[:2])
    return (
        f"{asked.name}: {where}; looked for {looked}, in a folder with {called} in its name. "
        f"Get it from {asked.get} ({asked.licence})"
    )
