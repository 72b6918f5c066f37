"""`salad index`: photos described and added.

A command is a frozen dataclass: its fields are its options, its docstring its help, `run` what it does. Each
imports what it needs when it runs, so that a command line that is only looked at loads no torch.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salad.cli import shell
from salad.cli.arguments import ModelName, Photos, Table, positive
from salad.cli.opening import model_of, opened


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
        model = load(self.model or model_of(self.to), device=self.device)
        with opened(self.to, model) as index, shell.progress("indexing") as bar:
            bar(0, len(paths))
            done = index_photos(paths, index, model, table=table, batch_size=batch_size, progress=bar)
            held, placed = len(index), index.info().with_position
        for sentence in (*done.twins, *done.unreadable):
            shell.say(sentence)
        shell.say(f"{self.to}: {done.added} photos added, {done.skipped} there already, "
                  f"{len(done.unreadable)} unreadable; it holds {held}, {placed} with a position")  # fmt: skip
        return shell.FOUND if done.added or done.skipped else shell.BAD_INPUT
