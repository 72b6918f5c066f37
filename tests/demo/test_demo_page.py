"""The demo's page: whole, self-contained, safe, and true to the result."""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pages import Page, Sharing
from salad.demo.demo_page import coordinates, draw_demo_page, town_map
from salad.demo.demo_result import DemoResult
from salad.geo import GeoPoint
from salad.images.exif import save_jpeg
from salad.models.fake import FakeDescriber
from salad.report.page import write_page

Result = Callable[..., DemoResult]


def test_the_page_is_whole_and_fetches_nothing(outcome: Result) -> None:
    text = draw_demo_page(outcome(), Sharing())
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
    page = Page(draw_demo_page(result))
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
    page = Page(draw_demo_page(outcome(), Sharing()))
    photos = [attrs for attrs in page.all("img") if "layer" not in (attrs.get("class") or "")]
    layers = page.all("img", "layer")
    assert len(photos) == 3 * (1 + 3)
    assert len(layers) == 2 * len(photos)
    assert all(len(attrs["alt"] or "") > 10 for attrs in photos)
    assert all(attrs["alt"] == "" for attrs in layers)


def test_without_a_dustbin_photos_stand_alone(outcome: Result) -> None:
    for model in (None, FakeDescriber()):
        page = Page(draw_demo_page(outcome(), model))
        assert not page.all("input")
        assert not page.all("img", "layer")
    switch = Page(draw_demo_page(outcome(), Sharing())).all("input", name="view")
    assert [attrs["value"] for attrs in switch] == ["photo", "dustbin", "clusters"]
    assert ["checked" in attrs for attrs in switch] == [False, True, False]


def test_hostile_names_stay_text(outcome: Result) -> None:
    name = "<script>alert({})<script> \"onload='x' & $title ${{css}}.jpg"
    model, condition = "</style><img onerror=x>", "\"><b>night</b>'&"
    result = outcome({condition: [3.0]}, name=name, model=model)
    page = Page(draw_demo_page(result))
    said = page.said
    assert result.town.queries[0].name in said
    assert model in said
    assert condition in said
    assert len(page.all("script")) == len(page.all("style")) == 1
    assert not any("onload" in attrs or "onerror" in attrs for _, attrs in page.tags)
    assert page.all("article")[0]["data-condition"] == condition
    assert condition in [attrs.get("data-condition") for attrs in page.all("button")]


def test_filters_count_what_they_show(outcome: Result) -> None:
    page = Page(draw_demo_page(outcome({"night": [3.0, None], "fog": [80.0]})))
    chips = page.all("button", "chip")
    assert [chip["data-condition"] for chip in chips if "data-condition" in chip] == ["", "night", "fog"]
    assert [chip["data-verdict"] for chip in chips if "data-verdict" in chip] == ["right", "wrong", "unknown"]
    text = re.sub(r"\s+", " ", page.said)
    assert "all 3 night 2 fog 1" in text
    assert "right 1 wrong 1 unknown 1" in text


def test_a_demo_without_queries_still_has_a_page(outcome: Result) -> None:
    assert "No photos were asked about." in Page(draw_demo_page(outcome({}))).said


def test_the_map_draws_positions_to_scale(outcome: Result) -> None:
    result = outcome({"night": [20.0]})
    metre = town_map(result).frame.scale
    page = Page(draw_demo_page(result))
    truth, found = page.all("circle", "truth")[0], page.all("circle", "found")[0]
    assert float(truth["cy"] or "") - float(found["cy"] or "") == pytest.approx(20 * metre, abs=0.01 * metre + 0.1)
    assert truth["cx"] == found["cx"]
    assert float(page.all("circle", "radius")[0]["r"] or "") == pytest.approx(26.0 * metre, abs=0.1)
    references = page.all("g", "references")
    assert len(references) == 1


def test_a_reference_looks_where_its_heading_points(outcome: Result) -> None:
    (*_, east), (*_, unknown) = town_map(outcome()).references[:2]
    assert east == pytest.approx((15, 0))
    assert unknown is None


def test_a_reference_without_a_position_is_not_on_the_map(outcome: Result) -> None:
    result = outcome()
    bare = result.town.references[1]
    save_jpeg(np.zeros((8, 8, 3), np.uint8), bare)
    assert len(town_map(result).references) == len(result.town.references) - 1


def test_a_query_without_matches_says_so(outcome: Result) -> None:
    result = outcome()
    one = replace(result.judged[0], answer=replace(result.judged[0].answer, place=None, matches=[]))
    assert "no references" in Page(draw_demo_page(replace(result, judged=(one,)))).said


def test_coordinates_name_their_hemisphere() -> None:
    assert coordinates(GeoPoint(-33.5, -70.25)) == "33.50000° S, 70.25000° W"
    assert coordinates(GeoPoint(47.5, 64.5)) == "47.50000° N, 64.50000° E"


def test_the_page_replaces_an_older_one(outcome: Result) -> None:
    result = outcome()
    result.page.write_text("older")
    write_page(result.page, draw_demo_page(result))
    assert result.page.read_text(encoding="utf-8").endswith("</html>\n")
