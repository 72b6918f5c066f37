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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from salad.config import Calibration
from salad.geo import GeoPoint, centre, spread
from salad.index import Match
from salad.place.ballots import RADIUS_M, ballots, groups
from salad.place.confidence import Evidence, confidence, evidence

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
    everyone = ballots(matches, sharpness)
    for group in groups(everyone, radius_m):
        points, weights = zip(*((ballot.where, ballot.weight) for ballot in group.supporters), strict=True)
        middle = centre(points, weights)
        yield Candidate(
            where=middle,
            scatter_m=math.hypot(radius_m, 2 * spread(points, weights)),
            support=len(group.supporters),
            evidence=evidence(group, everyone, middle),
        )
