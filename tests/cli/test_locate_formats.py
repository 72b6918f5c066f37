"""What `salad locate` writes as table, JSON and CSV, read back by what reads it."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from datetime import datetime
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

import salad
from salad.cli import locate_command
from salad.geo import GeoPoint
from salad.images.photo import Photo

HERE = GeoPoint(48.1, 11.5)
NAMES = [
    "a [red] wall.jpg",
    "東京 (1).jpg",
    "me@home.jpg",
    "[bold]b[oops].jpg",
    'say "cheese", now.jpg',
    "شارع.jpg",
]


def answer(name: str, where: GeoPoint | None = HERE, *, radius_m: float = 25.0) -> salad.Answer:
    """A photo whose best match stands at `where`; unknown where that is None."""
    photo = (
        Photo(Path("/photos") / name, where, 90.0, datetime(2024, 5, 1, 12)) if where else Photo(Path("/photos") / name)
    )
    place = salad.Place(where, radius_m, 0.75, 1) if where else None
    return salad.Answer(Path("queries") / name, place, [salad.Match(photo, 0.9, 0)])


quick = settings(deadline=None, max_examples=40)


# --- CSV and JSON --------------------------------------------------------------------------


@quick
@given(names=st.lists(st.text(st.characters(exclude_characters="/\0\r", exclude_categories=("Cs",)), min_size=1)))
def test_csv_parses_back(names: list[str]) -> None:
    answers = [answer(name, HERE if number % 2 else None) for number, name in enumerate(names)]
    rows = list(csv.DictReader(io.StringIO(locate_command.as_csv(answers), newline="")))
    assert [row["query"] for row in rows] == [str(one.query) for one in answers]
    assert [row["best_match"] for row in rows] == [str(one.matches[0].photo.path) for one in answers]
    for row, one in zip(rows, answers, strict=True):
        if one.place:
            assert (float(row["lat"]), float(row["lon"])) == (HERE.lat, HERE.lon)
            assert (float(row["radius_m"]), float(row["confidence"]), int(row["support"])) == (25, 0.75, 1)
        else:
            assert {row[column] for column in ("lat", "lon", "radius_m", "confidence", "support")} == {""}


def test_no_spreadsheet_takes_a_name_for_a_formula() -> None:
    names = ["=1+1.jpg", "+a.jpg", "-a.jpg", "@a.jpg", "\ta.jpg", "\ra.jpg", "a=.jpg", "-5"]
    answers = [salad.Answer(Path(name), salad.Place(GeoPoint(-33.5, -70.25), 25, 0.5, 1), []) for name in names]
    rows = list(csv.DictReader(io.StringIO(locate_command.as_csv(answers), newline="")))
    assert [row["query"] for row in rows] == [name if name[0] == "a" else f"./{name}" for name in names]
    assert [Path(row["query"]) for row in rows] == [Path(name) for name in names]
    assert {(row["lat"], row["lon"]) for row in rows} == {("-33.500000", "-70.250000")}


def test_csv_without_a_match_leaves_it_empty() -> None:
    (row,) = csv.DictReader(io.StringIO(locate_command.as_csv([salad.Answer(Path("a.jpg"), None, [])])))
    assert list(row.values()) == ["a.jpg", *[""] * 7]


def test_json_keeps_names_readable() -> None:
    text = locate_command.as_json([answer(name) for name in NAMES])
    assert [one["query"] for one in json.loads(text)] == [str(Path("queries") / name) for name in NAMES]
    assert "東京" in text
    assert "شارع" in text


def test_no_format_for_programs_holds_what_a_terminal_obeys() -> None:
    name = "a\x1b[2J\x9b2J\x85\x7f\u2028.jpg"
    texts = {form: locate_command.as_text([answer(name)], form) for form in ("json", "geojson", "kml")}
    for text in texts.values():
        assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f]", text)
    assert json.loads(texts["json"])[0]["query"] == str(Path("queries") / name)
    assert json.loads(texts["geojson"])["features"][0]["properties"]["query"] == str(Path("queries") / name)


def test_json_of_an_unknown_place_is_null() -> None:
    (told,) = json.loads(locate_command.as_json([answer("a.jpg", None)]))
    assert told["place"] is None
    assert [told["matches"][0][key] for key in ("lat", "lon", "heading", "time")] == [None] * 4


# --- the table -----------------------------------------------------------------------------


def drawn(answers: list[Any], width: int = 300) -> str:
    console = Console(width=width, file=io.StringIO(), force_terminal=False)
    console.print(locate_command.as_table(answers))
    return console.file.getvalue()


def test_the_table_shows_names_as_they_are() -> None:
    lines = drawn([answer(name) for name in NAMES]).splitlines()
    assert lines[0].split() == ["photo", "place", "within", "confidence", "looks", "like"]
    for name, line in zip(NAMES, lines[1:], strict=True):
        assert line.startswith(name)
        assert f"{name} (0.90)" in line
        assert "48.100000, 11.500000" in line
        assert "25 m" in line


def test_the_table_says_unknown_and_no_match() -> None:
    (_, line) = drawn([salad.Answer(Path("a.jpg"), None, [])]).splitlines()
    assert line.split("  ")[0] == "a.jpg"
    assert "unknown" in line
    assert "no match" in line


@quick
@given(name=st.text(st.characters(exclude_characters="/\0"), min_size=1))
def test_no_name_can_steer_a_terminal(name: str) -> None:
    lines = drawn([answer(name)]).split("\n")
    assert len(lines) == 3  # header, photo, and what follows the last line break
    assert lines[1].rstrip().isprintable()
    assert "\udc80" not in lines[1]


def test_a_narrow_terminal_shortens_names_and_keeps_the_place() -> None:
    name = "@0543256.96@4178906.70@10@S@037.75643@-122.50886@kzVnDf2Yo0DDmbrG@@60@@@@201311@@.jpg"
    lines = drawn([answer(name)], width=80).splitlines()
    assert len(lines) == 2
    assert all(len(line) <= 80 for line in lines)
    assert "48.100000, 11.500000" in lines[1]
    assert math.isclose(25, float(lines[1].split(" m")[0].split()[-1]))
