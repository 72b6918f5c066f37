"""From matches to a place."""

import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from PIL import Image

from salad.errors import PhotoError, WrongModelError
from salad.geo import GeoPoint, metres_between, shifted
from salad.index import Index, Match, index_photos
from salad.model.fake import FakeDescriber
from salad.photos import Photo
from salad.place import Answer, Place, locate, locate_many, vote
from salad.place.voting import RADIUS_M, _ballots, _groups

TOWN = GeoPoint(51.5, -0.1)
loose = partial(vote, min_score=0.0, min_share=0.0)


def match(score: float, where: GeoPoint | None, row: int = 0) -> Match:
    return Match(Photo(Path(f"{row}.jpg"), where), score, row)


def at(score: float, north: float, east: float, row: int = 0, around: GeoPoint = TOWN) -> Match:
    return match(score, shifted(around, north, east), row)


@st.composite
def votes(draw: st.DrawFn, *, unknown: bool = True) -> list[Match]:
    around = draw(st.sampled_from([TOWN, GeoPoint(-16.8, 180), GeoPoint(0, -180), GeoPoint(71, 25)]))
    metres = st.floats(-60, 60)
    scores = st.floats(0, 1) | st.sampled_from([0.5, 0.9])
    size = draw(st.integers(1, 8))
    return [
        match(draw(scores), None, row)
        if unknown and draw(st.integers(0, 5)) == 0
        else at(draw(scores), draw(metres), draw(metres), row, around)
        for row in range(size)
    ]


@given(matches=votes(), order=st.randoms(use_true_random=False))
def test_the_order_of_matches_does_not_matter(matches: list[Match], order: object) -> None:
    mixed = list(matches)
    order.shuffle(mixed)
    assert vote(mixed) == vote(matches)


@given(matches=votes(), score=st.floats(0, 1))
def test_one_more_for_the_place_never_hurts_it(matches: list[Match], score: float) -> None:
    before = loose(matches)
    assume(before is not None)
    winner = next(_groups([b for b in _ballots(matches, 20.0) if b.match.photo.where], RADIUS_M))
    heart = next(  # the supporter that all others stand around
        b.where for b in winner if all(metres_between(b.where, o.where) <= RADIUS_M for o in winner)
    )
    after = loose([*matches, match(score, heart, len(matches))])
    assert after is not None
    assert after.support >= before.support
    assert after.confidence >= before.confidence - 1e-9


@given(matches=votes())
def test_a_place_lies_among_its_supporters(matches: list[Match]) -> None:
    place = loose(matches)
    assume(place is not None)
    supporters = next(_groups([b for b in _ballots(matches, 20.0) if b.match.photo.where], RADIUS_M))
    assert place.support == len(supporters)
    points = [ballot.where for ballot in supporters]
    widest = max(metres_between(a, b) for a in points for b in points)
    assert all(metres_between(place.where, point) <= widest + 1e-3 for point in points)
    assert min(metres_between(place.where, point) for point in points) <= RADIUS_M
    assert place.radius_m >= RADIUS_M
    assert 0 <= place.confidence <= 1


@given(matches=votes(unknown=False))
def test_matches_at_one_point_make_that_point(matches: list[Match]) -> None:
    agreed = [replace(m, photo=Photo(m.photo.path, TOWN)) for m in matches]
    place = loose(agreed)
    assert place is not None
    assert place.support == len(agreed)
    assert metres_between(place.where, TOWN) < 1e-3
    assert place.radius_m == pytest.approx(RADIUS_M)


def test_agreement_wins_over_a_single_better_match() -> None:
    place = vote([at(0.80, 900, 0, 0), at(0.79, 0, 0, 1), at(0.78, 4, 0, 2), at(0.78, 0, 4, 3)])
    assert place is not None
    assert place.support == 3
    assert metres_between(place.where, TOWN) < 4
    clear = vote([at(0.95, 900, 0, 0), at(0.79, 0, 0, 1), at(0.78, 4, 0, 2), at(0.78, 0, 4, 3)])
    assert clear is not None
    assert metres_between(clear.where, TOWN) > 800


def test_the_better_supporter_pulls_the_place_to_itself() -> None:
    place = vote([at(0.9, 0, 0), at(0.8, 20, 0, 1)])
    assert place is not None
    assert metres_between(place.where, TOWN) == pytest.approx(20 / (1 + math.exp(2)), abs=0.01)


def test_scattered_supporters_make_a_wider_place() -> None:
    near, far = (vote([at(0.9, 0, 0), at(0.9, metres, 0, 1)]) for metres in (5, 24))
    assert near is not None
    assert far is not None
    assert near.radius_m < far.radius_m
    assert near.where != far.where


def test_a_place_may_lie_on_the_date_line() -> None:
    place = vote([match(0.9, GeoPoint(-16.8, 179.9999)), match(0.9, GeoPoint(-16.8, -179.9999), 1)])
    assert place is not None
    assert place.support == 2
    assert abs(place.where.lon) == pytest.approx(180, abs=1e-6)


