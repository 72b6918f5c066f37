"""Tables of photos: which row means which photo, what is read however it is written, and what is refused by name."""

from __future__ import annotations

import csv
import io
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
from salad.images.photo import Photo, placed
from salad.images.photo_table import PhotoTable


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
        ("path,lat,lon\na.jpg,1,\n", "line 2: its lon '' is not known, but its lat is"),
        ("path,lat,lon\na.jpg,1\n", "line 2: its lon '' is not known, but its lat is"),
        ("path,lat,lon\na.jpg,91,1\n", "line 2: latitude 91.0"),
        ("path,lat,lon\na.jpg,nan,1\n", "line 2: its lat 'nan' is not known, but its lon is"),
        ("path,lat,lon\na.jpg,1_0,1\n", "line 2: its lat '1_0'"),
        ("path,lat,lon\na.jpg,1,\uff11\uff12\n", "line 2: its lon '\uff11\uff12'"),
        ("path,lat,lon\na.jpg,1," + "1" * 9000 + "\n", r"line 2: its lon '1{60}'\.\.\. is not a number"),
        ("path,lat,lon\n" + "a/" * 20_000 + ",1,1\n", "line 2: its path"),
        ("path,lat,lon\n" + "a" * 200_000 + ",1,1\n", "is not CSV .field larger"),
        ("path,lat,lon\n" + "," * (1 << 21) + "\n", "is not CSV .line 2 has over 1,048,576 letters"),
        ("path,lat,lon\n,1,1\n", "line 2: its path"),
        ("path,lat,lon\na\0b.jpg,1,1\n", r"line 2: its path|not CSV"),
        ("path,lat,lon\na,b.jpg,1,1\n", "line 2: it has more fields"),
        ("path,lat,lon,heading\na.jpg,1,1,inf\n", "line 2: its heading"),
        ("path,lat,lon,time\na.jpg,1,1,yesterday\n", "line 2: its time 'yesterday'"),
        ("path,lat,lon\na.jpg,1,1\n./a.jpg,1,1\n", "line 3: './a.jpg' has a row already, line 2"),
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


# --- which photo a row means, however its path is written -----------------------------------


