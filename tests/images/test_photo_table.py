"""Tables of positions: what fits a photo, and what is refused with its line."""

from __future__ import annotations

import os
import tempfile
import unicodedata
from datetime import datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.errors import PositionError
from salad.geo import GeoPoint
from salad.images.metadata import Position
from salad.images.photo import PhotoTable


def table(folder: Path, text: str | bytes, name: str = "places.csv") -> PhotoTable:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return PhotoTable.read(path)


def test_a_table_with_everything(tmp_path: Path) -> None:
    text = (
        "\ufeffPath, lat,lon,heading,time,weather\r\n"
        'a.jpg,1.5,-2,370,2024-05-31T14:00:00+02:00,fine\r\n\r\n"b, c.jpg",3,4,,,"rain,\nsnow"\r\n'
    )
    places = table(tmp_path, text)
    assert len(places) == 2
    time = datetime.fromisoformat("2024-05-31T14:00:00+02:00")
    assert places.get(tmp_path / "a.jpg") == Position(GeoPoint(1.5, -2), 10, time)
    assert places.get(str(tmp_path / "b, c.jpg")) == Position(GeoPoint(3, 4))
    assert places.get(tmp_path / "c.jpg") is None


def parquet(path: Path, rows: list[dict[str, object]]) -> Path:
    arrow, tables = (
        pytest.importorskip("pyarrow", reason="the extra parquet is not installed"),
        pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed"),
    )
    tables.write_table(arrow.Table.from_pylist(rows), path)
    return path


def test_a_table_may_be_parquet(tmp_path: Path) -> None:
    time = datetime.fromisoformat("2024-05-31T14:00:00+02:00")
    rows: list[dict[str, object]] = [
        {"Path": "a.jpg", "lat": 1.5, "lon": -2, "heading": 370.0, "time": time, "weather": "fine"},
        {"Path": "b, c.jpg", "lat": 3.0, "lon": 4, "heading": float("nan"), "time": None, "weather": None},
    ]
    places = PhotoTable.read(parquet(tmp_path / "places.parquet", rows))
    assert places.get(tmp_path / "a.jpg") == Position(GeoPoint(1.5, -2), 10, time)
    assert places.get(tmp_path / "b, c.jpg") == Position(GeoPoint(3, 4))
    assert [row.line for row in places.rows] == [1, 2]
    text = [{name: "" if value is None else str(value) for name, value in row.items()} for row in rows[:1]]
    assert PhotoTable.read(parquet(tmp_path / "text.PARQUET", [*text])).get(tmp_path / "a.jpg") == places.get(
        tmp_path / "a.jpg"
    )


