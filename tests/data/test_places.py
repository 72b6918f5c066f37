"""Places to learn from: both layouts, the split, and batches that depend on their number alone."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.data.places import TrainingPlace, View, batches, find_places, split
from salad.errors import BenchmarkError

HEADER = "place_id,year,month,northdeg,city_id,lat,lon,panoid\n"


def _folders(root: Path, photos: dict[str, int]) -> Path:
    for name, count in photos.items():
        (root / name).mkdir(parents=True)
        for number in range(count):
            (root / name / f"{number:03d}.jpg").touch()
    return root


def _gsv(root: Path, city: str, rows: list[tuple[int, int, int]], *, suffix: str = ".jpg") -> Path:
    """GSV-Cities with empty photos: (place, year, month) a row; lat and lon with zeros that a float would lose."""
    (root / "Dataframes").mkdir(parents=True, exist_ok=True)
    (root / "Images" / city).mkdir(parents=True)
    lines = [
        f"{place},{year},{month},{7 * number},{city},51.10{place},-0.0500,pano_{number}\n"
        for number, (place, year, month) in enumerate(rows)
    ]
    (root / "Dataframes" / f"{city}.csv").write_text(HEADER + "".join(lines))
    for number, (place, year, month) in enumerate(rows):
        name = f"{city}_{place:07d}_{year}_{month:02d}_{7 * number:03d}_51.10{place}_-0.0500_pano_{number}"
        (root / "Images" / city / f"{name}{suffix}").touch()
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
    assert [(place.name, place.city, len(place.photos)) for place in places] == [
        ("a", "cams", 4),
        ("b", "cams", 5),
    ]
    assert [path.name for path in places[0].photos] == ["000.jpg", "001.jpg", "002.jpg", "003.jpg"]


def test_a_folder_of_sets_of_both_layouts(tmp_path: Path) -> None:
    _folders(tmp_path / "cams", {"a": 4})
    _folders(tmp_path / "walks" / "north", {"a": 4, "b": 4})
    _gsv(tmp_path / "gsv", "Bangkok", [(3, 2020, month) for month in range(1, 5)])
    (tmp_path / "licences").mkdir()
    (tmp_path / "licences" / "README.txt").touch()
    cities = Counter(place.city for place in find_places(tmp_path))
    assert cities == {"cams": 1, "north": 2, "gsv/Bangkok": 1}


@pytest.mark.parametrize("suffix", [".jpg", ".JPG"])
def test_gsv_cities_by_its_tables_oldest_first(tmp_path: Path, suffix: str) -> None:
    rows = [(7, 2019, 12), (7, 2018, 2), (7, 2019, 3), (7, 2021, 1), (8, 2019, 1)]
    (place,) = find_places(_gsv(tmp_path / "gsv", "Bangkok", rows, suffix=suffix))
    assert (place.name, place.city) == ("7", "gsv/Bangkok")
    assert [path.name[16:23] for path in place.photos] == ["2018_02", "2019_03", "2019_12", "2021_01"]
    assert all(path.is_file() for path in place.photos)


def test_a_photo_that_a_table_names_in_vain_is_told(tmp_path: Path) -> None:
    root = _gsv(tmp_path, "Bangkok", [(7, 2019, month) for month in range(1, 6)])
    gone = next(iter((root / "Images" / "Bangkok").glob("*pano_2.jpg")))
    gone.unlink()
    with pytest.raises(BenchmarkError, match=rf"Bangkok\.csv names {gone.name}, which is not in"):
        find_places(root)


@pytest.mark.parametrize(
    "line", ["7,2019\n", "7,never,1,0,Bangkok,1,2,x\n", "7,2019,1,north,Bangkok,1,2,x\n"]
)
def test_a_bad_line_of_a_table_is_told(tmp_path: Path, line: str) -> None:
    root = _gsv(tmp_path, "Bangkok", [(7, 2019, 1)])
    with (root / "Dataframes" / "Bangkok.csv").open("a") as table:
        table.write(line)
    with pytest.raises(BenchmarkError, match=r"Bangkok\.csv, line 3: cannot be read"):
        find_places(root)


def test_nothing_to_learn_from_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="there is no folder"):
        find_places(tmp_path / "gone")
    with pytest.raises(BenchmarkError, match="holds no place to learn from"):
        find_places(tmp_path)
    with pytest.raises(BenchmarkError, match="holds no place to learn from"):
        find_places(_folders(tmp_path / "few", {"a": 3, "b": 1}))
    with pytest.raises(BenchmarkError, match="holds no place to learn from"):
        find_places(_gsv(tmp_path / "gsv", "Bangkok", [(7, 2019, 1)]))


@settings(deadline=None, max_examples=40)
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


def _take(places: list[TrainingPlace], count: int, **more: int) -> list[list[View]]:
    options = {"per_batch": 4, "views": 3, "seed": 1} | more
    return list(itertools.islice(batches(places, **options), count))


def test_the_nth_batch_depends_on_the_seed_and_n_alone() -> None:
    places = _made({"a": 6, "b": 3})
    whole = _take(places, 6)
    assert whole == _take(places, 6)
    assert whole[4:] == _take(places, 2, start=4)
    assert whole != _take(places, 6, seed=2)
    assert len({str(batch) for batch in whole}) == 6


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(4, 6), st.integers(0, 999))
def test_a_batch_shows_each_of_its_places_alike(per_batch: int, views: int, photos: int, seed: int) -> None:
    places = _made({"a": 6, "b": 3}, photos)
    (batch,) = _take(places, 1, per_batch=per_batch, views=views, seed=seed)
    assert len(batch) == per_batch * views
    seen = []
    for label in range(per_batch):
        of_place = [view for view in batch if view.label == label]
        (home,) = {view.path.parent for view in of_place}
        seen.append(home)
        assert (
            len({view.mirrored for view in of_place}) == 1
        )  # a mirrored place is mirrored in all its photos
        shown = Counter(view.path for view in of_place)
        assert sum(shown.values()) == views
        assert max(shown.values()) == -(-views // photos)  # none twice before each was seen
    assert len(set(seen)) == per_batch


def test_half_of_the_places_are_mirrored() -> None:
    mirrored = [batch[0].mirrored for batch in _take(_made({"a": 8}), 200)]
    assert 60 < sum(mirrored) < 140


def test_a_city_takes_part_by_the_square_root_of_its_size() -> None:
    places = _made({"large": 90, "small": 10})
    drawn = Counter(batch[0].path.parts[0] for batch in _take(places, 1000, per_batch=1))
    assert drawn["large"] / drawn["small"] == pytest.approx(3, rel=0.3)


def test_too_few_places_for_a_batch_is_a_sentence() -> None:
    with pytest.raises(BenchmarkError, match="a batch needs 4 places, but there are 3"):
        _take(_made({"a": 3}), 1)