def made(folder: Path, *names: str) -> list[Path]:
    """Photos in a folder, of nothing: a table looks at names."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return [folder / name for name in names]


@pytest.mark.parametrize(
    "path",
    [
        *("day1/a b.jpg", "./day1/a b.jpg", "day1\\a b.jpg", ".\\day1\\a b.jpg", "a b.jpg"),
        *("/home/other/day1/a b.jpg", "C:\\Users\\me\\day1\\a b.jpg", "D:/day1/a b.jpg", "\\\\server\\day1\\a b.jpg"),
        *("file:///home/other/day1/a%20b.jpg", "FILE:/day1/a%20b.jpg", "file:///C:/me/day1/a%20b.jpg"),
        *("file://server/day1/a%20b.jpg", "file://localhost/x/day1/a%20b.jpg"),
    ],
)
def test_a_path_may_be_written_as_another_computer_writes_it(tmp_path: Path, path: str) -> None:
    here, other = made(tmp_path / "photos", "day1/a b.jpg", "day2/a b c.jpg")
    (tmp_path / "tables").mkdir()
    for folder in (tmp_path / "tables", tmp_path / "photos"):  # apart from the photos, and beside them
        places, told = table(folder, f'path,lat,lon\n"{path}",1,2\n').fitted([here, other])
        assert places.get(here) == Position(GeoPoint(1, 2))
        assert places.get(other) is None
        assert told == []


def test_paths_of_another_computer_keep_the_folders_in_which_they_differ(tmp_path: Path) -> None:
    photos = made(tmp_path, "p/day1/1.jpg", "p/day2/1.jpg", "q/1.jpg")
    places = table(tmp_path, "path,lat,lon\n/me/day1/1.jpg,1,1\n/me/day2/1.jpg,2,2\n")
    assert not any(map(places.get, photos))  # they are not in `me` here
    places = table(tmp_path, "path,lat,lon\n/x/p/day1/1.jpg,1,1\n/x/p/day2/1.jpg,2,2\n")
    assert [places.get(photo) for photo in photos] == [Position(GeoPoint(1, 1)), Position(GeoPoint(2, 2)), None]


def test_a_url_or_a_backslash_may_be_the_name_itself(tmp_path: Path) -> None:
    if os.sep == "\\":
        pytest.skip("no file of Windows has such a name")
    strange, plain = made(tmp_path, "a\\b%20.jpg", "a/b%20.jpg")
    places = table(tmp_path, "path,lat,lon\na\\b%20.jpg,1,1\na/b%20.jpg,2,2\n")
    assert places.get(strange) == Position(GeoPoint(1, 1))
    assert places.get(plain) == Position(GeoPoint(2, 2))
    (tmp_path / "apart").mkdir()
    assert table(tmp_path / "apart", "path,lat,lon\na\\b%20.jpg,1,1\n").get(strange) == Position(GeoPoint(1, 1))


def test_small_letters_for_large_ones_where_that_is_one_photo(tmp_path: Path) -> None:
    photos = made(tmp_path / "p", "IMG_1.JPG", "IMG_2.JPG", "img_2.jpg", "Ärger.JPG")
    places = table(tmp_path, "path,lat,lon\nimg_1.jpg,1,1\nImg_2.Jpg,2,2\na\u0308rger.jpg,3,3\n")
    assert [places.get(photo) for photo in photos] == [None, None, None, None]
    fitted, told = places.fitted(photos)
    assert [fitted.get(photo) for photo in photos] == [Position(GeoPoint(1, 1)), None, None, Position(GeoPoint(3, 3))]
    assert len(told) == 1
    assert "of its rows 2 fit a photo and 1 none, the first of them line 3, 'Img_2.Jpg'" in told[0]


def test_as_it_is_written_comes_before_other_letters(tmp_path: Path) -> None:
    photos = made(tmp_path / "p", "a.jpg", "A.JPG")
    fitted, told = table(tmp_path, "path,lat,lon\na.jpg,1,1\n").fitted(photos)
    assert [fitted.get(photo) for photo in photos] == [Position(GeoPoint(1, 1)), None]
    assert told == []
    fitted, _ = table(tmp_path, "path,lat,lon\nb.JPG,1,1\nB.jpg,2,2\n").fitted(made(tmp_path / "p", "b.jpg"))
    assert fitted.get(tmp_path / "p/b.jpg") is None  # of two rows nobody knows which is meant


def test_rows_that_fit_no_photo_are_told_with_their_number_and_the_first(tmp_path: Path) -> None:
    rows = "".join(f"{name}.jpg,1,1\n" for name in "abcde")
    (here,) = made(tmp_path, "b.jpg")
    _, told = table(tmp_path, "path,lat,lon\n" + rows).fitted([here])
    assert len(told) == 1
    assert told[0].startswith(f"{tmp_path / 'places.csv'}: of its rows 1 fit a photo and 4 none, the first of them")
    assert "line 2, 'a.jpg'" in told[0]
    _, told = table(tmp_path, "path,lat,lon\n").fitted([here])
    assert told == [f"{tmp_path / 'places.csv'} has no rows but the names of its columns"]


def test_null_island_is_told(tmp_path: Path) -> None:
    photos = made(tmp_path, "a.jpg", "b.jpg", "c.jpg")
    _, told = table(tmp_path, "path,lat,lon\na.jpg,1,1\nb.jpg,0,0\nc.jpg,-0.0,0\n").fitted(photos)
    assert told == [f"{tmp_path / 'places.csv'}: 2 rows say 0,0, which counts as no position; the first is line 3"]


# --- how a table is written ------------------------------------------------------------------

ROWS = (("path", "lat", "lon"), ("a, b.jpg", "47.5", "-8.25"), ("c.jpg", "-0.125", "179"))


def written(delimiter: str, end: str, decimal: str) -> str:
    text = io.StringIO(newline="")
    csv.writer(text, delimiter=delimiter, lineterminator=end).writerows(
        [cells[0], *(cell.replace(".", decimal) for cell in cells[1:])] for cells in ROWS
    )
    return text.getvalue()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("told", [False, True])
def test_a_spreadsheet_may_save_it_as_it_likes(
    tmp_path: Path, delimiter: str, end: str, decimal: str, encoding: str, told: bool
) -> None:
    text = (f"sep={delimiter}{end}" if told else "") + written(delimiter, end, decimal)
    places = table(tmp_path, text.encode(encoding))
    assert places.get("/x/a, b.jpg") == Position(GeoPoint(47.5, -8.25))
    assert places.get("/x/c.jpg") == Position(GeoPoint(-0.125, 179))
    assert [row.line for row in places.rows] == [2 + told, 3 + told]


@pytest.mark.parametrize(
    ("header", "where"),
    [
        ("SourceFile,GPSLatitude,GPSLongitude", GeoPoint(10, 20)),
        ("filename,Latitude,Longitude", GeoPoint(10, 20)),
        ("Image,lat,lng", GeoPoint(10, 20)),
        ("name,latitude,long", GeoPoint(10, 20)),
        ("path,lat,lon", GeoPoint(10, 20)),
    ],
)
def test_columns_may_have_other_names(tmp_path: Path, header: str, where: GeoPoint) -> None:
    assert table(tmp_path, f"{header}\na.jpg,10,20\n").get("/x/a.jpg") == Position(where)


def test_of_several_columns_that_could_be_meant_none_is_taken(tmp_path: Path) -> None:
    with pytest.raises(PositionError, match=r"one column 'path', but its columns are file, name, lat, lon"):
        table(tmp_path, "file,name,lat,lon\na.jpg,b,1,2\n")
    for header in ("path,name,lat,lon", "SourceFile,FileName,Latitude,Longitude"):  # ours, and exiftool's
        assert table(tmp_path, f"{header}\na.jpg,b,1,2\n").get("/x/a.jpg") == Position(GeoPoint(1, 2))


def test_what_exiftool_writes_is_read_by_it(tmp_path: Path) -> None:
    header = "SourceFile,GPSLatitudeRef,GPSLatitude,GPSLongitudeRef,GPSLongitude,GPSImgDirection,DateTimeOriginal"
    rows = (
        *("a.jpg,S,33.5,W,70.25,-90,2023:07:14 10:20:30", 'b.jpg,South,"33 deg 30\' 0.00"" S",East,70.25,,'),
        *("c.jpg,N,33.5,E,70.25,400,0000:00:00 00:00:00", "d.jpg,-,-,-,-,-,-", "e.jpg,,,,,12,"),
    )
    places = table(tmp_path, "\n".join((header, *rows)))
    assert places.get("/x/a.jpg") == Position(GeoPoint(-33.5, -70.25), 270, datetime(2023, 7, 14, 10, 20, 30))
    assert places.get("/x/b.jpg") == Position(GeoPoint(-33.5, 70.25))
    assert places.get("/x/c.jpg") == Position(GeoPoint(33.5, 70.25), 40)
    assert places.get("/x/d.jpg") == Position()
    assert places.get("/x/e.jpg") == Position(None, 12)


@pytest.mark.parametrize("blank", ["", " ", "NaN", "nan", "NULL", "None", "N/A", "-", "<NA>", "\\N"])
def test_a_row_may_have_no_position(tmp_path: Path, blank: str) -> None:
    places = table(
        tmp_path, f"path,lat,lon,heading,time\na.jpg,{blank},{blank},90,{blank}\n,,,,\nb.jpg,1,2,,\n\n,,,,\n"
    )
    assert [places.get(f"/x/{name}.jpg") for name in "ab"] == [Position(None, 90), Position(GeoPoint(1, 2))]
    with pytest.raises(PositionError, match=r"line 2: its lat .* is not known, but its lon is"):
        table(tmp_path, f"path,lat,lon\na.jpg,{blank},1\n")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"PK\x03\x04" + bytes(100), "is not CSV .it is a spreadsheet of Excel"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(100), "is not CSV .it is a spreadsheet of an old Excel"),
        (b"PAR1" + bytes(100), "is not CSV .it is Parquet, and its name must end in"),
        (b'<?xml version="1.0"?><gpx/>', "is not CSV .it is XML, such as GPX"),
        (b"\xef\xbb\xbf\n <kml/>", "is not CSV .it is XML"),
        (b'{"type": "FeatureCollection"}', "is not CSV .it is JSON, such as GeoJSON"),
        (b"[1]", "is not CSV .it is JSON"),
        ("path,lat,lon\nZ\u00fcrich.jpg,1,2\n".encode("latin-1"), "is not UTF-8 text: save it as CSV in UTF-8"),
        (b"path,X,Y\na.jpg,8,47\n", "needs one column 'lat', but its columns are path, x, y"),
    ],
)
def test_what_is_no_table_of_positions_is_called_by_its_name(tmp_path: Path, content: bytes, says: str) -> None:
    with pytest.raises(PositionError, match=says):
        table(tmp_path, content)


# --- the tables that people brought ------------------------------------------------------------

ONE, BOTH = {"IMG_0001.JPG": (47.5, 8.7)}, {"IMG_0001.JPG": (47.5, 8.7), "IMG_0002.JPG": (47.6, 8.8)}
ZURICH = {"Zürich.jpg": (47.5, 8.7)}
_AS_BOTH = (
    *("ok", "bom", "crlf", "cr", "semicolon", "semicolon_dot", "tab", "sep_line", "quoted_comma", "utf16"),
    *("blank_rows", "blank_line", "one_without", "nan", "null", "zero", "spaces", "spaces_header", "names"),
    *("names2", "exiftool", "pandas_index", "backslash", "backslash_full", "dot_slash", "other_root", "case"),
)
_AS_ONE = ("file_url", "dms", "dms_q", "suffix", "degree_sign", "thin_space", "times", "times_exif")
READ = (
    dict.fromkeys(_AS_BOTH, BOTH)
    | dict.fromkeys(_AS_ONE, ONE)
    | {"nfd": ZURICH, "minus_unicode": {"IMG_0001.JPG": (-33.9, 18.4)}, "none_fit": {}, "noext": {}, "head_only": {}}
)
TOLD = {
    "none_fit": "of its rows 0 fit a photo and 1 none, the first of them line 2, 'DSC_1.JPG'",
    "noext": "of its rows 0 fit a photo and 2 none, the first of them line 2, 'IMG_0001'",
    "head_only": "has no rows",
    "zero": "1 row says 0,0, which counts as no position; the first is line 4",
}
REFUSED = {
    "latin1.csv": "is not UTF-8 text",
    "comma_name.csv": "line 2: it has more fields than the header .put names with commas in quotes",
    "dup.csv": "line 4: 'IMG_0001.JPG' has a row already, line 2",
    "dup_name_same.csv": "line 4: 'IMG_0001.JPG' has a row already, line 2",
    "empty.csv": "its columns are none",
    "xy.csv": "its columns are path, x, y",
    "colmap.txt": "its columns are img_0001.jpg 47.5 8.7 400",
    "geo.txt": "its columns are epsg:4326",
    "geo.geojson": "it is JSON",
    "track.gpx": "it is XML, such as GPX",
    "book.xlsx": "it is a spreadsheet",
    "swapped_over90.csv": "latitude 139.7 is not between -90 and 90: it and longitude 35.7 may be exchanged",
    "lon_west_positive.csv": "longitude 237.6 is not between -180 and 180",
    "utm.csv": r"line 2: 5\.26235e\+06 and 478123 are metres on some map, such as UTM",
    "times_us.csv": "its time '7/14/2023 10:20' may begin with the day or the month",
    "times_epoch.csv": "its time '1689329430' counts days or seconds",
    "times_excel.csv": "its time '45121.43090277778' counts days or seconds",
}


@pytest.mark.parametrize("name", READ)
def test_tables_of_people_are_read(cases: Path, name: str) -> None:
    photos = sorted((cases / "07-tables/photos/day1").iterdir())
    places, told = PhotoTable.read(cases / "07-tables/tables" / f"{name}.csv").fitted(photos)
    known = {photo.name: placed(Photo(photo), places).where for photo in photos}
    assert {name: (where.lat, where.lon) for name, where in known.items() if where} == READ[name]
    assert [TOLD[name] in sentence for sentence in told] == [True] * (name in TOLD)
    if name.startswith("times"):
        assert {position.time for photo in photos if (position := places.get(photo))} <= {
            *(datetime(2023, 7, 14, 10, 20), datetime(2023, 7, 14, 10, 20, 30))
        }


@pytest.mark.parametrize("name", REFUSED)
def test_tables_of_people_are_refused_by_name(cases: Path, name: str) -> None:
    with pytest.raises(PositionError, match=REFUSED[name]):
        PhotoTable.read(cases / "07-tables/tables" / name)


def test_no_table_of_people_is_left_out(cases: Path) -> None:
    assert {path.name for path in (cases / "07-tables/tables").iterdir()} == {
        *(f"{name}.csv" for name in READ),
        *REFUSED,
        "ok.parquet",
    }
