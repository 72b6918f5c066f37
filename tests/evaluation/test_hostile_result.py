"""A saved result may be anybody's: whatever one value of it is, it is read and shown, or refused by a sentence."""

from __future__ import annotations

import copy
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from salad.datasets.benchmark import Benchmark
from salad.errors import BenchmarkError
from salad.evaluation.evaluate_benchmark import EvalSettings, judge
from salad.evaluation.leaks import Leak
from salad.evaluation.result import Ranked, as_csv, read_result, write_result
from salad.geo import GeoPoint, shifted
from salad.images.photo import Photo
from salad.report.evaluation_page import draw_report

HOME = GeoPoint(48.1, 11.5)


def saved(folder: Path) -> dict[str, Any]:
    """A result of six queries with everything that there may be in one, as its file has it."""
    photos = [Photo(folder / "in" / f"{number}.jpg", shifted(HOME, 20.0 * number, 0)) for number in range(6)]
    queries = [Photo(folder / "out" / photo.path.name, photo.where) for photo in photos]
    right = [np.array([number] if number != 4 else [], dtype=np.int64) for number in range(6)]
    rows = np.array([[(number + (number % 3 == 0)) % 6, number] for number in range(6)])
    scores = np.column_stack([np.linspace(0.2, 0.9, 6), np.full(6, 0.1)])
    set_ = Benchmark("set", "frames ±0", photos, queries, right, ("a note",), groups=tuple("aabbcc"))
    result = judge(set_, Ranked(rows, scores), EvalSettings((1, 2), times=20), model="m", fingerprint="f", seconds=1.0)
    path = folder / "r.json"
    write_result(result, path)
    told: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    told["leaks"] = [vars_of(Leak(0, 1, "q", "r", "file"))]
    return told


def vars_of(leak: Leak) -> dict[str, Any]:
    return {name: getattr(leak, name) for name in Leak.__slots__}


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The way to every value in JSON."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(way for key, held in inner for way in places(held, (*at, key)))]


ODD = [
    *(
        None,
        True,
        -1,
        0,
        1,
        7,
        10**30,
        10**400,
        1e300,
        -1.5,
        "",
        "x",
        "1_0",
        "\ud800",
        "<script>",
        [],
        {},
        [1, 2],
        [None],
    ),
    *({"a": 1}, {"1": 2}, {"0": [1, 2]}, [[1, 2]], float("nan"), float("inf"), ["a", None]),
]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return saved(tmp_path_factory.mktemp("set"))


@settings(max_examples=150, deadline=None)
@given(data=st.data(), odd=st.sampled_from(ODD), lost=st.booleans())
def test_any_value_in_any_place_is_shown_or_refused(
    told: dict[str, Any], tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, odd: Any, lost: bool
) -> None:
    changed = copy.deepcopy(told)
    *way, last = data.draw(st.sampled_from(places(told)[1:]))
    held: Any = changed
    for key in way:
        held = held[key]
    if lost and isinstance(held, dict):
        del held[last]
    else:
        held[last] = odd
    path = tmp_path_factory.getbasetemp() / "changed.json"
    path.write_text(json.dumps(changed), encoding="utf-8")
    with suppress(BenchmarkError):
        result = read_result(path)
        text, _ = draw_report(result, path.with_name("page.html"))
        assert "<script" not in text
        as_csv(result)
        json.dumps(result.as_dict())


@given(content=st.binary(max_size=60) | st.text(max_size=60).map(str.encode))
@example(content=b"[" * 100_000)
@example(content=b'{"verdicts": ' * 50_000)
@example(content=b"1" * 5000)
@example(content=b'{"verdicts": [], "format": 1}')
def test_any_bytes_are_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.json"
    path.write_bytes(content)
    with pytest.raises(BenchmarkError, match=r"any\.json"):
        read_result(path)
