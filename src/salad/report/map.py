"""The map of every page: where queries were right and wrong, north up.

Queries near one another share a map, since a set may span the earth; those whose places nobody knows are cells of a
strip in the order of the drive. `templates/map.html.j2` writes it all as SVG.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from salad.evaluation.result import Degrees, QueryResult, Result, along
from salad.geo import EARTH_RADIUS_M, round_metres, told_metres
from salad.report.mistakes import OUTCOMES, Outcome, outcome

WIDE = 1000.0  # units across a map; the page scales it
# The least and the most height, as a part of the width: a street is no sliver, and a map fits on a screen.
SHAPE = (0.42, 0.86)
MARGIN = 0.06  # of the longer side
SMALLEST_M = 40.0  # across a map, in metres, where all of it is one place
REGION_CELL = 0.25  # degrees: what touches across cells of that size is one region
MAPS = 6  # the regions with the most queries are drawn
# Marks that are elements of their own; more are drawn as one shape a kind, or a browser crawls.
SINGLE = 4000
_M_A_DEGREE = math.radians(1) * EARTH_RADIUS_M


@dataclass(frozen=True, slots=True)
class Frame:
    """Where points of the earth fall on a map.

    Attributes:
        middle: Of the map, latitude and longitude in degrees.
        scale: Units a metre.
        height: In units, as is the width.
    """

    middle: Degrees
    scale: float
    height: float
    width = WIDE

    def at(self, point: Degrees) -> tuple[float, float]:
        """Right and down, in units; a plane is right to a few metres in a town."""
        turn = (point[1] - self.middle[1] + 180) % 360 - 180  # the date line may run through the map
        right = turn * _M_A_DEGREE * math.cos(math.radians(self.middle[0]))
        up = (point[0] - self.middle[0]) * _M_A_DEGREE
        return WIDE / 2 + right * self.scale, self.height / 2 - up * self.scale

    def path(self, points: Iterable[Degrees]) -> str:
        """A line through points, as the data of an SVG path."""
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in map(self.at, points))

    @property
    def bar_m(self) -> float:
        """Metres of the scale bar: a round number, at most a fifth of the map."""
        return round_metres(WIDE / 5 / self.scale)

    @classmethod
    def around(cls, points: Sequence[Degrees]) -> Frame:
        """A frame that holds all the points, none too flat and none too steep."""
        lats, east = [lat for lat, _ in points], points[0][1]
        turns = [(lon - east + 180) % 360 - 180 for _, lon in points]
        middle = (min(lats) + max(lats)) / 2, east + (min(turns) + max(turns)) / 2
        across = (max(turns) - min(turns)) * _M_A_DEGREE * math.cos(math.radians(middle[0]))
        down = (max(lats) - min(lats)) * _M_A_DEGREE
        margin = 2 * MARGIN * max(across, down, SMALLEST_M)
        across, down = max(across, SMALLEST_M) + margin, down + margin
        shape = min(max(down / across, SHAPE[0]), SHAPE[1])
        return cls(middle, WIDE / max(across, down / shape), WIDE * shape)


@dataclass(frozen=True, slots=True)
class QueryMark:
    """A query on a map or a strip.

    Attributes:
        number: Of the query, from 1.
        outcome: What became of it: its colour and its shape.
        label: The same in words.
        linked: Whether it leads to its strip of photos, `#query-N`.
    """

    number: int
    outcome: str
    label: str
    linked: bool = True

    @classmethod
    def of(cls, one: QueryResult, number: int, *, linked: bool) -> QueryMark:
        """The mark of an evaluation's query, by its number from 0."""
        kind = outcome(one)
        away = f", {told_metres(one.metres)} off" if one.metres is not None else ""
        group = f", {one.group}" if one.group is not None else ""
        return cls(number + 1, kind, f"{one.query}: {kind}{away}{group}", linked)


class Shapes(NamedTuple):
    """Many shapes of one kind, as the data of one SVG path."""

    outcome: str
    path: str
    opacity: float = 1.0


