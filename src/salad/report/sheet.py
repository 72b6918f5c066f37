"""Where queries were right and wrong, as maps in SVG, north up: one a region, since a set may span the earth."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from salad.evaluation.result import Degrees, QueryResult, Result
from salad.geo import EARTH_RADIUS_M, round_metres, told_metres
from salad.report.choosing import OUTCOMES, Outcome, outcome
from salad.report.words import shown

WIDE = 1000.0  # units across a map; the page scales it
SHAPE = (0.42, 0.86)  # the least and the most height, as a part of the width
MARGIN = 0.06  # of the longer side
SMALLEST_M = 40.0  # across a map, where all of it is one place
CELL = 0.25  # degrees: what touches across cells of that size is one region
MAPS = 6  # the regions with the most queries
SINGLE = 4000  # marks that have a name each; more are drawn as one shape a kind
_M_A_DEGREE = math.radians(1) * EARTH_RADIUS_M


@dataclass(frozen=True, slots=True)
class Frame:
    """A map: its middle in degrees, how many units a metre is, and how high it is."""

    middle: Degrees
    scale: float
    height: float

    def at(self, point: Degrees) -> tuple[float, float]:
        """Right and down, in units; a plane is right to a few metres in a town."""
        turn = (point[1] - self.middle[1] + 180) % 360 - 180  # the date line may run through the map
        right = turn * _M_A_DEGREE * math.cos(math.radians(self.middle[0]))
        up = (point[0] - self.middle[0]) * _M_A_DEGREE
        return WIDE / 2 + right * self.scale, self.height / 2 - up * self.scale

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


def position(where: Degrees | None) -> Degrees | None:
    """A position that can be drawn: what is not finite, which a hand-made file may hold, is none."""
    return where if where is not None and all(map(math.isfinite, where)) else None


def regions(places: Mapping[int, Degrees]) -> list[list[int]]:
    """Numbers of queries that are near one another, the largest region first; a whole country may be one."""
    cells: dict[tuple[int, int], list[int]] = {}
    for number, (lat, lon) in places.items():
        cells.setdefault((math.floor(lat / CELL), math.floor(lon / CELL)), []).append(number)
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


def draw_maps(result: Result, places: Mapping[int, Degrees], linked: Collection[int]) -> str:
    """A map of each region; the smallest of very many are counted in words.

    Args:
        result: what to draw.
        places: where each query is, by its number from 0.
        linked: numbers of the queries that have a strip.
    """
    found = regions(places)
    maps = [_map(result, {number: places[number] for number in some}, linked) for some in found[:MAPS]]
    rest = found[MAPS:]
    if rest:
        maps.append(f"<p>{sum(map(len, rest)):,} queries in {len(rest)} smaller regions are not drawn.</p>")
    return "\n".join(maps)


def _map(result: Result, places: Mapping[int, Degrees], linked: Collection[int]) -> str:
    frame = Frame.around(list(places.values()))
    parts = [
        f'<rect class="ground" width="{WIDE:.0f}" height="{frame.height:.1f}"/>',
        _references(frame, result),
        _ways(frame, result, places),
        *_queries(frame, result, places, linked),
        _scale_bar(frame),
        _north_arrow(),
    ]
    return (
        f'<svg class="map" viewBox="0 0 {WIDE:.0f} {frame.height:.1f}" role="group" '
        f'aria-label="Map of {len(places):,} queries">' + "\n".join(parts) + "</svg>"
    )


def _references(frame: Frame, result: Result) -> str:
    """A dot for each reference that was found for some query, once where they cannot be told apart."""
    placed = (where for one in result.known.values() if (where := position(one.where)))
    points = {(round(x, 1), round(y, 1)) for x, y in map(frame.at, placed) if _inside(frame, x, y)}
    return f'<path class="references" d="{_dots(sorted(points))}"/>'


def _ways(frame: Frame, result: Result, places: Mapping[int, Degrees]) -> str:
    """From each query that was answered wrongly to where it was thought to be; many are drawn faintly."""
    ways: dict[Outcome, list[str]] = {kind: [] for kind in OUTCOMES}
    for number, here in places.items():
        one = result.per_query[number]
        there = position(result.known[one.matches[0]].where) if one.matches else None
        if there is not None and not one.hit(1):
            (x, y), (to_x, to_y) = frame.at(here), frame.at(there)
            cut = min(
                1.0, 2 * WIDE / max(math.hypot(to_x - x, to_y - y), 1.0)
            )  # off the map: dashes need no more
            ways[outcome(one)].append(f"M{x:.1f} {y:.1f}l{(to_x - x) * cut:.1f} {(to_y - y) * cut:.1f}")
    seen = {kind: min(0.6, max(0.1, 25 / max(1, len(some)))) for kind, some in ways.items()}
    return "".join(
        f'<path class="way {kind}" stroke-opacity="{seen[kind]:.2f}" d="{"".join(some)}"/>'
        for kind, some in ways.items()
        if some
    )


def _queries(
    frame: Frame, result: Result, places: Mapping[int, Degrees], linked: Collection[int]
) -> Iterable[str]:
    """A mark for each query, the right ones below; very many unnamed ones as one shape a kind."""
    for kind in OUTCOMES:
        some = [number for number in places if outcome(result.per_query[number]) == kind]
        crowd = [number for number in some if number not in linked] if len(places) > SINGLE else []
        if crowd:
            yield f'<path class="crowd {kind}" d="{_dots([frame.at(places[number]) for number in crowd])}"/>'
        for number in some if not crowd else (number for number in some if number in linked):
            x, y = frame.at(places[number])
            yield named(result.per_query[number], number, _mark(kind, x, y), linked=number in linked)


def named(one: QueryResult, number: int, shape: str, *, linked: bool) -> str:
    """A query's mark with what became of it in words, and the way to its strip where it has one."""
    kind = outcome(one)
    said = f"{one.query}: {kind}" + (f", {told_metres(one.metres)} off" if one.metres is not None else "")
    if one.group is not None:
        said += f", {one.group}"
    title = f"<title>{shown(said)}</title>{shape}"
    if not linked:
        return f'<g class="query {kind}">{title}</g>'
    words = f'aria-label="{shown(said)}"'
    return f'<a id="map-{number + 1}" class="query {kind}" href="#query-{number + 1}" {words}>{title}</a>'


