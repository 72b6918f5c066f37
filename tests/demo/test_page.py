"""The demo's page: whole, self-contained, safe, and true to the result."""

import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pages import Page, Sharing
from salad.demo.page import draw_page, write_page
from salad.demo.result import DemoResult
from salad.demo.strips import coordinates
from salad.demo.townmap import Frame, draw_map
from salad.errors import BenchmarkError
from salad.geo import EARTH_RADIUS_M, GeoPoint, metres_between, round_metres, shifted
from salad.models.fake import FakeDescriber

Result = Callable[..., DemoResult]


def test_the_page_is_whole_and_fetches_nothing(outcome: Result) -> None:
    text = draw_page(outcome(), Sharing())
    page = Page(text)
    assert not re.search(r"https?://|//[a-z]+\.|@import|url\(", text)
    for tag, attrs in page.tags:
        for name in ("src", "href"):
            assert (attrs.get(name) or "#").startswith(("#", "data:")), (tag, attrs)
    policy = next(a["content"] for a in page.all("meta") if a.get("http-equiv"))
    assert policy is not None
    assert "default-src 'none'" in policy


def test_every_query_has_a_strip_and_a_mark_that_point_at_each_other(outcome: Result) -> None:
    result = outcome({"night": [3.0, None], "fog": [80.0]})
    page = Page(draw_page(result))
    strips, marks = page.all("article", "strip"), page.all("a", "query")
    for found in (strips, marks):
        assert [one["data-verdict"] for one in found] == ["right", "unknown", "wrong"]
        assert [one["data-condition"] for one in found] == ["night", "night", "fog"]
    ids = Counter(attrs["id"] for _, attrs in page.tags if "id" in attrs)
    assert max(ids.values()) == 1
    for _, attrs in page.tags:
        target = attrs.get("href") or ""
        assert not target.startswith("#") or target[1:] in ids
    said = page.said
    assert all(one.answer.query.name in said for one in result.judged)
    assert "80 m off" in said


def test_every_photo_is_told_in_words_and_layers_are_not(outcome: Result) -> None:
    page = Page(draw_page(outcome(), Sharing()))
    photos = [attrs for attrs in page.all("img") if "layer" not in (attrs.get("class") or "")]
    layers = page.all("img", "layer")
    assert len(photos) == 3 * (1 + 3)
    assert len(layers) == 2 * len(photos)
    assert all(len(attrs["alt"] or "") > 10 for attrs in photos)
    assert all(attrs["alt"] == "" for attrs in layers)


def test_without_a_dustbin_photos_stand_alone(outcome: Result) -> None:
    for model in (None, FakeDescriber()):
        page = Page(draw_page(outcome(), model))
        assert page.all("html")[0]["data-view"] == "photo"
        assert not page.all("input")
        assert not page.all("img", "layer")
    with_one = Page(draw_page(outcome(), Sharing()))
    assert with_one.all("html")[0]["data-view"] == "dustbin"
    assert [attrs["value"] for attrs in with_one.all("input", name="view")] == [
        "photo",
        "dustbin",
        "clusters",
    ]


def test_hostile_names_stay_text(outcome: Result) -> None:
    name = "<script>alert({})<script> \"onload='x' & $title ${{css}}.jpg"
    model, condition = "</style><img onerror=x>", "\"><b>night</b>'&"
    result = outcome({condition: [3.0]}, name=name, model=model)
    page = Page(draw_page(result))
    said = page.said
    assert result.town.queries[0].name in said
    assert model in said
    assert condition in said
    assert len(page.all("script")) == len(page.all("style")) == 1
    assert not any("onload" in attrs or "onerror" in attrs for _, attrs in page.tags)
    assert page.all("article")[0]["data-condition"] == condition
    assert condition in [attrs.get("data-condition") for attrs in page.all("button")]


def test_filters_count_what_they_show(outcome: Result) -> None:
    page = Page(draw_page(outcome({"night": [3.0, None], "fog": [80.0]})))
    chips = page.all("button", "chip")
    assert [chip["data-condition"] for chip in chips if "data-condition" in chip] == ["", "night", "fog"]
    assert [chip["data-verdict"] for chip in chips if "data-verdict" in chip] == ["right", "wrong", "unknown"]
    text = re.sub(r"\s+", " ", page.said)
    assert "all 3night 2fog 1" in text
    assert "right 1wrong 1unknown 1" in text