@dataclass(frozen=True, slots=True)
class RegionMap:
    """The map of one region.

    Attributes:
        frame: Where things fall on it.
        queries: How many it shows.
        references: Dots, as the data of one SVG path.
        errors: Lines from queries that were answered wrongly to where they were thought to be.
        crowds: Dots of the queries without a mark of their own.
        marks: Queries with their places in units, the right ones first and so below the others.
    """

    frame: Frame
    queries: int
    references: str
    errors: Sequence[Shapes]
    crowds: Sequence[Shapes]
    marks: Sequence[tuple[QueryMark, float, float]]

    @classmethod
    def of(cls, result: Result, places: Mapping[int, Degrees], linked: Collection[int]) -> RegionMap:
        """The map of the queries with `places`, by their numbers from 0; those `linked` have a strip of photos."""
        frame = Frame.around(list(places.values()))
        known = (where for one in result.known.values() if (where := position(one.where)))
        # Dots that cannot be told apart are drawn once: drives have many references in one place.
        points = {(round(x, 1), round(y, 1)) for x, y in map(frame.at, known)}
        seen = sorted((x, y) for x, y in points if 0 <= x <= WIDE and 0 <= y <= frame.height)
        crowds, marks = [], []
        for kind in OUTCOMES:
            some = [number for number in places if outcome(result.per_query[number]) == kind]
            crowd = [number for number in some if number not in linked] if len(places) > SINGLE else []
            if crowd:
                crowds.append(Shapes(kind, _dots(frame.at(places[number]) for number in crowd)))
            for number in sorted(set(some) - set(crowd)):
                mark = QueryMark.of(result.per_query[number], number, linked=number in linked)
                marks.append((mark, *frame.at(places[number])))
        return cls(frame, len(places), _dots(seen), error_lines(frame, result, places), crowds, marks)


def error_lines(frame: Frame, result: Result, places: Mapping[int, Degrees]) -> list[Shapes]:
    """Lines from each query that was answered wrongly to where it was thought to be; many are drawn faintly."""
    lines: dict[Outcome, list[str]] = {}
    for number, here in places.items():
        one = result.per_query[number]
        there = position(result.known[one.matches[0]].where) if one.matches else None
        if there is not None and not one.hit(1):
            (x, y), (to_x, to_y) = frame.at(here), frame.at(there)
            # Cut where it has long left the map: a browser draws every dash of a line to the antipodes.
            cut = min(1.0, 2 * WIDE / max(math.hypot(to_x - x, to_y - y), 1.0))
            line = f"M{x:.1f} {y:.1f}l{(to_x - x) * cut:.1f} {(to_y - y) * cut:.1f}"
            lines.setdefault(outcome(one), []).append(line)
    return [
        Shapes(kind, "".join(lines[kind]), min(0.6, max(0.1, 25 / len(lines[kind]))))
        for kind in OUTCOMES
        if kind in lines
    ]


def _dots(points: Iterable[tuple[float, float]]) -> str:
    """Lines without length, whose round ends are discs: the shortest way to write many."""
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points)


def position(where: Degrees | None) -> Degrees | None:
    """A position that can be drawn: what is not finite, which a hand-made file may hold, is none."""
    return where if where is not None and all(map(math.isfinite, where)) else None


def regions(places: Mapping[int, Degrees]) -> list[list[int]]:
    """Numbers of queries that are near one another, the largest region first; a whole country may be one."""
    cells: dict[tuple[int, int], list[int]] = {}
    for number, (lat, lon) in places.items():
        cells.setdefault((math.floor(lat / REGION_CELL), math.floor(lon / REGION_CELL)), []).append(number)
    found = []
    while cells:
        start = next(iter(cells))
        reached, numbers = [start], cells.pop(start)
        while reached:
            lat, lon = reached.pop()
            near = [(lat + up, lon + right) for up in (-1, 0, 1) for right in (-1, 0, 1)]
            for cell in (cell for cell in near if cell in cells):
                numbers += cells.pop(cell)
                reached.append(cell)
        found.append(sorted(numbers))
    return sorted(found, key=len, reverse=True)


