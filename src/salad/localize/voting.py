"""From matches to places: the best matches vote by position and score.

    weight       of a match: exp(sharpness * score), the sharpness being the calibration's
    group        the matches within `radius_m` of one of them that look its way, as far as that is known; the
                 heaviest group is the place, the others are runners-up
    place        the group's weighted mean, its radius, how many stand behind it, and how sure it is

Matches without a position vote for no group but count in the whole: where the best matches are of unknown
position, no place is sure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from salad.geo import GeoPoint, centre, metres, metres_between, spread, turn_between
from salad.index.index import Match
from salad.network.config import Calibration

# --- Matches as ballots: how much each weighs, and which of them mean one place ---


RADIUS_M = 25.0
"""Photos this close show one place: the field's own measure of a right answer."""
VIEW = 90.0
"""Photos of one spot that look further apart than this, in degrees, have nothing in view that both show."""


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
    """Ballots that stand together, best first.

    Args:
        supporters: those that mean the place, one at least.
        bystanders: those that stand there too but look another way, so that they cannot show what the
            supporters show: they speak neither for the place nor against it.
    """

    supporters: list[WeightedMatch]
    bystanders: list[WeightedMatch]


def weighted_matches(matches: Iterable[Match], sharpness: float) -> list[WeightedMatch]:
    """Matches with their weights, in an order that does not depend on the one they came in."""
    ordered = sorted(matches, key=lambda match: (-match.score, match.row, str(match.photo.path)))
    return [WeightedMatch(match, math.exp(sharpness * (match.score - ordered[0].score))) for match in ordered]


def weight(some: Iterable[WeightedMatch]) -> float:
    """What ballots weigh together, exactly rounded: the order of terms is no vote."""
    return math.fsum(ballot.weight for ballot in some)


def groups(everyone: Sequence[WeightedMatch], radius_m: float) -> Iterator[Group]:
    """Again and again the heaviest group of those left, until every ballot with a position is in one.

    A group stands within `radius_m` of one of its ballots and looks its way, as far as headings are known.
    """
    placed = [ballot for ballot in everyone if ballot.match.photo.where is not None]
    beside, alike = _beside(placed, radius_m), _alike(placed)
    left = list(range(len(placed)))
    while left:
        heart = max(
            left, key=lambda one: _worth([placed[n] for n in left if beside[one, n] and alike[one, n]])
        )
        around = [n for n in left if beside[heart, n]]
        yield Group(
            supporters=[placed[n] for n in around if alike[heart, n]],
            bystanders=[placed[n] for n in around if not alike[heart, n]],
        )
        left = [n for n in left if n not in around]


def _worth(group: Sequence[WeightedMatch]) -> tuple[float, int]:
    return weight(group), len(group)


def _beside(placed: Sequence[WeightedMatch], radius_m: float) -> npt.NDArray[np.bool_]:
    """Which stand beside which, `[ballots, ballots]`; each beside itself."""
    lat, lon = ([getattr(ballot.where, axis) for ballot in placed] for axis in ("lat", "lon"))
    beside: npt.NDArray[np.bool_] = (
        metres(np.array(lat)[:, None], np.array(lon)[:, None], lat, lon) <= radius_m
    )
    return beside | np.eye(len(placed), dtype=np.bool_)


def _alike(placed: Sequence[WeightedMatch]) -> npt.NDArray[np.bool_]:
    """Which may show one view, `[ballots, ballots]`: all but those that look more than `VIEW` apart."""
    headings = np.array([ballot.match.photo.heading for ballot in placed], dtype=np.float64)  # None is NaN
    apart = turn_between(headings[:, None], headings)
    alike: npt.NDArray[np.bool_] = ~(apart > VIEW)
    return alike


# --- How sure a place is: what speaks for it in four numbers, and the calibrated confidence they make ---


FAR_M = 100.0  # a match this far from the place counts half as scattered as one at the end of the world


