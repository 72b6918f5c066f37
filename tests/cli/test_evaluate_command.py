"""`salad evaluate` on named protocols, other methods' outputs, and files beside its figures; two results compared."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from salad.cli.evaluation_tables import compare_results, leak_sentences
from salad.errors import BenchmarkError
from salad.evaluation.evaluate_benchmark import CENTRED
from salad.evaluation.leaks import Leak
from salad.evaluation.result import read_result
from salad.images.exif import save_jpeg
from salad.images.photo import read_photo
from salad.models.fake import FakeDescriber
from salad.network.config import Calibration

Cli = Callable[..., Any]


@pytest.fixture
def sides(photos: Any) -> list[Any]:
    return ["evaluate", "--references", photos.references, "--queries", photos.queries]


def sentence(ran: Any) -> str:
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.startswith("salad: ")
    assert ran.err.count("\n") == 1
    return str(ran.err)


def test_everything_at_once(cli: Cli, asked: Any, sides: list[Any], tmp_path: Path) -> None:
    files = {name: tmp_path / name for name in ("result.json", "result.csv")}
    ran = cli(
        *(*sides, "--frames", 0, "--leaks", "--cache", tmp_path / "cache", "--seed", 3),
        *("--save", files["result.json"], "--csv", files["result.csv"]),
    )
    assert ran.code == 0
    for told in (
        "R@1",
        "100.0 %",
        "area under precision-recall",
        "recall at 100 % precision",
        "in both sides",
    ):
        assert told in ran.out
    result = read_result(files["result.json"])
    assert result.recall[1] == 100.0
    assert result.drawn["seed"] == 3
    assert len(files["result.csv"].read_text(encoding="utf-8").splitlines()) == 7
    again = cli(*sides, "--frames", 0, "--cache", tmp_path / "cache", "--format", "json")
    assert again.json()["recall"] == {"1": 100.0, "5": 100.0, "10": 100.0, "20": 100.0}
    assert list((tmp_path / "cache").rglob("*.safetensors"))


def test_a_model_that_is_searched_by_centred_scores_can_be_judged_plain(
    cli: Cli, asked: Any, sides: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = (*sides, "--frames", 0, "--format", "json")
    before = cli(*command).json()
    monkeypatch.setattr(FakeDescriber, "calibration", Calibration(centred=True), raising=False)
    own, plain = cli(*command).json(), cli(*command, "--plain").json()
    assert (before["model"], own["model"], plain["model"]) == (
        "salad-lite",
        "salad-lite",
        "salad-lite, plain",
    )
    assert (before["notes"], own["notes"], plain["notes"]) == ([], [CENTRED], [])


def test_what_comes_from_outside_is_plain_already(cli: Cli, sides: list[Any], tmp_path: Path) -> None:
    said = sentence(cli(*sides, "--frames", 0, "--plain", "--rankings", tmp_path / "r.txt"))
    assert "leave --plain away" in said


def test_a_protocol_by_its_name(cli: Cli, asked: Any, sides: list[Any], photos: Any) -> None:
    ran = cli(*sides, "--protocol", "frames", "--frames", 0, "--format", "json")
    assert (ran.code, ran.json()["protocol"]) == (0, "frames ±0")
    assert "'no-such'" in sentence(cli(*sides, "--protocol", "no-such"))
    assert "--data" in sentence(cli("evaluate", "--protocol", "msls-val-740"))
    told = sentence(cli("evaluate", "--protocol", "msls-val-740", "--data", photos.references))
    assert "msls-val-740" in told


def test_descriptors_and_rankings_of_another_method(cli: Cli, sides: list[Any], tmp_path: Path, asked: Any) -> None:
    for name in ("refs", "mine"):
        np.save(tmp_path / f"{name}.npy", np.eye(6, dtype=np.float32))
    described = ("--descriptors", tmp_path / "refs.npy", tmp_path / "mine.npy")
    ran = cli(*sides, "--frames", 0, *described, "--format", "json")
    told = ran.json()
    assert (told["model"], told["recall"]["1"], asked) == ("mine", 100.0, [])
    assert "length 1" in ran.err
    ran = cli(*sides, "--frames", 0, *described, "--called", "Peer", "--format", "json")
    assert ran.json()["model"] == "Peer"
    spaced = cli(*sides, "--frames", 0, *described, "--save-rankings", tmp_path / "ranked.txt")
    assert "has a space" in sentence(spaced)  # as people's names for photos do


def test_the_order_that_descriptors_have_to_be_in(
    cli: Cli, sides: list[Any], photos: Any, tmp_path: Path, asked: Any
) -> None:
    files = tmp_path / "refs.txt", tmp_path / "queries.txt"
    ran = cli(*sides, "--frames", 0, "--list-photos", *files)
    assert (ran.code, ran.out, asked) == (0, "", [])
    for path, side in zip(files, (photos.reference, photos.query), strict=True):
        assert path.read_text(encoding="utf-8").splitlines() == sorted(map(str, side))


def test_rankings_come_and_go(cli: Cli, asked: Any, tmp_path: Path) -> None:
    for side in ("database", "queries"):
        (tmp_path / side).mkdir()
        for number in range(3):
            pixels = np.random.default_rng(number).integers(0, 256, (32, 32, 3), dtype=np.uint8)
            save_jpeg(pixels, tmp_path / side / f"{number}.jpg")
    sides = ("--references", tmp_path / "database", "--queries", tmp_path / "queries", "--frames", 0)
    ran = cli("evaluate", *sides, "--save-rankings", tmp_path / "ranked.txt", "--format", "json")
    assert ran.code == 0
    asked.clear()
    again = cli("evaluate", *sides, "--rankings", tmp_path / "ranked.txt", "--format", "json", "--leaks")
    told = again.json()
    assert (told["model"], told["recall"], asked) == ("ranked", ran.json()["recall"], [])
    assert [leak["kind"] for leak in told["leaks"]] == ["file"] * 3
    assert again.err.count("is the same file as") == 3


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (["--descriptors", "a.npy", "b.npy", "--rankings", "c.txt"], "one at a time"),
        (["--rankings", "c.txt", "--cache", "d"], "--cache"),
        (["--save", "no/such/place.json"], "name a file in a folder"),
        (["--report", "no/such/page.html"], "name a file in a folder"),
        (["--heat"], "--result"),
        (["--rankings", "c.txt"], "c.txt"),
        (["--protocol", "frames", "--data", "x"], "--data"),
    ],
)
def test_refused_before_any_work(cli: Cli, asked: Any, sides: list[Any], more: list[Any], named: str) -> None:
    assert named in sentence(cli(*sides, "--frames", 0, *more))
    assert asked == []


def test_a_page_of_a_new_result_and_of_a_saved_one(
    cli: Cli, asked: Any, sides: list[Any], photos: Any, tmp_path: Path
) -> None:
    saved, pages = tmp_path / "r.json", [tmp_path / f"{name}.html" for name in ("new", "old", "heat")]
    new = cli(*sides, "--frames", 0, "--save", saved, "--report", pages[0], "--format", "json")
    assert (new.code, f"written to {pages[0]}" in new.err) == (0, True)
    asked.clear()
    again = ("evaluate", "--result", saved, *sides[1:])
    old = cli(*again, "--report", pages[1], "--format", "json")
    assert (old.json(), asked) == (new.json(), [])
    assert pages[1].read_text(encoding="utf-8") == pages[0].read_text(encoding="utf-8")
    assert "R@1" in pages[1].read_text(encoding="utf-8")
    hot = cli(*again, "--report", pages[2], "--heat", "--csv", tmp_path / "r.csv")
    assert (hot.code, asked, (tmp_path / "r.csv").is_file()) == (0, ["salad-lite"], True)


def test_photos_of_a_saved_result_that_lie_elsewhere_now(
    cli: Cli, asked: Any, sides: list[Any], tmp_path: Path, photos: Any
) -> None:
    np.save(tmp_path / "r.npy", np.eye(6, dtype=np.float32))
    np.save(tmp_path / "q.npy", np.eye(6, dtype=np.float32)[::-1].copy())  # every answer is wrong
    saved, page = tmp_path / "r.json", tmp_path / "page.html"
    descriptors = ("--descriptors", tmp_path / "r.npy", tmp_path / "q.npy")
    cli(*sides, "--frames", 0, *descriptors, "--save", saved)
    again = ("evaluate", "--result", saved, "--report", page)
    ran = cli(*again, "--references", tmp_path, "--queries", photos.queries)
    assert (ran.code, "6 of 12 photos to show cannot be opened" in ran.err) == (0, True)
    ran = cli(*again, "--references", photos.references, "--queries", photos.queries)
    assert (ran.code, "cannot be opened" in ran.err) == (0, False)
    ran = cli(*again, "--references", photos.references)
    assert (ran.code, "the queries are not shown" in ran.err, "--queries" in ran.err) == (0, True, True)
    assert "not shown" not in cli("evaluate", "--result", saved).err  # without a page nobody misses them
    told = sentence(cli("evaluate", "--result", saved, "--report", page, "--heat"))
    assert "no model of ours" in told


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (["--frames", 2], "--frames"),
        (["--leaks"], "--leaks"),
        (["--any-size"], "--any-size"),
        (["--heat"], "--report"),
        ([], "no such file"),
    ],
)
def test_a_saved_result_is_not_judged_again(cli: Cli, asked: Any, tmp_path: Path, more: list[Any], named: str) -> None:
    assert named in sentence(cli("evaluate", "--result", tmp_path / "r.json", *more)).lower()
    assert asked == []


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (["--references", "x"], "--queries is missing"),
        (["--queries", "x"], "--references is missing"),
        (["--data", "x"], "--protocol"),
    ],
)
def test_a_set_has_to_be_named(cli: Cli, given: list[Any], named: str) -> None:
    assert named in sentence(cli("evaluate", *given))


def test_two_results_compared(
    cli: Cli, asked: Any, sides: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right = np.eye(6, dtype=np.float32)
    for name, rows in (("r", right), ("good", right), ("bad", right[::-1].copy())):
        np.save(tmp_path / f"{name}.npy", rows)
    for name in ("good", "bad"):
        saved = ("--save", tmp_path / f"{name}.json")
        cli(*sides, "--frames", 0, "--descriptors", tmp_path / "r.npy", tmp_path / f"{name}.npy", *saved)
    assert compare_results(tmp_path / "bad.json", tmp_path / "good.json") == 0
    told = capsys.readouterr().out
    assert "+100.0" in told
    assert told.count("won: ") == 6
    assert compare_results(tmp_path / "good.json", tmp_path / "bad.json", form="json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["first"], shown["other"], len(shown["recall"]["1"]["lost"])) == ("good", "bad", 6)
    with pytest.raises(BenchmarkError, match="no JSON"):
        compare_results(tmp_path / "good.json", tmp_path / "r.npy")


def test_many_leaks_are_not_all_told(cli: Cli, asked: Any, sides: list[Any], tmp_path: Path) -> None:
    cli(*sides, "--frames", 0, "--save", tmp_path / "r.json")
    result = read_result(tmp_path / "r.json")
    leaks = tuple(Leak(0, row, "q", f"r{row}", "picture") for row in range(30))
    told = leak_sentences(replace(result, leaks=leaks))
    assert (len(told), told[0], told[-1]) == (
        *(21, "q is the same picture as r0", "and 10 more photos that are in both sides"),
    )


@pytest.fixture
def table(photos: Any, tmp_path: Path) -> Path:
    """Where the queries were taken, all of them looking north."""
    known = [read_photo(path).where for path in photos.reference]
    rows = [f"{path},{where.lat},{where.lon},0" for path, where in zip(photos.query, known, strict=True) if where]
    path = tmp_path / "places.csv"
    path.write_text("path,lat,lon,heading\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("protocol", [(), ("--protocol", "folder")])
def test_positions_from_a_table_and_the_way_a_photo_looks(
    cli: Cli, asked: Any, sides: list[Any], table: Path, protocol: tuple[str, ...]
) -> None:
    words = (*sides, *protocol, "--radius", 25, "--table", table, "--format", "json")
    assert cli(*words).json()["unanswerable"] == 0
    told = cli(*words, "--heading", 45).json()
    assert told["unanswerable"] == 4  # references look 0, 30, 60 ... degrees
    assert "45" in told["protocol"]


def test_a_misspelt_row_of_the_table_is_noticed(cli: Cli, asked: Any, sides: list[Any], table: Path) -> None:
    with table.open("a", encoding="utf-8") as lines:
        lines.write("nobody.jpg,1,2,3\n")
    for protocol in ((), ("--protocol", "folder")):
        assert "nobody.jpg" in sentence(cli(*sides, *protocol, "--radius", 25, "--table", table))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--frames", 0, "--heading", 45), "--heading says more about a radius, and there is none"),
        (("--frames", 0, "--table", "a.csv"), "--table says more about a radius, and there is none"),
        (("--frames", 0, "--layout", "msls"), "--layout msls is of a published set"),
        (("--protocol", "frames", "--frames", 0, "--layout", "msls"), "no layout msls"),
    ],
)
def test_an_option_that_would_change_nothing_is_refused(
    cli: Cli, sides: list[Any], words: tuple[Any, ...], said: str
) -> None:
    assert said in sentence(cli(*sides, *words))
