"""The pieces of the curve of recall per byte do what they say, at the smallest size."""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from benchmarks.accuracy import recall_per_byte
from benchmarks.accuracy.byte_chart import SHAPES, chart
from benchmarks.accuracy.real_descriptors import Distractors, Layout, evenly
from benchmarks.speed.compressed import Asked
from salad.search.base import ArrayRows
from salad.search.compressed import ArrayCodes, Coding, CompressedSearcher
from salad.search.exact import ExactSearcher

if TYPE_CHECKING:
    from benchmarks.accuracy.ways_to_search import Way

ROWS, DIM = 2500, 128  # rows in small groups, so that the ten best of a query stand out
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    rng = np.random.default_rng(0)
    towns = np.repeat(rng.standard_normal((ROWS // 10, DIM)), 10, axis=0)
    made = towns + 0.3 * rng.standard_normal((ROWS, DIM))
    return (made / np.linalg.norm(made, axis=1, keepdims=True)).astype(np.float16)


@pytest.fixture(scope="module")
def queries(rows: np.ndarray) -> np.ndarray:
    return rows[::250].astype(np.float32) + np.float32(0.01)


@pytest.fixture(scope="module")
def small() -> Iterator[None]:
    """As few parameters as there may be."""
    pytest.importorskip("faiss", reason="FAISS is what the curve compares with, and nothing else needs it")
    pytest.importorskip("usearch", reason="usearch is what the curve compares with, and nothing else needs it")
    from benchmarks.accuracy import ways_to_search

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ways_to_search, "OURS", (32, 64))
        patch.setattr(ways_to_search, "PRODUCTS", (16, 32))
        patch.setattr(ways_to_search, "REDUCED", 64)
        patch.setattr(ways_to_search, "LEARNT_FROM", 1000)
        patch.setattr(ways_to_search, "TURNS", 2)
        patch.setattr(ways_to_search, "LISTS", 4)
        patch.setattr(ways_to_search, "PROBED", 4)
        yield


@pytest.fixture(scope="module")
def all_ways(small: None, rows: np.ndarray) -> list[Way]:
    from benchmarks.accuracy import ways_to_search

    return list(ways_to_search.ways(rows, seed=0))


def test_every_way_gives_rows_of_the_index_and_most_of_the_right_ones(
    all_ways: list[Way], rows: np.ndarray, queries: np.ndarray
) -> None:
    best = ExactSearcher(ArrayRows(rows), threads=1).search(queries, k=10).rows
    for way in all_ways:
        for depth in recall_per_byte.depths(way):
            found = recall_per_byte.found(way, rows, queries, depth)
            assert found.shape == (len(queries), 10), way
            assert found.min() >= -1, way
            assert found.max() < ROWS, way
            assert all(len(set(some[some >= 0])) == (some >= 0).sum() for some in found), way
            assert recall_per_byte.share(found, best) > (0.9 if depth else 0.3), (way, depth)


def test_exact_scores_of_all_rows_are_an_exact_search(rows: np.ndarray, queries: np.ndarray) -> None:
    pytest.importorskip("faiss", reason="FAISS is what the curve compares with, and nothing else needs it")
    pytest.importorskip("usearch", reason="usearch is what the curve compares with, and nothing else needs it")
    from benchmarks.accuracy.ways_to_search import rescored

    every = np.tile(np.arange(ROWS), (len(queries), 1))
    best = ExactSearcher(ArrayRows(rows), threads=1).search(queries, k=10).rows
    np.testing.assert_array_equal(rescored(rows, queries, every, 10), best)
    few = np.full((len(queries), 12), -1)
    few[:, :2] = 7, 3
    assert set(rescored(rows, queries, few, 10)[0]) == {-1, 3, 7}


def test_ours_finds_what_salad_finds(all_ways: list[Way], rows: np.ndarray, queries: np.ndarray) -> None:
    way = next(way for way in all_ways if way.name == "salad")
    coding = Coding.fitted(ArrayRows(rows), size=way.code)
    searcher = CompressedSearcher(ArrayRows(rows), ArrayCodes(coding, ArrayRows(rows)), candidates=500)
    found = recall_per_byte.found(way, rows, queries, 500)
    assert recall_per_byte.share(found, searcher.search(queries, k=10).rows) > 0.99  # codes may tie at the 500th


def test_times_are_told_of_every_way_and_depth(all_ways: list[Way], rows: np.ndarray, queries: np.ndarray) -> None:
    taken = recall_per_byte.times(all_ways, rows, queries[:1], rounds=1)
    assert set(taken) == {(n, depth) for n, way in enumerate(all_ways) for depth in recall_per_byte.depths(way)}


def test_distractors_of_a_model_with_a_layout_take_each_cell_from_one_photo() -> None:
    layout = Layout(scene=2, clusters=3, features=2, cells=2, cell=2)
    parents = np.ones((2, 12), np.float16) * np.array([[1], [-1]], np.float16)
    made = np.concatenate(list(Distractors(parents, layout=layout, noise=0.0).blocks(200)))
    signs = np.sign(made.astype(np.float32))
    for part in range(layout.parts.max() + 1):
        of_part = signs[:, layout.parts == part]
        assert (of_part == of_part[:, :1]).all()
    assert len(np.unique(signs, axis=0)) > 30  # of the 64 that there are


def test_few_are_spread_over_many() -> None:
    assert evenly(10, 3) == [0, 4, 9]
    assert evenly(2, 5) == [0, 1]


def test_a_model_is_measured_once_and_drawn_again(
    small: None, rows: np.ndarray, queries: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = {"training": queries[:4], "evaluation": queries[4:]}
    monkeypatch.setattr(recall_per_byte, "asked", lambda *_, **__: Asked(kinds, rows, rows))
    kept, picture = tmp_path / "kept.jsonl", tmp_path / "curve.svg"
    options = ["--json", str(kept), "--svg", str(picture), "--rows", str(ROWS), "--timed", "1", "--rounds", "1"]
    monkeypatch.setattr(sys, "argv", ["recall_per_byte", "somewhere/mine", *options])
    recall_per_byte.main()
    figures = [json.loads(line) for line in kept.read_text().splitlines()]
    assert {each["model"] for each in figures} == {"mine"}
    assert {each["way"] for each in figures} == set(SHAPES)
    assert figures[0]["queries"] == {"training": 4, "evaluation": 6}
    drawn = picture.read_text()
    monkeypatch.setattr(recall_per_byte, "asked", None)  # not asked again
    recall_per_byte.main()
    assert kept.read_text().count("\n") == len(figures)
    assert picture.read_text() == drawn


def figure(way: str, code: int, recall: dict[str, float]) -> dict[str, Any]:
    return {
        "model": "a & b",
        "way": way,
        "setting": f"{code} bytes",
        "bytes": {"code": code, "beside": 0.0, "shared": 10},
        "recall": {depth: {"all": share} for depth, share in recall.items()},
        "time": dict.fromkeys(recall, 0.5),
    }


def test_the_picture_and_the_table_show_every_figure() -> None:
    figures = [
        figure("salad", 32, {"0": 0.5, "100": 0.9, "500": 0.95}),
        figure("salad", 64, {"0": 0.75, "100": 0.99, "500": 1.0}),
        figure("FAISS HNSW", 16896, {"0": 0.875}),
    ]
    drawn = ET.fromstring(chart({"a & b": figures}))
    told = [title.text or "" for title in drawn.iter(f"{SVG}title")]
    assert len(told) == 1 + 2 + 2 + 1
    for share in ("0.500", "0.900", "0.750", "0.990", "0.875"):
        assert sum(text.endswith(share) for text in told) == 1
    words = next(drawn.iter(f"{SVG}desc")).text or ""
    assert "0.900 by 32 bytes to 0.990 by 64 bytes" in words
    assert "0.875 by 16,896 bytes" in words
    assert all(way in "".join(text.text or "" for text in drawn.iter(f"{SVG}text")) for way in SHAPES)
    table = recall_per_byte.table(figures).splitlines()
    assert len(table) == 2 + len(figures)
    assert "0.500 | 0.900 | 0.950" in table[2]
    assert len({line.count("|") for line in table}) == 1
