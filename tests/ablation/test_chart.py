"""A comparison as a picture: every figure is in it once, and every mark within it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.ablation.chart import comparison_chart
from salad.ablation.comparison import BenchmarkColumn, ModelLine
from salad.ablation.comparison_tables import csv_table, markdown_table
from salad.ablation.grids import PaperFigure

TOWN = BenchmarkColumn("town", "frames ±1")
SVG = "{http://www.w3.org/2000/svg}"


def test_the_picture_shows_every_figure_once_and_reads_in_light_and_dark(
    three_models: tuple[ModelLine, ...],
) -> None:
    text = comparison_chart(three_models, "a & b")
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
def test_every_mark_lies_within_the_picture(figures: Sequence[Sequence[float]], paper: Sequence[float]) -> None:
    lines = [
        ModelLine(
            f"row {number}",
            {TOWN: {1: times}} if times else {},
            {"x": PaperFigure("x", paper[number])} if number < len(paper) else {},
            len(times),
        )
        for number, times in enumerate(figures)
    ]
    drawn = ET.fromstring(comparison_chart(lines, "any"))
    _, _, width, height = map(float, drawn.attrib["viewBox"].split())
    marks = list(drawn.iter(f"{SVG}circle"))
    assert len(marks) == sum(bool(times) for times in figures) + min(len(paper), len(figures))
    for mark in marks:
        assert 0 < float(mark.attrib["cx"]) < width
        assert 0 < float(mark.attrib["cy"]) < height
    markdown_table(lines)
    csv_table(lines)


def test_a_picture_of_nothing_says_so() -> None:
    drawn = ET.fromstring(comparison_chart([], "empty"))
    assert "there is no figure yet" in [text.text for text in drawn.iter(f"{SVG}text")]


@pytest.mark.parametrize("percent", [0.0, 50.0, 100.0])
def test_one_figure_alone_has_an_axis(percent: float) -> None:
    drawn = ET.fromstring(comparison_chart([ModelLine("a", {TOWN: {1: [percent]}}, seeds=1)], "one"))
    ticks = [float(text.text) for text in drawn.iter(f"{SVG}text") if re.fullmatch(r"[\d.]+", text.text or "")]
    assert min(ticks) <= percent <= max(ticks)
    assert len(ticks) >= 2