class Evidence(NamedTuple):
    """What speaks for a place; all of it but `spread` makes it surer.

    Args:
        top: score of its best supporter.
        gap: how much better that is than the best match elsewhere, below 0 where it is worse; where nothing
            stands elsewhere, how much better than the last match, since whatever else there is scored lower.
        spread: how far all matches scatter from the place: 0 where all stand on it, 1 where all are far away
            or of unknown position.
        share: its supporters' share of all matches' weight, 0 to 1.
    """

    top: float
    gap: float
    spread: float
    share: float


def evidence(group: Group, everyone: Sequence[WeightedMatch], middle: GeoPoint) -> Evidence:
    """What speaks for the place of a group.

    Args:
        group: who supports it.
        everyone: all ballots of the query, best first, the group's own too.
        middle: where the place is.
    """
    aside = {id(ballot) for ballot in group.bystanders}
    inside = {id(ballot) for ballot in group.supporters}
    heard = [ballot for ballot in everyone if id(ballot) not in aside]
    elsewhere = [ballot for ballot in heard if id(ballot) not in inside]
    top, rival = group.supporters[0].match.score, (elsewhere or heard[-1:])[0].match.score
    return Evidence(
        top=top,
        gap=top - rival,
        spread=math.fsum(_scattered(ballot, middle) for ballot in heard) / len(heard),
        share=weight(group.supporters) / weight(heard),
    )


def confidence(given: Evidence, by: Calibration) -> float:
    """How probable it is that the place is right, 0 to 1, as far as the calibration goes."""
    z = by.bias + by.top * given.top + by.gap * given.gap - by.spread * given.spread + by.share * given.share
    return 1 / (1 + math.exp(-z)) if z >= 0 else math.exp(z) / (1 + math.exp(z))


def _scattered(ballot: WeightedMatch, middle: GeoPoint) -> float:
    where = ballot.match.photo.where
    if where is None:
        return 1.0
    away = metres_between(where, middle)
    return away / (away + FAR_M)


GENERIC = Calibration()
"""Stands in where a model has no calibration of its own."""


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


class Candidate(NamedTuple):
    """A group of matches before anybody says how sure it is; `scatter_m` is its radius before calibration."""

    where: GeoPoint
    scatter_m: float
    support: int
    evidence: Evidence


class Voting(Protocol):
    """How matches become places: `vote`, or what a caller puts in its stead."""

    def __call__(self, matches: Sequence[Match], *, radius_m: float, calibration: Calibration) -> list[Place]:
        """The places that matches vote for, the likeliest first."""
        ...


def vote(
    matches: Sequence[Match], *, radius_m: float = RADIUS_M, calibration: Calibration = GENERIC
) -> list[Place]:
    """The places that matches vote for, the heaviest first; their order does not matter.

    Args:
        matches: Of one query.
        radius_m: How far apart, in metres, matches may be and still mean one place.
        calibration: What the model's scores are worth.

    Returns:
        None of it is left out for being unsure. Of two places only one can be right, so a runner-up's
        confidence is never above what the first leaves.
    """
    found: list[Place] = []
    for one in candidates(matches, radius_m=radius_m, sharpness=calibration.sharpness):
        sure = confidence(one.evidence, calibration)
        left = 1 - found[0].confidence if found else 1.0
        found.append(Place(one.where, calibration.radius * one.scatter_m, min(sure, left), one.support))
    return found


def candidates(matches: Sequence[Match], *, radius_m: float, sharpness: float) -> Iterator[Candidate]:
    """The groups that matches make and what speaks for each, the heaviest first."""
    everyone = weighted_matches(matches, sharpness)
    for group in groups(everyone, radius_m):
        points, weights = zip(*((ballot.where, ballot.weight) for ballot in group.supporters), strict=True)
        middle = centre(points, weights)
        yield Candidate(
            where=middle,
            scatter_m=math.hypot(radius_m, 2 * spread(points, weights)),
            support=len(group.supporters),
            evidence=evidence(group, everyone, middle),
        )
