"""What is known of a photo, and which it is."""

from __future__ import annotations

import os
import tempfile
import unicodedata
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from salad.errors import PhotoError, PositionError
from salad.geo import GeoPoint, metres_between, shifted
from salad.images.at_names import at_name
from salad.images.decode import open_rgb
from salad.images.exif import save_jpeg
from salad.images.metadata import Position
from salad.images.photo import Photo, content_hash, read_photo
from salad.images.photo_table import PhotoTable

HERE = GeoPoint(37.7126, -122.4855)
GREY = np.full((4, 6, 3), 128, np.uint8)


def files(root: Path, *names: str) -> list[Path]:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"x")
    return [root / name for name in names]


def test_save_and_read_again_to_the_centimetre(tmp_path: Path) -> None:
    path, time = tmp_path / "写真 @home.jpg", datetime(2024, 5, 31, 14, 0, 1)
    save_jpeg(GREY, path, where=HERE, heading=271.25, time=time)
    photo = read_photo(path)
    assert photo.where is not None
    assert metres_between(photo.where, HERE) < 0.05
    assert (photo.path, photo.heading, photo.time) == (path, 271.25, time)


def test_an_at_sign_in_a_folder_says_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "@0545350.23@4174054.95@10@S@"
    folder.mkdir()
    save_jpeg(GREY, folder / "a.jpg")
    assert read_photo(folder / "a.jpg") == Photo(folder / "a.jpg")


def test_table_then_name_then_exif_each_for_what_it_knows(tmp_path: Path) -> None:
    by_name, by_table = shifted(HERE, 100, 0), GeoPoint(1, 2)
    path = tmp_path / at_name(by_name, heading=90)
    save_jpeg(GREY, path, where=HERE, heading=10, time=datetime(2020, 1, 1))
    photo = read_photo(path)
    assert photo.where is not None
    assert metres_between(photo.where, by_name) < 0.1
    assert (photo.heading, photo.time) == (90, datetime(2020, 1, 1))

    (tmp_path / "places.csv").write_text(f"path,lat,lon\n{path.name},1,2\nother.jpg,3,4\n")
    table = PhotoTable.read(tmp_path / "places.csv")
    assert read_photo(path, table) == Photo(path, by_table, 90, datetime(2020, 1, 1))
    save_jpeg(GREY, tmp_path / "third.jpg", where=HERE, heading=0.0)
    assert read_photo(tmp_path / "third.jpg", table).heading == 0


@pytest.mark.parametrize("content", [b"", b"not an image", b"\xff\xd8\xff\xe1\x00\x10Exif\0\0garbage"])
def test_a_photo_that_cannot_be_opened_has_no_exif_but_its_name_counts(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / at_name(HERE)
    path.write_bytes(content)
    assert read_photo(path).where is not None
    (tmp_path / "plain.jpg").write_bytes(content)
    assert read_photo(tmp_path / "plain.jpg") == Photo(tmp_path / "plain.jpg")


@pytest.mark.parametrize("suffix", [".png", ".webp", ".tif"])
def test_other_formats_carry_exif_too(tmp_path: Path, suffix: str) -> None:
    save_jpeg(GREY, tmp_path / "a.jpg", where=HERE, heading=12)
    with Image.open(tmp_path / "a.jpg") as image:
        image.save(tmp_path / f"a{suffix}", exif=image.getexif())
    photo = read_photo(tmp_path / f"a{suffix}")
    assert photo.where is not None
    assert metres_between(photo.where, HERE) < 0.05


def test_reading_what_is_known_decodes_no_pixels(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    save_jpeg(noise, tmp_path / "whole.jpg", where=HERE)
    cut = (tmp_path / "whole.jpg").read_bytes()[:-500]
    (tmp_path / "cut.jpg").write_bytes(cut)
    assert read_photo(tmp_path / "cut.jpg").where is not None
    with pytest.raises(PhotoError):
        open_rgb(tmp_path / "cut.jpg")


@pytest.mark.parametrize("read", [read_photo, content_hash, open_rgb])
def test_what_is_not_a_file_is_said(tmp_path: Path, read: object) -> None:
    assert callable(read)
    for path, says in (
        (tmp_path / "gone.jpg", "no photo at"),
        (tmp_path, "is a folder"),
        (Path("/dev/null"), "is not a file"),
        (tmp_path / ("long" * 100 + ".jpg"), "no photo at"),
        (Path("nul\0.jpg"), "no photo at"),
    ):
        with pytest.raises(PhotoError, match=says):
            read(path)


def test_identity_is_the_content_whatever_the_name(tmp_path: Path) -> None:
    one, two, three = files(tmp_path, "1.jpg", "2.png", "3.jpg")
    three.write_bytes(b"y")
    assert content_hash(one) == content_hash(two) != content_hash(three)
    assert len(content_hash(one)) == 32
    assert int(content_hash(one), 16) >= 0


# --- tables of positions -----------------------------------------------------------------


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
    places = table(tmp_path / "lists", f"path,lat,lon\n../references/1.jpg,1,1\n{full},2,2\nfar/2.jpg,3,3\n3.jpg,4,4\n")
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
        ("path,lat,lon\na.jpg,1_0,1\n", "line 2: its lat '1_0'"),
        ("path,lat,lon\na.jpg,1,\uff11\uff12\n", "line 2: its lon '\uff11\uff12'"),
        ("path,lat,lon\na.jpg,1," + "1" * 9000 + "\n", r"line 2: its lon '1{60}'\.\.\. is not a number"),
        ("path,lat,lon\n" + "a/" * 3000 + ",1,1\n", "line 2: its path"),
        ("path,lat,lon\n" + "a" * 200_000 + ",1,1\n", "is not CSV .field larger"),
        ("path,lat,lon\n" + "," * (1 << 21) + "\n", "is not CSV .line 2 has over 1,048,576 letters"),
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
    | st.lists(st.lists(st.text('a1.,-"\n\0é/ ', max_size=6), min_size=2, max_size=5).map(",".join), max_size=5).map(
        lambda rows: "path,lat,lon,time\n" + "\n".join(rows)
    )
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
