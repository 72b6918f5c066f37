"""The commands about an index: `salad index`, `locate`, `info`, `verify` and `remove`.

A command is a frozen dataclass: its fields are its options, its docstring its help, `run` what it does. Each
imports what it needs when it runs, so that a command line that is only looked at loads no torch.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from salad.cli import formats, shell
from salad.cli.arguments import SHIPPED, Form, IndexFolder, ModelName, Photos, Table, positive
from salad.errors import ModelError, PhotoError

if TYPE_CHECKING:
    from salad.index import Index as OpenIndex
    from salad.model.describer import Describes
    from salad.place import Answer


@dataclass(frozen=True)
class Index:
    """Describe photos and add them to an index; what it holds already is skipped, so run it again at will."""

    photos: Photos
    to: Path
    """The index: a folder, made where there is none."""
    model: ModelName = None
    """A name of the zoo, a folder or a published file; by default the index's own, else salad-lite."""
    table: Table = None
    """A CSV with path,lat,lon[,heading,time] for photos that carry no position themselves."""
    device: str = "cpu"
    """Where the model runs, as torch names it."""
    batch_size: int = 16
    """Photos the model takes at a time."""

    def run(self) -> int:
        """Index the photos."""
        from salad.index.build import index_photos
        from salad.model.weights import load
        from salad.photos import PhotoTable, find_photos

        batch_size = positive(self.batch_size, "--batch-size")
        paths = find_photos(self.photos)
        table = PhotoTable.read(self.table) if self.table else None
        model = load(self.model or _model_of(self.to), device=self.device)
        with _opened(self.to, model) as index, shell.progress("indexing") as bar:
            bar(0, len(paths))
            done = index_photos(paths, index, model, table=table, batch_size=batch_size, progress=bar)
            held, placed = len(index), index.info().with_position
        for sentence in (*done.twins, *done.unreadable):
            shell.say(sentence)
        shell.say(f"{self.to}: {done.added} photos added, {done.skipped} there already, "
                  f"{len(done.unreadable)} unreadable; it holds {held}, {placed} with a position")  # fmt: skip
        return shell.FOUND if done.added or done.skipped else shell.BAD_INPUT


@dataclass(frozen=True)
class Locate:
    """Say where photos were taken, by an index of photos whose places are known."""

    photos: Photos
    index: Path
    """The index to look in."""
    k: Annotated[int, arg(aliases=["-k"])] = 5
    """How many matches vote."""
    format: Literal["table", "json", "geojson", "csv"] = "table"
    """For people, programs, maps or spreadsheets."""
    model: ModelName = None
    """The model the index was made with, where it is not one of the zoo."""
    device: str = "cpu"
    """Where the model runs, as torch names it."""

    def run(self) -> int:
        """Locate the photos."""
        from salad.index import Index as Opened
        from salad.model.weights import load
        from salad.photos import find_photos
        from salad.place import locate_many

        k = positive(self.k, "-k")
        paths = find_photos(self.photos)
        unreadable: list[str] = []
        answers: list[Answer] = []
        with Opened.open(self.index) as index, shell.progress("locating") as bar:
            model = load(self.model or _model_of(self.index), device=self.device)
            bar(0, len(paths))
            for answer in locate_many(paths, index=index, model=model, k=k, on_unreadable=unreadable.append):
                answers.append(answer)
                bar(len(answers) + len(unreadable), len(paths))
        for sentence in unreadable:
            shell.say(sentence)
        self._put(answers)
        if any(answer.place for answer in answers):
            return shell.FOUND
        return shell.NOTHING if answers else shell.BAD_INPUT

    def _put(self, answers: list[Answer]) -> None:
        if self.format == "table":
            shell.put_table(formats.as_table(answers))
        else:
            write = {"json": formats.as_json, "geojson": formats.as_geojson, "csv": formats.as_csv}
            shell.put(write[self.format](answers))


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


def _model_of(folder: Path) -> str:
    """The name in the zoo of an index's model; where there is no index yet, of the model that ships."""
    from salad.index import Index as Opened
    from salad.model.zoo import ZOO

    if not _is_index(folder):
        return SHIPPED
    with Opened.open(folder) as index:
        if index.model in ZOO:
            return index.model
        raise ModelError(
            f"{folder} was made with {index.model!r}, which is not in the zoo: say where that model is with --model"
        )


def _opened(folder: Path, model: Describes) -> OpenIndex:
    from salad.index import Index as Opened

    if _is_index(folder):
        return Opened.open(folder)
    return Opened.create(folder, dim=model.dim, fingerprint=model.fingerprint, model=model.name)


def _is_index(folder: Path) -> bool:
    from salad.index.header import NAME

    return (folder / NAME).exists()
