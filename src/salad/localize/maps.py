"""What `salad locate` writes for maps: GeoJSON, KML, and a GPX track."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from salad.geo import GeoPoint, shifted

if TYPE_CHECKING:
    from salad.localize.locate import Answer
    from salad.localize.voting import Place


CORNERS = 32  # of the polygon that stands for a circle
_NOT_XML = re.compile("[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def as_geojson(answers: Sequence[Answer]) -> str:
    """Each place as a point, its radius as a polygon, a line to each match; unknown is without geometry."""
    features = [feature for answer in answers for feature in _features(answer)]
    return json.dumps({"type": "FeatureCollection", "features": features}, ensure_ascii=False, indent=2)


def as_kml(answers: Sequence[Answer]) -> str:
    """The same for globes: a folder a query."""
    root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ElementTree.SubElement(root, "Document")
    for answer in answers:
        folder = ElementTree.SubElement(document, "Folder")
        _put(folder, "name", answer.query.name)
        _put(folder, "description", str(answer.query))
        _draw(folder, answer)
    return _as_text(root)


def as_gpx(answers: Sequence[Answer], times: Sequence[datetime | None]) -> str:
    """A track through the places found, unknown ones left out.

    Args:
        answers: in the order given.
        times: of each query. Where all that are placed have one the track is in the order of time, else in the
            order given. A time without a zone is written without one, and compared as if it were UTC.
    """
    stops = [(answer, time) for answer, time in zip(answers, times, strict=True) if answer.place]
    dated = [(stop, time) for stop, time in stops if time is not None]
    if len(dated) == len(stops):
        stops = sorted(dated, key=lambda stop: _utc(stop[1]))  # type: ignore[arg-type]  # all have a time here
    root = ElementTree.Element(
        "gpx", version="1.1", creator="salad", xmlns="http://www.topografix.com/GPX/1/1"
    )
    track = ElementTree.SubElement(ElementTree.SubElement(root, "trk"), "trkseg")
    for answer, time in stops:
        if answer.place:
            _stop(track, answer.query.name, answer.place, time)
    return _as_text(root)


# --- GeoJSON -------------------------------------------------------------------------------


def _features(answer: Answer) -> Iterator[dict[str, Any]]:
    told = answer.as_dict()
    place, query = answer.place, told["query"]
    if place is None:
        yield _feature(None, None, {"query": query, "kind": "unknown"})
        return
    facts = {key: told["place"][key] for key in ("radius_m", "confidence", "support")}
    yield _feature("Point", _beside(place.where, place.where), {"query": query, "kind": "place", **facts})
    ring = [_beside(place.where, corner) for corner in _ring(place)]
    yield _feature("Polygon", [ring], {"query": query, "kind": "radius"})
    for match in answer.matches:
        if match.photo.where is not None:
            line = [_beside(place.where, end) for end in (place.where, match.photo.where)]
            facts = {"match": str(match.photo.path), "score": match.score}
            yield _feature("LineString", line, {"query": query, "kind": "match", **facts})


def _feature(kind: str | None, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    geometry = None if kind is None else {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _beside(middle: GeoPoint, point: GeoPoint) -> list[float]:
    """Longitude and latitude as GeoJSON has them; what crosses the date line runs on over it, uncut."""
    return [point.lon + 360 * round((middle.lon - point.lon) / 360), point.lat]


def _ring(place: Place) -> list[GeoPoint]:
    """The circle around a place: counter-clockwise and closed, as an outer ring is wanted."""
    ring = []
    for corner in range(CORNERS):
        turn = 2 * math.pi * corner / CORNERS
        ring.append(shifted(place.where, place.radius_m * math.sin(turn), place.radius_m * math.cos(turn)))
    return [*ring, ring[0]]


# --- KML and GPX ---------------------------------------------------------------------------


def _draw(folder: ElementTree.Element, answer: Answer) -> None:
    place = answer.place
    if place is None:
        _put(ElementTree.SubElement(folder, "Placemark"), "name", "unknown")
        return
    told = f"confidence {place.confidence:.2f}, within {place.radius_m:.0f} m, {place.support} matches"
    _put(_mark(folder, answer.query.name, told, "Point"), "coordinates", _kml(place.where))
    circle = _mark(folder, "radius", f"{place.radius_m:.1f} m", "Polygon")
    outer = ElementTree.SubElement(ElementTree.SubElement(circle, "outerBoundaryIs"), "LinearRing")
    _put(outer, "coordinates", *map(_kml, _ring(place)))
    for match in answer.matches:
        if match.photo.where is not None:
            line = _mark(folder, match.photo.path.name, f"score {match.score:.4f}", "LineString")
            _put(line, "coordinates", _kml(place.where), _kml(match.photo.where))


def _mark(folder: ElementTree.Element, name: str, told: str, kind: str) -> ElementTree.Element:
    mark = ElementTree.SubElement(folder, "Placemark")
    _put(mark, "name", name)
    _put(mark, "description", told)
    return ElementTree.SubElement(mark, kind)


def _kml(point: GeoPoint) -> str:
    return f"{point.lon:.9f},{point.lat:.9f}"  # 0.1 mm


def _stop(track: ElementTree.Element, name: str, place: Place, time: datetime | None) -> None:
    lon = round(place.where.lon, 9)
    lon = -180.0 if lon == 180 else lon  # GPX ends just below 180
    point = ElementTree.SubElement(track, "trkpt", lat=f"{place.where.lat:.9f}", lon=f"{lon:.9f}")
    if time is not None:
        _put(point, "time", time.isoformat() if time.tzinfo is None else _utc(time).isoformat()[:-6] + "Z")
    _put(point, "name", name)


def _utc(time: datetime) -> datetime:
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def _put(parent: ElementTree.Element, name: str, *words: str) -> None:
    """A child with a text; letters that XML cannot hold become the replacement character."""
    ElementTree.SubElement(parent, name).text = _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", " ".join(words))


def _as_text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode")