def test_a_demo_without_queries_still_has_a_page(outcome: Result) -> None:
    assert "No photos were asked about." in Page(draw_page(outcome({}))).said


def test_style_and_script_cannot_end_early_and_the_script_parses(tmp_path: Path) -> None:
    texts = {
        name: files("salad.demo").joinpath(name).read_text(encoding="utf-8")
        for name in ("page.css", "page.js")
    }
    assert not any("</" in text for text in texts.values())
    assert texts["page.css"].count("{") == texts["page.css"].count("}")
    if node := shutil.which("node"):
        script = tmp_path / "page.js"
        script.write_text(texts["page.js"], encoding="utf-8")
        assert subprocess.run([node, "--check", str(script)], check=False).returncode == 0


# --- the map -------------------------------------------------------------------------------


@given(
    lat=st.floats(-70, 70), lon=st.floats(-179, 179), north=st.floats(-500, 500), east=st.floats(-500, 500)
)
def test_the_map_keeps_distances_and_directions(lat: float, lon: float, north: float, east: float) -> None:
    here = GeoPoint(lat, lon)
    there = shifted(here, north, east)
    frame = Frame.around([here, there])
    (x, y), (to_x, to_y) = frame.at(here), frame.at(there)
    assert np.hypot(to_x - x, to_y - y) == pytest.approx(metres_between(here, there), rel=2e-3, abs=0.01)
    bend = east**2 * np.tan(np.radians(abs(lat))) / (2 * EARTH_RADIUS_M)  # of the way east from the parallel
    assert to_x - x == pytest.approx(east, rel=2e-3, abs=0.01)
    assert y - to_y == pytest.approx(north, rel=2e-3, abs=0.01 + 1.1 * bend)
    for point in ((x, y), (to_x, to_y)):
        assert 0 < point[0] < frame.width
        assert 0 < point[1] < frame.height


def test_the_map_draws_positions_to_scale(outcome: Result) -> None:
    result = outcome({"night": [20.0]})
    page = Page(draw_map(result))
    truth, found = page.all("circle", "truth")[0], page.all("circle", "found")[0]
    assert float(truth["cy"] or "") - float(found["cy"] or "") == pytest.approx(20, abs=0.2)
    assert truth["cx"] == found["cx"]
    assert float(page.all("circle", "radius")[0]["r"] or "") == 26.0
    assert len(page.all("g", "references")) == 1


@given(about=st.floats(0.5, 1e5))
def test_a_scale_bar_is_round_and_not_too_long(about: float) -> None:
    length = round_metres(about)
    assert length <= about * 1.001 < length * 2.6
    assert f"{length:g}"[0] in "1250"


def test_a_scale_bar_grows_with_the_map() -> None:
    lengths = [round_metres(about) for about in (1, 2, 4, 5, 9, 10, 99)]
    assert lengths == [1, 2, 2, 5, 5, 10, 50]
    assert all(a <= b for a, b in pairwise(lengths))


def test_coordinates_name_their_hemisphere() -> None:
    assert coordinates(GeoPoint(-33.5, -70.25)) == "33.50000° S, 70.25000° W"
    assert coordinates(GeoPoint(47.5, 64.5)) == "47.50000° N, 64.50000° E"


# --- writing -------------------------------------------------------------------------------


def test_an_older_page_survives_a_failure(outcome: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    result = outcome()
    result.page.write_text("older")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(BenchmarkError, match=r"town\.html cannot be written.*another folder"):
        write_page(result)
    assert result.page.read_text() == "older"
    assert sorted(path.name for path in result.page.parent.iterdir()) == ["town", "town.html"]


def test_the_page_replaces_an_older_one(outcome: Result) -> None:
    result = outcome()
    result.page.write_text("older")
    assert write_page(result) == result.page
    assert result.page.read_text(encoding="utf-8").endswith("</html>\n")
