"""The report of an evaluation: whole, self-contained, safe, and true to the result."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from pages import Page, Sharing
from salad.datasets.benchmark import Benchmark
from salad.errors import BenchmarkError
from salad.evaluation.evaluate_benchmark import EvalSettings, judge
from salad.evaluation.leaks import Leak
from salad.evaluation.result import Ranked, Result, read_result, write_result
from salad.geo import GeoPoint, shifted
from salad.images.exif import save_jpeg
from salad.images.photo import Photo
from salad.models.fake import FakeDescriber
from salad.report import map as maps
from salad.report import mistakes
from salad.report.evaluation_page import draw_report, write_report

HOME = GeoPoint(48.1, 11.5)
Make = Callable[..., Result]


class Sheet(Page):
    """A page of figures and of queries marked."""

    def values(self) -> list[float]:
        """Every figure, to its last digit."""
        return [float(attrs["value"] or "nan") for attrs in self.all("data")]

    def marks(self) -> dict[str, int]:
        """How many queries of each kind are marked by themselves."""
        found = Counter((attrs["class"] or "").split()[1] for tag in ("a", "g") for attrs in self.all(tag, "query"))
        return {kind: found[kind] for kind in mistakes.OUTCOMES}


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Queries, of which every third is wrong and the fifth cannot be answered; photos that are there."""

    def make(
        queries: int = 12,
        *,
        positions: Sequence[int] | None = None,
        groups: Sequence[str] | None = None,
        scored: bool = True,
        name: str = "{}.jpg",
        protocol: str = "frames ±0",
        photos: bool = True,
    ) -> Result:
        placed = range(queries) if positions is None else positions
        sides = []
        for side in ("in", "out"):
            (tmp_path / side).mkdir(exist_ok=True)
            paths = [tmp_path / side / name.format(number) for number in range(queries)]
            for number, path in enumerate(paths if photos else []):
                pixels = np.random.default_rng(number).integers(0, 256, (6, 8, 3), dtype=np.uint8)
                save_jpeg(np.kron(pixels, np.ones((8, 8, 1), dtype=np.uint8)), path)
            where = [shifted(HOME, 20.0 * n, 5.0 * n) if n in placed else None for n in range(queries)]
            sides.append([Photo(path, spot) for path, spot in zip(paths, where, strict=True)])
        right = [np.array([number] if number != 4 else [], dtype=np.int64) for number in range(queries)]
        rows = np.array([[(n + 5 * (n % 3 == 0)) % queries, n] for n in range(queries)])
        scores = np.column_stack([np.linspace(0.2, 0.9, queries), np.full(queries, 0.1)])
        set_ = Benchmark(
            "set", protocol, sides[0], sides[1], right, ("a note",), groups=tuple(groups) if groups else None
        )
        ranked = Ranked(rows, scores if scored else None)
        return judge(set_, ranked, EvalSettings((1, 2), times=40), model="mine", fingerprint="f1", seconds=1.25)

    return make


def drawn(result: Result, at: Path, model: FakeDescriber | None = None) -> Sheet:
    return Sheet(draw_report(result, at / "page.html", model)[0])


def figures_of(told: object) -> list[float]:
    """Every number in a result's JSON form that is a figure."""
    if isinstance(told, dict):
        return [one for key, value in told.items() if key not in ("drawn",) for one in figures_of(value)]
    if isinstance(told, list):
        return [one for value in told for one in figures_of(value)]
    return [float(told)] if isinstance(told, int | float) and not isinstance(told, bool) else []


# --- the whole page ------------------------------------------------------------------------


def test_the_page_is_whole_and_fetches_nothing(make: Make, tmp_path: Path) -> None:
    text, gone = draw_report(make(), tmp_path / "page.html", Sharing())
    page = Sheet(text)
    assert gone == ()
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", text)
    assert not page.all("script")
    for tag, attrs in page.tags:
        assert (attrs.get("src") or "data:").startswith("data:"), (tag, attrs)
        assert ":" not in (attrs.get("href") or "").removeprefix("data:"), (tag, attrs)
    policy = next(a["content"] or "" for a in page.all("meta") if a.get("http-equiv"))
    assert "default-src 'none'" in policy
    assert "script-src" not in policy
    assert len(text) < 5_000_000


