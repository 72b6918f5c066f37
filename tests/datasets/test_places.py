"""Places to learn from: every layout, sets of sets, and the split."""

from __future__ import annotations

import os
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.datasets.cluster import Cell
from salad.datasets.places import COLUMNS, find_places, split, write_places
from salad.datasets.training_place import TrainingPlace
from salad.errors import BenchmarkError
from salad.geo import GeoPoint, metres_between
from salad.images.photo import Photo
from salad.images.photo_table import PhotoTable


def _folders(root: Path, photos: dict[str, int]) -> Path:
    for name, count in photos.items():
        (root / name).mkdir(parents=True)
        for number in range(count):
            (root / name / f"{number:03d}.jpg").touch()
    return root


def _gsv(root: Path, photos: int = 4) -> Path:
    (root / "Dataframes").mkdir(parents=True)
    (root / "Images" / "Bangkok").mkdir(parents=True)
    rows = [f"3,2020,{month},0,B,1.0,2.0,x" for month in range(1, photos + 1)]
    table = ["place_id,year,month,northdeg,city_id,lat,lon,panoid", *rows]
    (root / "Dataframes" / "Bangkok.csv").write_text("\n".join(table))
    for month in range(1, photos + 1):
        (root / "Images" / "Bangkok" / f"B_0000003_2020_{month:02d}_000_1.0_2.0_x.jpg").touch()
    return root


def _table(root: Path, photos: int = 4) -> Path:
    root.mkdir(parents=True)
    for number in range(photos):
        (root / f"{number}.jpg").touch()
    (root / "places.csv").write_text("path,place\n" + "".join(f"{number}.jpg,here\n" for number in range(photos)))
    return root


def _made(cities: dict[str, int], photos: int = 5) -> list[TrainingPlace]:
    return [
        TrainingPlace(f"{number}", city, tuple(Path(f"{city}/{number}/{photo}") for photo in range(photos)))
        for city, count in cities.items()
        for number in range(count)
    ]


def test_one_folder_a_place_oldest_first(tmp_path: Path) -> None:
    root = _folders(tmp_path / "cams", {"b": 5, "a": 4, "few": 3, "empty": 0})
    (root / "a" / "notes.txt").touch()
    (root / "a" / "._000.jpg").touch()  # what a file manager leaves beside a photo
    places = find_places(root)
    assert [(place.name, place.city, len(place.photos), place.where) for place in places] == [
        ("a", "cams", 4, None),
        ("b", "cams", 5, None),
    ]
    assert [path.name for path in places[0].photos] == ["000.jpg", "001.jpg", "002.jpg", "003.jpg"]


def test_a_folder_of_sets_of_every_layout(tmp_path: Path) -> None:
    _folders(tmp_path / "cams", {"a": 4})
    _folders(tmp_path / "walks" / "north", {"a": 4, "b": 4})
    _gsv(tmp_path / "gsv")
    _table(tmp_path / "mine")
    (tmp_path / "licences").mkdir()
    (tmp_path / "licences" / "README.txt").touch()
    cities = Counter(place.city for place in find_places(tmp_path))
    assert cities == {"cams": 1, "north": 2, "gsv/Bangkok": 1, "mine": 1}


def test_a_table_of_places_by_its_own_name(tmp_path: Path) -> None:
    root = _table(tmp_path / "mine")
    assert find_places(root / "places.csv") == find_places(root)


def test_nothing_to_learn_from_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="there is no folder"):
        find_places(tmp_path / "gone")
    for root in (
        tmp_path,
        _folders(tmp_path / "few", {"a": 3, "b": 1}),
        _gsv(tmp_path / "gsv", 3),
        _table(tmp_path / "mine", 3),
        tmp_path / "mine" / "places.csv",
    ):
        with pytest.raises(BenchmarkError, match="holds no place to learn from"):
            find_places(root)


def test_the_real_folders_have_places(shared: Path) -> None:
    cities = Counter(place.city for place in find_places(shared / "data" / "train"))
    assert cities == {
        "amos-15": 15,
        "grief-10": 10,
        "tilde-5": 5,
        "vcl-10": 10,
        "sfxl-240/SanFrancisco": 240,
        "msls-london-west/London": 246,  # and of ie-tower none: three photos a place
    }


@settings(max_examples=40)
@given(
    st.dictionaries(st.sampled_from("abc"), st.integers(1, 12), min_size=1),
    st.floats(0, 1),
    st.integers(0, 99),
)
def test_a_split_parts_every_city_and_loses_nobody(cities: dict[str, int], held_out: float, seed: int) -> None:
    places = _made(cities)
    learn, choose = split(places, held_out=held_out, seed=seed)
    assert sorted(learn + choose, key=places.index) == places
    assert set(learn).isdisjoint(choose)
    assert Counter(place.city for place in choose) == {
        city: round(held_out * count) for city, count in cities.items() if round(held_out * count)
    }
    assert split(places, held_out=held_out, seed=seed) == (learn, choose)


def test_another_seed_splits_otherwise() -> None:
    places = _made({"a": 40})
    assert split(places, held_out=0.5, seed=1) != split(places, held_out=0.5, seed=2)


# --- The table of places: what is written comes back, and what makes no sense is named by its line ---


