"""What `salad locate` writes for maps: GeoJSON, KML, and a GPX track."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from salad.files import json_text
from salad.geo import GeoPoint, shifted

if TYPE_CHECKING:
    from salad.localize.locate import Answer
    from salad.localize.voting import Place


CORNERS = 32  # of the polygon that stands for a circle: neither format has circles
# What XML 1.0 has no way to write, not even escaped, and the controls that it has; a file's name may hold both.
_NO_TEXT = re.compile("[^\t\n\x20-\x7e\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def as_geojson(answers: Sequence[Answer]) -> str:
    """Each place as a point, its radius as a polygon, a line to each match; unknown is without geometry."""
    features: list[dict[str, Any]] = []
    for answer in answers:
        query, place = str(answer.query), answer.place
        if place is None:
            features.append(_feature(None, None, query=query, kind="unknown"))
            continue
        here = _lon_lat(place.where, place.where)
        known = {"radius_m": place.radius_m, "confidence": place.confidence, "support": place.support}
        features.append(_feature("Point", here, query=query, kind="place", **known))
        ring = [_lon_lat(corner, place.where) for corner in _ring(place)]
        features.append(_feature("Polygon", [ring], query=query, kind="radius"))
        for match in answer.matches:
            if match.photo.where is not None:
                line = [here, _lon_lat(match.photo.where, place.where)]
                name, score = str(match.photo.path), match.score
                features.append(_feature("LineString", line, query=query, kind="match", match=name, score=score))
    return json_text({"type": "FeatureCollection", "features": features})


def as_kml(answers: Sequence[Answer]) -> str:
    """The same for globes and maps: a folder each for places, radii and matches, which are layers to a GIS."""
    root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ElementTree.SubElement(root, "Document")
    places, radii, matches = (ElementTree.SubElement(document, "Folder") for _ in range(3))
    for folder, name in ((places, "places"), (radii, "radii"), (matches, "matches")):
        _put(folder, "name", name)
    for answer in answers:
        name, place = answer.query.name, answer.place
        if place is None:
            _named(places, name, f"unknown; {answer.query}")
            continue
        known = f"confidence {place.confidence:.2f}, within {place.radius_m:.0f} m, {place.support} matches"
        point = ElementTree.SubElement(_named(places, name, f"{known}; {answer.query}"), "Point")
        _put(point, "coordinates", _kml(place.where, place.where))
        circle = ElementTree.SubElement(_named(radii, name, f"{place.radius_m:.1f} m"), "Polygon")
        outer = ElementTree.SubElement(ElementTree.SubElement(circle, "outerBoundaryIs"), "LinearRing")
        _put(outer, "coordinates", *(_kml(corner, place.where) for corner in _ring(place)))
        for match in answer.matches:
            if match.photo.where is not None:
                told = f"{match.photo.path.name}, score {match.score:.4f}"
                line = ElementTree.SubElement(_named(matches, name, told), "LineString")
                _put(line, "coordinates", _kml(place.where, place.where), _kml(match.photo.where, place.where))
    for folder in (places, radii, matches):
        if folder.find("Placemark") is None:  # a layer of nothing
            document.remove(folder)
    return _as_text(root)


def as_gpx(answers: Sequence[Answer], times: Sequence[datetime | None]) -> str:
    """A track through the places found, unknown ones left out.

    Args:
        answers: In the order given.
        times: Of each query. Where all that are placed have one the track is in the order of time, else in the
            order given. A time without a zone is compared as if it were UTC, and not written: GPX has only UTC.
    """
    stops = [
        (answer.query.name, answer.place, time) for answer, time in zip(answers, times, strict=True) if answer.place
    ]
    # An order of time that holds for some of them only would be no order.
    dated = [(_utc(time), number) for number, (_, _, time) in enumerate(stops) if time is not None]
    if len(dated) == len(stops):
        stops = [stops[number] for _, number in sorted(dated)]
    root = ElementTree.Element("gpx", version="1.1", creator="salad", xmlns="http://www.topografix.com/GPX/1/1")
    track = ElementTree.SubElement(ElementTree.SubElement(root, "trk"), "trkseg")
    for name, place, time in stops:
        lon = round(place.where.lon, 9)
        lon = -180.0 if lon == 180 else lon  # GPX ends just below 180
        point = ElementTree.SubElement(track, "trkpt", lat=f"{place.where.lat:.9f}", lon=f"{lon:.9f}")
        if time is not None and time.tzinfo is not None:
            _put(point, "time", _utc(time).isoformat()[:-6] + "Z")
        _put(point, "name", name)
    return _as_text(root)


def _feature(shape: str | None, coordinates: Any, **properties: Any) -> dict[str, Any]:
    geometry = None if shape is None else {"type": shape, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _lon_lat(point: GeoPoint, near: GeoPoint) -> list[float]:
    """Longitude and latitude as GeoJSON has them; beyond 180 degrees where the date line lies between the two."""
    # RFC 7946 would have such a shape cut in two; maps draw it whole where its longitudes run on.
    return [point.lon + 360 * round((near.lon - point.lon) / 360), point.lat]


def _ring(place: Place) -> list[GeoPoint]:
    """The circle around a place: counter-clockwise and closed, as an outer ring is wanted."""
    ring = []
    for corner in range(CORNERS):
        turn = 2 * math.pi * corner / CORNERS
        ring.append(shifted(place.where, place.radius_m * math.sin(turn), place.radius_m * math.cos(turn)))
    return [*ring, ring[0]]


def _named(folder: ElementTree.Element, name: str, description: str) -> ElementTree.Element:
    """A named place in a folder; its geometry is for the caller to add."""
    mark = ElementTree.SubElement(folder, "Placemark")
    _put(mark, "name", name)
    _put(mark, "description", description)
    return mark


def _kml(point: GeoPoint, near: GeoPoint) -> str:
    lon, lat = _lon_lat(point, near)
    return f"{lon:.9f},{lat:.9f}"  # 0.1 mm


def _utc(time: datetime) -> datetime:
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def _put(parent: ElementTree.Element, name: str, *words: str) -> None:
    """A child with a text; what XML cannot hold, or a terminal obeys, becomes the replacement character."""
    ElementTree.SubElement(parent, name).text = _NO_TEXT.sub("\N{REPLACEMENT CHARACTER}", " ".join(words))


def _as_text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)  # people open these files
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode")