def test_it_holds_every_figure_of_the_result(make: Make, tmp_path: Path) -> None:
    result = make()
    page, told = drawn(result, tmp_path), result.as_dict()
    threshold = told["precision_recall"].pop("threshold")
    assert f"from score {threshold:.3f} on" in page.said
    missing = Counter(figures_of(told)) - Counter(page.values())
    assert not missing
    for text in ("set", "frames ±0", "mine", "f1", "a note", "left out of recall", "40 times"):
        assert text in page.said


def test_a_saved_result_makes_the_same_page(make: Make, tmp_path: Path) -> None:
    result = make(groups=[f"g{n % 2}" for n in range(12)])
    write_result(result, tmp_path / "r.json")
    page, saved = tmp_path / "page.html", read_result(tmp_path / "r.json")
    assert write_report(saved, page, folders=(tmp_path / "in", tmp_path / "out")) == ()
    assert page.read_text(encoding="utf-8") == draw_report(result, page)[0]


def test_a_saved_result_shows_photos_of_folders_that_were_named_and_of_no_other(make: Make, tmp_path: Path) -> None:
    write_result(make(), tmp_path / "r.json")
    saved = read_result(tmp_path / "r.json")
    for folders, said, shown in (
        (None, "references and queries are not shown", 0),
        ((None, None), "references and queries are not shown", 0),
        ((tmp_path / "in", None), "the queries are not shown", 1),
        ((None, tmp_path / "out"), "the references are not shown", 1),
    ):
        text, told = draw_report(saved, tmp_path / "page.html", Sharing(), folders=folders)
        page = Sheet(text)
        assert len(told) == 1
        assert said in told[0]
        assert told[0] in page.said
        assert bool(page.all("img")) == bool(shown)


@pytest.mark.parametrize("way", ["../secret.jpg", "{}/secret.jpg", "link.jpg", "up/secret.jpg"])
def test_a_saved_result_shows_nothing_that_lies_outside_of_the_folders(make: Make, tmp_path: Path, way: str) -> None:
    """Whoever made the result has it name a file of the machine that makes a page of it."""
    result, folders = make(), (tmp_path / "in", tmp_path / "out")
    save_jpeg(np.full((16, 16, 3), 200, dtype=np.uint8), tmp_path / "secret.jpg")
    for folder in folders:
        (folder / "link.jpg").symlink_to(tmp_path / "secret.jpg")
        (folder / "up").symlink_to(tmp_path)
    name = way.format(tmp_path)
    crafted = replace(
        result,
        per_query=tuple(replace(one, query=name) for one in result.per_query),
        known={row: replace(one, name=name) for row, one in result.known.items()},
        folders=(str(tmp_path), str(tmp_path)),
    )
    write_result(crafted, tmp_path / "r.json")
    for given in (None, folders):
        text, told = draw_report(read_result(tmp_path / "r.json"), tmp_path / "page.html", Sharing(), folders=given)
        assert told
        assert not Sheet(text).all("img")


@pytest.mark.parametrize("positions", [None, (), (0, 3, 4)])
@pytest.mark.parametrize("grouped", [False, True])
def test_marks_are_as_many_as_the_result_counts(
    make: Make, tmp_path: Path, positions: Sequence[int] | None, grouped: bool
) -> None:
    result = make(positions=positions, groups=[f"drive {n % 3}" for n in range(12)] if grouped else None)
    page = drawn(result, tmp_path)
    expected = mistakes.counts(result.per_query)
    assert page.marks() == expected
    assert sum(expected.values()) == result.queries
    assert expected["unanswerable"] == result.unanswerable == 1
    hits = 100 * expected["right"] / (expected["right"] + expected["wrong"])
    assert hits == pytest.approx(result.recall[1])
    maps, drives = page.all("svg", "map"), page.all("svg", "drive")
    assert (len(maps) - len(drives), len(drives)) == ((positions != ()), (positions is not None))
    assert ("Groups, the worst first" in page.said) == grouped


