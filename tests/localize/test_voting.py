"""From matches to places: who votes for what, how the votes are counted, and how sure that makes a place."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from salad.geo import GeoPoint, metres_between, shifted
from salad.images.photo import Photo
from salad.index.index import Match
from salad.localize.voting import (
    RADIUS_M,
    VIEW,
    Evidence,
    Group,
    Place,
    confidence,
    evidence,
    groups,
    vote,
    weighted_matches,
)
from salad.network.config import Calibration

TOWN = GeoPoint(51.5, -0.1)


def match(score: float, where: GeoPoint | None, row: int = 0, heading: float | None = None) -> Match:
    return Match(Photo(Path(f"{row}.jpg"), where, heading), score, row)


def at(
    score: float,
    north: float,
    east: float,
    row: int = 0,
    *,
    around: GeoPoint = TOWN,
    heading: float | None = None,
) -> Match:
    return match(score, shifted(around, north, east), row, heading)


@st.composite
def votes(draw: st.DrawFn, *, unknown: bool = True, headings: bool = True) -> list[Match]:
    around = draw(st.sampled_from([TOWN, GeoPoint(-16.8, 180), GeoPoint(0, -180), GeoPoint(71, 25)]))
    metres = st.floats(-60, 60)
    scores = st.floats(0, 1) | st.sampled_from([0.5, 0.9])
    looking = st.none() | st.sampled_from([0.0, 90.0, 180.0, 359.0]) if headings else st.none()
    return [
        match(draw(scores), None, row)
        if unknown and draw(st.integers(0, 5)) == 0
        else at(draw(scores), draw(metres), draw(metres), row, around=around, heading=draw(looking))
        for row in range(draw(st.integers(1, 8)))
    ]


def first(matches: list[Match], **settings: float) -> Place:
    """The heaviest place there is."""
    places = vote(matches, **settings)
    assume(places)
    return places[0]


@given(matches=votes(), order=st.randoms(use_true_random=False))
def test_the_order_of_matches_does_not_matter(matches: list[Match], order: object) -> None:
    mixed = list(matches)
    order.shuffle(mixed)
    assert vote(mixed) == vote(matches)


@given(matches=votes(headings=False), score=st.floats(0, 1))
def test_one_more_for_the_place_never_loses_it_support(matches: list[Match], score: float) -> None:
    before = first(matches)
    winner = next(groups(weighted_matches(matches, 20.0), RADIUS_M)).supporters
    heart = next(  # the supporter that all others stand around
        b.where for b in winner if all(metres_between(b.where, o.where) <= RADIUS_M for o in winner)
    )
    assert first([*matches, match(score, heart, len(matches))]).support >= before.support


@given(matches=votes())
def test_a_place_lies_among_its_supporters(matches: list[Match]) -> None:
    place = first(matches)
    supporters = next(groups(weighted_matches(matches, 20.0), RADIUS_M)).supporters
    assert place.support == len(supporters)
    points = [ballot.where for ballot in supporters]
    widest = max(metres_between(a, b) for a in points for b in points)
    assert all(metres_between(place.where, point) <= widest + 1e-3 for point in points)
    assert min(metres_between(place.where, point) for point in points) <= RADIUS_M
    assert place.radius_m >= RADIUS_M
    assert 0 <= place.confidence <= 1


@given(matches=votes(unknown=False, headings=False))
def test_matches_at_one_point_make_that_point(matches: list[Match]) -> None:
    (place,) = vote([replace(m, photo=Photo(m.photo.path, TOWN)) for m in matches])
    assert place.support == len(matches)
    assert metres_between(place.where, TOWN) < 1e-3
    assert place.radius_m == pytest.approx(RADIUS_M)


@given(matches=votes())
def test_places_are_the_heaviest_first_and_share_one_certainty(matches: list[Match]) -> None:
    found = list(groups(weighted_matches(matches, 20.0), RADIUS_M))
    weights = [math.fsum(ballot.weight for ballot in group.supporters) for group in found]
    assert weights == sorted(weights, reverse=True)
    places = vote(matches)
    assert [place.support for place in places] == [len(group.supporters) for group in found]
    assert all(places[0].confidence + other.confidence <= 1 + 1e-12 for other in places[1:])


@given(matches=votes())
def test_groups_hold_every_placed_match_once_and_look_one_way(matches: list[Match]) -> None:
    found = list(groups(weighted_matches(matches, 20.0), RADIUS_M))
    rows = [b.match.row for group in found for b in (*group.supporters, *group.bystanders)]
    assert sorted(rows) == [match.row for match in matches if match.photo.where]
    for group in found:
        scores = [ballot.match.score for ballot in group.supporters]
        assert scores == sorted(scores, reverse=True)


def test_a_match_that_looks_the_other_way_speaks_neither_for_nor_against() -> None:
    ours = [at(0.8, 0, 0, 0, heading=10), at(0.7, 5, 0, 1, heading=350), at(0.6, 900, 0, 2)]
    alone, beside = vote(ours), vote([*ours, at(0.75, 0, 3, 3, heading=10 + VIEW + 45)])
    assert beside[0] == alone[0]
    assert alone[0].support == 2
    unknown = vote([*ours, at(0.75, 0, 3, 3)])
    assert unknown[0].support == 3
    north = vote([at(0.8, 0, 0, 0, heading=0), at(0.8, 1, 0, 1, heading=VIEW)])
    assert [place.support for place in north] == [2]  # a right angle is still one view, more is not


def test_agreement_wins_over_a_single_better_match() -> None:
    three = [at(0.79, 0, 0, 1), at(0.78, 4, 0, 2), at(0.78, 0, 4, 3)]
    place, other = vote([at(0.80, 900, 0, 0), *three])
    assert (place.support, other.support) == (3, 1)
    assert metres_between(place.where, TOWN) < 4
    assert metres_between(other.where, TOWN) > 800
    assert metres_between(vote([at(0.95, 900, 0, 0), *three])[0].where, TOWN) > 800


def test_the_better_supporter_pulls_the_place_to_itself() -> None:
    for sharpness in (5.0, 20.0):
        (place,) = vote([at(0.9, 0, 0), at(0.8, 20, 0, 1)], calibration=Calibration(sharpness=sharpness))
        share = 1 / (1 + math.exp(0.1 * sharpness))
        assert metres_between(place.where, TOWN) == pytest.approx(20 * share, abs=0.01)


def test_scattered_supporters_make_a_wider_place() -> None:
    near, far = (vote([at(0.9, 0, 0), at(0.9, metres, 0, 1)])[0] for metres in (5, 24))
    assert near.radius_m < far.radius_m
    assert near.where != far.where
    wide = vote([at(0.9, 0, 0), at(0.9, 24, 0, 1)], calibration=Calibration(radius=3.0))[0]
    assert wide.radius_m == pytest.approx(3 * far.radius_m)


def test_the_radius_says_what_one_place_is() -> None:
    split = [at(0.7, 0, 0), at(0.7, 500, 0, 1), at(0.7, 1000, 0, 2)]
    assert [place.support for place in vote(split)] == [1, 1, 1]
    assert [place.support for place in vote(split, radius_m=2000)] == [3]


def test_a_place_may_lie_on_the_date_line() -> None:
    (place,) = vote([match(0.9, GeoPoint(-16.8, 179.9999)), match(0.9, GeoPoint(-16.8, -179.9999), 1)])
    assert place.support == 2
    assert abs(place.where.lon) == pytest.approx(180, abs=1e-6)


@pytest.mark.parametrize("matches", [[], [match(0.9, None), match(0.8, None, 1)]])
def test_without_a_position_there_is_no_place(matches: list[Match]) -> None:
    assert vote(matches) == []


@pytest.mark.parametrize(
    "matches",
    [
        [at(0.1, 0, 0), at(0.1, 1, 0, 1)],  # they agree, but look like nothing here
        [at(0.7, 100 * n, 0, n) for n in range(5)],  # each says something else
        [match(0.9, None), at(0.7, 0, 0, 1)],  # the best is of unknown position
    ],
)
def test_what_cannot_be_told_is_unsure(matches: list[Match]) -> None:
    assert vote(matches)[0].confidence < Calibration().min_confidence


@settings(max_examples=5)
@given(st.integers(1, 50))
def test_a_street_of_photos_is_cut_into_places(count: int) -> None:
    street = weighted_matches([at(0.5, 20.0 * n, 0, n) for n in range(count)], 20.0)
    found = list(groups(street, RADIUS_M))
    assert sum(len(group.supporters) for group in found) == count
    assert all(len(group.supporters) <= 3 for group in found)
    assert np.isclose(sum(ballot.weight for ballot in street), count)


# --- How sure a place is: monotone in all that speaks for it, and a probability ---

weights = st.floats(0, 50)
calibrations = st.builds(Calibration, bias=st.floats(-50, 50), top=weights, gap=weights, spread=weights, share=weights)
evidences = st.builds(Evidence, st.floats(-1, 1), st.floats(-2, 2), st.floats(0, 1), st.floats(0, 1))


@given(calibrations, evidences, st.sampled_from(Evidence._fields), st.floats(0, 2))
def test_better_evidence_never_lowers_confidence(by: Calibration, given_: Evidence, which: str, more: float) -> None:
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
    everyone = weighted_matches([at(0.9, 0, 0, 0), at(0.8, 0, 0, 1), at(0.7, 100, 0, 2), match(0.6, None, 3)], 10.0)
    place = Group(everyone[:2], [])
    found = evidence(place, everyone, TOWN)
    assert found.top == 0.9
    assert found.gap == pytest.approx(0.9 - 0.7)
    assert found.spread == pytest.approx((0 + 0 + 0.5 + 1) / 4, abs=1e-6)
    sizes = [math.exp(10 * (score - 0.9)) for score in (0.9, 0.8, 0.7, 0.6)]
    assert found.vote_fraction == pytest.approx(sum(sizes[:2]) / sum(sizes))


def test_a_runner_up_lags_behind() -> None:
    everyone = weighted_matches([at(0.9, 0, 0, 0), at(0.8, 500, 0, 1)], 10.0)
    found = evidence(Group(everyone[1:], []), everyone, shifted(TOWN, 500, 0))
    assert found.gap == pytest.approx(-0.1)


def test_where_all_agree_the_gap_reaches_to_the_last() -> None:
    everyone = weighted_matches([at(0.9, 0, 0, 0), at(0.65, 1, 0, 1)], 10.0)
    assert evidence(Group(everyone, []), everyone, TOWN).gap == pytest.approx(0.25)
    alone = everyone[:1]
    assert evidence(Group(alone, []), alone, TOWN) == Evidence(0.9, 0, 0, 1)
