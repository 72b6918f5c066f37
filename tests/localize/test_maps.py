"""What `salad locate` writes for maps, read back by what reads it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from datetime import UTC, datetime, timedelta, timezone
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import salad
from salad.geo import GeoPoint, metres_between, shifted
from salad.images.photo import Photo
from salad.localize import maps

HERE = GeoPoint(48.1, 11.5)
KML = "{http://www.opengis.net/kml/2.2}"
GPX = "{http://www.topografix.com/GPX/1/1}"

quick = settings(deadline=None, max_examples=40)
points = st.builds(GeoPoint, st.floats(-89.9, 89.9), st.floats(-180, 180))
names = st.text(st.characters(exclude_characters="/\0"), min_size=1).filter(lambda name: name.strip("."))


def answer(
    name: str, where: GeoPoint | None = HERE, *, radius_m: float = 25.0, matched: GeoPoint | None = None
) -> salad.Answer:
    """A photo found at `where`; unknown where that is None. Its best match stands there too, unless told."""
    photo = Photo(Path("/photos") / name, matched or where)
    place = salad.Place(where, radius_m, 0.75, 1) if where else None
    return salad.Answer(Path("queries") / name, place, [salad.Match(photo, 0.9, 0)])


def signed_area(ring: list[list[float]]) -> float:
    """Positive where the ring runs counter-clockwise."""
    return sum(x1 * y2 - x2 * y1 for (x1, y1), (x2, y2) in pairwise(ring)) / 2


# --- GeoJSON -------------------------------------------------------------------------------


@quick
@given(where=points, radius_m=st.floats(1, 5000))
def test_geojson_draws_the_place_and_its_radius(where: GeoPoint, radius_m: float) -> None:
    told = json.loads(maps.as_geojson([answer("a.jpg", where, radius_m=radius_m)]))
    assert told["type"] == "FeatureCollection"
    point, circle, line = told["features"]
    assert point["geometry"] == {"type": "Point", "coordinates": [where.lon, where.lat]}
    assert point["properties"]["radius_m"] == radius_m
    assert line["geometry"]["coordinates"] == [[where.lon, where.lat]] * 2
    assert line["properties"]["score"] == 0.9
    (ring,) = circle["geometry"]["coordinates"]
    assert ring[0] == ring[-1]
    assert len(ring) > 8
    middle = [[lon - where.lon, lat - where.lat] for lon, lat in ring]
    assert all(abs(lon) <= 180 for lon, _ in middle)  # it does not jump round the earth at the date line
    for lon, lat in ring:
        corner = GeoPoint(lat, (lon + 180) % 360 - 180)
        assert metres_between(where, corner) == pytest.approx(radius_m, rel=1e-3, abs=1e-3)


@quick
@given(where=st.builds(GeoPoint, st.floats(-80, 80), st.floats(-180, 180)))
def test_a_ring_runs_counter_clockwise(where: GeoPoint) -> None:
    told = json.loads(maps.as_geojson([answer("a.jpg", where)]))
    (ring,) = told["features"][1]["geometry"]["coordinates"]
    centred = [[lon - where.lon, lat - where.lat] for lon, lat in ring]
    assert signed_area(centred) > 0


def test_geojson_of_an_unknown_place_has_no_geometry() -> None:
    told = json.loads(maps.as_geojson([answer("a.jpg", None), answer("b.jpg")]))
    assert [(feature["geometry"] or {}).get("type") for feature in told["features"]] == [
        None,
        "Point",
        "Polygon",
        "LineString",
    ]
    assert told["features"][0]["properties"] == {"query": str(Path("queries/a.jpg")), "kind": "unknown"}
    assert all(feature["type"] == "Feature" for feature in told["features"])


def test_geojson_of_nothing_is_an_empty_collection() -> None:
    assert json.loads(maps.as_geojson([])) == {"type": "FeatureCollection", "features": []}


def test_a_line_to_a_match_runs_on_over_the_date_line() -> None:
    edge = GeoPoint(-16.8, 179.999)
    told = json.loads(maps.as_geojson([answer("a.jpg", edge, matched=shifted(edge, 0, 500))]))
    (start, end) = told["features"][2]["geometry"]["coordinates"]
    assert start == [edge.lon, edge.lat]
    assert 180 < end[0] < 180.01


def test_a_match_of_unknown_position_has_no_line() -> None:
    lost = salad.Answer(Path("a.jpg"), answer("a.jpg").place, [salad.Match(Photo(Path("/b.jpg")), 0.9, 0)])
    assert len(json.loads(maps.as_geojson([lost]))["features"]) == 2
    assert len(list(ElementTree.fromstring(maps.as_kml([lost])).iter(f"{KML}Placemark"))) == 2


# --- KML -----------------------------------------------------------------------------------


def corners(shape: ElementTree.Element | None) -> list[GeoPoint]:
    """What stands in a shape's coordinates."""
    assert shape is not None
    text = next(shape.iter(f"{KML}coordinates")).text or ""
    pairs = [(float(lon), float(lat)) for lon, lat in (pair.split(",") for pair in text.split(" "))]
    if all(abs(lat) < 80 for _, lat in pairs):  # a circle around a pole goes round the earth
        assert all(abs(one[0] - other[0]) <= 180 for one, other in pairwise(pairs))
    return [GeoPoint(lat, (lon + 180) % 360 - 180 if abs(lon) > 180 else lon) for lon, lat in pairs]