def test_parquet_that_makes_no_sense_is_a_sentence(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    rows: list[dict[str, object]] = [
        {"path": "a.jpg", "lat": 1.0, "lon": 2.0},
        {"path": "b.jpg", "lat": 91.0, "lon": 2.0},
    ]
    with pytest.raises(PositionError, match=r"far\.parquet, line 2: .*91.*correct the row"):
        PhotoTable.read(parquet(tmp_path / "far.parquet", rows))
    with pytest.raises(PositionError, match="needs one column 'lon', but its columns are path, lat"):
        PhotoTable.read(parquet(tmp_path / "short.parquet", [{"path": "a.jpg", "lat": 1.0}]))
    with pytest.raises(PositionError, match="line 1: its path is empty"):
        PhotoTable.read(parquet(tmp_path / "none.parquet", [{"path": None, "lat": 1.0, "lon": 2.0}]))
    (tmp_path / "no.parquet").write_bytes(b"PAR1 or not")
    with pytest.raises(PositionError, match="it is no Parquet"):
        PhotoTable.read(tmp_path / "no.parquet")
    with pytest.raises(PositionError, match=r"gone\.parquet cannot be read"):
        PhotoTable.read(tmp_path / "gone.parquet")


def test_which_photo_a_row_means(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("references/1.jpg", "queries/1.jpg", "lists/x"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    full = tmp_path / "queries/1.jpg"
    places = table(
        tmp_path / "lists", f"path,lat,lon\n../references/1.jpg,1,1\n{full},2,2\nfar/2.jpg,3,3\n3.jpg,4,4\n"
    )
    assert places.get(tmp_path / "references/1.jpg") == Position(GeoPoint(1, 1))
    assert places.get(full) == Position(GeoPoint(2, 2))
    assert places.get("/elsewhere/far/2.jpg") == Position(GeoPoint(3, 3))
    assert places.get("/elsewhere/near/2.jpg") is None
    assert places.get("/elsewhere/3.jpg") == Position(GeoPoint(4, 4))
    monkeypatch.chdir(tmp_path / "queries")
    assert places.get("1.jpg") == Position(GeoPoint(2, 2))
    assert places.get(Path("../references/./1.jpg")) == Position(GeoPoint(1, 1))


def test_a_row_whose_photo_stands_there_speaks_for_no_other(tmp_path: Path) -> None:
    for name in ("references/1.jpg", "queries/1.jpg"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    places = table(tmp_path / "references", "path,lat,lon\n1.jpg,1,1\n")
    assert places.get(tmp_path / "references/1.jpg") is not None
    assert places.get(tmp_path / "queries/1.jpg") is None


def test_the_longest_end_counts(tmp_path: Path) -> None:
    places = table(tmp_path, "path,lat,lon\nx.jpg,1,1\na/x.jpg,2,2\n")
    assert places.get("/photos/a/x.jpg") == Position(GeoPoint(2, 2))
    assert places.get("/photos/b/x.jpg") == Position(GeoPoint(1, 1))


def test_accents_are_the_same_however_they_are_kept(tmp_path: Path) -> None:
    places = table(tmp_path, f"path,lat,lon\n{unicodedata.normalize('NFD', 'café ж あ.jpg')},1,1\n")
    assert places.get(f"/photos/{unicodedata.normalize('NFC', 'café ж あ.jpg')}") is not None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("path,lat,lon\na.jpg,1,1\nb.jpg,north,1\n", "line 3: its lat 'north' is not a number"),
        ("path,lat,lon\na.jpg,1,\n", "line 2: its lon '' is not"),
        ("path,lat,lon\na.jpg,1\n", "line 2: its lon '' is not"),
        ("path,lat,lon\na.jpg,91,1\n", "line 2: latitude 91.0"),
        ("path,lat,lon\na.jpg,nan,1\n", "line 2: its lat 'nan'"),
        ("path,lat,lon\n,1,1\n", "line 2: its path"),
        ("path,lat,lon\na\0b.jpg,1,1\n", r"line 2: its path|not CSV"),
        ("path,lat,lon\na,b.jpg,1,1\n", "line 2: it has more fields"),
        ("path,lat,lon,heading\na.jpg,1,1,inf\n", "line 2: its heading"),
        ("path,lat,lon,time\na.jpg,1,1,yesterday\n", "line 2: its time 'yesterday'"),
        ("path,lat,lon\na.jpg,1,1\n./a.jpg,1,1\n", "line 3: './a.jpg' has a row already, line 2"),
        ("path;lat;lon\na.jpg;1;1\n", "needs one column 'path'"),
        ("path,lat,lat,lon\na.jpg,1,1,1\n", "needs one column 'lat'"),
        ("", "its columns are none"),
        ('path,"l\nat",lon\n', r"its columns are path, 'l\\nat', lon: write"),
        (f"path,{'x' * 999}\n", r"path, x{40}\.\.\.: write"),
        ('path,lat,lon\n"a.jpg,1,1\n', "not CSV"),
        (b"path,lat,lon\n\xff.jpg,1,1\n", "not UTF-8"),
    ],
)
def test_bad_tables_are_refused_with_a_sentence(tmp_path: Path, text: str | bytes, says: str) -> None:
    with pytest.raises(PositionError, match=says) as caught:
        table(tmp_path, text)
    assert "places.csv" in str(caught.value)


def test_a_table_that_is_not_there(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(PositionError, match="cannot be read"):
            PhotoTable.read(path)


def test_each_row_has_one_photo_or_says_which_has_not(tmp_path: Path) -> None:
    places = table(tmp_path, "path,lat,lon\na.jpg,1,1\nb.jpg,2,2\n")
    places.check_used(["/p/a.jpg", "/p/b.jpg", "/p/c.jpg", "/p/../p/b.jpg"])
    with pytest.raises(PositionError, match=r"line 3: no photo fits 'b.jpg'"):
        places.check_used(["/p/a.jpg"])
    with pytest.raises(PositionError, match=r"line 2: .a\.jpg. fits two photos, /p/a\.jpg and /q/a\.jpg"):
        places.check_used(["/p/a.jpg", "/q/a.jpg", "/p/b.jpg"])


@given(
    st.text(max_size=80)
    | st.binary(max_size=80)
    | st.lists(
        st.lists(st.text('a1.,-"\n\0é/ ', max_size=6), min_size=2, max_size=5).map(",".join), max_size=5
    ).map(lambda rows: "path,lat,lon,time\n" + "\n".join(rows))
)
def test_no_table_crashes(text: str | bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        raw = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
        try:
            places = table(Path(folder), raw)
        except PositionError:
            return
        for row in places.rows:
            assert places.get(Path(folder, row.path)) == row.position
            assert os.sep not in row.path or row.position.where is not None