NAMES = 150.0  # units that the rows' names take at the left of the drive
ROW = 26.0  # units of a row's height
CELLS = 120  # in a row at most
ROW_GROUPS = 40  # so many groups have rows of their own; more only stand one after another
LETTERS = 20  # of a row's name
CELL_WIDTH = (3.0, 18.0)  # the least and the most width of a cell in units
CELL_HEIGHT = {"right": 9.0, "wrong": 20.0, "unanswerable": 14.0}


@dataclass(frozen=True, slots=True)
class DriveRow:
    """A row of the drive.

    Attributes:
        name: Of its group, or of its first query.
        middle: From the top, in units.
        length: In units.
        marks: Queries with their shapes, as the data of SVG paths.
        crowds: Shapes of the queries without a mark of their own.
    """

    name: str
    middle: float
    length: float
    marks: Sequence[tuple[QueryMark, str]]
    crowds: Sequence[Shapes]


@dataclass(frozen=True, slots=True)
class Drive:
    """Queries whose places nobody knows, in the order of the drive: one cell a frame, a row or more a group.

    Attributes:
        rows: From the top.
        queries: How many.
    """

    rows: Sequence[DriveRow]
    queries: int
    names, width = NAMES, WIDE

    @property
    def height(self) -> float:
        """In units."""
        return ROW * len(self.rows) + 12

    @classmethod
    def of(cls, result: Result, numbers: Sequence[int], linked: Collection[int]) -> Drive:
        """The drive of the queries with these numbers, from 0; those `linked` have a strip of photos."""
        rows, single = list(drive_rows(result, numbers)), len(numbers) <= SINGLE
        wide = min(max((WIDE - NAMES) / max(len(cells) for _, cells in rows), CELL_WIDTH[0]), CELL_WIDTH[1])
        drawn = []
        for place, (name, cells) in enumerate(rows):
            middle = ROW * (place + 0.5) + 6
            marks, crowds = [], dict.fromkeys(OUTCOMES, "")
            for column, number in enumerate(cells):
                one = result.per_query[number]
                shape = cell_path(outcome(one), NAMES + wide * column, middle, wide)
                if single or number in linked:
                    marks.append((QueryMark.of(one, number, linked=number in linked), shape))
                else:
                    crowds[outcome(one)] += shape
            shapes = [Shapes(kind, path) for kind, path in crowds.items() if path]
            drawn.append(DriveRow(name, middle, wide * len(cells), marks, shapes))
        return cls(drawn, len(numbers))


def drive_rows(result: Result, numbers: Sequence[int]) -> Iterable[tuple[str, Sequence[int]]]:
    """Queries in rows of one length as far as they go, each with a name."""
    results = result.per_query
    frames = along([Path(results[number].query) for number in numbers])
    groups: dict[str | None, list[int]] = {}
    for _, number in sorted(zip(frames, numbers, strict=True)):
        groups.setdefault(results[number].group, []).append(number)
    if len(groups) > ROW_GROUPS:
        groups = {None: [number for _, some in sorted(groups.items(), key=str) for number in some]}
    longest = max(map(len, groups.values()))
    row = math.ceil(longest / math.ceil(longest / CELLS))
    for group, some in groups.items():
        for start in range(0, len(some), row):
            name = results[some[start]].query if group is None else group if not start else ""
            yield name if len(name) <= LETTERS else f"…{name[1 - LETTERS :]}", some[start : start + row]


def cell_path(kind: Outcome, left: float, middle: float, wide: float) -> str:
    """Low where right, high where wrong, hollow where no reference is: colour alone tells nothing to some."""
    high, gap = CELL_HEIGHT[kind], min(1.6, wide / 4)
    inner = wide - gap
    outer = f"M{left:.1f} {middle - high / 2:.1f}h{inner:.1f}v{high:g}h{-inner:.1f}Z"
    if kind != "unanswerable":
        return outer
    # The hole is drawn the other way round, so that it stays empty.
    edge = min(1.6, inner / 4)
    hole, down = inner - 2 * edge, high - 2 * edge
    return f"{outer}M{left + edge:.1f} {middle - high / 2 + edge:.1f}v{down:.1f}h{hole:.1f}v{-down:.1f}Z"
