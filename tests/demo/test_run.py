"""The demo's road and its figures."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from salad.demo import run as demo
from salad.demo.demo_result import DemoResult, distance, table
from salad.demo.run import run_demo
from salad.demo.town.town import Town
from salad.errors import StoreError
from salad.index.index import Index
from salad.models.fake import FakeDescriber

Result = Callable[..., DemoResult]


def test_figures_of_known_answers(outcome: Result) -> None:
    result = outcome({"night": [1.0, 24.9, None], "fog": [25.2, 60.0], "rain": [5.0]})
    assert result.queries == 6
    assert [result.count(verdict) for verdict in ("right", "wrong", "unknown")] == [3, 2, 1]
    assert result.right_fraction == 0.5
    assert result.median_error() == pytest.approx(24.9, rel=1e-3)
    assert result.median_error("fog") == pytest.approx(42.6, rel=1e-3)
    assert result.count("right", condition="night") == 2
    assert result.conditions == {"night": 3, "fog": 2, "rain": 1}
    assert result.photos_a_second == 5.0


def test_figures_where_nothing_is_known_or_asked(outcome: Result) -> None:
    unknown = outcome({"night": [None]})
    assert (unknown.median_error(), unknown.right_fraction) == (None, 0.0)
    empty = outcome({})
    assert (empty.median_error(), empty.right_fraction, empty.conditions) == (None, 0.0, {})


def test_a_match_without_a_position_is_off_by_nobody_knows(outcome: Result) -> None:
    from dataclasses import replace

    one = outcome().judged[0]
    match = one.answer.matches[1]
    assert one.off_by(match) == pytest.approx(30, rel=1e-3)
    assert one.off_by(replace(match, photo=replace(match.photo, where=None))) is None


@pytest.mark.parametrize(
    ("metres", "said"),
    [
        (None, "–"),
        (0.0, "0.0 m"),
        (9.94, "9.9 m"),
        (9.96, "10 m"),
        (999.4, "999 m"),
        (999.6, "1.0 km"),
        (1499, "1.5 km"),
    ],
)
def test_distances_read_well(metres: float | None, said: str) -> None:
    assert distance(metres) == said


def test_the_table_tells_every_condition_and_the_whole(outcome: Result) -> None:
    console = Console(width=110, record=True, file=open("/dev/null", "w"))  # noqa: PTH123, SIM115  # open as long as the console is
    with console.file:
        console.print(table(outcome({"night": [3.0, None], "[red]fog": [80.0]})))
    lines = console.export_text().splitlines()
    assert any("[red]fog" in line and "80 m" in line for line in lines)
    whole = next(line for line in lines if " all " in line)
    assert "1 (33 %)" in whole
    assert "42 m" in whole  # the median of 3 and 80
    assert any("5.0 a second" in line for line in lines)
    assert table(outcome({})).row_count == 1


def test_the_road_from_a_town_to_a_page(tmp_path: Path, paint: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "draw_town", paint)
    said: list[str] = []
    steps: list[tuple[int, int]] = []
    result = run_demo(
        tmp_path,
        references=6,
        queries=4,
        model=FakeDescriber(),
        say=said.append,
        progress=lambda done, whole: steps.append((done, whole)),
    )
    assert len(said) == 4
    assert (6, 6) in steps
    assert [one.answer.query for one in result.judged] == list(result.town.queries)
    assert all(one.answer.matches[0].photo.path.name == f"ref_{n}.jpg" for n, one in enumerate(result.judged))
    assert [one.condition for one in result.judged] == ["night", "fog", "night", "fog"]
    assert result.described == 10
    assert result.seconds > 0
    assert (result.model, result.seed) == ("fake", 7)
    assert result.page.read_text(encoding="utf-8").startswith("<!doctype html>")
    with Index.open(result.index) as index:
        assert len(index) == 6
    assert sorted(path.name for path in tmp_path.iterdir()) == ["town", "town.html", "town.index"]


def test_a_second_run_starts_from_an_empty_index(tmp_path: Path, paint: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "draw_town", paint)
    run_demo(tmp_path, references=6, queries=1, model=FakeDescriber())
    again = run_demo(tmp_path, references=3, queries=1, model=FakeDescriber(dim=8))
    with Index.open(again.index) as index:
        assert (len(index), index.dim) == (3, 8)


def test_what_is_no_index_of_ours_is_left_alone(tmp_path: Path, paint: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "draw_town", paint)
    precious = tmp_path / "town.index" / "diary.txt"
    precious.parent.mkdir()
    precious.write_text("mine")
    with pytest.raises(StoreError, match="not empty"):
        run_demo(tmp_path, references=3, queries=1, model=FakeDescriber())
    assert precious.read_text() == "mine"


def test_the_shipped_model_is_asked_for_by_name(tmp_path: Path, paint: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def load(name: str) -> FakeDescriber:
        asked.append(name)
        return FakeDescriber(name=name)

    monkeypatch.setattr(demo, "draw_town", paint)
    monkeypatch.setattr("salad.models.model_folder.load", load)
    assert run_demo(tmp_path, references=3, queries=1).model == "salad-lite"
    assert asked == ["salad-lite"]


def test_a_drawn_town_goes_all_the_way(tmp_path: Path) -> None:
    result = run_demo(tmp_path, references=2, queries=1, model=FakeDescriber())
    assert isinstance(result.town, Town)
    assert result.judged[0].verdict in ("right", "wrong", "unknown")
    assert "query_001.jpg" in result.page.read_text(encoding="utf-8")
