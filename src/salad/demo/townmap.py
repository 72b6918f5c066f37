"""The demo's map as SVG, in metres, north up: streets, houses, references, and every query's two positions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from itertools import chain

from salad.demo.report import distance
from salad.demo.result import DemoResult, Judged
from salad.geo import EARTH_RADIUS_M, GeoPoint, round_metres
from salad.images.photo import read_photo

MARGIN_M = 9.0
TINTS = 4  # of house roofs


@dataclass(frozen=True, slots=True)
class Frame:
    """Where points of the earth fall on the map: metres right of and below its north-west corner."""

    origin: GeoPoint
    width: float
    height: float

    @property
    def unit(self) -> float:
        """A hundredth of the map's longer side: what marks and letters are measured in, whatever the town."""
        return max(self.width, self.height) / 100

    def at(self, point: GeoPoint) -> tuple[float, float]:
        """Right and down, in metres; a plane is right to millimetres in a town."""
        metres_a_degree = math.radians(1) * EARTH_RADIUS_M
        right = (point.lon - self.origin.lon) * metres_a_degree * math.cos(math.radians(self.origin.lat))
        return right, (self.origin.lat - point.lat) * metres_a_degree

    @classmethod
    def around(cls, points: Sequence[GeoPoint]) -> Frame:
        """A frame that holds all the points, with a margin."""
        north_west = GeoPoint(max(p.lat for p in points), min(p.lon for p in points))
        south_east = GeoPoint(min(p.lat for p in points), max(p.lon for p in points))
        across, down = cls(north_west, 0, 0).at(south_east)
        a_degree = math.radians(1) * EARTH_RADIUS_M
        corner = GeoPoint(
            north_west.lat + MARGIN_M / a_degree,
            north_west.lon - MARGIN_M / (a_degree * math.cos(math.radians(north_west.lat))),
        )
        return cls(corner, across + 2 * MARGIN_M, down + 2 * MARGIN_M)


def draw_map(result: DemoResult) -> str:
    """The whole map, one `<svg>`; each query is a link to its strip, `#query-N`."""
    town = result.town
    found = (one.answer.place.where for one in result.judged if one.answer.place)
    frame = Frame.around([*chain.from_iterable(town.streets + town.blocks), *town.truth.values(), *found])
    parts = [
        f'<rect class="ground" width="{frame.width:.1f}" height="{frame.height:.1f}"/>',
        _streets(frame, town.streets),
        _houses(frame, town.blocks),
        _references(frame, result),
        '<g class="queries">',
        *(_query(frame, number, one) for number, one in enumerate(result.judged, 1)),
        "</g>",
        _scale_bar(frame),
        _north_arrow(frame),
    ]
    size = f"0 0 {frame.width:.1f} {frame.height:.1f}"
    label = f"Map of the town with {result.queries} queries, their true and their found positions"
    return (
        f'<svg class="map" viewBox="{size}" role="group" aria-label="{label}" '
        f'style="--u:{frame.unit:.3f}px">' + "\n".join(parts) + "</svg>"
    )


def _streets(frame: Frame, streets: Iterable[Sequence[GeoPoint]]) -> str:
    """Every street three times: all pavements first, so that crossings stay open, then asphalt, then its line."""
    lines = "".join(f'<path d="M{_points(frame, street)}"/>' for street in streets)
    return "".join(f'<g class="{layer}">{lines}</g>' for layer in ("pavement", "asphalt", "midline"))


def _houses(frame: Frame, blocks: Iterable[Sequence[GeoPoint]]) -> str:
    shapes = [_points(frame, block) for block in blocks]
    shadows = "".join(f'<path d="M{shape}Z"/>' for shape in shapes)
    roofs = "".join(f'<path class="t{n * 7 % TINTS}" d="M{shape}Z"/>' for n, shape in enumerate(shapes))
    return f'<g class="shadows" transform="translate(1 1.2)">{shadows}</g><g class="houses">{roofs}</g>'


def _references(frame: Frame, result: DemoResult) -> str:
    """A dot for each reference, and a tick to where it looked."""
    marks = []
    for path in result.town.references:
        photo = read_photo(path)
        if photo.where is None:
            continue
        x, y = frame.at(photo.where)
        if photo.heading is not None:
            turn = math.radians(photo.heading)
            reach = 1.5 * frame.unit
            marks.append(
                f'<path d="M{x:.1f} {y:.1f}l{reach * math.sin(turn):.1f} {-reach * math.cos(turn):.1f}"/>'
            )
        marks.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{0.42 * frame.unit:.2f}"/>')
    return f'<g class="references">{"".join(marks)}</g>'


