"""GeoJSON a feature at a time: what the whole file says, wherever it is cut into parts, and no part without end."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from salad.index import geojson
from salad.index.geojson import read_features, write_features

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=12,
)
BESIDE = st.dictionaries(st.text(max_size=5).filter(lambda name: name != "features"), VALUES, max_size=3)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "photos.geojson"


def features(file: Path, text: str) -> list[Any]:
    file.write_text(text, encoding="utf-8")
    return list(read_features(file))


@given(
    listed=st.lists(VALUES, max_size=5),
    before=BESIDE,
    behind=BESIDE,
    indent=st.sampled_from([None, 1, "\t\r\n"]),
    ahead=st.integers(40, 200),
)
@example(listed=[1.5, -7, 123456789, 1e-05, True, None], before={}, behind={"a": 12}, indent=None, ahead=40)
def test_it_is_read_as_a_whole_file_would_be(
    tmp_path_factory: pytest.TempPathFactory,
    listed: list[Any],
    before: dict[str, Any],
    behind: dict[str, Any],
    indent: Any,
    ahead: int,
) -> None:
    text = json.dumps({**before, "features": listed, **behind}, indent=indent)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(geojson, "_AHEAD", ahead)
        assert features(tmp_path_factory.getbasetemp() / "any.geojson", text) == json.loads(text)["features"]


@given(text=st.text(st.sampled_from('{}[]",:0 features\\un'), max_size=40))
def test_any_text_is_read_as_it_is_meant_or_refused(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "text.geojson"
    try:
        found = features(path, text)
    except ValueError:
        return
    assert found == json.loads(text)["features"]


def test_it_is_refused_wherever_it_is_cut(file: Path) -> None:
    whole = json.dumps({"type": "FeatureCollection", "features": [{"a": [1, 2.5]}, {"b": "é"}], "name": "x"})
    for length in range(len(whole)):
        with pytest.raises(ValueError):  # noqa: PT011  # the words are json's own
            features(file, whole[:length])
    assert len(features(file, whole + " \n")) == 2
    assert len(features(file, "\ufeff" + whole)) == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"features": ' + "[" * 100_000, "nested too deeply"),
        ('{"a": ' * 100_000, "nested too deeply"),
        ('{"features": ["' + "x" * (2 * geojson.MOST), "longer than"),
        ('{"a": [' + "1," * geojson.MOST, "longer than"),
        ('{"features": [], "features": []}', "twice"),
        ('{"type": "FeatureCollection"}', "no features"),
        ('{"features": {}}', "should stand"),
        ('{"features": []} {}', "behind its end"),
        ('{"features": [' + "1" * 5000 + "]}", "integer string"),
    ],
)
def test_what_nobody_can_mean_is_refused(file: Path, text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        features(file, text)


@pytest.mark.skipif(os.name != "posix", reason="a file of holes is POSIX's")
def test_a_file_of_holes_is_refused_at_once(file: Path) -> None:
    file.write_text('{"features": [', encoding="utf-8")
    os.truncate(file, 1 << 40)
    with pytest.raises(ValueError, match="longer than"):
        list(read_features(file))


def test_what_is_written_is_a_feature_collection(file: Path) -> None:
    with write_features(file, ("path", "lat", "lon", "note")) as write:
        write([{"path": "a.jpg", "lat": 1.0, "lon": 2.0, "note": "é"}])
        write([{"path": "b\udcff.jpg", "lat": None, "lon": None, "note": None}])
    assert json.loads(file.read_text(encoding="utf-8"))["features"] == list(read_features(file))
    assert [feature["geometry"] for feature in read_features(file)] == [
        {"type": "Point", "coordinates": [2.0, 1.0]},
        None,
    ]
