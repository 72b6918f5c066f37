"""Every command from its arguments to its exit code, with a fake model; one road with a real one."""

from __future__ import annotations

import json
import math
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.table import Table

import salad as library
from salad.errors import SaladError
from salad.geo import GeoPoint, metres_between, shifted
from salad.images.exif import save_jpeg
from salad.images.photo import read_photo
from salad.index.index import Index
from salad.models.fake import FakeDescriber
from salad.network.aggregator_config import SaladConfig
from salad.network.config import LiteConfig, ModelConfig, Preprocessing

TINY = ModelConfig(
    name="tiny",
    backbone=LiteConfig(blocks=3),
    aggregator=SaladConfig(width=24, clusters=4, cluster_dim=8, scene_dim=8, hidden=16),
    preprocessing=Preprocessing(64, 64),
)


def one_sentence(ran: Any) -> str:
    """What a refused command says: one line to stderr, nothing to stdout, no traceback, exit 2."""
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.startswith("salad: ")
    assert ran.err.count("\n") == 1
    assert "Traceback" not in ran.err
    return ran.err


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    """A photo that cannot be read."""
    path = tmp_path / "broken [b].jpg"
    path.write_bytes(b"\xff\xd8\xff\xe0 no photo")
    return path


# --- index ---------------------------------------------------------------------------------


def test_index_takes_files_and_folders_and_a_list(cli: Any, asked: Any, photos: Any, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "city [1].index"
    first, second, *rest = photos.reference
    assert cli("index", first, "--to", folder).code == 0
    assert cli("index", "-", "--to", folder, stdin=f"{second}\n\n{rest[0]}\r\n").code == 0
    ran = cli("index", photos.references, photos.references, "--to", folder)
    assert ran.code == 0
    assert ran.out == ""
    assert "3 photos added, 3 there already, 0 unreadable; it holds 6, 6 with a position" in ran.err
    with Index.open(folder) as index:
        assert [photo.path for photo in index.photos()] == [
            path.resolve() for path in (first, second, rest[0], *sorted(rest[1:]))
        ]


def test_index_twice_adds_nothing(cli: Any, city: Path, photos: Any) -> None:
    ran = cli("index", photos.references, "--to", city)
    assert ran.code == 0
    assert "0 photos added, 6 there already" in ran.err


def test_index_names_the_unreadable_and_takes_the_others(
    cli: Any, asked: Any, photos: Any, broken: Path, tmp_path: Path
) -> None:
    ran = cli("index", broken, photos.reference[0], "--to", tmp_path / "index")
    assert ran.code == 0
    assert f"{broken} is" in ran.err
    assert "1 photos added, 0 there already, 1 unreadable" in ran.err


def test_index_without_a_readable_photo_is_bad_input(cli: Any, asked: Any, broken: Path, tmp_path: Path) -> None:
    assert cli("index", broken, "--to", tmp_path / "index").code == 2


def test_index_names_copies(cli: Any, city: Path, photos: Any, tmp_path: Path) -> None:
    copy = tmp_path / "copy.jpg"
    shutil.copy(photos.reference[0], copy)
    ran = cli("index", copy, "--to", city)
    assert ran.code == 0
    assert f"{copy} is a copy of {photos.reference[0].resolve()}" in ran.err


def test_index_takes_positions_from_a_table(cli: Any, asked: Any, photos: Any, tmp_path: Path) -> None:
    table = tmp_path / "places.csv"
    table.write_text(f'path,lat,lon\n"{photos.query[1]}",-33.5,151.25\n', encoding="utf-8")
    ran = cli("index", photos.query[1], "--to", tmp_path / "index", "--table", table)
    assert "it holds 1, 1 with a position" in ran.err
    with Index.open(tmp_path / "index") as index:
        assert [photo.where for photo in index.photos()] == [GeoPoint(-33.5, 151.25)]


def test_index_reads_at_names(cli: Any, asked: Any, photos: Any, tmp_path: Path) -> None:
    path = tmp_path / "@0690000.00@5330000.00@32@U@@@pano@@90@@@@20240501_120000@note@.jpg"
    shutil.copy(photos.query[0], path)
    assert cli("index", path, "--to", tmp_path / "index").code == 0
    ran = cli("locate", photos.query[0], "--index", tmp_path / "index", "--format", "json")
    (match,) = ran.json()[0]["matches"]
    assert (match["heading"], match["time"]) == (90.0, "2024-05-01T12:00:00")
    assert (match["lat"], match["lon"]) == pytest.approx((48.09, 11.55), abs=0.02)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--model", "no-such-model"], "no-such-model"),
        (["--table", "no-such.csv"], "no-such.csv"),
        (["--batch-size", "0"], "--batch-size 0"),
        (["--threads", "0"], "--threads 0"),
        (["no-such.jpg"], "no-such.jpg"),
    ],
)
def test_a_refused_index_leaves_no_folder(
    cli: Any, photos: Any, tmp_path: Path, arguments: list[str], named: str
) -> None:
    folder = tmp_path / "deep" / "new.index"
    ran = cli("index", *arguments, photos.reference[0], "--to", folder)
    assert named in one_sentence(ran)
    assert list(tmp_path.iterdir()) == []


