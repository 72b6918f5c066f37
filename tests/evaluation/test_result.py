"""A result comes back from its file as it was; what is no result is refused in a sentence."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.datasets.benchmark import Benchmark
from salad.errors import BenchmarkError
from salad.evaluation.evaluate_benchmark import EvalSettings, judge
from salad.evaluation.leaks import Leak
from salad.evaluation.result import Ranked, Result, as_csv, read_result, write_csv, write_result
from salad.geo import GeoPoint
from salad.images.photo import Photo

LEAK = Leak(0, 1, "q0", "r1", "picture", 1.5)


@pytest.fixture
def made() -> Result:
    references = [Photo(Path(f"in/r{number}.jpg"), GeoPoint(10.0, number / 1e4)) for number in range(4)]
    queries = [
        Photo(Path("out/東, 1.jpg"), GeoPoint(10.0, 0.0)),
        Photo(Path("out/2.jpg")),
        Photo(Path("out/3.jpg")),
    ]
    right = [np.array([1, 2]), np.zeros(0, np.int64), np.array([3])]
    ranked = Ranked(np.array([[2, 0], [1, 3], [0, -1]]), np.array([[0.9, 0.5], [0.75, 0.5], [0.5, -np.inf]]))
    set_ = Benchmark("set", "p", references, queries, right, ("a note",), groups=("a", "b", "b"))
    return judge(set_, ranked, EvalSettings((1, 2), times=20), model="m", fingerprint="f", seconds=1.5)


@pytest.mark.parametrize("leaks", [None, (), (LEAK,)])
def test_written_and_read_whole(made: Result, tmp_path: Path, leaks: Any) -> None:
    result = replace(made, leaks=leaks)
    write_result(result, tmp_path / "result.json")
    assert read_result(tmp_path / "result.json") == result
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]
    told = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert {name: told[name] for name in result.as_dict()} == json.loads(json.dumps(result.as_dict()))


def test_a_result_without_scores_and_positions(made: Result, tmp_path: Path) -> None:
    bare = replace(
        made,
        precision_recall=None,
        distances=None,
        per_query=tuple(replace(one, scores=None, where=None, metres=None) for one in made.per_query),
    )
    write_result(bare, tmp_path / "result.json")
    assert read_result(tmp_path / "result.json") == bare
    assert bare.answers() is None
    assert made.answers() is not None


def test_csv_has_a_line_a_query(made: Result, tmp_path: Path) -> None:
    write_csv(made, tmp_path / "result.csv")
    text = (tmp_path / "result.csv").read_text(encoding="utf-8")
    assert text == as_csv(made)
    first, second, third = csv.DictReader(io.StringIO(text))
    assert (first["query"], first["group"], first["positives"], first["first_right"]) == (
        "東, 1.jpg",
        "a",
        "2",
        "1",
    )
    assert (first["best_match"], first["best_score"], first["best_is_right"]) == ("r2.jpg", "0.900000", "1")
    assert float(first["metres"]) == pytest.approx(21.9, abs=0.1)
    assert (second["first_right"], second["metres"], second["lat"], second["positives"]) == ("", "", "", "0")
    assert third["best_is_right"] == "0"


def test_where_nothing_can_be_written(made: Result, tmp_path: Path) -> None:
    for write in (write_result, write_csv):
        with pytest.raises(BenchmarkError, match="name a file in a folder"):
            write(made, tmp_path / "no" / "such")


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (None, "cannot be read"),
        (b"", "no JSON"),
        (b"\xff\xfe", "no JSON"),
        (b"[" * 100_000, "no JSON"),
        (b"[]", "what became of each query"),
        (b'{"recall": {"1": 5.0}}', "what became of each query"),
        (b'{"verdicts": [], "format": 99}', "format 99"),
        (b'{"verdicts": [], "format": 1}', "damaged"),
    ],
)
def test_what_is_no_result(tmp_path: Path, content: bytes | None, named: str) -> None:
    path = tmp_path / "result.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BenchmarkError, match=named):
        read_result(path)


JUNK = st.sampled_from([None, "x", -1.5, [], {}, [[1]], {"a": 1}, True])


@given(data=st.data())
def test_a_result_with_a_piece_exchanged_is_read_or_refused(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("junk") / "result.json"
    set_ = Benchmark("s", "p", [Photo(Path("r"))], [Photo(Path("q"))], [np.array([0])])
    write_result(judge(set_, Ranked(np.array([[0]])), EvalSettings((1,), times=2), model="m"), path)
    told = json.loads(path.read_text(encoding="utf-8"))
    spot = told if data.draw(st.booleans()) else told["verdicts"][0]
    spot[data.draw(st.sampled_from(sorted(spot)))] = data.draw(JUNK)
    path.write_text(json.dumps(told), encoding="utf-8")
    try:
        read = read_result(path)
    except BenchmarkError:
        read = None
    assert read is None or len(read.per_query) == read.queries


@pytest.mark.parametrize("harm", ["verdicts", "known"])
def test_parts_that_do_not_fit(made: Result, tmp_path: Path, harm: str) -> None:
    write_result(made, tmp_path / "r.json")
    told = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    told[harm] = told[harm][1:] if harm == "verdicts" else {}
    (tmp_path / "r.json").write_text(json.dumps(told), encoding="utf-8")
    with pytest.raises(BenchmarkError, match="damaged"):
        read_result(tmp_path / "r.json")
