"""`salad locate`: where photos were taken.

options ──> matches and places ──> a table, JSON, GeoJSON, CSV or KML on stdout ──> copies with EXIF, a GPX track
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import arg

from salad.cli import terminal
from salad.cli.arguments import (
    Degrees,
    Engine,
    Folder,
    ModelName,
    Photos,
    Threads,
    check_threads,
    model_name_for,
    positive,
)
from salad.errors import PhotoError, SaladError, reason
from salad.files import json_text

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from salad.localize.locate import Answer
    from salad.localize.voting import Place
    from salad.search.filters import Filter


Around = Annotated[str | None, arg(metavar="LAT,LON", help_behavior_hint="")]
Box = Annotated[str | None, arg(metavar="SOUTH,WEST,NORTH,EAST", help_behavior_hint="")]
Moment = Annotated[str | None, arg(metavar="DATE", help_behavior_hint="")]
Confidence = Annotated[float | None, arg(metavar="0..1", help_behavior_hint="")]
Track = Annotated[Path | None, arg(metavar="FILE.gpx", help_behavior_hint="")]

_A_DAY = len("2024-05-01")  # letters of a date without an hour


@dataclass(frozen=True)
class FilterOptions:
    """Look only at photos of the index that keep to all of these."""

    near: Around = None
    """Taken around this point."""
    within: Annotated[float, arg(metavar="METRES")] = 500.0
    """How far from it."""
    box: Box = None
    """Taken in this box; one whose west is above its east crosses the date line."""
    since: Moment = None
    """Taken then or later: 2024-05-01, or 2024-05-01T12:00 with or without a zone such as +02:00."""
    until: Moment = None
    """Taken then or before; a day counts to its end."""
    heading: Degrees = None
    """Taken looking this way, clockwise from north."""
    heading_within: Annotated[float, arg(metavar="DEGREES")] = 45.0
    """How far to either side of it."""

    def filter(self) -> Filter | None:
        """The same for a search; None where every photo may be found.

        Raises:
            SaladError: If a value makes no sense.
        """
        if all(value is None for value in (self.near, self.box, self.since, self.until, self.heading)):
            return None  # the distances alone filter nothing: a search without a filter is the faster one
        from salad.geo import GeoPoint
        from salad.search.filters import Filter

        near = None if self.near is None else _degrees_in(self.near, 2, "--near", "LAT,LON")
        box = None if self.box is None else _degrees_in(self.box, 4, "--box", "SOUTH,WEST,NORTH,EAST")
        return Filter(
            box=None if box is None else (box[0], box[1], box[2], box[3]),
            near=None if near is None else GeoPoint(*near),
            within_m=None if near is None else self.within,
            since=_moment(self.since, "--since"),
            until=_moment(self.until, "--until", to_its_end=True),
            heading=self.heading,
            heading_within=self.heading_within,
        )


def _degrees_in(text: str, count: int, option: str, form: str) -> list[float]:
    from salad.tables import number

    try:
        found = [number(part) for part in text.split(",")]
    except ValueError:
        found = []  # refused below, as too few and too many are
    if len(found) != count:
        raise SaladError(f"{option} {text} cannot be read: write {form}, in degrees")
    return found


def _moment(text: str | None, option: str, *, to_its_end: bool = False) -> datetime | None:
    if text is None:
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise SaladError(f"{option} {text} is no date: write 2024-05-01, or 2024-05-01T12:00") from error
    day_alone = len(text) <= _A_DAY
    # `--until 2024-05-01` means with all of that day, or the photos of its afternoon would be lost.
    return moment + timedelta(days=1, microseconds=-1) if to_its_end and day_alone else moment


@dataclass(frozen=True)
class LocateCommand:
    """Say where photos were taken, by an index of photos whose places are known."""

    photos: Photos
    index: Path
    """The index to look in."""
    k: Annotated[int, arg(aliases=["-k"])] = 5
    """How many matches vote."""
    format: Literal["table", "json", "geojson", "csv", "kml"] = "table"
    """For people, programs, maps, spreadsheets or globes."""
    min_confidence: Confidence = None
    """A place less sure than this is unknown; by default the model's own limit."""
    radius: Annotated[float, arg(metavar="METRES")] = 25.0
    """How far apart matches may be and still mean one place."""
    exact: bool = False
    """Compare with every photo itself, even where the index has codes."""
    only: FilterOptions = field(default_factory=FilterOptions)
    write_exif: Folder = None
    """Put a copy of each JPEG that was located into this folder, its position in the copy's EXIF."""
    gpx: Track = None
    """Write the places found as a track, in the order of the photos' times."""
    model: ModelName = None
    """The model the index was made with, where it is not one of the zoo."""
    device: str = "cpu"
    """Where the model runs, as torch names it."""
    engine: Engine = "auto"
    threads: Threads = None

    def run(self) -> int:
        """Locate the photos."""
        from salad.images.finding import find_photos
        from salad.images.workers import prepare

        # Whatever can be refused is refused now: a drive may take an hour to locate.
        positive(self.k, "-k")
        check_threads(self.threads)
        if self.min_confidence is not None and not 0 <= self.min_confidence <= 1:
            raise SaladError(f"--min-confidence {self.min_confidence} is not between 0 and 1")
        if not 0 < self.radius <= 1e6:
            raise SaladError(f"--radius {self.radius} makes no place: give metres, above 0")
        sources = list(terminal.expand_stdin(self.photos))  # kept: stdin can be read but once
        paths = find_photos(sources, on_unreadable=terminal.say)
        prepare()  # what reads the photos starts while the model loads
        if self.write_exif:
            check_folder(self.write_exif, paths)
        if self.gpx:
            check_track(self.gpx)

        answers, unreadable = self._locate(paths)
        for sentence in unreadable:
            terminal.say(sentence)
        if self.format == "table":
            terminal.write_table(as_table(answers))
        else:
            terminal.write(as_text(answers, self.format))
        copied = write_copies(self.write_exif, answers, sources) if self.write_exif else None
        if self.gpx:
            write_track(self.gpx, answers)
        if any(answer.place for answer in answers):
            # Copies that were asked for and could not be made are no small thing; of some that could, the rest is told.
            return terminal.BAD_INPUT if copied == 0 else terminal.FOUND
        return terminal.NOTHING if answers else terminal.BAD_INPUT

    def _locate(self, paths: list[Path]) -> tuple[list[Answer], list[str]]:
        """An answer for each photo that can be read; a sentence for each other, and for codes that cannot be used."""
        from salad.index.index import Index
        from salad.localize.locate import locate_many
        from salad.models.model_folder import load
        from salad.search.exact import ExactSearcher

        where = self.only.filter()
        answers: list[Answer] = []
        unreadable: list[str] = []
        with (
            Index.open(self.index, searcher=ExactSearcher if self.exact else None) as index,
            terminal.progress("locating") as bar,
        ):
            # A whole day is what calendars on walls said, too: no word is lost over that.
            by_hour = any(len(bound or "") > _A_DAY for bound in (self.only.since, self.only.until))
            if where is not None and by_hour and (count := index.compared_by_the_clock(where)):
                terminal.say(
                    f"{count:,} photos of {self.index} and the bounds of --since and --until do not both have a time "
                    "zone: they are compared by the clock on the wall"
                )
            named = self.model or model_name_for(self.index)
            model = load(named, device=self.device, engine=self.engine, threads=self.threads)
            bar(0, len(paths))
            for answer in locate_many(
                paths,
                index=index,
                model=model,
                k=self.k,
                where=where,
                radius_m=self.radius,
                min_confidence=self.min_confidence,
                threads=self.threads,
                on_unreadable=unreadable.append,
            ):
                answers.append(answer)
                bar(len(answers) + len(unreadable), len(paths))
            return answers, unreadable + index.noticed


