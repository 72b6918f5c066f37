"""`salad quantize`: a model in fewer bits, made on your photos and judged on others of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from salad.cli import terminal
from salad.cli.arguments import Table, read_positions
from salad.errors import WeightsError

Sources = Annotated[tuple[str, ...], arg(metavar="PHOTOS")]


@dataclass(frozen=True)
class QuantizeCommand:
    """Make a model in int8 or bfloat16, two to four times as fast: another model, which wants an index of its own.

    What comes out is kept only if, on photos it was not made with, it recognises as well as before, within a point.
    """

    model: Annotated[Positional[str], arg(metavar="MODEL", help="A name of the zoo, or a model's folder.")]
    photos: Sources
    """Files and folders of the kind it is to recognise, 200 photos or more; positions, where they have any, count."""
    to: Path
    """The folder to make."""
    precision: Literal["int8", "bf16"] = "int8"
    """What to compute in: int8 is the smaller, bf16 nearer to what the model gave before."""
    table: Table = None
    """A CSV or Parquet table path,lat,lon for photos that carry no position themselves."""
    seed: int = 0
    """Of which photos are drawn."""

    def run(self) -> int:
        """Quantize."""
        from salad.evaluation.quantization import quantize
        from salad.images.finding import find_photos
        from salad.models.model_folder import load, write_folder

        if self.to.exists():  # said before the work, not after it
            raise WeightsError(f"{self.to} exists already; choose another folder, or remove it first")
        paths = find_photos(terminal.expand_stdin(self.photos), on_unreadable=terminal.say)
        table = read_positions(self.table, paths)
        model = load(self.model, engine="openvino")
        with terminal.progress("judging") as bar:
            bar(
                0, None
            )  # it learns for a minute before it is judged: let people see that there is something to wait for
            made, kept = quantize(model, paths, precision=self.precision, table=table, seed=self.seed, progress=bar)
        for sentence in terminal.first_few(kept.unreadable, what="could not be read"):
            terminal.say(sentence)
        terminal.say(f"{made.name}: {kept}")
        terminal.write(str(write_folder(made, self.to)))
        return terminal.FOUND
