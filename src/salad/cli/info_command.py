"""`salad info`: what an index holds, or what is known of a photo and who says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from salad.cli import terminal
from salad.cli.arguments import Format

if TYPE_CHECKING:
    from rich.table import Table

    from salad.images.metadata import Position
    from salad.images.photo import Photo

IndexOrPhoto = Annotated[Positional[Path], arg(metavar="INDEX", help="An index, which is a folder, or a photo.")]

_MEGA = 1e6  # bytes in a megabyte, as disks count them


@dataclass(frozen=True)
class InfoCommand:
    """Say what an index holds; or of a photo where, which way and when it was taken, and who says so."""

    index: IndexOrPhoto
    format: Format = "table"

    def run(self) -> int:
        """Tell."""
        return self._of_photo(self.index) if self.index.is_file() else self._of_index(self.index)

    def _of_index(self, folder: Path) -> int:
        from salad.index.index import Index

        with Index.open(folder) as index:
            known, zero = index.info().as_dict(), index.at_null_island()
        if zero:
            terminal.say(f"{folder}: {zero:,} at 0,0, which counts as no position")
        if self.format == "json":
            terminal.write_json(known)
        else:
            terminal.write_fields(dict(_with_units(name, value) for name, value in known.items()))
        return terminal.FOUND

    def _of_photo(self, path: Path) -> int:
        """What counts of a photo, and then what each source says of it, the one that wins first."""
        from salad.images.photo import Photo
        from salad.images.workers import Workers

        with Workers(1) as workers:
            known, said = workers.look(path), workers.said(path)
        told = [_told(Photo.of(path, one)) for one in said if _says_something(one)]
        if self.format == "json":
            terminal.write_json({"path": str(path), **_told(known), "said": told})
        else:
            terminal.write_table(_as_table(_told(known), told))
        return terminal.FOUND


def _says_something(one: Position) -> bool:
    return any(fact is not None for fact in (one.where, one.heading, one.time)) or bool(one.remark)


def _told(photo: Photo) -> dict[str, Any]:
    """What is known of a photo, or said of it by one source, as JSON holds it; the path is known already."""
    _, *known = photo.as_dict().items()
    return {"source": photo.source, **dict(known), "remark": photo.remark or None}


def _as_table(known: dict[str, Any], told: Sequence[dict[str, Any]]) -> Table:
    """The same for people: a line for what counts, and a line a source."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in ("", "position", "heading", "time", "remark"):
        table.add_column(column)
    counts = f"what counts, by {known['source']}" if known["source"] else "what counts"
    for name, one in [(counts, known), *((one["source"], one) for one in told)]:
        place = "" if one["lat"] is None else f"{one['lat']:.6f}, {one['lon']:.6f}"  # 0.1 m
        heading = "" if one["heading"] is None else f"{one['heading']:.1f}"
        table.add_row(name, place, heading, one["time"] or "", Text(one["remark"] or ""))
    return table


def _with_units(name: str, value: Any) -> tuple[str, Any]:
    """A fact for people: JSON keys are short and their units are in the docs, here they stand in the name."""
    names = {
        "box": "south, west, north, east",
        "span_km": "km from south to north, west to east",
        "bytes": "MB",
        "bytes_of_descriptors": "MB of descriptors",
        "bytes_of_codes": "MB of codes",
        "code_bytes": "bytes of codes a photo",
        "coded": "photos with codes",
        "codes_fitted_on": "photos when codes were fitted",
    }
    return names.get(name, name), round(value / _MEGA, 3) if name.startswith("bytes") else value
