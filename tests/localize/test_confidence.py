"""How sure a place is: monotone in all that speaks for it, and a probability."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.geo import GeoPoint, shifted
from salad.images.photo import Photo
from salad.index.index import Match
from salad.localize.voting import Evidence, Group, confidence, evidence, weighted_matches
from salad.network.config import Calibration

HERE = GeoPoint(48.1, 11.5)
weights = st.floats(0, 50)
calibrations = st.builds(
    Calibration, bias=st.floats(-50, 50), top=weights, gap=weights, spread=weights, share=weights
)
evidences = st.builds(Evidence, st.floats(-1, 1), st.floats(-2, 2), st.floats(0, 1), st.floats(0, 1))


def match(score: float, metres: float | None, row: int) -> Match:
    where = None if metres is None else shifted(HERE, metres, 0)
    return Match(Photo(Path(f"{row}.jpg"), where), score, row)


@given(calibrations, evidences, st.sampled_from(Evidence._fields), st.floats(0, 2))
def test_better_evidence_never_lowers_confidence(
    by: Calibration, given_: Evidence, which: str, more: float
) -> None:
    sign = -1 if which == "spread" else 1
    better = given_._replace(**{which: getattr(given_, which) + sign * more})
    assert 0 <= confidence(given_, by) <= confidence(better, by) <= 1


@given(calibrations, evidences)
def test_confidence_is_the_logistic_function(by: Calibration, given_: Evidence) -> None:
    z = math.fsum(
        [
            by.bias,
            by.top * given_.top,
            by.gap * given_.gap,
            -by.spread * given_.spread,
            by.share * given_.vote_fraction,
        ]
    )
    assert confidence(given_, by) == pytest.approx(0.5 * (1 + math.tanh(z / 2)), abs=1e-9)
    doubt = replace(by, bias=-1e6)
    assert confidence(given_, doubt) == 0  # neither overflows
    assert confidence(given_, replace(by, bias=1e6)) == 1


def test_evidence_is_what_its_words_say() -> None:
    everyone = weighted_matches(
        [match(0.9, 0, 0), match(0.8, 0, 1), match(0.7, 100, 2), match(0.6, None, 3)], 10.0
    )
    place = Group(everyone[:2], [])
    found = evidence(place, everyone, HERE)
    assert found.top == 0.9
    assert found.gap == pytest.approx(0.9 - 0.7)
    assert found.spread == pytest.approx((0 + 0 + 0.5 + 1) / 4, abs=1e-6)
    sizes = [math.exp(10 * (score - 0.9)) for score in (0.9, 0.8, 0.7, 0.6)]
    assert found.vote_fraction == pytest.approx(sum(sizes[:2]) / sum(sizes))


def test_a_runner_up_lags_behind() -> None:
    everyone = weighted_matches([match(0.9, 0, 0), match(0.8, 500, 1)], 10.0)
    found = evidence(Group(everyone[1:], []), everyone, shifted(HERE, 500, 0))
    assert found.gap == pytest.approx(-0.1)


def test_where_all_agree_the_gap_reaches_to_the_last() -> None:
    everyone = weighted_matches([match(0.9, 0, 0), match(0.65, 1, 1)], 10.0)
    assert evidence(Group(everyone, []), everyone, HERE).gap == pytest.approx(0.25)
    alone = everyone[:1]
    assert evidence(Group(alone, []), alone, HERE) == Evidence(0.9, 0, 0, 1)
