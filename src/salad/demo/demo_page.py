"""The demo's page: the figures, the map of the town with true and found positions, and a strip for every query."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from salad.demo.demo_result import VERDICTS, WITHIN_M, DemoResult, Judged
from salad.geo import GeoPoint, told_metres
from salad.images.photo import read_photo
from salad.report.map import Frame, QueryMark
from salad.report.page import render
from salad.report.strips import CaptionPart, Figure, Strip, Thumbnails

if TYPE_CHECKING:
    from salad.index.index import Match
    from salad.models.describer import DescriberLike

BEST = 3  # references shown beside a query
# Pixels of photos' longer sides: twice of what the page shows, for fine screens.
QUERY_SIDE, REFERENCE_SIDE = 480, 320


def draw_demo_page(result: DemoResult, model: DescriberLike | None = None) -> str:
    """The page as text.

    Args:
        result: What to show.
        model: Draws the dustbin and the clusters over the photos; without it, or without a dustbin, the page
            shows the photos alone.

    Raises:
        PhotoError: If a reference of the town cannot be read.
    """
    # The strips come first: they open the photos, and only then is it known what the dustbin takes of them.
    thumbnails = Thumbnails(model, clusters=True)
    strips = [_strip(number, one, thumbnails) for number, one in enumerate(result.judged, 1)]
    return render(
        "demo.html.j2",
        result=result,
        within_m=WITHIN_M,
        town_map=town_map(result),
        verdicts={verdict: result.count(verdict) for verdict in VERDICTS},
        dustbin=thumbnails.dustbin,
        strips=strips,
    )


class FoundMark(NamedTuple):
    """Where a query was found, and the radius of that, in units of the map."""

    x: float
    y: float
    radius: float


class TownMark(NamedTuple):
    """A query: its words, its true place in units of the map, where it was found if anywhere, data for the script."""

    mark: QueryMark
    x: float
    y: float
    found: FoundMark | None
    data: dict[str, object]


@dataclass(frozen=True, slots=True)
class TownMap:
    """What the map shows; lines and outlines are the data of SVG paths.

    Attributes:
        frame: Where things fall on it.
        streets: Their middle lines.
        houses: Their outlines.
        references: Where each stands, and where it looks from there, if that is known; in units.
        queries: The later photos.
    """

    frame: Frame
    streets: Sequence[str]
    houses: Sequence[str]
    references: Sequence[tuple[float, float, tuple[float, float] | None]]
    queries: Sequence[TownMark]


def town_map(result: DemoResult) -> TownMap:
    """The whole map; each query on it leads to its strip."""
    town = result.town
    # Wrong answers count too: what is found outside the town must still be on its map.
    found = (one.answer.place.where for one in result.judged if one.answer.place)
    corners = [*chain.from_iterable(town.streets + town.blocks), *town.truth.values(), *found]
    frame = Frame.around([_degrees(point) for point in corners])
    references: list[tuple[float, float, tuple[float, float] | None]] = []
    for path in town.references:
        photo = read_photo(path)
        if photo.where is not None:
            looks = None
            if photo.heading is not None:
                turn = math.radians(photo.heading)
                # A tick of 15 units; north is up, and an SVG's y grows downwards.
                looks = (15 * math.sin(turn), -15 * math.cos(turn))
            references.append((*frame.at(_degrees(photo.where)), looks))
    queries = []
    for number, one in enumerate(result.judged, 1):
        verdict = "unknown" if one.error_m is None else f"{one.verdict}, {told_metres(one.error_m)} off"
        place = one.answer.place
        queries.append(
            TownMark(
                QueryMark(number, one.verdict, f"{one.answer.query.name}, {one.condition}: {verdict}"),
                *frame.at(_degrees(one.truth)),
                FoundMark(*frame.at(_degrees(place.where)), place.radius_m * frame.scale) if place else None,
                _data(number, one),
            )
        )
    return TownMap(
        frame,
        streets=[frame.path(map(_degrees, street)) for street in town.streets],
        houses=[frame.path(map(_degrees, block)) + "Z" for block in town.blocks],
        references=references,
        queries=queries,
    )


def _data(number: int, one: Judged) -> dict[str, object]:
    """What the page's script knows of a query: it lights its mark and its strip together, and filters both."""
    return {"data-n": number, "data-condition": one.condition, "data-verdict": one.verdict}


def _degrees(point: GeoPoint) -> tuple[float, float]:
    return point.lat, point.lon


def _strip(number: int, one: Judged, thumbnails: Thumbnails) -> Strip:
    """A query, what the model made of it, and its best references."""
    query = one.answer.query
    figures = [
        Figure(
            "query-photo",
            thumbnails.of(query, query.name, side=QUERY_SIDE),
            f"Query {query.name}, taken in this light: {one.condition}",
            caption=(CaptionPart(f"taken at {coordinates(one.truth)}"),),
        ),
        *(_reference(one, match, thumbnails) for match in one.answer.matches[:BEST]),
    ]
    # An index without references still finds nothing: the strip says so where the photos would stand.
    if len(figures) == 1:
        figures.append(Figure("reference", None, "no references"))
    place = one.answer.place
    facts = [("Found", "unknown: the matches disagree, or score too low", "")]
    if place is not None:
        facts = [
            ("Found", coordinates(place.where), f"± {told_metres(place.radius_m)}"),
            ("Confidence", f"{place.confidence:.2f}", ""),
            ("Support", f"{place.support} of {len(one.answer.matches)} matches", ""),
        ]
    return Strip(
        number,
        one.verdict,
        "unknown" if one.error_m is None else f"{told_metres(one.error_m)} off",
        query.name,
        figures,
        aside=one.condition,
        facts=facts,
        data=_data(number, one),
    )


def _reference(one: Judged, match: Match, thumbnails: Thumbnails) -> Figure:
    off, name = one.off_by(match), match.photo.path.name
    # A reference is judged as the answer is: right where it stands within the same metres of the truth.
    kind = "plain" if off is None else "right" if off <= WITHIN_M else "wrong"
    away = "position unknown" if off is None else f"{told_metres(off)} away"
    score = CaptionPart(f"{match.score:.2f}", "score", "how alike; 1 is the same picture")
    return Figure(
        f"reference {kind}",
        thumbnails.of(match.photo.path, name, side=REFERENCE_SIDE),
        f"Reference {name}, {away}, score {match.score:.2f}",
        caption=(score, CaptionPart(away, "away")),
    )


def coordinates(point: GeoPoint) -> str:
    """Degrees to about a metre, with their hemisphere."""
    north, east = "NS"[point.lat < 0], "EW"[point.lon < 0]
    return f"{abs(point.lat):.5f}° {north}, {abs(point.lon):.5f}° {east}"
