"""GSV-Cities: its tables decide, one listing a city, and no photo is opened."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest

from salad.datasets.places import find_places
from salad.errors import BenchmarkError
from salad.geo import metres_between

HEADER = "place_id,year,month,northdeg,city_id,lat,lon,panoid\n"


def gsv(root: Path, city: str, rows: list[tuple[int, int, int]], *, suffix: str = ".jpg") -> Path:
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


def test_the_real_layout_with_photos_that_know_nothing(shared: Path) -> None:
    places = find_places(shared / "data" / "train" / "sfxl-240")
    assert {place.city for place in places} == {"sfxl-240/SanFrancisco"}
    assert len(places) == 240
    assert sum(len(place.photos) for place in places) == 2396
    for place in places:
        assert place.where is not None
        assert place.where.lat == pytest.approx(37.75, abs=0.1)
        years = [path.name.split("_")[2:4] for path in place.photos]
        assert years == sorted(years)
    assert all(path.is_file() for path in places[0].photos)
    assert metres_between(places[0].where, places[1].where) > 45


@pytest.mark.parametrize("suffix", [".jpg", ".JPG"])
def test_gsv_cities_by_its_tables_oldest_first(tmp_path: Path, suffix: str) -> None:
    rows = [(7, 2019, 12), (7, 2018, 2), (7, 2019, 3), (7, 2021, 1), (8, 2019, 1)]
    (place,) = find_places(gsv(tmp_path / "gsv", "Bangkok", rows, suffix=suffix))
    assert (place.name, place.city) == ("7", "gsv/Bangkok")
    assert [path.name[16:23] for path in place.photos] == ["2018_02", "2019_03", "2019_12", "2021_01"]
    assert all(path.is_file() for path in place.photos)
    assert place.where is not None
    assert (place.where.lat, place.where.lon) == pytest.approx((51.107, -0.05))


def test_no_photo_is_looked_at_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = gsv(tmp_path, "Bangkok", [(place, 2020, month) for place in range(300) for month in range(1, 6)])
    looked: Counter[str] = Counter()
    for name in ("stat", "lstat", "open"):
        plain = getattr(os, name)

        def count(path: object, *rest: object, plain: object = plain, **more: object) -> object:
            looked[Path(str(path)).suffix] += 1
            return plain(path, *rest, **more)

        monkeypatch.setattr(os, name, count)
    assert len(find_places(root)) == 300
    assert looked[".jpg"] == 0


def test_photos_that_a_table_names_in_vain_are_told(tmp_path: Path) -> None:
    root = gsv(tmp_path, "Bangkok", [(7, 2019, month) for month in range(1, 7)])
    for gone in ("pano_2", "pano_4"):
        next(iter((root / "Images" / "Bangkok").glob(f"*{gone}.jpg"))).unlink()
    with pytest.raises(
        BenchmarkError, match=r"Bangkok\.csv names .*pano_2\.jpg, which is not in .* \(nor are 1 more\)"
    ):
        find_places(root)
    said: list[str] = []
    (place,) = find_places(root, say=said.append)
    assert [path.name[-5] for path in place.photos] == ["0", "1", "3", "5"]
    (sentence,) = said
    assert "pano_2.jpg, which is not in" in sentence
    assert sentence.endswith("(nor are 1 more): left out")


def test_a_city_without_its_photos_is_left_out_and_told(tmp_path: Path) -> None:
    rows = [(7, 2019, month) for month in range(1, 5)]
    gsv(tmp_path, "Bangkok", rows)
    gsv(tmp_path, "Oslo", rows)
    (tmp_path / "Images" / "Oslo").rename(tmp_path / "elsewhere")
    said: list[str] = []
    (place,) = find_places(tmp_path, say=said.append)
    assert place.city.endswith("/Bangkok")
    assert len(said) == 1


@pytest.mark.parametrize(
    "line",
    [
        "7,2019\n",
        "7,never,1,0,Bangkok,1,2,x\n",
        "7,2019,1,north,Bangkok,1,2,x\n",
        "7,2019,1,0,Bangkok,north,2,x\n",
        "7,2019,1,0,Bangkok,91,2,x\n",
        "7,2019,1,0,Bangkok,nan,2,x\n",
    ],
)
def test_a_bad_line_of_a_table_is_told(tmp_path: Path, line: str) -> None:
    root = gsv(tmp_path, "Bangkok", [(7, 2019, 1)])
    with (root / "Dataframes" / "Bangkok.csv").open("a") as table:
        table.write(line)
    with pytest.raises(BenchmarkError, match=r"Bangkok\.csv, line 3: cannot be read"):
        find_places(root)


def test_a_table_that_is_no_text_is_told(tmp_path: Path) -> None:
    root = gsv(tmp_path, "Bangkok", [(7, 2019, 1)])
    (root / "Dataframes" / "Bangkok.csv").write_bytes(HEADER.encode() + b"\xff\xfe\x00" * 9)
    with pytest.raises(BenchmarkError, match=r"Bangkok\.csv, line \d+: cannot be read"):
        find_places(root)


def test_a_mark_at_the_tables_start_does_no_harm(tmp_path: Path) -> None:
    root = gsv(tmp_path, "Bangkok", [(7, 2019, month) for month in range(1, 5)])
    table = root / "Dataframes" / "Bangkok.csv"
    table.write_text("\ufeff" + table.read_text(), encoding="utf-8")
    assert len(find_places(root)) == 1