def test_index_refuses_a_folder_of_something_else(cli: Any, asked: Any, photos: Any, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    assert f"{tmp_path} already exists" in one_sentence(cli("index", photos.references, "--to", tmp_path))
    taken = one_sentence(cli("index", photos.references, "--to", tmp_path / "thesis.txt"))
    assert "thesis.txt" in taken
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_an_interrupted_index_is_sound_and_goes_on(
    cli: Any, asked: Any, photos: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    describe, calls = FakeDescriber.describe, []

    def tired(self: FakeDescriber, *arguments: Any, **settings: Any) -> Any:
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return describe(self, *arguments, **settings)

    monkeypatch.setattr("salad.index.build.COMMIT_BATCHES", 1)
    monkeypatch.setattr(FakeDescriber, "describe", tired)
    command = ("index", photos.references, "--to", tmp_path / "index", "--batch-size", 1)
    ran = cli(*command)
    assert (ran.code, ran.out) == (130, "")
    assert "interrupted" in ran.err
    assert "Traceback" not in ran.err
    assert cli("verify", tmp_path / "index").code == 0
    assert "3 photos added, 3 there already" in cli(*command).err


def test_a_full_disk_is_told_in_a_sentence(
    cli: Any, asked: Any, photos: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("salad.index.build.index_photos", full)
    ran = cli("index", photos.references, "--to", tmp_path / "index")
    assert "No space left on device" in one_sentence(ran)


# --- locate --------------------------------------------------------------------------------


def test_locate_finds_every_photo(cli: Any, city: Path, photos: Any) -> None:
    ran = cli("locate", photos.queries, "--index", city, "--format", "json")
    assert (ran.code, ran.err) == (0, "")
    answers = {answer["query"]: answer for answer in ran.json()}
    assert sorted(answers) == sorted(map(str, photos.query))
    with Index.open(city) as index:
        truth = {photo.path.name: photo for photo in index.photos()}
    for path, answer in answers.items():
        expected, place, best = truth[Path(path).name], answer["place"], answer["matches"][0]
        assert metres_between(GeoPoint(place["lat"], place["lon"]), expected.where) < 1
        assert best["path"] == str(expected.path)
        assert (best["lat"], best["lon"]) == (expected.where.lat, expected.where.lon)
        assert (best["heading"], best["time"]) == (expected.heading, expected.time.isoformat())


def test_json_of_locate_has_the_keys_that_are_promised(cli: Any, city: Path, photos: Any) -> None:
    (answer,) = cli("locate", photos.query[0], "--index", city, "-k", 3, "--format", "json").json()
    assert list(answer) == ["query", "place", "matches", "others"]
    assert list(answer["place"]) == ["lat", "lon", "radius_m", "confidence", "support"]
    assert len(answer["matches"]) == 3
    for match in answer["matches"]:
        assert list(match) == ["path", "score", "lat", "lon", "heading", "time"]
        assert isinstance(match["path"], str)
        assert -1.001 <= match["score"] <= 1.001
    assert 0 < answer["place"]["confidence"] <= 1
    assert answer["place"]["support"] == 1


def test_locate_without_positions_finds_nothing(cli: Any, asked: Any, photos: Any, tmp_path: Path) -> None:
    assert cli("index", photos.queries, "--to", tmp_path / "index").code == 0
    ran = cli("locate", photos.query[0], "--index", tmp_path / "index", "--format", "json")
    assert (ran.code, ran.err) == (1, "")
    (answer,) = ran.json()
    assert answer["place"] is None
    assert {(match["lat"], match["lon"], match["heading"], match["time"]) for match in answer["matches"]} == {
        (None, None, None, None)
    }


def test_locate_passes_over_the_unreadable(cli: Any, city: Path, photos: Any, broken: Path) -> None:
    ran = cli("locate", broken, photos.query[0], "--index", city, "--format", "json")
    assert ran.code == 0
    assert [answer["query"] for answer in ran.json()] == [str(photos.query[0])]
    assert f"{broken} is" in ran.err


def test_locate_of_nothing_readable_is_bad_input(cli: Any, city: Path, broken: Path) -> None:
    ran = cli("locate", broken, "--index", city, "--format", "json")
    assert (ran.code, ran.json()) == (2, [])
    assert f"{broken} is" in ran.err


def test_locate_reads_a_list(cli: Any, city: Path, photos: Any) -> None:
    listed = "".join(f"{path}\n" for path in photos.query[:2])
    ran = cli("locate", "-", photos.query[3], "--index", city, "--format", "json", stdin=listed)
    assert [answer["query"] for answer in ran.json()] == [str(photos.query[n]) for n in (0, 1, 3)]


@pytest.mark.parametrize("k", ["0", "-3", "some"])
def test_locate_refuses_a_bad_k(cli: Any, city: Path, photos: Any, asked: Any, k: str) -> None:
    ran = cli("locate", photos.query[0], "--index", city, "-k", k)
    assert (ran.code, ran.out, asked) == (2, "", [])
    assert k in ran.err
    assert "Traceback" not in ran.err


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["no-such.jpg"], "no-such.jpg"),
        ([], "no photos are named"),
        (["-"], "no photos are named"),
    ],
)
def test_locate_refuses_missing_photos(cli: Any, city: Path, arguments: list[str], named: str) -> None:
    assert named in one_sentence(cli("locate", *arguments, "--index", city))