def _query(frame: Frame, number: int, one: Judged) -> str:
    """A link with the true position, the found one with its radius, and the line between them."""
    unit, (x, y) = frame.unit, frame.at(one.truth)
    shapes = []
    if place := one.answer.place:
        at_x, at_y = frame.at(place.where)
        shapes += [
            f'<circle class="radius" cx="{at_x:.1f}" cy="{at_y:.1f}" r="{place.radius_m:.1f}"/>',
            f'<path class="off" d="M{x:.1f} {y:.1f}L{at_x:.1f} {at_y:.1f}"/>',
            f'<circle class="truth" cx="{x:.1f}" cy="{y:.1f}" r="{0.85 * unit:.2f}"/>',
            _found(at_x, at_y, unit, right=one.verdict == "right"),
        ]
    else:
        shapes += [
            f'<circle class="truth" cx="{x:.1f}" cy="{y:.1f}" r="{1.05 * unit:.2f}"/>',
            f'<text class="mark" x="{x:.1f}" y="{y + 0.6 * unit:.1f}" font-size="{1.7 * unit:.1f}">?</text>',
        ]
    shapes.append(f'<circle class="reach" cx="{x:.1f}" cy="{y:.1f}" r="{2 * unit:.1f}"/>')
    said = f"{one.answer.query.name}, {one.condition}: {_said(one)}"
    return (
        f'<a id="map-{number}" class="query {one.verdict}" href="#query-{number}" data-n="{number}" '
        f'data-condition="{escape(one.condition)}" data-verdict="{one.verdict}" aria-label="{escape(said)}">'
        f"<title>{escape(said)}</title>{''.join(shapes)}</a>"
    )


def _said(one: Judged) -> str:
    return "unknown" if one.error_m is None else f"{one.verdict}, {distance(one.error_m)} off"


def _found(x: float, y: float, unit: float, *, right: bool) -> str:
    """A disc where right, a diamond where wrong: colour alone tells nothing to some."""
    if right:
        return f'<circle class="found" cx="{x:.1f}" cy="{y:.1f}" r="{0.85 * unit:.2f}"/>'
    r = 1.15 * unit
    return (
        f'<path class="found" d="M{x:.1f} {y - r:.1f}l{r:.1f} {r:.1f}l{-r:.1f} {r:.1f}l{-r:.1f} {-r:.1f}Z"/>'
    )


def _scale_bar(frame: Frame) -> str:
    """A bar of a round number of metres, about a fifth of the map, in the lower left corner."""
    length = round_metres(frame.width / 5)
    unit, half = frame.unit, length / 2
    x, y = 2.6 * unit, frame.height - 2.8 * unit
    texts = "".join(
        f'<text x="{x + step:.1f}" y="{y - 0.9 * unit:.1f}" font-size="{1.9 * unit:.1f}">{step:g}{mark}</text>'
        for step, mark in ((0, ""), (half, ""), (length, " m"))
    )
    plate = (
        f'<rect class="plate" x="{x - 1.6 * unit:.1f}" y="{y - 3.6 * unit:.1f}" rx="{0.5 * unit:.1f}" '
        f'width="{length + 4.6 * unit:.1f}" height="{5.2 * unit:.1f}"/>'
    )
    bars = "".join(
        f'<rect class="{kind}" x="{x + start:.1f}" y="{y:.1f}" width="{half:.1f}" height="{0.7 * unit:.2f}"/>'
        for kind, start in (("full", 0.0), ("hollow", half))
    )
    return f'<g class="scale" role="img" aria-label="Scale bar of {length:g} metres">{plate}{bars}{texts}</g>'


def _north_arrow(frame: Frame) -> str:
    unit = frame.unit
    return (
        f'<g class="north" role="img" aria-label="North is up" '
        f'transform="translate({frame.width - 4.2 * unit:.1f} {5.2 * unit:.1f}) scale({unit:.3f})">'
        '<circle class="plate" r="3.2" cy="-0.4"/><path class="full" d="M0 -2.6L1.15 1.6L0 .8Z"/>'
        '<path class="hollow" d="M0 -2.6L-1.15 1.6L0 .8Z"/></g>'
    )


def _points(frame: Frame, shape: Sequence[GeoPoint]) -> str:
    return "L".join(f"{x:.1f} {y:.1f}" for x, y in map(frame.at, shape))
