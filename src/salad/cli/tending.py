"""The commands that tend an index: `salad info`, `verify` and `remove`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salad.cli import shell
from salad.cli.arguments import Form, IndexFolder, Photos
from salad.errors import PhotoError


@dataclass(frozen=True)
class Info:
    """Say what an index holds."""

    index: IndexFolder
    format: Form = "table"

    def run(self) -> int:
        """Tell."""
        from salad.index import Index as Opened

        with Opened.open(self.index) as index:
            told = index.info().as_dict()
        if self.format == "json":
            shell.put_json(told)
        else:
            told["south, west, north, east"] = told.pop("box")
            shell.facts(told)
        return shell.FOUND


@dataclass(frozen=True)
class Verify:
    """Read a whole index and say what is wrong with it, and which photos' files are gone."""

    index: IndexFolder

    def run(self) -> int:
        """Check."""
        from salad.index import Index as Opened

        with Opened.open(self.index) as index:
            wrong, gone, held = index.verify(), index.missing(), len(index)
        for sentence in wrong:
            shell.put(sentence)
        for path in gone:
            shell.say(f"{path} is gone; its descriptor stays until it is removed")
        if not wrong:
            shell.put(f"{self.index} is sound: {held} photos")
        return shell.NOTHING if wrong else shell.FOUND


@dataclass(frozen=True)
class Remove:
    """Forget photos of an index; their files are not touched and need not exist."""

    photos: Photos
    index: Path
    """The index to forget them in."""

    def run(self) -> int:
        """Remove."""
        from salad.index import Index as Opened

        paths = list(shell.listed(self.photos))
        if not paths:
            raise PhotoError("no photos are named: give files, folders, or - with a list on standard input")
        with Opened.open(self.index) as index:
            removed = index.remove(paths)
        shell.say(f"{self.index}: {removed} photos removed")
        return shell.FOUND if removed else shell.NOTHING
