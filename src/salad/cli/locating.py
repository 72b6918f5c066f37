"""`salad locate`: where photos were taken."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from salad.cli import formats, shell
from salad.cli.arguments import ModelName, Photos, positive
from salad.cli.opening import model_of

if TYPE_CHECKING:
    from salad.place import Answer


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
            model = load(self.model or model_of(self.index), device=self.device)
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