# What is written to stdout, by --format; maps have a file of their own.


def as_text(answers: Sequence[Answer], form: str) -> str:
    """The answers as json, geojson, csv or kml."""
    from salad.localize import maps

    writers = {"json": as_json, "geojson": maps.as_geojson, "csv": as_csv, "kml": maps.as_kml}
    return writers[form](answers)


def as_json(answers: Sequence[Answer]) -> str:
    """One object a query."""
    return json_text([answer.as_dict() for answer in answers])


def as_csv(answers: Sequence[Answer]) -> str:
    """One line a query; an unknown place leaves its fields empty."""
    from salad.tables import csv_line, without_formulas

    columns = ("query", "lat", "lon", "radius_m", "confidence", "support", "best_match", "best_score")
    lines = [csv_line(columns)]
    for answer in answers:
        place, best = answer.place, answer.matches[0] if answer.matches else None
        found: list[Any] = [""] * 5
        if place:
            found = [*_degrees(place), f"{place.radius_m:.1f}", f"{place.confidence:.3f}", place.support]
        matched = [best.photo.path, f"{best.score:.4f}"] if best else ["", ""]
        lines.append(csv_line(without_formulas([answer.query, *found, *matched])))
    return "".join(lines).removesuffix("\n")  # `terminal.write` ends the last one


