"""Places to learn from: every layout, sets of sets, and the split."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.datasets.places import find_places, split
from salad.datasets.training_place import TrainingPlace
from salad.errors import BenchmarkError


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
    (root / "places.csv").write_text(
        "path,place\n" + "".join(f"{number}.jpg,here\n" for number in range(photos))
    )
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
def test_a_split_parts_every_city_and_loses_nobody(
    cities: dict[str, int], held_out: float, seed: int
) -> None:
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