@pytest.mark.parametrize(
    "matches",
    [
        [],
        [match(0.9, None), match(0.8, None, 1)],
        [at(0.2, 0, 0), at(0.2, 1, 0, 1)],  # they agree, but look like nothing here
        [at(0.7, 100 * n, 0, n) for n in range(5)],  # each says something else
        [match(0.9, None), at(0.7, 0, 0, 1)],  # the best is of unknown position
    ],
)
def test_what_cannot_be_told_is_unknown(matches: list[Match]) -> None:
    assert vote(matches) is None


def test_thresholds_are_the_callers() -> None:
    split = [at(0.7, 0, 0), at(0.7, 500, 0, 1), at(0.7, 1000, 0, 2)]
    assert vote(split, min_share=0.3) is not None
    assert vote(split[:1], min_score=0.71) is None
    assert vote(split, radius_m=2000) == vote(split[::-1], radius_m=2000)
    certain = vote([at(1.0, 0, 0)], min_score=1.0)
    assert certain is not None
    assert certain.confidence == 1


# --- whole photos ---------------------------------------------------------------------------


def draw(path: Path, seed: int) -> Path:
    coarse = np.random.default_rng(seed).integers(0, 256, (4, 4, 3), dtype=np.uint8)
    Image.fromarray(coarse).resize((64, 64)).save(path)
    return path


@pytest.fixture
def city(tmp_path: Path) -> Index:
    model = FakeDescriber()
    index = Index.create(tmp_path / "i", dim=model.dim, fingerprint=model.fingerprint, model=model.name)
    photos = [draw(tmp_path / f"{n}.png", n) for n in range(6)]
    index_photos(photos, index, model)
    facts = [Photo(path, shifted(TOWN, 500 * n, 0), 10.0 * n) for n, path in enumerate(photos)]
    index.add(facts, model.describe(photos))
    return index


def test_a_photo_of_the_index_is_located(city: Index, tmp_path: Path) -> None:
    answer = locate(str(tmp_path / "3.png"), index=city, model=FakeDescriber(), k=3)
    assert answer.place is not None
    assert metres_between(answer.place.where, shifted(TOWN, 1500, 0)) < 1
    assert len(answer.matches) == 3
    assert answer.matches[0].photo.heading == 30
    unknown = locate(
        tmp_path / "3.png", index=city, model=FakeDescriber(), voting=partial(vote, min_score=1.1)
    )
    assert unknown.place is None


def test_answers_keep_the_order_and_unreadable_photos_are_named(city: Index, tmp_path: Path) -> None:
    (tmp_path / "bad.png").write_text("no picture")
    queries = [tmp_path / f"{name}.png" for name in ("5", "bad", "0", "none", "2")]
    said: list[str] = []
    model = FakeDescriber()
    found = list(locate_many(queries, index=city, model=model, batch_size=2, on_unreadable=said.append))
    assert [answer.query.stem for answer in found] == ["5", "0", "2"]
    assert [answer.matches[0].photo.path for answer in found] == [answer.query for answer in found]
    assert len(said) == 2
    assert "bad.png" in said[0]
    assert "none.png" in said[1]
    with pytest.raises(PhotoError, match=r"bad\.png"):
        list(locate_many(queries, index=city, model=model))


def test_another_model_is_refused(city: Index, tmp_path: Path) -> None:
    with pytest.raises(WrongModelError):
        locate(tmp_path / "3.png", index=city, model=FakeDescriber(seed=1))


def test_an_answer_is_json() -> None:
    known = Photo(Path("/a.jpg"), GeoPoint(1, 2), 90.0, datetime(2024, 5, 1, 12, tzinfo=UTC))
    answer = Answer(
        Path("q.jpg"),
        Place(GeoPoint(1, 2), 25.0, 0.5, 1),
        [Match(known, 0.9, 4), Match(Photo(Path("/b.jpg")), 0.8, 2)],
    )
    assert json.loads(json.dumps(answer.as_dict())) == {
        "query": "q.jpg",
        "place": {"lat": 1, "lon": 2, "radius_m": 25.0, "confidence": 0.5, "support": 1},
        "matches": [
            {
                "path": "/a.jpg",
                "score": 0.9,
                "lat": 1,
                "lon": 2,
                "heading": 90.0,
                "time": "2024-05-01T12:00:00+00:00",
            },
            {"path": "/b.jpg", "score": 0.8, "lat": None, "lon": None, "heading": None, "time": None},
        ],
    }
    assert Answer(Path("q.jpg"), None, []).as_dict() == {"query": "q.jpg", "place": None, "matches": []}


@settings(max_examples=5, deadline=None)
@given(st.integers(1, 50))
def test_groups_hold_every_ballot_once(count: int) -> None:
    ballots = _ballots([at(0.5, 20.0 * n, 0, n) for n in range(count)], 20.0)
    rows = [ballot.match.row for group in _groups(ballots, RADIUS_M) for ballot in group]
    assert sorted(rows) == list(range(count))
