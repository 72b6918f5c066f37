"""Which of the photos that a table names are there: one look at a folder, not one at each of its photos."""

from __future__ import annotations

import os
from pathlib import Path

from salad.data.views import Say
from salad.errors import BenchmarkError


class Listing:
    """The names in folders, each folder listed once, when it is first asked for."""

    def __init__(self) -> None:
        self._names: dict[Path, frozenset[str]] = {}

    def __contains__(self, path: Path) -> bool:
        return path.name in self.names(path.parent)

    def names(self, folder: Path) -> frozenset[str]:
        """What a folder holds; nothing where there is no such folder."""
        if folder not in self._names:
            try:
                self._names[folder] = frozenset(os.listdir(folder))  # noqa: PTH208  # names, not a Path for each
            except OSError:
                self._names[folder] = frozenset()
        return self._names[folder]


def tell_missing(table: Path, missing: list[Path], say: Say | None) -> None:
    """Say that a table names photos in vain, in one sentence; where nobody listens, refuse.

    Raises:
        BenchmarkError: some are missing and `say` is None.
    """
    if not missing:
        return
    more = f" (nor are {len(missing) - 1} more)" if len(missing) > 1 else ""
    fault = f"{table} names {missing[0].name}, which is not in {missing[0].parent}{more}"
    if say is None:
        raise BenchmarkError(f"{fault}: fetch what is missing, or take its lines out of the table")
    say(f"{fault}: left out")