@pytest.mark.parametrize("positions", [None, ()])
def test_very_many_queries_are_shapes_and_are_all_there(
    make: Make, tmp_path: Path, positions: Sequence[int] | None
) -> None:
    few = make(10, positions=positions)
    many = tuple(few.per_query[n % 10] for n in range(maps.SINGLE + 6))
    result = replace(few, per_query=many, queries=len(many))
    text = draw_report(result, tmp_path / "page.html")[0]
    page, expected = Sheet(text), mistakes.counts(many)
    assert sum(page.marks().values()) == 2 * mistakes.SHOWN + mistakes.UNANSWERABLE
    crowds = page.all("path", "crowd") or page.all("path", "mark", "query")
    for kind in mistakes.OUTCOMES:
        shapes = [one["d"] or "" for one in crowds if kind in (one["class"] or "").split()]
        each = "v" if positions is not None else "h0"
        count = sum(shape.count(each) for shape in shapes)
        per = {"right": 1, "wrong": 1, "unanswerable": 3}[kind] if positions is not None else 1
        assert count == per * (expected[kind] - page.marks()[kind])
    assert len(text) < 5_000_000


def test_marks_and_strips_point_at_each_other(make: Make, tmp_path: Path) -> None:
    for result in (make(), make(positions=())):
        page = drawn(result, tmp_path)
        ids = Counter(attrs["id"] for _, attrs in page.tags if "id" in attrs)
        assert max(ids.values()) == 1
        inner = [attrs["href"] or "" for attrs in page.all("a") if (attrs["href"] or "").startswith("#")]
        assert all(target[1:] in ids for target in inner)
        strips = page.all("article", "strip")
        assert len(strips) == sum(not one.hit(1) for one in result.per_query)
        assert len([target for target in inner if target.startswith("#query-")]) == len(strips)


# --- photos --------------------------------------------------------------------------------


def test_links_lead_to_the_photos(make: Make, tmp_path: Path) -> None:
    result = make(name='a <b> & "{}" \'%23?#.jpg')
    (tmp_path / "pages").mkdir()
    page = drawn(result, tmp_path / "pages")
    links = [attrs["href"] or "" for attrs in page.all("a", "picture")]
    assert len(links) >= 12
    for href in links:
        assert (tmp_path / "pages" / unquote(href)).is_file()
        assert not set(href) & set("?#<>\"' ")


def test_hostile_names_stay_text(make: Make, tmp_path: Path) -> None:
    name = "<script>alert({})<script> \"onload='x' & $title ${{css}}.jpg"
    evil = "</style><img onerror=x> '\"&$map"
    result = replace(
        make(name=name, groups=[evil, "b"] * 6),
        model=evil,
        benchmark=evil,
        protocol=evil,
        fingerprint=evil,
        notes=(evil,),
        leaks=(Leak(0, 1, evil, "r", "picture"),),
    )
    page = drawn(result, tmp_path)
    assert result.per_query[0].query in page.said
    assert page.said.count(evil) >= 6
    assert not page.all("script")
    assert len(page.all("style")) == 1
    assert not any("onload" in attrs or "onerror" in attrs for _, attrs in page.tags)


def test_names_that_are_no_text(tmp_path: Path, make: Make) -> None:
    result = make(photos=False)
    odd = tuple(replace(one, query=one.query + "\udcff\ud800\0") for one in result.per_query)
    told = write_report(replace(result, per_query=odd), tmp_path / "page.html")
    assert "cannot be opened" in told[0]
    assert "0.jpg??" in Sheet((tmp_path / "page.html").read_text(encoding="utf-8")).said.replace("\0", "")