def _mark(kind: Outcome, x: float, y: float) -> str:
    """A disc where right, a diamond where wrong, a ring where nothing is: colour alone tells nothing to some."""
    if kind == "wrong":
        return f'<path class="mark" d="M{x:.1f} {y - 9.5:.1f}l9.5 9.5l-9.5 9.5l-9.5 -9.5Z"/>'
    return f'<circle class="mark" cx="{x:.1f}" cy="{y:.1f}" r="{6.5 if kind == "right" else 7}"/>'


def _dots(points: Iterable[tuple[float, float]]) -> str:
    """Lines without length, whose round ends are discs: the shortest way to write many."""
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points)


def _inside(frame: Frame, x: float, y: float) -> bool:
    return 0 <= x <= WIDE and 0 <= y <= frame.height


def _scale_bar(frame: Frame) -> str:
    """A bar of a round number of metres, at most a fifth of the map, in the lower left corner."""
    metres = round_metres(WIDE / 5 / frame.scale)
    length, y = metres * frame.scale, frame.height - 24
    told = f"{metres / 1000:g} km" if metres >= 1000 else f"{metres:g} m"
    return (
        f'<g class="scale"><rect class="plate" x="14" y="{y - 28:.1f}" rx="5" width="{length + 28:.1f}" height="42"/>'
        f'<path d="M28 {y - 5:.1f}v7h{length:.1f}v-7"/>'
        f'<text x="{28 + length / 2:.1f}" y="{y - 8:.1f}">{told}</text></g>'
    )


def _north_arrow() -> str:
    return (
        '<g class="north" role="img" aria-label="North is up" transform="translate(962 44) scale(9)">'
        '<circle class="plate" r="3.2" cy="-.4"/><path d="M0 -2.6L1.15 1.6L0 .8L-1.15 1.6Z"/></g>'
    )