@quick
@given(where=points, matched=points, radius_m=st.floats(1, 5000), name=names)
def test_kml_holds_what_was_found(where: GeoPoint, matched: GeoPoint, radius_m: float, name: str) -> None:
    text = maps.as_kml([answer(name, where, radius_m=radius_m, matched=matched)])
    root = ElementTree.fromstring(text.encode())
    place, circle, line = root.iter(f"{KML}Placemark")
    (found,) = corners(place.find(f"{KML}Point"))
    assert metres_between(found, where) < 0.001
    ring = corners(circle.find(f"{KML}Polygon"))
    assert ring[0] == ring[-1]
    assert all(metres_between(where, corner) == pytest.approx(radius_m, abs=0.01) for corner in ring)
    assert metres_between(corners(line.find(f"{KML}LineString"))[1], matched) < 0.001
    assert "0.75" in (place.findtext(f"{KML}description") or "")


@quick
@given(name=names)
def test_any_name_makes_xml_that_parses(name: str) -> None:
    kml = ElementTree.fromstring(maps.as_kml([answer(name)]).encode())
    gpx = ElementTree.fromstring(maps.as_gpx([answer(name)], [None]).encode())
    shown = [kml.findtext(f".//{KML}Placemark/{KML}name"), gpx.findtext(f".//{GPX}name")]
    assert all(len(each or "") == len(name) for each in shown)
    if name.isprintable():
        assert shown == [name, name]


def test_kml_says_unknown() -> None:
    root = ElementTree.fromstring(maps.as_kml([answer("a.jpg", None)]))
    assert [mark.findtext(f"{KML}name") for mark in root.iter(f"{KML}Placemark")] == ["a.jpg"]
    assert "unknown" in (root.findtext(f".//{KML}description") or "")
    assert not list(root.iter(f"{KML}coordinates"))


def test_many_photos_are_three_layers_of_kml_and_no_more() -> None:
    answers = [answer(f"{number}.jpg") for number in range(8)] + [answer("lost.jpg", None)]
    root = ElementTree.fromstring(maps.as_kml(answers))
    layers = {
        folder.findtext(f"{KML}name"): len(folder.findall(f"{KML}Placemark")) for folder in root.iter(f"{KML}Folder")
    }
    assert layers == {"places": 9, "radii": 8, "matches": 8}
    assert not list(ElementTree.fromstring(maps.as_kml([])).iter(f"{KML}Folder"))


@pytest.mark.skipif(shutil.which("ogrinfo") is None, reason="GDAL is not installed")
def test_what_gdal_shows_of_kml(tmp_path: Path) -> None:
    edge = GeoPoint(-16.8, 179.999)
    path = tmp_path / "found.kml"
    path.write_text(maps.as_kml([answer(f"{n}.jpg", edge, matched=shifted(edge, 0, 500)) for n in range(8)]))
    said = subprocess.run(["ogrinfo", "-ro", "-al", "-so", path], capture_output=True, text=True, check=True).stdout
    assert re.findall(r"Layer name: (\w+)", said) == ["places", "radii", "matches"]
    assert re.findall(r"Feature Count: (\d+)", said) == ["8"] * 3
    extents = re.findall(r"Extent: \((\S+), \S+\) - \((\S+), ", said)
    assert all(abs(float(east) - float(west)) < 1 for west, east in extents)  # in one piece over the date line


# --- GPX -----------------------------------------------------------------------------------


def track(answers: list[salad.Answer], times: list[datetime | None]) -> list[tuple[str, GeoPoint, str | None]]:
    """Name, place and time of each point of the track that is written."""
    root = ElementTree.fromstring(maps.as_gpx(answers, times))
    assert root.get("version") == "1.1"
    return [
        (
            point.findtext(f"{GPX}name") or "",
            GeoPoint(float(point.attrib["lat"]), float(point.attrib["lon"])),
            point.findtext(f"{GPX}time"),
        )
        for point in root.iter(f"{GPX}trkpt")
    ]


@quick
@given(st.lists(st.tuples(points, st.datetimes(datetime(1990, 1, 1), datetime(2090, 1, 1))), max_size=6))
def test_a_track_is_in_the_order_of_time(stops: list[tuple[GeoPoint, datetime]]) -> None:
    found = track([answer(str(n), where) for n, (where, _) in enumerate(stops)], [time for _, time in stops])
    expected = sorted(range(len(stops)), key=lambda n: stops[n][1])
    assert [int(name) for name, _, _ in found] == expected
    for name, where, time in found:
        assert metres_between(where, stops[int(name)][0]) < 0.001
        assert -180 <= where.lon < 180  # as its schema has it
        assert time is None  # of a clock whose zone nobody knows


def test_without_a_time_the_order_given_stays() -> None:
    late, early = datetime(2024, 5, 2), datetime(2024, 5, 1)
    found = track([answer("late"), answer("never"), answer("early")], [late, None, early])
    assert [(name, time) for name, _, time in found] == [
        ("late", None),
        ("never", None),
        ("early", None),
    ]


def test_times_with_a_zone_are_told_in_utc_and_unknown_places_are_left_out() -> None:
    east = timezone(timedelta(hours=2))
    found = track(
        [answer("b"), answer("lost", None), answer("a")],
        [datetime(2024, 5, 1, 13, tzinfo=UTC), None, datetime(2024, 5, 1, 14, tzinfo=east)],
    )
    assert [(name, time) for name, _, time in found] == [
        ("a", "2024-05-01T12:00:00Z"),
        ("b", "2024-05-01T13:00:00Z"),
    ]
