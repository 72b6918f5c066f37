"""Which mistakes a page shows, and where their photos lead."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.evaluation.result import QueryResult
from salad.report.mistakes import link, outcome, surest, worst

RESULTS = st.builds(
    QueryResult,
    query=st.just("q"),
    positives=st.integers(0, 2),
    first_right=st.none() | st.integers(1, 5),
    matches=st.just((0, 1)),
    scores=st.none() | st.tuples(st.floats(-1, 1), st.just(-1.0)),
    metres=st.none() | st.floats(0, 1e6),
).map(lambda one: one if one.positives else replace(one, first_right=None))


@given(st.lists(RESULTS, max_size=30))
def test_mistakes_are_chosen_in_order_and_once(results: list[QueryResult]) -> None:
    sure = surest(results, most=5)
    far = worst(results, besides=sure, most=5)
    assert not set(sure) & set(far)
    assert not any(results[number].hit(1) for number in (*sure, *far))
    scores = [one.scores[0] for one in results if one.scores and outcome(one) == "wrong"]
    assert [(results[n].scores or ())[0] for n in sure] == sorted(scores, reverse=True)[:5]
    metres = [results[n].metres for n in far]
    known = [one for one in metres if one is not None]
    assert known == sorted(known, reverse=True)
    assert metres[: len(known)] == known


def test_a_link_to_another_drive_is_the_files_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def apart(*_: object) -> str:
        raise ValueError

    assert link(tmp_path / "a b.jpg", tmp_path / "p.html") == "a%20b.jpg"
    assert link(tmp_path / "x:y.jpg", tmp_path / "in" / "p.html") == "../x%3Ay.jpg"
    monkeypatch.setattr(os.path, "relpath", apart)
    assert link(tmp_path / "a b.jpg", tmp_path / "p.html") == (tmp_path / "a b.jpg").as_uri()