@pytest.mark.parametrize("command", ["info", "verify", "locate", "remove"])
def test_what_is_no_index_is_refused(cli: Any, photos: Any, tmp_path: Path, asked: Any, command: str) -> None:
    where = {"info": [tmp_path], "verify": [tmp_path]}.get(command, [photos.query[0], "--index", tmp_path])
    assert f"{tmp_path} is not an index" in one_sentence(cli(command, *where))
    (tmp_path / "index.json").write_text("{", encoding="utf-8")
    assert "damaged" in one_sentence(cli(command, *where))


def test_another_model_is_refused(cli: Any, city: Path, photos: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("salad.models.model_folder.load", lambda *_, **__: FakeDescriber(dim=256, name="other", seed=1))
    for command in (
        ("locate", photos.query[0], "--index", city, "--model", "other"),
        ("index", photos.query[0], "--to", city, "--model", "other"),
    ):
        sentence = one_sentence(cli(*command))
        assert "salad-lite" in sentence
        assert "other" in sentence
    with Index.open(city) as index:
        assert len(index) == 6


def test_the_model_is_the_one_named_else_the_index_s_own(cli: Any, city: Path, photos: Any, asked: Any) -> None:
    cli("locate", photos.query[0], "--index", city)
    cli("index", photos.query[0], "--to", city)
    cli("index", photos.query[0], "--to", city, "--model", "here/or there")
    cli("locate", photos.query[0], "--index", city, "--model", "elsewhere")
    assert asked == ["salad-lite", "salad-lite", "here/or there", "elsewhere"]


# --- info, verify, remove ------------------------------------------------------------------


def test_info_tells_what_an_index_holds(cli: Any, city: Path) -> None:
    ran = cli("info", city, "--format", "json")
    assert (ran.code, ran.err) == (0, "")
    told = ran.json()
    assert list(told) == [
        *("photos", "with_position", "with_heading", "with_time", "removed", "model", "fingerprint", "dim"),
        *(
            "bytes",
            "bytes_of_descriptors",
            "created",
            "box",
            "span_km",
            "earliest",
            "latest",
            "format_version",
        ),
    ]
    assert (told["photos"], told["with_position"], told["dim"], told["model"]) == (6, 6, 256, "salad-lite")
    south, west, north, east = told["box"]
    assert (south, west, east) == pytest.approx((48.1, 11.5, 11.5), abs=1e-6)
    assert north == pytest.approx(48.109, abs=1e-3)
    assert told["span_km"] == pytest.approx([1.0, 0.0], abs=0.01)
    assert (told["earliest"], told["latest"]) == ("2024-05-01T12:00:00", "2024-05-06T12:00:00")
    assert (told["with_heading"], told["with_time"], told["removed"]) == (6, 6, 0)
    assert told["bytes_of_descriptors"] == 6 * 256 * 2 < told["bytes"]


@pytest.mark.parametrize("wrong", ["\x1b[2J", "0" * 30, "9999", "99999999999999999999-01-01", "0 " + "x" * 50_000])
def test_info_tells_no_time_that_is_none(wrong: str, cli: Any, city: Path) -> None:
    with closing(sqlite3.connect(city / "photos.sqlite")) as db, db:
        db.execute("UPDATE photos SET time = ? WHERE row = 1", (wrong,))
    ran = cli("info", city)
    assert ran.code == 0
    assert wrong[:20] not in ran.out
    assert len(ran.out) < 5_000


def test_info_for_people_has_the_same_facts(cli: Any, city: Path) -> None:
    told = cli("info", city, "--format", "json").json()
    ran = cli("info", city)
    assert ran.code == 0
    lines = ran.out.splitlines()
    named = [line.split("  ")[0] for line in lines]
    units = {"box": "south, west, north, east", "span_km": "km from south to north, west to east"}
    units |= {"bytes": "MB", "bytes_of_descriptors": "MB of descriptors"}
    assert named == [units.get(name, name.replace("_", " ")) for name in told]
    assert lines[0].split() == ["photos", "6"]
    assert len({len(line) - len(line.split("  ")[-1].lstrip()) for line in lines}) == 1  # one column of values


def test_verify_tells_sound_from_damaged(cli: Any, city: Path) -> None:
    ran = cli("verify", city)
    assert (ran.code, ran.out, ran.err) == (0, f"{city} is sound: 6 photos\n", "")
    matrix = city / "descriptors.f16"
    matrix.write_bytes(b"\0" * 512 + matrix.read_bytes()[512:])
    ran = cli("verify", city)
    assert ran.code == 1
    assert len(ran.out.splitlines()) == 1
    assert "damaged descriptor" in ran.out


def test_verify_names_photos_that_are_gone(cli: Any, asked: Any, photos: Any, tmp_path: Path) -> None:
    moved = tmp_path / "gone one.jpg"
    shutil.copy(photos.query[0], moved)
    cli("index", moved, "--to", tmp_path / "index")
    moved.unlink()
    ran = cli("verify", tmp_path / "index")
    assert ran.code == 0
    assert "is sound" in ran.out
    assert f"{moved.resolve()} is gone" in ran.err


def test_remove_takes_files_folders_and_a_list(cli: Any, city: Path, photos: Any) -> None:
    first, second, third, *_ = photos.reference
    ran = cli("remove", first, "--index", city)
    assert (ran.code, ran.out) == (0, "")
    assert "1 photos removed" in ran.err
    assert "2 photos removed" in cli("remove", "-", "--index", city, stdin=f"{second}\n{third}\n").err
    assert "3 photos removed" in cli("remove", photos.references, "--index", city).err
    ran = cli("remove", first, "--index", city)
    assert ran.code == 1
    assert "0 photos removed" in ran.err
    assert all(path.exists() for path in photos.reference)


@pytest.mark.parametrize("arguments", [[], ["-"]])
def test_remove_of_nothing_is_bad_input(cli: Any, city: Path, arguments: list[str]) -> None:
    assert "no photos are named" in one_sentence(cli("remove", *arguments, "--index", city))


def test_what_is_removed_is_not_found(cli: Any, city: Path, photos: Any) -> None:
    cli("remove", photos.reference[0], "--index", city)
    (answer,) = cli("locate", photos.query[0], "--index", city, "--format", "json").json()
    assert str(photos.reference[0].resolve()) not in [match["path"] for match in answer["matches"]]


# --- evaluate ------------------------------------------------------------------------------


@pytest.fixture
def sides(photos: Any) -> list[Any]:
    return ["evaluate", "--references", photos.references, "--queries", photos.queries]


def test_evaluate_by_frames(cli: Any, asked: Any, sides: list[Any]) -> None:
    ran = cli(*sides, "--frames", 0, "--format", "json")
    assert (ran.code, ran.err) == (0, "")
    told = ran.json()
    assert list(told)[:7] == [*("protocol", "queries", "references", "unanswerable", "recall", "model", "seconds")]
    assert told["recall"] == {"1": 100.0, "5": 100.0, "10": 100.0, "20": 100.0}
    assert (told["queries"], told["references"], told["unanswerable"]) == (6, 6, 0)
    assert told["seconds"] >= 0
    assert told["model"] == "salad-lite"


def test_evaluate_by_truth(cli: Any, asked: Any, sides: list[Any], photos: Any, tmp_path: Path) -> None:
    truth = tmp_path / "gt.csv"
    right, wrong = photos.query[0].name, photos.query[1].name
    truth.write_text(f"query,positives\n{right},{right}\n{wrong},{right}\n", encoding="utf-8")
    ran = cli(*sides, "--truth", truth, "--format", "json")
    assert ran.code == 0
    assert ran.json()["recall"]["1"] == 50.0
    assert "4 photos" in ran.err  # those the table does not mention


def test_evaluate_by_radius(cli: Any, asked: Any, photos: Any, tmp_path: Path) -> None:
    at = read_photo(photos.reference[0]).where
    save_jpeg(np.full((60, 60, 3), 128, np.uint8), tmp_path / "grey.jpg", where=shifted(at, 0.0, 30.0))
    command = ("evaluate", "--references", photos.references, "--queries", tmp_path, "--format", "json")
    ran = cli(*command, "--radius", 31)
    assert ran.code == 0
    told = ran.json()
    assert (told["unanswerable"], told["recall"]["10"]) == (0, 100.0)
    assert math.isfinite(told["seconds"])
    assert "no recall" in one_sentence(cli(*command, "--radius", 29))  # no reference is so near


def test_evaluate_for_people(cli: Any, asked: Any, sides: list[Any]) -> None:
    ran = cli(*sides, "--frames", 0, "--model", "mine", "--heads", 2)
    assert ran.code == 0
    assert "R@1" in ran.out
    assert "100.0 %" in ran.out
    assert asked == ["mine"]


@pytest.mark.parametrize(
    ("rule", "named"),
    [
        ([], "0 rules"),
        (["--frames", 1, "--radius", 25], "2 rules"),
        (["--truth", "gt.csv", "--frames", 0, "--radius", 0], "3 rules"),
        (["--truth", "no-such.csv"], "no-such.csv"),
        (["--frames", -1], "-1"),
        (["--radius", "nan"], "nan"),
        (["--radius", 25], ""),  # the queries carry no geotags
    ],
)
def test_evaluate_takes_one_good_rule(cli: Any, asked: Any, sides: list[Any], rule: list[Any], named: str) -> None:
    assert named in one_sentence(cli(*sides, *rule))
    assert asked == []  # before a model is loaded


def test_evaluate_refuses_a_set_with_holes(cli: Any, asked: Any, photos: Any, broken: Path) -> None:
    broken.rename(broken.with_name("broken 1.jpg"))
    ran = cli("evaluate", "--references", photos.references, "--queries", broken.parent, "--frames", 0)
    assert "broken 1.jpg" in one_sentence(ran)


# --- train and demo ------------------------------------------------------------------------


def tiny_training(monkeypatch: pytest.MonkeyPatch) -> None:
    from salad.training.recipe import PRESETS, Preset, Recipe

    recipe = Recipe(tuned_blocks=1, places=2, views=2, warmup=1, measure_every=1, precision="32-true", held_out=0.5)
    monkeypatch.setitem(PRESETS, "tiny", Preset(TINY, "", recipe))


@pytest.mark.torch
def test_train_makes_a_model_that_locates(
    cli: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, training_photos: Path
) -> None:
    tiny_training(monkeypatch)
    steps = ("--head-steps", 1, "--tune-steps", 1, "--accelerator", "cpu", "--seed", 3)
    command = ("train", "--data", training_photos, "--to", tmp_path / "run", "--preset", "tiny", *steps)
    ran = cli(*command)
    model = tmp_path / "run" / "model"
    assert (ran.code, ran.out) == (0, f"{model}\n")
    assert library.load(model).dim == TINY.aggregator.dim
    lines = (tmp_path / "run" / "log.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["step"] for line in lines] == [1, 2]
    again = cli(*command[:-1], 4)  # another seed is another run
    assert "another recipe" in one_sentence(replace(again, err=again.err.splitlines()[-1] + "\n"))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--preset", "nope"], "nope"),
        pytest.param(["--start", "no-such.pth"], "no-such.pth", marks=pytest.mark.torch),
        pytest.param(["--data", "nowhere"], "nowhere", marks=pytest.mark.torch),
    ],
)
def test_train_refuses_what_is_not_there(
    cli: Any, tmp_path: Path, training_photos: Path, arguments: list[Any], named: str
) -> None:
    given = ["--data", training_photos] if "--data" not in arguments else []
    ran = cli("train", *given, "--to", tmp_path / "run", *arguments)
    assert ran.code == 2
    assert named in ran.err.splitlines()[-1]
    assert "Traceback" not in ran.err
    assert not (tmp_path / "run").exists()


