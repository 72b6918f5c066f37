"""A comparison in writing and as a picture: every figure is in it once, and nothing breaks its form."""

from __future__ import annotations

import csv
import io
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.ablation.chart import picture
from salad.ablation.comparison import Column, Line, Published
from salad.ablation.tables import as_csv, markdown, order

TOWN, STREET = Column("town", "frames ±1"), Column("street", "radius 25 m")
SVG = "{http://www.w3.org/2000/svg}"
LINES = (
    Line(
        "SALAD",
        {TOWN: {1: [80.0, 82.0], 5: [90.0, 92.0]}, STREET: {1: [40.0, 41.0]}},
        {"msls-val-740": Published(92.2)},
        2,
        {"trained parameters": 123456.0, "ms a photo": 12.34},
    ),
    Line(
        "GeM | <b>",
        {TOWN: {1: [60.0, 61.0]}, STREET: {1: [50.0, 51.0]}},
        {"msls-val-740": Published(85.4)},
        2,
        {"trained parameters": 1.0},
    ),
    Line("CosPlace", {TOWN: {1: [55.0, 75.0]}}, {"msls-val-740": Published(87.4, "on another backbone")}, 2),
)


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def test_markdown_has_every_figure_with_its_spread_and_the_papers_beside_it() -> None:
    told = markdown(LINES, notes=["A sentence."])
    table = [cells(line) for line in told.splitlines() if line.startswith("|")]
    assert table[0] == [
        *("", "town, frames ±1", "street, radius 25 m", "paper: msls-val-740"),
        *("trained parameters", "ms a photo", "seeds"),
    ]
    assert len({len(row) for row in table}) == 1
    assert table[2] == ["SALAD", "**81.0 ± 1.4**", "40.5 ± 0.7", "92.2", "123,456", "12.3", "2"]
    assert table[3] == ["GeM \\| <b>", "60.5 ± 0.7", "**50.5 ± 0.7**", "85.4", "1", "–", "2"]
    assert table[4] == ["CosPlace", "65.0 ± 14.1", "–", "87.4\\*", "–", "–", "2"]
    assert "\nA sentence.\n" in told
    assert "\\* on another backbone; left out of the order." in told
    assert "Bold: leads every other row" in told


def test_the_order_is_told_set_by_set() -> None:
    town, street = order(LINES)
    assert town == "- town, frames ±1: of 1 pairs that the paper puts in an order, 1 stand in it here."
    assert street == (
        "- street, radius 25 m: of 1 pairs that the paper puts in an order, 0 stand in it here; the other way "
        "round by more than the spread: GeM | <b> before SALAD by 10.0 ± 1.0."
    )
    near = [
        Line("a", {TOWN: {1: [5.0]}}, {"x": Published(1.0)}),
        Line("b", {TOWN: {1: [4.0]}}, {"x": Published(2.0)}),
    ]
    assert order(near)[0].endswith("within the spread or with none known: a before b by 1.0.")
    assert order([Line("a", {TOWN: {1: [5.0]}})]) == []


def test_what_cannot_be_said_is_not() -> None:
    assert markdown([]) == "There is no result yet."
    alone = markdown([Line("a", {TOWN: {1: [5.0]}}, seeds=1), Line("b", {TOWN: {1: [90.0]}}, seeds=1)])
    assert "of one seed" in alone
    assert "**" not in alone
    assert "paper" not in alone
    level = markdown(
        [Line("a", {TOWN: {1: [5.0, 6.0]}}, seeds=2), Line("b", {TOWN: {1: [6.0, 5.0]}}, seeds=2)]
    )
    assert "none is bold" in level
    assert "**" not in level


def test_csv_has_a_line_a_figure() -> None:
    rows = list(csv.DictReader(io.StringIO(as_csv(LINES))))
    assert len(rows) == 9
    first = rows[0]
    assert (first["source"], first["model"], first["set"], first["protocol"], first["k"]) == (
        *("ours", "SALAD", "town", "frames ±1", "1"),
    )
    assert (first["percent"], first["deviation"], first["seeds"]) == ("81.000", "1.414", "2")
    assert first["trained parameters"] == "123456"
    theirs = [row for row in rows if row["source"] == "paper"]
    assert [(row["model"], row["percent"], row["aside"]) for row in theirs] == [
        ("SALAD", "92.2", ""),
        ("GeM | <b>", "85.4", ""),
        ("CosPlace", "87.4", "on another backbone"),
    ]


def test_the_picture_shows_every_figure_once_and_reads_in_light_and_dark() -> None:
    text = picture(LINES, "a & b")
    drawn = ET.fromstring(text)
    told = [title.text for title in drawn.iter(f"{SVG}title")]
    assert told[0] == "a & b"
    assert sorted(filter(None, told[1:])) == sorted(
        [
            *(
                "SALAD: 81.0 ± 1.4, 2 seeds",
                "GeM | <b>: 60.5 ± 0.7, 2 seeds",
                "CosPlace: 65.0 ± 14.1, 2 seeds",
            ),
            *("SALAD: 40.5 ± 0.7, 2 seeds", "GeM | <b>: 50.5 ± 0.7, 2 seeds"),
            *("SALAD: 92.2", "GeM | <b>: 85.4", "CosPlace: 87.4, on another backbone"),
        ]
    )
    assert "prefers-color-scheme: dark" in text
    assert len(list(drawn.iter(f"{SVG}circle"))) == 8


@given(
    st.lists(st.lists(st.floats(0, 100, allow_nan=False), min_size=0, max_size=3), min_size=1, max_size=4),
    st.lists(st.floats(0, 100, allow_nan=False), max_size=4),
)
def test_every_mark_lies_within_the_picture(
    figures: Sequence[Sequence[float]], paper: Sequence[float]
) -> None:
    lines = [
        Line(
            f"row {number}",
            {TOWN: {1: times}} if times else {},
            {"x": Published(paper[number])} if number < len(paper) else {},
            len(times),
        )
        for number, times in enumerate(figures)
    ]
    drawn = ET.fromstring(picture(lines, "any"))
    _, _, width, height = map(float, drawn.attrib["viewBox"].split())
    marks = list(drawn.iter(f"{SVG}circle"))
    assert len(marks) == sum(bool(times) for times in figures) + min(len(paper), len(figures))
    for mark in marks:
        assert 0 < float(mark.attrib["cx"]) < width
        assert 0 < float(mark.attrib["cy"]) < height
    markdown(lines)
    as_csv(lines)


def test_a_picture_of_nothing_says_so() -> None:
    drawn = ET.fromstring(picture([], "empty"))
    assert "there is no figure yet" in [text.text for text in drawn.iter(f"{SVG}text")]


@pytest.mark.parametrize("percent", [0.0, 50.0, 100.0])
def test_one_figure_alone_has_an_axis(percent: float) -> None:
    drawn = ET.fromstring(picture([Line("a", {TOWN: {1: [percent]}}, seeds=1)], "one"))
    ticks = [
        float(text.text) for text in drawn.iter(f"{SVG}text") if re.fullmatch(r"[\d.]+", text.text or "")
    ]
    assert min(ticks) <= percent <= max(ticks)
    assert len(ticks) >= 2
