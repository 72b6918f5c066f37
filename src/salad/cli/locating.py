"""`salad locate`: where photos were taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from salad.cli import formats, maps, outputs, shell
from salad.cli.arguments import ModelName, Photos, positive
from salad.cli.filtering import Only
from salad.cli.opening import model_of
from salad.errors import SaladError

if TYPE_CHECKING:
    from salad.place import Answer

Sure = Annotated[float | None, arg(metavar="0..1", help_behavior_hint="")]
Folder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
Track = Annotated[Path | None, arg(metavar="FILE.gpx", help_behavior_hint="")]
WRITERS: dict[str, Callable[[Sequence[Answer]], str]] = {
    "json": formats.as_json,
    "geojson": maps.as_geojson,
    "csv": formats.as_csv,
    "kml": maps.as_kml,
}


@dataclass(frozen=True)
class Locate:
    """Say where photos were taken, by an index of photos whose places are known."""

    photos: Photos
    index: Path
    """The index to look in."""
    k: Annotated[int, arg(aliases=["-k"])] = 5
    """How many matches vote."""
    format: Literal["table", "json", "geojson", "csv", "kml"] = "table"
    """For people, programs, maps, spreadsheets or globes."""
    min_confidence: Sure = None
    """A place less sure than this is unknown; by default the model's own limit."""
    radius: Annotated[float, arg(metavar="METRES")] = 25.0
    """How far apart matches may be and still mean one place."""
    only: Only = field(default_factory=Only)
    write_exif: Folder = None
    """Put a copy of each JPEG that was located into this folder, its position in the copy's EXIF."""
    gpx: Track = None
    """Write the places found as a track, in the order of the photos' times."""
    model: ModelName = None
    """The model the index was made with, where it is not one of the zoo."""
    device: str = "cpu"
    """Where the model runs, as torch names it."""

    def run(self) -> int:
        """Locate the photos."""
        from salad.photos import find_photos

        self._check()
        paths = find_photos(self.photos)
        if self.write_exif:
            outputs.check_folder(self.write_exif, paths)
        if self.gpx:
            outputs.check_track(self.gpx)
        answers, unreadable = self._located(paths)
        for sentence in unreadable:
            shell.say(sentence)
        self._put(answers)
        if any(answer.place for answer in answers):
            return shell.FOUND
        return shell.NOTHING if answers else shell.BAD_INPUT

    def _check(self) -> None:
        positive(self.k, "-k")
        if self.min_confidence is not None and not 0 <= self.min_confidence <= 1:
            raise SaladError(f"--min-confidence {self.min_confidence} is not between 0 and 1")
        if not 0 < self.radius <= 1e6:
            raise SaladError(f"--radius {self.radius} makes no place: give metres, above 0")

    def _located(self, paths: list[Path]) -> tuple[list[Answer], list[str]]:
        """An answer for each photo that can be read, a sentence for each other."""
        from salad.index import Index as Opened
        from salad.model.weights import load
        from salad.place import locate_many

        where = self.only.filter()
        answers: list[Answer] = []
        unreadable: list[str] = []
        with Opened.open(self.index) as index, shell.progress("locating") as bar:
            model = load(self.model or model_of(self.index), device=self.device)
            bar(0, len(paths))
            for answer in locate_many(
                paths,
                index=index,
                model=model,
                k=self.k,
                where=where,
                radius_m=self.radius,
                min_confidence=self.min_confidence,
                on_unreadable=unreadable.append,
            ):
                answers.append(answer)
                bar(len(answers) + len(unreadable), len(paths))
        return answers, unreadable

    def _put(self, answers: list[Answer]) -> None:
        if self.format == "table":
            shell.put_table(formats.as_table(answers))
        else:
            shell.put(WRITERS[self.format](answers))
        if self.write_exif:
            outputs.write_copies(self.write_exif, answers)
        if self.gpx:
            outputs.write_track(self.gpx, answers)
