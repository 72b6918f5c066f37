"""`salad places` from the shell: a table on disk, its path on stdout, what became of the photos on stderr."""

from __future__ import annotations

import csv
from datetime import datetime
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from salad.cli.places_command import _ADVICE, PlacesCommand
from salad.datasets.cluster import Reason
from salad.datasets.places import find_places
from salad.errors import SaladError
from salad.geo import GeoPoint, shifted
from salad.images.exif import save_jpeg

HOME = GeoPoint(48.10004, 11.50006)


@pytest.fixture
def streets(tmp_path: Path) -> Path:
    """Three spots 200 m apart: five photos, five of which one is cut short, and two; one photo knows nothing."""
    folder = tmp_path / "streets"
    folder.mkdir()
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    for spot, count in enumerate((5, 5, 2)):
        for number in range(count):
            save_jpeg(
                picture,
                folder / f"{spot}-{number}.jpg",
                where=shifted(HOME, 200.0 * spot, 0.0),
                heading=2.0 * number,
                time=datetime(2024, 5, 1 + count - number),
            )
    save_jpeg(picture, folder / "nowhere.jpg")
    cut = folder / "1-0.jpg"
    cut.write_bytes(cut.read_bytes()[:-2500])
    return folder


def ran(command: PlacesCommand, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = command.run()
    return code, *capsys.readouterr()


def test_places_are_written_and_told(streets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    to = tmp_path / "places.csv"
    code, out, err = ran(PlacesCommand((str(streets),), to), capsys)
    assert (code, out) == (0, f"{to}\n")
    assert "1-0.jpg" in err
    told = dict(line.rsplit(maxsplit=1) for line in err.splitlines()[-7:])
    assert told == {
        "photos": "13",
        "used": "9",
        "places": "2",
        "cities": "1",
        "left out, no position": "1",
        "left out, unreadable": "1",
        "left out, too few in their cell": "2",
    }
    first, second = find_places(to)
    assert [path.name for path in first.photos] == [f"0-{number}.jpg" for number in (4, 3, 2, 1, 0)]
    assert len(second.photos) == 4
    with to.open() as lines:
        rows = list(csv.DictReader(lines))
    assert rows[0]["path"] == str(Path("streets") / "0-4.jpg")
    assert (rows[0]["heading"], rows[0]["time"]) == ("8.0", "2024-05-02T00:00:00")


def test_without_a_check_a_broken_photo_is_trusted(
    streets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = ran(PlacesCommand((str(streets),), tmp_path / "places.csv", check=False), capsys)
    assert code == 0
    assert "unreadable" not in err
    assert [len(place.photos) for place in find_places(tmp_path / "places.csv")] == [5, 5]


def test_json_is_for_programs(streets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    code, out, _ = ran(PlacesCommand((str(streets),), tmp_path / "places.csv", apart=250, format="json"), capsys)
    told: Any = json.loads(out)
    assert code == 0
    assert told["table"] == str(tmp_path / "places.csv")
    assert (told["photos"], told["used"], told["places"]) == (13, 5, 1)
    assert told["left_out"]["too near another place"] == 4


def test_positions_may_come_from_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = np.zeros((8, 8, 3), dtype=np.uint8)
    for number in range(4):
        save_jpeg(picture, tmp_path / f"{number}.jpg")
    (tmp_path / "where.csv").write_text("path,lat,lon\n" + "".join(f"{n}.jpg,48.10004,11.50006\n" for n in range(4)))
    photos = tuple(str(tmp_path / f"{number}.jpg") for number in range(4))
    code, _, _ = ran(PlacesCommand(photos, tmp_path / "places.csv", table=tmp_path / "where.csv"), capsys)
    assert code == 0
    assert len(find_places(tmp_path / "places.csv")[0].photos) == 4


def test_no_place_writes_no_table(streets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    to = tmp_path / "places.csv"
    code, out, err = ran(PlacesCommand((str(streets / "nowhere.jpg"),), to), capsys)
    assert (code, out) == (1, "")
    assert "left out, no position" in err
    assert "nothing is written; most photos: no position. Name a table" in err
    assert not to.exists()
    code, out, _ = ran(PlacesCommand((str(streets / "nowhere.jpg"),), to, format="json"), capsys)
    assert code == 1
    assert '"table": null' in out


@pytest.mark.parametrize("pattern", ["*.jpg", "2-*.jpg"])
def test_too_few_photos_of_each_place_are_told_with_what_to_do(
    streets: Path, tmp_path: Path, pattern: str, capsys: pytest.CaptureFixture[str]
) -> None:
    photos = tuple(map(str, streets.glob(pattern)))
    code, out, err = ran(PlacesCommand(photos, tmp_path / "places.csv", fewest=6), capsys)
    assert (code, out) == (1, "")
    assert "most photos: too few in their cell. Take larger cells (--cell)" in err


def test_every_reason_has_its_advice() -> None:
    assert set(_ADVICE) == set(get_args(Reason))


def test_photos_whose_places_are_known_already_are_for_training_as_they_are(
    streets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (streets / "Dataframes").mkdir()
    with pytest.raises(SaladError, match=f"`salad train --data {streets}`"):
        PlacesCommand((str(streets),), tmp_path / "places.csv").run()
    table = tmp_path / "where.csv"
    table.write_text("path,lat,lon\nstreets/nowhere.jpg,48.1,11.5\n")
    code, _, _ = ran(PlacesCommand((str(streets),), tmp_path / "places.csv", table=table), capsys)
    assert code == 0  # whoever brings positions wants places of their own


@pytest.mark.parametrize("to", ["gone/places.csv", "."])
def test_a_table_that_cannot_be_written_is_told_before_any_work(streets: Path, tmp_path: Path, to: str) -> None:
    with pytest.raises(SaladError, match="cannot be written: name a file in a folder that is there"):
        PlacesCommand((str(streets),), tmp_path / to).run()
