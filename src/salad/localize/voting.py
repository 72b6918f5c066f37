"""From matches to places: the best matches vote by position and score, and what speaks for a place makes it sure.

    weight       of a match: exp(sharpness * score), the sharpness being the calibration's
    group        the matches within `radius_m` of one of them that look its way, as far as that is known; the
                 heaviest group is the place, the others are runners-up
    place        the group's weighted mean, its radius, how many stand behind it
    confidence   a logistic function of four numbers that speak for the place, as the calibration weighs them

Matches without a position vote for no group but count in the whole: where the best matches are of unknown
position, no place is sure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from salad.geo import GeoPoint, centre, metres, metres_between, spread, turn_between
from salad.network.config import Calibration

if TYPE_CHECKING:
    from salad.index.index import Match

RADIUS_M = 25.0  # photos this close show one place: the field's own measure of a right answer
VIEW = 90.0  # degrees; photos of one spot that look further apart have nothing in view that both show
FAR_M = 100.0  # a match this far from the place counts half as scattered as one at the end of the world
GENERIC = Calibration()  # stands in where a model has no calibration of its own


@dataclass(frozen=True, slots=True)
class Place:
    """Where a photo may have been taken, as far as the matches tell.

    Attributes:
        where: Weighted mean of the supporters' positions.
        radius_m: Within how many metres of it the photo was probably taken.
        confidence: 0 to 1: how probable it is that the place is right, where the model is calibrated; else
            a number that orders answers.
        support: Matches that stand behind the place.
    """

    where: GeoPoint
    radius_m: float
    confidence: float
    support: int

    def as_dict(self) -> dict[str, Any]:
        """This place as JSON holds it."""
        return {
            "lat": self.where.lat,
            "lon": self.where.lon,
            "radius_m": self.radius_m,
            "confidence": self.confidence,
            "support": self.support,
        }


class Voting(Protocol):
    """How matches become places: `vote`, or what a caller puts in its stead."""

    def __call__(self, matches: Sequence[Match], *, radius_m: float, calibration: Calibration) -> list[Place]:
        """The places that matches vote for, the likeliest first."""
        ...


def vote(matches: Sequence[Match], *, radius_m: float = RADIUS_M, calibration: Calibration = GENERIC) -> list[Place]:
    """The places that matches vote for, the heaviest first; their order does not matter.

    Args:
        matches: Of one query.
        radius_m: How far apart, in metres, matches may be and still mean one place.
        calibration: What the model's scores are worth.

    Returns:
        None of it is left out for being unsure. Of two places only one can be right, so a runner-up's
        confidence is never above what the first leaves.
    """
    places: list[Place] = []
    for one in candidates(matches, radius_m=radius_m, sharpness=calibration.sharpness):
        sure = confidence(one.evidence, calibration)
        left = 1 - places[0].confidence if places else 1.0  # one photo was taken in one place
        places.append(Place(one.where, calibration.radius * one.scatter_m, min(sure, left), one.support))
    return places


class Evidence(NamedTuple):
    """What speaks for a place; all of it but `spread` makes it surer.

    Attributes:
        top: Score of its best supporter.
        gap: How much better that is than the best match elsewhere, below 0 where it is worse; where nothing
            stands elsewhere, how much better than the last match, since whatever else there is scored lower.
        spread: How far all matches scatter from the place: 0 where all stand on it, 1 where all are far away
            or of unknown position.
        vote_fraction: Its supporters' part of all matches' weight, 0 to 1.
    """

    top: float
    gap: float
    spread: float
    vote_fraction: float


class Candidate(NamedTuple):
    """A group of matches before anybody says how sure it is; `scatter_m` is its radius before calibration."""

    where: GeoPoint
    scatter_m: float
    support: int
    evidence: Evidence


def candidates(matches: Iterable[Match], *, radius_m: float, sharpness: float) -> Iterator[Candidate]:
    """The groups that matches make and what speaks for each, the heaviest first."""
    everyone = weighted_matches(matches, sharpness)
    for group in groups(everyone, radius_m):
        points, weights = zip(*((one.where, one.weight) for one in group.supporters), strict=True)
        middle = centre(points, weights)
        yield Candidate(
            where=middle,
            scatter_m=math.hypot(radius_m, 2 * spread(points, weights)),  # two standard deviations
            support=len(group.supporters),
            evidence=evidence(group, everyone, middle),
        )


@dataclass(frozen=True, slots=True)
class WeightedMatch:
    """A match and its weight, 1 for the best of a query."""

    match: Match
    weight: float

    @property
    def where(self) -> GeoPoint:
        """Where its photo was taken, which must be known."""
        assert self.match.photo.where is not None
        return self.match.photo.where


class Group(NamedTuple):
    """Weighted matches that stand together, best first.

    Attributes:
        supporters: Those that mean the place, one at least.
        bystanders: Those that stand there too but look another way, so that they cannot show what the
            supporters show: they speak neither for the place nor against it.
    """

    supporters: list[WeightedMatch]
    bystanders: list[WeightedMatch]


def weighted_matches(matches: Iterable[Match], sharpness: float) -> list[WeightedMatch]:
    """Matches with their weights, in an order that does not depend on the one they came in."""
    ordered = sorted(matches, key=lambda match: (-match.score, match.row, str(match.photo.path)))
    # Relative to the best score, so that no weight overflows; only ratios count.
    return [WeightedMatch(match, math.exp(sharpness * (match.score - ordered[0].score))) for match in ordered]


def total_weight(some: Iterable[WeightedMatch]) -> float:
    """What matches weigh together, exactly rounded: in which order they are added is no vote."""
    return math.fsum(one.weight for one in some)


def groups(everyone: Sequence[WeightedMatch], radius_m: float) -> Iterator[Group]:
    """Again and again the heaviest group of those left, until every match with a position is in one.

    A group stands within `radius_m` of one of its matches and looks its way, as far as headings are known.
    """
    placed = [one for one in everyone if one.match.photo.where is not None]
    lat, lon = ([getattr(one.where, axis) for one in placed] for axis in ("lat", "lon"))
    near = metres(np.array(lat)[:, None], np.array(lon)[:, None], lat, lon) <= radius_m
    np.fill_diagonal(near, True)  # whatever rounding, and a radius of 0, make of a match beside itself
    headings = np.array([one.match.photo.heading for one in placed], dtype=np.float64)  # None becomes NaN
    same_view = ~(turn_between(headings[:, None], headings) > VIEW)  # not <=: what is unknown suits all

    left = list(range(len(placed)))
    while left:
        around = {n: [placed[m] for m in left if near[n, m] and same_view[n, m]] for n in left}
        # A match far below the best adds nothing to a sum in float64: then the larger group is the heavier one.
        heaviest = max(left, key=lambda n: (total_weight(around[n]), len(around[n])))
        there = [n for n in left if near[heaviest, n]]
        yield Group(
            supporters=around[heaviest],
            bystanders=[placed[n] for n in there if not same_view[heaviest, n]],
        )
        left = [n for n in left if n not in there]


def evidence(group: Group, everyone: Sequence[WeightedMatch], middle: GeoPoint) -> Evidence:
    """What speaks for the place of a group.

    Args:
        group: Who supports it.
        everyone: All matches of the query, best first, the group's own too.
        middle: Where the place is.
    """
    # By identity: a search of the caller's own may name one photo twice, and equals have a vote each.
    bystanders = {id(one) for one in group.bystanders}
    supporters = {id(one) for one in group.supporters}
    heard = [one for one in everyone if id(one) not in bystanders]
    elsewhere = [one for one in heard if id(one) not in supporters]
    scattered = []
    for one in heard:
        where = one.match.photo.where
        away = math.inf if where is None else metres_between(where, middle)
        scattered.append(1.0 if where is None else away / (away + FAR_M))
    # Where nothing stands elsewhere the last match is the rival: whatever else the index has scored lower than it.
    top, rival = group.supporters[0].match.score, (elsewhere or heard[-1:])[0].match.score
    return Evidence(
        top=top,
        gap=top - rival,
        spread=math.fsum(scattered) / len(heard),
        vote_fraction=total_weight(group.supporters) / total_weight(heard),
    )


def confidence(given: Evidence, by: Calibration) -> float:
    """How probable it is that the place is right, 0 to 1, as far as the calibration goes."""
    z = by.bias + by.top * given.top + by.gap * given.gap - by.spread * given.spread
    z += by.share * given.vote_fraction
    return 1 / (1 + math.exp(-z)) if z >= 0 else math.exp(z) / (1 + math.exp(z))  # neither overflows