def photos_in(folder: Path, names: list[str]) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()
    return [folder / name for name in names]


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    inside = photos_in(tmp_path / "set" / "photos", ["a, b.jpg", "é 2.jpg", "c.jpg", "d.jpg"])
    outside = photos_in(tmp_path / "elsewhere", ["e.jpg", "f.jpg", "g.jpg", "h.jpg"])
    where = GeoPoint(48.1234567, -11.5)
    times = [None, datetime(2020, 1, 2, 3, 4, 5), datetime(2021, 1, 1, tzinfo=UTC), datetime(2022, 1, 1)]
    dated = tuple(Photo(path, where, 90.0, time) for path, time in zip(inside, times, strict=True))
    one = Cell("p", "x", dated, where)
    two = Cell("p", "y", tuple(Photo(path) for path in outside), where)
    to = tmp_path / "set" / "places.csv"
    write_places([one, two], to)
    found = find_places(to)
    assert [(place.name, place.city, len(place.photos)) for place in found] == [
        ("p", "set/x", 4),
        ("p", "set/y", 4),
    ]
    assert found[0].photos == tuple(inside)
    assert found[1].photos == tuple(outside)
    assert found[0].where is not None
    assert metres_between(found[0].where, where) < 0.1
    assert found[1].where is None
    lines = to.read_text(encoding="utf-8").splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert lines[1] == f'"photos{os.sep}a, b.jpg",p,x,48.1234567,-11.5000000,90.0,'


def test_it_is_a_table_of_photos_too(tmp_path: Path) -> None:
    paths = photos_in(tmp_path, ["a.jpg", "b.jpg", "c.jpg", "d.jpg"])
    when = datetime(2020, 1, 2, 3, 4, 5)
    where = GeoPoint(1.0, 2.0)
    write_places([Cell("p", "x", tuple(Photo(path, where, 90.0, when) for path in paths), where)], tmp_path / "t.csv")
    told = PhotoTable.read(tmp_path / "t.csv").get(paths[2])
    assert told is not None
    assert (told.where, told.heading, told.time) == (where, 90.0, when)


def test_a_table_by_hand_needs_little(tmp_path: Path) -> None:
    photos_in(tmp_path, [f"{number}.jpg" for number in range(9)])
    lines = [f" {number}.jpg , {'here' if number < 5 else 'there'} ,{2030 - number}-01-01" for number in range(9)]
    table = tmp_path / "mine.csv"
    table.write_text("\ufeffpath,place,time\n" + "\n".join(lines) + "\n", encoding="utf-8")
    here, there = find_places(table)
    assert [path.name for path in here.photos] == ["4.jpg", "3.jpg", "2.jpg", "1.jpg", "0.jpg"]
    assert (there.name, there.city, there.where) == ("there", tmp_path.name, None)


def test_places_with_too_few_photos_are_left_out(tmp_path: Path) -> None:
    photos_in(tmp_path, [f"{number}.jpg" for number in range(7)])
    lines = [f"{number}.jpg,{'few' if number < 3 else 'enough'}" for number in range(7)]
    (tmp_path / "places.csv").write_text("path,place\n" + "\n".join(lines))
    assert [place.name for place in find_places(tmp_path / "places.csv")] == ["enough"]


def test_photos_that_are_gone_are_told(tmp_path: Path) -> None:
    photos_in(tmp_path, [f"{number}.jpg" for number in range(4)])
    table = tmp_path / "places.csv"
    table.write_text("path,place\n" + "".join(f"{number}.jpg,here\n" for number in range(6)))
    with pytest.raises(BenchmarkError, match=r"places\.csv names 4\.jpg, which is not in .* \(nor are 1 more\): fetch"):
        find_places(table)
    said: list[str] = []
    (place,) = find_places(table, say=said.append)
    assert isinstance(place, TrainingPlace)
    assert len(place.photos) == 4
    assert len(said) == 1


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ("a.jpg,here,north,2,", "line 3: cannot be read"),
        ("a.jpg,here,1,,", "line 3: cannot be read"),
        ("a.jpg,here,91,2,", "line 3: cannot be read"),
        ("a.jpg,here,1,2,yesterday", "line 3: cannot be read"),
        (",here,1,2,", "line 3: cannot be read .*it needs a path and a place"),
        ("a.jpg,,1,2,", "line 3: cannot be read .*it needs a path and a place"),
        ("a.jpg,here,1,2,,more", "line 3: cannot be read .*no more fields than the header"),
        ("a\0.jpg,here,1,2,", "line 3: cannot be read|is not CSV"),
    ],
)
def test_a_bad_line_is_told(tmp_path: Path, lines: str, told: str) -> None:
    photos_in(tmp_path, ["a.jpg"])
    (tmp_path / "t.csv").write_text(f"path,place,lat,lon,time\na.jpg,here,1,2,\n{lines}\n")
    with pytest.raises(BenchmarkError, match=rf"t\.csv.*{told}"):
        find_places(tmp_path / "t.csv")


def test_another_table_is_told_by_the_column_it_lacks(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("path,lat,lon\na.jpg,1,2\n")
    with pytest.raises(BenchmarkError, match=r"t\.csv is no table of places, for it has no column 'place'"):
        find_places(tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("")
    with pytest.raises(BenchmarkError, match="no column 'path'"):
        find_places(tmp_path / "t.csv")


def test_a_field_without_end_is_told(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("path,place\n" + "a" * 200_000 + ",here\n")
    with pytest.raises(BenchmarkError, match=r"t\.csv is not CSV"):
        find_places(tmp_path / "t.csv")


def test_where_it_cannot_be_written_nothing_is_left(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match=r"places\.csv cannot be written"):
        write_places([], tmp_path / "gone" / "places.csv")
    assert list(tmp_path.iterdir()) == []


def test_a_table_that_may_not_be_read_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = tmp_path / "t.csv"
    table.write_text("path,place\n")

    def refused(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refused)
    with pytest.raises(BenchmarkError, match=r"t\.csv cannot be read \(Permission denied\)"):
        find_places(table)
