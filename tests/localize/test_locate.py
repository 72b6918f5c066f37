"""Photos in, answers out: a small city of drawn photos and a describer without a network."""

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from salad.errors import PhotoError, WrongModelError
from salad.geo import GeoPoint, metres_between, shifted
from salad.images.photo import Photo
from salad.index.build import index_photos
from salad.index.index import Index, Match
from salad.localize.locate import Answer, locate, locate_many
from salad.localize.voting import Place
from salad.models.fake import FakeDescriber
from salad.network.config import Calibration
from salad.search.filters import Filter

TOWN = GeoPoint(51.5, -0.1)


class Calibrated(FakeDescriber):
    """A fake model that knows what its scores are worth."""

    calibration = Calibration(radius=2.0, min_confidence=0.9)


class Centred(FakeDescriber):
    """One whose scores are worth that once they are centred."""

    calibration = Calibration(centred=True)


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
    assert answer.others
    assert all(metres_between(other.where, answer.place.where) > 400 for other in answer.others)


def test_what_is_less_sure_than_asked_is_unknown(city: Index, tmp_path: Path) -> None:
    photo = tmp_path / "3.png"
    known = locate(photo, index=city, model=FakeDescriber())
    unknown = locate(photo, index=city, model=FakeDescriber(), min_confidence=1.0)
    assert known.place is not None
    assert unknown.place is None
    assert unknown.others == [known.place, *known.others]
    assert unknown.matches == known.matches


def test_a_calibrated_model_brings_its_own_radius_and_limit(city: Index, tmp_path: Path) -> None:
    photo = tmp_path / "3.png"
    plain, calibrated = (
        locate(photo, index=city, model=model, min_confidence=0.0) for model in (FakeDescriber(), Calibrated())
    )
    assert plain.place is not None
    assert calibrated.place is not None
    assert calibrated.place.radius_m == pytest.approx(2 * plain.place.radius_m)
    (strict,) = locate_many([photo], index=city, model=Calibrated())
    assert (strict.place is not None) == (plain.place.confidence >= 0.9)


def test_a_model_calibrated_on_centred_scores_is_searched_by_them(city: Index, tmp_path: Path) -> None:
    photo = tmp_path / "3.png"
    due, plain = (city.search(FakeDescriber().describe([photo]), k=6, centred=centred)[0] for centred in (True, False))
    assert due != plain
    for model, matches in ((Centred(), due), (Calibrated(), plain), (FakeDescriber(), plain)):
        assert locate(photo, index=city, model=model, k=6).matches == matches


def test_a_place_is_looked_for_where_it_may_be(city: Index, tmp_path: Path) -> None:
    photo, home = tmp_path / "3.png", shifted(TOWN, 1500, 0)
    for where, holds in (
        (Filter(near=home, within_m=700), {2, 3, 4}),
        (Filter(heading=0, heading_within=25), {0, 1, 2}),
    ):
        answer = locate(photo, index=city, model=FakeDescriber(), where=where)
        assert {int(match.photo.path.stem) for match in answer.matches} == holds


def test_a_caller_may_vote_in_another_way(city: Index, tmp_path: Path) -> None:
    elsewhere = Place(GeoPoint(1, 2), 3.0, 1.0, 4)

    def stubborn(matches: object, *, radius_m: float, calibration: Calibration) -> list[Place]:
        assert (radius_m, calibration) == (50.0, Calibration())
        return [elsewhere]

    answer = locate(tmp_path / "3.png", index=city, model=FakeDescriber(), radius_m=50.0, voting=stubborn)
    assert (answer.place, answer.others) == (elsewhere, [])


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
        [Place(GeoPoint(3, 4), 30.0, 0.25, 1)],
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
        "others": [{"lat": 3, "lon": 4, "radius_m": 30.0, "confidence": 0.25, "support": 1}],
    }
    unknown = Answer(Path("q.jpg"), None, []).as_dict()
    assert unknown == {"query": "q.jpg", "place": None, "matches": [], "others": []}


class OneMatch:
    """An index of another kind: it knows one photo, and finds it whatever is asked."""

    def __init__(self, known: Photo) -> None:
        self.known = known
        self.asked: list[object] = []

    def check_model(self, model: object) -> None:
        self.asked.append(model)

    def search(self, descriptors: np.ndarray, *, k: int, where: object, centred: bool) -> list[list[Match]]:
        self.asked.append((descriptors.shape, k, where, centred))
        return [[Match(self.known, 0.9, 0)] for _ in descriptors]


def test_any_index_will_do_that_answers_two_questions(tmp_path: Path) -> None:
    model, index = Centred(), OneMatch(Photo(Path("known.jpg"), TOWN))
    queries = [draw(tmp_path / f"{n}.png", n) for n in range(3)]
    answers = list(locate_many(queries, index=index, model=model, k=7, batch_size=2, min_confidence=0.0))
    assert [answer.query for answer in answers] == queries
    assert all(answer.place and metres_between(answer.place.where, TOWN) < 0.001 for answer in answers)
    assert index.asked == [model, ((2, model.dim), 7, None, True), ((1, model.dim), 7, None, True)]
