"""An index that was written before the rebuild: opened, searched, changed and written again as on that day.

What it answered is recorded (see `city.py`): the index on disk is a promise, and people hold files of it.
"""

from __future__ import annotations

import csv
import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import salad
from pins.city import CITY, MODEL, NAMES, answers, descriptors, make, photos, queries
from pins.where import recorded, salad_says, street

COLUMNS = ["path", "lat", "lon", "heading", "time", "identity", "source"]


@pytest.fixture
def city(tmp_path: Path) -> Path:
    """A copy that may be changed."""
    return Path(shutil.copytree(CITY, tmp_path / "city.index"))


def test_it_answers_as_on_its_first_day(city: Path) -> None:
    then, now = recorded("city"), answers(city)
    searched = then.pop("search"), now.pop("search")
    assert json.loads(json.dumps(now)) == then
    assert searched[0].keys() == searched[1].keys()
    for name, of_then in searched[0].items():
        for before, after in zip(of_then, searched[1][name], strict=True):
            assert [match[:2] for match in after] == [match[:2] for match in before], name
            scores = [match[2] for match in after]
            np.testing.assert_allclose(scores, [match[2] for match in before], rtol=0, atol=1e-6)


def test_it_is_sound_and_belongs_to_its_model(city: Path) -> None:
    with salad.Index.open(city) as index:
        assert index.verify() == []
        index.check_model(MODEL)  # the fake's fingerprint is of the names of its settings
    ran = salad_says("verify", city)
    assert (ran.code, ran.out) == (0, f"{city} is sound: 11 photos\n")


def test_equal_photos_tie_and_the_removed_one_stays_away(city: Path) -> None:
    with salad.Index.open(city) as index:
        (found,) = index.search(descriptors()[1], k=50)
    assert [match.row for match in found[:2]] == [1, 11]
    assert found[0].score == found[1].score
    assert sorted(match.row for match in found) == [0, 1, 2, 3, 4, 5, 6, 7, 9, 10, 11]


def test_an_index_made_today_is_the_same_to_the_byte(city: Path, tmp_path: Path) -> None:
    """Rounding to float16, checksums, the table's form and the header; only the date and the version are others.

    The table that today's is compared with is that of the old index, once it is brought to today's form.
    """
    anew = tmp_path / "anew.index"
    make(anew)
    with salad.Index.open(city) as index:
        assert index.remove([]) == 0  # a change, before which it is
    with closing(sqlite3.connect(city / "photos.sqlite")) as db, db:
        db.execute("UPDATE committed SET generation = generation - 1")
    headers = [json.loads((folder / "index.json").read_bytes()) for folder in (city, anew)]
    assert [header.pop("created")[-6:] for header in headers] == ["+00:00"] * 2
    assert headers[0] == headers[1]
    assert list(headers[0]) == ["kind", "model", "fingerprint", "dim", "format_version"]
    assert sorted(file.name for file in anew.iterdir()) == sorted(file.name for file in city.iterdir())
    assert (anew / "descriptors.f16").read_bytes() == (city / "descriptors.f16").read_bytes()
    assert _table(anew) == _table(city)


def _table(folder: Path) -> Any:
    """Everything in the database: its tables, columns, marks and rows."""
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db:
        db.text_factory = bytes  # one name is not UTF-8
        tables = [name.decode() for (name,) in db.execute("SELECT name FROM sqlite_master ORDER BY name")]
        marks = [db.execute(f"PRAGMA {mark}").fetchone() for mark in ("user_version", "application_id")]
        columns = [db.execute(f"PRAGMA table_xinfo({name})").fetchall() for name in tables]
        held = [db.execute(f"SELECT * FROM {name}").fetchall() for name in ("photos", "committed")]
    return tables, marks, columns, held


def test_photos_can_be_added_and_removed(city: Path) -> None:
    with salad.Index.open(city) as index:
        more = salad.Photo(Path("/photos/l.jpg"), salad.GeoPoint(48.2, 11.5))
        assert index.add([more], MODEL.describe([street(50)]), identities=["f" * 32]) == 1
        ((best, *_),) = index.search(MODEL.describe([street(50)]), k=1)
        assert (best.row, best.photo) == (12, more)
        assert index.remove(["/photos/sub"]) == 2
        assert index.verify() == []
        assert (len(index), index.info().removed) == (10, 3)


def test_it_can_be_compacted(city: Path) -> None:
    with salad.Index.open(city) as index:
        before = index.search(queries(), k=20)
        done = index.compact()
        assert (done.kept, done.damaged) == (11, [])
        after = index.search(queries(), k=20)
        assert index.verify() == []
    told = [[[(one.photo, one.score) for one in best] for best in found] for found in (before, after)]
    assert told[0] == told[1]


@pytest.mark.parametrize("form", ["csv", "geojson"])
def test_it_can_be_exported_and_taken_back(city: Path, tmp_path: Path, form: str) -> None:
    out = tmp_path / "out"
    assert salad_says("export", city, "--to", out, "--format", form).code == 0
    rows = np.load(out / "descriptors.npy")
    whole = np.fromfile(city / "descriptors.f16", dtype=np.float16).reshape(12, 48)
    np.testing.assert_array_equal(rows, np.delete(whole, 8, axis=0))
    if form == "csv":
        with (out / "photos.csv").open(encoding="utf-8", errors="surrogateescape", newline="") as file:
            first, *lines = csv.reader(file)
        assert first == COLUMNS
        assert [Path(line[0]) for line in lines] == [one.path for n, one in enumerate(photos()) if n != 8]
        assert lines[0] == ["/photos/a.jpg", "48.1", "11.5", "0.0", "2024-05-01T12:30:00+09:00", "0" * 32, ""]
        assert lines[4][1:3] == ["", ""]
    else:
        told = json.loads((out / "photos.geojson").read_text(encoding="utf-8"))
        assert (list(told), told["type"]) == (["type", "features"], "FeatureCollection")
        first = told["features"][0]
        assert list(first) == ["type", "geometry", "properties"]
        assert first["geometry"] == {"type": "Point", "coordinates": [11.5, 48.1]}
        assert list(first["properties"]) == ["path", "heading", "time", "identity", "source"]
        assert told["features"][4]["geometry"] is None
    back = tmp_path / "back.index"
    assert salad_says("index", "--from", out, "--to", back).code == 0
    with salad.Index.open(city) as index, salad.Index.open(back) as again:
        assert list(again.photos()) == list(index.photos())
        assert again.fingerprint == index.fingerprint


def test_what_is_damaged_is_passed_over_and_named(city: Path) -> None:
    """Not a number, infinity, another photo's descriptor, far too long: none of them is ever found."""
    whole = np.memmap(city / "descriptors.f16", dtype=np.float16, mode="r+", shape=(12, 48))
    whole[0, 5], whole[2, 0], whole[3], whole[5] = np.nan, np.inf, whole[1].copy(), 30 * whole[5]
    whole.flush()
    with salad.Index.open(city) as index:
        for centred in (False, True):
            for best in index.search(np.concatenate([queries(), descriptors()]), k=20, centred=centred):
                assert sorted(match.row for match in best) == [1, 4, 6, 7, 9, 10, 11]
        told = index.verify()
        assert len(told) == 4
        for row in (0, 2, 3, 5):
            assert any(NAMES[row] in sentence for sentence in told), row
        assert index.compact(dropping=len).kept == 7
