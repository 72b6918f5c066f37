"""The commands of an index that is there: `salad verify`, `remove`, `compact`, `export` and `merge`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from salad.cli import terminal
from salad.cli.arguments import IndexFolder, Photos
from salad.cli.compress_command import keep_compressed
from salad.errors import PhotoError, StoreError

Others = Annotated[
    Positional[tuple[Path, ...]],
    arg(metavar="OTHER", help="Indexes to take photos from.", help_behavior_hint="(one or more)"),
]

_MEGA = 1e6  # bytes in a megabyte, as disks count them


@dataclass(frozen=True)
class VerifyCommand:
    """Read a whole index and say what is wrong with it, and which photos' files are gone."""

    index: IndexFolder

    def run(self) -> int:
        """Check."""
        from salad.index.header import Header
        from salad.index.index import Index

        Header.read(self.index)  # what is no index, or a later salad's, is not ours to judge
        wrong: list[str] = []
        gone: list[Path] = []
        held = 0
        try:
            with Index.open(self.index) as index:
                wrong = index.verify()
                gone, held = index.missing(), len(index)
        except StoreError as error:  # that it cannot be opened, or listed, is what was asked for
            if str(error) not in wrong:
                wrong.append(str(error))
        for sentence in wrong:  # to stdout: what is wrong is what was asked for
            terminal.write_line(sentence)
        lost = [f"{path} is gone; its descriptor stays until it is removed" for path in gone]
        for sentence in terminal.first_few(lost, what="are gone"):
            terminal.say(sentence)
        if not wrong:
            terminal.write_line(f"{self.index} is sound: {held} photos")
        return terminal.NOTHING if wrong else terminal.FOUND


@dataclass(frozen=True)
class RemoveCommand:
    """Forget photos of an index; their files are not touched and need not exist."""

    photos: Photos
    index: Path
    """The index to forget them in."""

    def run(self) -> int:
        """Remove."""
        from salad.index.index import Index

        paths = list(terminal.expand_stdin(self.photos))
        if not paths:  # an empty list on stdin is a slip of a script, seldom what was meant
            raise PhotoError("no photos are named: give files, folders, or - with a list on standard input")
        with Index.open(self.index) as index:
            removed = index.remove(paths)
        terminal.say(f"{self.index}: {removed} photos removed")
        return terminal.FOUND if removed else terminal.NOTHING


@dataclass(frozen=True)
class CompactCommand:
    """Give back the room of removed photos; where photos are damaged nothing is changed, unless they may be dropped."""

    index: IndexFolder
    drop_damaged: bool = False
    """Let go of photos whose descriptors are damaged or lost; each is named before."""

    def run(self) -> int:
        """Compact."""
        from salad.index.index import Index

        with Index.open(self.index) as index:
            done = index.compact(dropping=_say_dropped if self.drop_damaged else None)
        terminal.say(f"{self.index}: {done.freed / _MEGA:.1f} MB given back; it holds {done.kept} photos")
        return terminal.FOUND


def _say_dropped(paths: Sequence[Path]) -> None:
    for path in paths:
        terminal.say(f"{path} is damaged and goes: index it again")


@dataclass(frozen=True)
class ExportCommand:
    """Write an index's descriptors (.npy) and photos for other tools; `salad index --from` takes them back."""

    index: IndexFolder
    to: Path
    """The folder to write; it must not exist or be empty."""
    format: Literal["csv", "parquet", "geojson"] = "csv"
    """Of the table of photos."""
    dtype: Literal["float16", "float32"] = "float16"
    """Of the descriptors; as float32 they are the same numbers in twice the room."""

    def run(self) -> int:
        """Export."""
        from salad.index.index import Index
        from salad.index.transfer import export

        with Index.open(self.index) as index:
            done = export(index, self.to, form=self.format, dtype=self.dtype)
        _say_damaged(done.damaged)
        terminal.say(f"{self.to}: {done.photos} photos written")
        return terminal.FOUND if done.photos else terminal.NOTHING


@dataclass(frozen=True)
class MergeCommand:
    """Take the photos of other indexes of the same model into one; a photo they share is held once."""

    index: IndexFolder
    others: Others

    def run(self) -> int:
        """Merge."""
        from salad.index.index import Index
        from salad.index.transfer import merge

        if not self.others:
            raise StoreError("no other index is named: say which indexes to take photos from")
        with Index.open(self.index) as into:
            for folder in self.others:
                with Index.open(folder) as other:
                    done = merge(into, other)
                for path in done.other:  # a path names one photo, so ours stays
                    terminal.say(f"{path} was left out of {folder}: {self.index} has another photo at that path")
                _say_damaged(done.damaged)
                terminal.say(f"{folder}: {done.added} photos added, {done.held} there already")
            keep_compressed(into)
            terminal.say(f"{self.index}: it holds {len(into)} photos")
        return terminal.FOUND


def _say_damaged(paths: Sequence[Path]) -> None:
    for path in paths:
        terminal.say(f"{path} was left out, since its descriptor is damaged: index it again")
