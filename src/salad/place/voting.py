"""From matches to a place: the best matches vote by position and score, or the answer is "unknown".

    weight       of a match: exp(sharpness * score): 0.05 better than another counts e times as much
    group        the matches within `radius_m` of one of them; the heaviest group wins
    place        the group's weighted mean, its radius, how many stand behind it, and a first confidence

Matches without a position vote for no group but weigh in the whole: where the best matches are of unknown
position, the rest is no answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from salad.errors import PhotoError
from salad.geo import GeoPoint, centre, metres, spread
from salad.index import Index, Match
from salad.index.build import Pixels, in_order, workers
from salad.photos import open_rgb, squeeze

if TYPE_CHECKING:
    from salad.config import Preprocessing
    from salad.model.describer import Describes

RADIUS_M = 25.0
"""Photos this close show one place: the field's own measure of a right answer."""
SHARPNESS = 20.0
"""How fast a match's weight falls with its score: by e for every 1 / 20 of cosine."""
MIN_SCORE = 0.35
"""A place whose best match scores lower is unknown."""
MIN_SHARE = 0.4
"""A place that wins less than this share of all weight is unknown: the matches disagree."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a photo was taken, as far as the matches tell.

    Attributes:
        where: Weighted mean of the supporters' positions.
        radius_m: Within how many metres of it the photo was probably taken, the vote's radius at least.
        confidence: 0 to 1, higher is surer. A first measure that orders answers; it is not yet a probability.
        support: Matches that stand behind the place.
    """

    where: GeoPoint
    radius_m: float
    confidence: float
    support: int


@dataclass(frozen=True, slots=True)
class Answer:
    """A query, its place (None where unknown) and the matches it rests on, best first."""

    query: Path
    place: Place | None
    matches: list[Match]

    def as_dict(self) -> dict[str, Any]:
        """This answer as JSON holds it; null for what is unknown, times in ISO 8601."""
        return {
            "query": str(self.query),
            "place": _place_dict(self.place) if self.place else None,
            "matches": [_match_dict(match) for match in self.matches],
        }


Voting = Callable[[Sequence[Match]], Place | None]


def vote(
    matches: Sequence[Match],
    *,
    radius_m: float = RADIUS_M,
    sharpness: float = SHARPNESS,
    min_score: float = MIN_SCORE,
    min_share: float = MIN_SHARE,
) -> Place | None:
    """The place that matches agree on, or None; their order does not matter.

    Args:
        matches: Of one query.
        radius_m: How far apart, in metres, matches may be and still mean one place.
        sharpness: How fast a match's weight falls with its score.
        min_score: None where the place's best match scores lower.
        min_share: None where the place has less of the whole weight.
    """
    ballots = _ballots(matches, sharpness)
    groups = _groups([ballot for ballot in ballots if ballot.match.photo.where], radius_m)
    winner, second = next(groups, []), next(groups, [])
    if not winner:
        return None
    whole = _weight(ballots)
    share, lead = _weight(winner) / whole, (_weight(winner) - _weight(second)) / whole
    top = winner[0].match.score
    if top < min_score or share < min_share:
        return None
    points, weights = [ballot.where for ballot in winner], [ballot.weight for ballot in winner]
    return Place(
        where=centre(points, weights),
        radius_m=math.hypot(radius_m, 2 * spread(points, weights)),
        confidence=_confidence(top, share, lead, min_score),
        support=len(winner),
    )


def locate(query: str | Path, *, index: Index, model: Describes, k: int = 5, voting: Voting = vote) -> Answer:
    """Where a photo was taken.

    Args:
        query: The photo.
        index: The photos whose places are known.
        model: The model the index was made with.
        k: How many matches vote.
        voting: How they vote; `functools.partial(vote, radius_m=50)` sets a measure of it.

    Raises:
        PhotoError: If the photo cannot be read.
        WrongModelError: If the index was made with another model.
    """
    return next(locate_many([Path(query)], index=index, model=model, k=k, voting=voting))


