"""`salad index`: photos described and added.

A command is a frozen dataclass: its fields are its options, its docstring its help, `run` what it does. Each
imports what it needs when it runs, so that a command line that is only looked at loads no torch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import UseAppendAction, arg

from salad.cli import terminal
from salad.cli.arguments import (
    Engine,
    ModelName,
    Photos,
    Table,
    Threads,
    check_threads,
    model_name_for,
    open_or_create,
    positive,
    read_positions,
    settle_engine,
    unless_there,
)
from salad.cli.compress_command import keep_compressed
from salad.errors import SaladError, StoreError

if TYPE_CHECKING:
    from salad.images.photo import Photo
    from salad.images.photo_table import PhotoTable
    from salad.index.build import Indexed, Outcome
    from salad.index.index import Index
    from salad.models.describer import DescriberLike


Patterns = Annotated[tuple[str, ...], arg(metavar="PATTERN", help_behavior_hint=""), UseAppendAction]
ListFile = Annotated[Path | None, arg(name="list", metavar="FILE.csv", help_behavior_hint="")]
Exported = Annotated[Path | None, arg(name="from", metavar="DIR", help_behavior_hint="")]


@dataclass(frozen=True)
class IndexCommand:
    """Describe photos and add them to an index; what it holds already is skipped, so run it again at will."""

    photos: Photos
    to: Path
    """The index: a folder, made where there is none."""
    model: ModelName = None
    """A name of the zoo, a folder or a published file; by default the index's own, else salad-lite."""
    table: Table = None
    """A CSV or Parquet table path,lat,lon[,heading,time] for photos that carry no position themselves."""
    exclude: Patterns = ()
    """Leave out files and folders of this name, or path below a folder given: '*.png', 'raw/*'. Again for more."""
    prune: bool = False
    """Forget the photos of the folders given whose files are gone; without it they are only told."""
    prune_all: bool = False
    """As --prune, which stops where a whole folder has become empty, as one does whose disk is not there."""
    list_: ListFile = None
    """Write what was found of each photo, and why it has no position, into this table."""
    from_: Exported = None
    """Take what `salad export` wrote, or another tool's .npy and table (name their model), in place of PHOTOS."""
    device: str = "cpu"
    """Where the model runs, as torch names it."""
    engine: Engine = "auto"
    threads: Threads = None
    batch_size: int = 16
    """Photos the model takes at a time."""

    def run(self) -> int:
        """Index the photos."""
        from salad.cli.index_report import PhotoList, sentences
        from salad.images.finding import look_through

        if self.from_ is not None:
            return self._take(self.from_)
        from salad.images.workers import prepare
        from salad.models.model_folder import load

        listing = None if self.list_ is None else PhotoList(self.list_)
        positive(self.batch_size, "--batch-size")
        check_threads(self.threads)
        sources = list(terminal.expand_stdin(self.photos))  # kept: stdin can be read but once
        found = look_through(sources, exclude=self.exclude, allow_empty=self.prune_all)
        paths = found.photos
        prepare()  # what reads the photos starts while the model loads
        table = read_positions(self.table, paths)
        named = self.model or model_name_for(self.to)
        model = load(named, device=self.device, engine=self.engine, threads=self.threads)
        settle_engine(model, len(paths))
        with open_or_create(self.to, model) as index:
            # Only who names a folder says that its photos are all there are in it.
            before = {Path(source): index.count_below(source) for source in sources if Path(source).is_dir()}
            done = self._describe(paths, index, model, table, listing.note if listing else None)
            gone, doubts = self._vanished(index, before)
            keep_compressed(index)
            held, placed = len(index), index.info().with_position
        # After the bar, which lines in between would tear apart.
        for sentence in (*found.unreadable.values(), *done.twins, *done.unreadable, *gone):
            terminal.say(sentence)
        for sentence in sentences(found, done):
            terminal.say(sentence)
        if listing:
            listing.note_others(found)
            listing.write()
        terminal.say(f"{self.to}: {done.added} photos added, {done.skipped} there already, "
                  f"{len(done.unreadable)} unreadable; it holds {held}, {placed} with a position")  # fmt: skip
        if doubts:
            raise StoreError(
                f"nothing was dropped, since a disk may not be there: {'; '.join(doubts)}. Mount it, or say --prune-all"
            )
        # Where not one photo of all could be read, something is wrong with what was given, not with a photo.
        return terminal.FOUND if done.added or done.skipped or not paths else terminal.BAD_INPUT

    def _describe(
        self,
        paths: Sequence[Path],
        index: Index,
        model: DescriberLike,
        table: PhotoTable | None,
        on_photo: Callable[[Outcome], None] | None,
    ) -> Indexed:
        from salad.index.build import index_photos

        far = 0  # how far it came is told where it is stopped, since that much is in the index
        with terminal.progress("indexing") as bar:

            def report(done: int, total: int) -> None:
                nonlocal far
                far = done
                bar(done, total)

            report(0, len(paths))  # the first batch takes a while: let people see that there is something to wait for
            try:
                return index_photos(
                    paths,
                    index,
                    model,
                    table=table,
                    batch_size=self.batch_size,
                    threads=self.threads,
                    progress=report,
                    on_photo=on_photo,
                )
            except KeyboardInterrupt:
                terminal.say(f"{self.to}: {far} of {len(paths)} photos were done; it holds {len(index)}")
                raise

    def _vanished(self, index: Index, before: Mapping[Path, int]) -> tuple[list[str], list[str]]:
        """A sentence for each photo whose file is gone, forgotten where that is asked for; and why it must not be.

        Args:
            index: What holds them.
            before: Of each folder given, how many photos the index held below it before this run.
        """
        from salad.index.vanished import disk_may_be_away

        gone = index.missing(list(before)) if before else []
        doubts = disk_may_be_away(gone, before) if self.prune and not self.prune_all else []
        drop = (self.prune or self.prune_all) and not doubts
        if drop and gone:
            gone = index.remove_missing(list(before))
        fate = "it was dropped" if drop else "it is still in the index" if doubts else "--prune drops it from the index"
        return terminal.first_few([f"{path} is gone: {fate}" for path in gone], what="are gone"), doubts

    def _take(self, folder: Path) -> int:
        """Take in what `salad export` or another tool wrote."""
        from salad.index.index import Index
        from salad.index.transfer import take, take_as_new

        if self.photos or self.table or self.exclude or self.prune or self.prune_all or self.list_:
            raise SaladError(
                "--from takes photos and positions from its folder: leave out PHOTOS, --table, --exclude, --list "
                "and --prune"
            )
        zero: list[str] = []

        def note(photo: Photo) -> None:
            zero.append(photo.path.name)

        added = unless_there(self.to, lambda: take_as_new(self.to, folder, model=self.model, on_null_island=note))
        with Index.open(self.to) as index:
            if added is None:
                zero.clear()  # whoever came first may have begun, too
                added = take(index, folder, model=self.model, on_null_island=note)
            held, placed = len(index), index.info().with_position
            keep_compressed(index)
        if zero:
            terminal.say(f"{folder}: {len(zero):,} at 0,0, which counts as no position; the first is {zero[0]}")
        terminal.say(f"{self.to}: {added} photos added from {folder}; it holds {held}, {placed} with a position")
        return terminal.FOUND if held else terminal.NOTHING