def test_photos_that_are_gone_are_said(make: Make, tmp_path: Path) -> None:
    result = make()
    (tmp_path / "out" / "0.jpg").unlink()
    (tmp_path / "out" / "3.jpg").write_bytes(b"no photo")
    text, gone = draw_report(result, tmp_path / "page.html")
    assert "2 of " in gone[0]
    assert "the first 3.jpg" in gone[0]  # the surer of the two
    page = Sheet(text)
    assert len(page.all("span", "picture", "gone")) == 3  # two photos, and what the unanswerable one has none of
    assert gone[0] in page.said
    nowhere = replace(result, folders=("/no/such/folder", ""))
    text, gone = draw_report(nowhere, tmp_path / "page.html", Sharing())
    page = Sheet(text)
    assert not page.all("img")
    assert not page.all("input")


def test_heat_lies_over_every_photo_of_a_model_with_a_dustbin(make: Make, tmp_path: Path) -> None:
    for model, layers in ((None, 0), (FakeDescriber(), 0), (Sharing(), 1)):
        page = drawn(make(), tmp_path, model)
        photos = [attrs for attrs in page.all("img") if "layer" not in (attrs.get("class") or "")]
        assert len(page.all("img", "layer")) == layers * len(photos) > -1
        assert len(page.all("input")) == 2 * layers
        assert all(len(attrs["alt"] or "") > 5 for attrs in photos)
        assert all(max(int(a["width"] or 0), int(a["height"] or 0)) <= 256 for a in photos)


# --- what results there are ----------------------------------------------------------------


def test_without_scores_there_is_no_such_curve(make: Make, tmp_path: Path) -> None:
    page = drawn(make(scored=False, positions=()), tmp_path)
    assert len(page.all("svg", "plot")) == 1
    assert "Surest mistakes" not in page.said
    assert "Worst mistakes" in page.said
    assert len(drawn(make(), tmp_path).all("svg", "plot")) == 3


def test_without_a_mistake(make: Make, tmp_path: Path) -> None:
    result = make()
    right = tuple(one for one in result.per_query if one.hit(1))
    page = drawn(replace(result, per_query=right, queries=len(right), unanswerable=0), tmp_path)
    assert "None: every query was answered rightly." in page.said


def test_queries_for_which_nothing_was_found(make: Make, tmp_path: Path) -> None:
    result = make()
    none = tuple(
        replace(one, matches=(), scores=(), first_right=None, metres=None, right=one.right and 99)
        for one in result.per_query
    )
    page = drawn(replace(result, per_query=none, precision_recall=None), tmp_path)
    assert "nothing found" in page.said
    assert not page.all("path", "error")


def test_leaks_and_many_groups_are_counted(make: Make, tmp_path: Path) -> None:
    groups = [f"a long name of drive {n:03}" for n in range(60)]
    leaks = tuple(Leak(n, n, f"q{n}", f"r{n}", "file") for n in range(30))
    page = drawn(replace(make(60, groups=groups, positions=(), photos=False), leaks=leaks), tmp_path)
    assert "30 photos are in both sides." in page.said
    assert "So are 10 more." in page.said
    assert "q19" in page.said
    assert "q20" not in page.said
    assert "39 better groups" in page.said


def test_a_result_without_recall_is_refused(make: Make, tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="no recall to show"):
        write_report(replace(make(photos=False), recall={}), tmp_path / "page.html")


def test_where_nothing_can_be_written(make: Make, tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="name a file in a folder"):
        write_report(make(photos=False), tmp_path / "no" / "page.html")


def test_towns_far_apart_have_maps_of_their_own(make: Make, tmp_path: Path) -> None:
    result = make(20, photos=False)
    far = tuple(replace(one, where=(float(n), 0.0)) for n, one in enumerate(result.per_query))
    page = drawn(replace(result, per_query=far), tmp_path)
    assert len(page.all("svg", "map")) == maps.MAPS
    assert "14 queries in 14 smaller regions are not drawn." in page.said
    ids = {attrs.get("id") for _, attrs in page.tags}
    back = [attrs["href"] or "" for attrs in page.all("a", "to-map")]
    assert back
    assert all(target[1:] in ids for target in back)
    odd = tuple(replace(one, where=(math.nan, 0.0)) for one in result.per_query)
    assert len(drawn(replace(result, per_query=odd), tmp_path).all("svg", "drive")) == 1