def test_demo_shows_a_table_and_says_where_the_page_is(
    cli: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: dict[str, Any] = {}

    def run_demo(to: Path, *, seed: int, say: Any, **_: Any) -> SimpleNamespace:
        told.update(to=to, seed=seed)
        say("Drawing a town")
        return SimpleNamespace(page=Path(to) / "town.html")

    def table(result: SimpleNamespace) -> Table:
        shown = Table("right")
        shown.add_row(result.page.name)
        return shown

    monkeypatch.setattr("salad.demo.run.run_demo", run_demo)
    monkeypatch.setattr("salad.demo.demo_result.table", table)
    ran = cli("demo", "--to", tmp_path / "here", "--seed", 9)
    assert ran.code == 0
    assert told == {"to": tmp_path / "here", "seed": 9}
    assert "Drawing a town" in ran.err
    assert "town.html" in ran.out
    assert ran.out.splitlines()[-1].endswith(str((tmp_path / "here" / "town.html").resolve()))


# --- a real model --------------------------------------------------------------------------


@pytest.fixture
def model_folder(tmp_path: Path) -> Path:
    """A real model, small and untrained: it tells photos apart no better than chance."""
    from salad.models.model_folder import write_folder
    from salad.network.network import build

    return write_folder(build(TINY), tmp_path / "models" / "my tiny")


@pytest.mark.torch
def test_the_whole_road_with_a_model_folder(cli: Any, photos: Any, model_folder: Path, tmp_path: Path) -> None:
    city = tmp_path / "city.index"
    assert cli("index", photos.reference[0], "--to", city, "--model", model_folder).code == 0
    ran = cli("locate", photos.query[0], "--index", city, "--model", model_folder, "--format", "json")
    assert (ran.code, ran.err) == (0, "")
    assert ran.json()[0]["matches"][0]["path"] == str(photos.reference[0].resolve())
    rule = ("--frames", 0, "--format", "json")
    sides = ("--references", photos.references, "--queries", photos.queries)
    ran = cli("evaluate", *sides, "--model", model_folder, *rule)
    assert ran.json()["recall"]["10"] == 100.0


@pytest.mark.torch
def test_a_model_folder_has_to_be_named_again(cli: Any, photos: Any, model_folder: Path, tmp_path: Path) -> None:
    city = tmp_path / "city.index"
    cli("index", photos.reference[0], "--to", city, "--model", model_folder)
    for command in (
        ("locate", photos.query[0], "--index", city),
        ("index", photos.reference[1], "--to", city),
    ):
        sentence = one_sentence(cli(*command))
        assert "tiny" in sentence
        assert "--model" in sentence


@pytest.mark.torch
def test_a_device_that_is_not_here_is_refused(cli: Any, photos: Any, model_folder: Path, tmp_path: Path) -> None:
    command = ("index", photos.reference[0], "--to", tmp_path / "index", "--model", model_folder)
    assert "warp" in one_sentence(cli(*command, "--device", "warp"))
    assert not (tmp_path / "index").exists()


def test_errors_of_the_library_are_the_command_line_s(cli: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise SaladError("the sky fell: look up")

    monkeypatch.setattr("salad.index.index.Index.open", refuse)
    assert one_sentence(cli("info", "x")) == "salad: the sky fell: look up\n"