def as_table(answers: Sequence[Answer]) -> Table:
    """One line a query, for a terminal."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("photo")  # where room is short, names give way to the place
    table.add_column("place", no_wrap=True)
    table.add_column("within", justify="right", no_wrap=True)
    table.add_column("confidence", justify="right", no_wrap=True)
    table.add_column("looks like")
    for answer in answers:
        place, best = answer.place, answer.matches[0] if answer.matches else None
        cells = ("unknown", "", "")
        if place:
            cells = (", ".join(_degrees(place)), f"{place.radius_m:.0f} m", f"{place.confidence:.2f}")
        like = f"{best.photo.path.name} ({best.score:.2f})" if best else "no match"
        table.add_row(_cell(answer.query.name), *cells, _cell(like))
    return table


def _degrees(place: Place) -> list[str]:
    return [f"{place.where.lat:.6f}", f"{place.where.lon:.6f}"]  # 0.1 m


def _cell(name: str) -> Text:
    """A name as it is, brackets and all, but for what a terminal would obey or cannot show."""
    from rich.text import Text

    shown = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name)
    return Text(shown, no_wrap=True, overflow="ellipsis")


# What is written beside it: copies of the photos with their position, and a track.


def check_folder(folder: Path, photos: Sequence[Path]) -> None:
    """Make sure, before any work, that copies in `folder` cannot lie among the photos they are made of.

    Raises:
        SaladError: If it is the folder of one of the photos, or a file.
    """
    if folder.exists() and not folder.is_dir():
        raise SaladError(f"--write-exif {folder} is a file: name a folder")
    home = os.path.realpath(folder)
    for photo in photos:
        # A link counts where it lies and where its photo does: a copy would replace the one or the other.
        if os.path.realpath(photo.parent) == home or os.path.dirname(os.path.realpath(photo)) == home:  # noqa: PTH120  # realpath's
            raise SaladError(
                f"--write-exif {folder} is the folder of {photo.name}, and originals are never touched: "
                "name another folder"
            )


def check_track(track: Path) -> None:
    """Make sure, before any work, that a track can be written and takes no photo's place.

    Raises:
        SaladError: If its name does not end in .gpx, or there is no folder for it.
    """
    if track.suffix.lower() != ".gpx":  # so that `--gpx photo.jpg`, a slip, costs nobody a photo
        raise SaladError(f"--gpx {track} is no name for a track: end it in .gpx")
    if track.is_dir() or not track.parent.is_dir():
        raise SaladError(f"--gpx {track} cannot be written: name a file in a folder that is there")


def write_copies(folder: Path, answers: Sequence[Answer], sources: Sequence[str]) -> int:
    """Copy each photo that was located into `folder` with its position; say what could not be, and how many were.

    Photos of a folder among the `sources` keep their folders below it, so that those of one name do not meet.

    Returns:
        How many copies were written.
    """
    from salad.images.exif_copy import copy_with_position

    folder.mkdir(parents=True, exist_ok=True)
    homes = [Path(source) for source in sources if os.path.isdir(source)]  # noqa: PTH112  # fails over no long name
    written = 0
    for answer in answers:
        if answer.place is None:
            continue
        home = next((home for home in homes if answer.query.is_relative_to(home)), answer.query.parent)
        place, copy = answer.place, folder / answer.query.relative_to(home)
        try:
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy_with_position(answer.query, copy, place.where, within_m=place.radius_m)
            written += 1
        except PhotoError as error:  # one that is no JPEG, say: the others are copied all the same
            terminal.say(str(error))
        except OSError as error:
            terminal.say(f"{copy.parent} cannot be made ({reason(error)}): check what stands there and the disk")
    terminal.say(f"{folder}: {written} copies written, with their position")
    return written


def write_track(track: Path, answers: Sequence[Answer]) -> None:
    """Write the places found as a GPX track, all of it or nothing; one of that name is replaced.

    Raises:
        OSError: If it cannot be written.
    """
    from salad.files import write_whole
    from salad.images.workers import Workers
    from salad.localize import maps

    with Workers(len(answers)) as workers:
        times = [workers.look(answer.query).time for answer in answers]
    undated = sum(time is None for answer, time in zip(answers, times, strict=True) if answer.place)
    if undated:
        terminal.say(f"{track}: {undated} photos do not know their time, so the track is in the order given")
    local = sum(time is not None and time.tzinfo is None for time in times)
    if local:
        terminal.say(
            f"{track}: {local} photos do not know the time zone of their clock, so the track does not tell their time"
        )
    write_whole(track, maps.as_gpx(answers, times).encode())
