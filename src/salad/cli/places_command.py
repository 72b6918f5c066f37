"""`salad places`: from photos that know where they were taken to places that a model can learn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from salad.cli import terminal
from salad.cli.arguments import Format, Photos, Table, read_positions
from salad.errors import SaladError

if TYPE_CHECKING:
    from salad.datasets.cluster import Clustering, Reason
    from salad.images.photo import Photo


Metres = Annotated[float, arg(metavar="METRES")]
Degrees = Annotated[float, arg(metavar="DEGREES")]
Count = Annotated[int, arg(metavar="N")]

_SIDE = 64  # pixels a photo is decoded to: it is read to its end for that, and yet takes little time
_ADVICE: dict[Reason, str] = {  # by what most photos were left out for
    "no position": "Name a table that has their positions with --table.",
    "unreadable": "Fetch them again, or save them as JPEG.",
    "too few in their cell": "Take larger cells (--cell), a wider --turn, or fewer photos of each (--fewest).",
    "too near another place": "Let places stand closer (--apart).",
}


@dataclass(frozen=True)
class PlacesCommand:
    """Find the places that geotagged photos show, several photos of each, and write a table for `salad train`."""

    photos: Photos
    to: Path
    """The table to write: a CSV with path,place,city,lat,lon,heading,time."""
    table: Table = None
    """A CSV or Parquet table path,lat,lon[,heading,time] for photos that carry no position themselves."""
    cell: Metres = 10.0
    """Side of the squares that photos of one place lie in."""
    turn: Degrees = 45.0
    """Part of the compass that counts as looking the same way; 360 for no matter."""
    fewest: Count = 4
    """Photos of a place, at least."""
    apart: Metres = 100.0
    """Between two places, at least; 0 keeps all, for training with one-city or clique batches."""
    check: bool = True
    """Open each photo that would be used, and leave out what cannot be read."""
    format: Format = "table"

    def run(self) -> int:
        """Find the places."""
        from salad.datasets.cluster import find_cells
        from salad.datasets.places import write_places

        if self.to.is_dir() or not self.to.parent.is_dir():  # said before the work, not after it
            raise SaladError(f"--to {self.to} cannot be written: name a file in a folder that is there")
        found = find_cells(
            self._read_photos(),
            side_m=self.cell,
            turn=self.turn,
            fewest=self.fewest,
            apart_m=self.apart,
            unreadable=_find_unreadable if self.check else None,
        )
        if found.places:
            write_places(found.places, self.to)
        self._report(found)
        return terminal.FOUND if found.places else terminal.NOTHING

    def _read_photos(self) -> list[Photo]:
        """All photos with where, which way and when they were taken."""
        from salad.datasets.readers.gsv_cities import is_gsv_cities
        from salad.images.finding import find_photos
        from salad.images.photo import placed
        from salad.images.workers import Workers

        names = list(terminal.expand_stdin(self.photos))
        known = next((name for name in names if is_gsv_cities(Path(name))), None)
        # Its names hold places that were cut with more knowledge than positions alone have.
        if known and not self.table:
            raise SaladError(
                f"{known} is laid out like GSV-Cities, so its places are known: train on it as it is with "
                f"`salad train --data {known}`, or name a table of positions with --table to find others"
            )
        paths = find_photos(names, on_unreadable=terminal.say)
        table = read_positions(self.table, paths)
        photos: list[Photo] = []
        with Workers(len(paths)) as workers, terminal.progress("looking") as bar:
            for photo in workers.in_order(lambda path: placed(workers.look(path), table), paths, ahead=64):
                photos.append(photo)
                bar(len(photos), len(paths))
        return photos

    def _report(self, found: Clustering) -> None:
        for sentence in terminal.first_few(found.trouble, what="cannot be read"):
            terminal.say(sentence)
        counts = found.as_dict()
        # The path alone goes to stdout, so that it can be handed on; for people, the counts are talk.
        if self.format == "json":
            terminal.write_json({"table": str(self.to) if found.places else None} | counts)
            return
        rows = [(name, value) for name, value in counts.items() if name != "left_out"]
        rows += [(f"left out, {reason}", count) for reason, count in counts["left_out"].items() if count]
        wide = max(len(name) for name, _ in rows)
        for name, value in rows:
            terminal.say(f"{name:<{wide}}  {value}")
        if found.places:
            terminal.write(str(self.to))
            return
        most = max(found.left_out, key=lambda reason: len(found.left_out[reason]))
        terminal.say(f"no place was found, so nothing is written; most photos: {most}. {_ADVICE[most]}")


def _find_unreadable(paths: Sequence[Path]) -> dict[Path, str]:
    """A sentence for each photo whose pixels cannot be read."""
    from salad.images.workers import Workers

    trouble: dict[Path, str] = {}
    with Workers(len(paths)) as workers, terminal.progress("checking") as bar:

        def tried(
            path: Path,
        ) -> str:  # in threads: a sentence can be handed back, an error would end them all
            try:
                workers.decode(path, _SIDE, _SIDE, "bilinear")
            except SaladError as error:
                return str(error)
            return ""

        for done, (path, sentence) in enumerate(
            zip(paths, workers.in_order(tried, paths, ahead=64), strict=True), start=1
        ):
            if sentence:
                trouble[path] = sentence
            bar(done, len(paths))
    return trouble