def locate_many(
    queries: Sequence[Path],
    *,
    index: Index,
    model: Describes,
    k: int = 5,
    batch_size: int = 16,
    voting: Voting = vote,
    on_unreadable: Callable[[str], None] | None = None,
) -> Iterator[Answer]:
    """Where photos were taken, one answer after another in the order of the queries; memory stays small.

    Args:
        queries: The photos.
        index: The photos whose places are known.
        model: The model the index was made with.
        k: How many matches vote.
        batch_size: Photos the model takes at a time.
        voting: How matches vote.
        on_unreadable: Called with a sentence for each photo that cannot be read, which then has no answer;
            where not given, the first such photo raises.

    Raises:
        PhotoError: If a photo cannot be read and `on_unreadable` is not given.
        WrongModelError: If the index was made with another model.
    """
    index.check_model(model)
    to = model.preprocessing
    with workers() as pool:
        decoded = in_order(pool, lambda path: _decoded(path, to), queries, ahead=2 * batch_size)
        readable = _readable(decoded, on_unreadable)
        while batch := list(islice(readable, batch_size)):
            descriptors = model.describe([pixels for _, pixels in batch], batch_size=batch_size)
            for (query, _), matches in zip(batch, index.search(descriptors, k=k), strict=True):
                yield Answer(query, voting(matches), matches)


@dataclass(frozen=True, slots=True)
class _Ballot:
    match: Match
    weight: float

    @property
    def where(self) -> GeoPoint:
        assert self.match.photo.where is not None
        return self.match.photo.where


def _ballots(matches: Iterable[Match], sharpness: float) -> list[_Ballot]:
    """Matches with their weights, in an order that does not depend on the one they came in."""
    ordered = sorted(matches, key=lambda match: (-match.score, match.row, str(match.photo.path)))
    return [_Ballot(match, math.exp(sharpness * (match.score - ordered[0].score))) for match in ordered]


def _weight(ballots: Iterable[_Ballot]) -> float:
    return math.fsum(ballot.weight for ballot in ballots)  # exactly rounded: the order of terms is no vote


def _groups(ballots: Sequence[_Ballot], radius_m: float) -> Iterator[list[_Ballot]]:
    """Again and again the heaviest group of those left: all within `radius_m` of one of them, best first."""
    if not ballots:
        return
    lat, lon = ([getattr(ballot.where, axis) for ballot in ballots] for axis in ("lat", "lon"))
    near = metres(np.array(lat)[:, None], np.array(lon)[:, None], lat, lon) <= radius_m
    left = list(range(len(ballots)))
    while left:
        around = [[other for other in left if near[one, other] or one == other] for one in left]
        group = max(around, key=lambda members: (_weight(ballots[n] for n in members), len(members)))
        yield [ballots[n] for n in group]
        left = [n for n in left if n not in group]


def _confidence(top: float, share: float, lead: float, min_score: float) -> float:
    """Geometric mean of three measures in 0..1, each of which must be good for the whole to be.

    How far the best supporter is above `min_score`, the group's share of the whole weight, and that share's
    lead on the second group's. It grows with each of them and is not calibrated: 0.8 is surer than 0.6, not
    right in 80 %.
    """
    height = (top - min_score) / (1 - min_score) if min_score < 1 else 1.0
    measures = (min(1.0, max(0.0, value)) for value in (height, share, lead))
    return math.prod(measures) ** (1 / 3)


def _decoded(path: Path, to: Preprocessing) -> tuple[Path, Pixels | PhotoError]:
    try:
        return path, squeeze(open_rgb(path), to.height, to.width, to.resample)
    except PhotoError as error:
        return path, error


def _readable(
    decoded: Iterable[tuple[Path, Pixels | PhotoError]], on_unreadable: Callable[[str], None] | None
) -> Iterator[tuple[Path, Pixels]]:
    for path, pixels in decoded:
        if not isinstance(pixels, PhotoError):
            yield path, pixels
        elif on_unreadable is None:
            raise pixels
        else:
            on_unreadable(str(pixels))


def _place_dict(place: Place) -> dict[str, Any]:
    return {
        "lat": place.where.lat,
        "lon": place.where.lon,
        "radius_m": place.radius_m,
        "confidence": place.confidence,
        "support": place.support,
    }


def _match_dict(match: Match) -> dict[str, Any]:
    photo = match.photo
    return {
        "path": str(photo.path),
        "score": match.score,
        "lat": photo.where.lat if photo.where else None,
        "lon": photo.where.lon if photo.where else None,
        "heading": photo.heading,
        "time": photo.time.isoformat() if photo.time else None,
    }
