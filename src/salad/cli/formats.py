"""What `salad locate` writes: a table for people, JSON, GeoJSON for maps, CSV for spreadsheets."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from salad.geo import shifted

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from salad.place import Answer, Place

CORNERS = 32  # of the polygon that stands for a circle
COLUMNS = ("query", "lat", "lon", "radius_m", "confidence", "support", "best_match", "best_score")


def as_json(answers: Sequence[Answer]) -> str:
    """One object a query."""
    return json.dumps([answer.as_dict() for answer in answers], ensure_ascii=False, indent=2)


def as_csv(answers: Sequence[Answer]) -> str:
    """One line a query; an unknown place leaves its fields empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for answer in answers:
        place, best = answer.place, answer.matches[0] if answer.matches else None
        found: list[Any] = [""] * 5
        if place:
            found = [*_degrees(place), f"{place.radius_m:.1f}", f"{place.confidence:.3f}", place.support]
        matched = [best.photo.path, f"{best.score:.4f}"] if best else ["", ""]
        writer.writerow([answer.query, *found, *matched])
    return text.getvalue().removesuffix("\n")


def as_geojson(answers: Sequence[Answer]) -> str:
    """For each place found a point and its radius as a polygon; an unknown place is a feature without geometry."""
    features = [feature for answer in answers for feature in _features(answer)]
    return json.dumps({"type": "FeatureCollection", "features": features}, ensure_ascii=False, indent=2)


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


def _cell(name: str) -> Text:
    """A name as it is, brackets and all, but for what a terminal would obey or cannot show."""
    from rich.text import Text

    shown = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name)
    return Text(shown, no_wrap=True, overflow="ellipsis")


def _degrees(place: Place) -> list[str]:
    return [f"{place.where.lat:.6f}", f"{place.where.lon:.6f}"]  # 0.1 m


def _features(answer: Answer) -> list[dict[str, Any]]:
    told = answer.as_dict()
    place = answer.place
    if place is None:
        return [_feature(None, {"query": told["query"], "kind": "unknown"})]
    facts = {key: told["place"][key] for key in ("radius_m", "confidence", "support")}
    point = {"type": "Point", "coordinates": [place.where.lon, place.where.lat]}
    return [
        _feature(point, {"query": told["query"], "kind": "place", **facts}),
        _feature(_circle(place), {"query": told["query"], "kind": "radius"}),
    ]


def _feature(geometry: dict[str, Any] | None, properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _circle(place: Place) -> dict[str, Any]:
    """Counter-clockwise and closed, as GeoJSON wants an outer ring; it runs on over the date line, uncut."""
    turns = (2 * math.pi * corner / CORNERS for corner in range(CORNERS))
    ring = [
        shifted(place.where, place.radius_m * math.sin(turn), place.radius_m * math.cos(turn))
        for turn in turns
    ]
    points = [[_beside(place.where.lon, point.lon), point.lat] for point in (*ring, ring[0])]
    return {"type": "Polygon", "coordinates": [points]}


def _beside(middle: float, lon: float) -> float:
    """The same longitude, less than half a turn from `middle`."""
    return lon + 360 * round((middle - lon) / 360)
