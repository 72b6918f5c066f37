"""Matches as ballots: how much each weighs, and which of them mean one place."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salad.geo import GeoPoint, metres, turn_between
from salad.index import Match

RADIUS_M = 25.0
"""Photos this close show one place: the field's own measure of a right answer."""
VIEW = 90.0
"""Photos of one spot that look further apart than this, in degrees, have nothing in view that both show."""


@dataclass(frozen=True, slots=True)
class Ballot:
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

    supporters: list[Ballot]
    bystanders: list[Ballot]


def ballots(matches: Iterable[Match], sharpness: float) -> list[Ballot]:
    """Matches with their weights, in an order that does not depend on the one they came in."""
    ordered = sorted(matches, key=lambda match: (-match.score, match.row, str(match.photo.path)))
    return [Ballot(match, math.exp(sharpness * (match.score - ordered[0].score))) for match in ordered]


def weight(some: Iterable[Ballot]) -> float:
    """What ballots weigh together, exactly rounded: the order of terms is no vote."""
    return math.fsum(ballot.weight for ballot in some)


def groups(everyone: Sequence[Ballot], radius_m: float) -> Iterator[Group]:
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


def _worth(group: Sequence[Ballot]) -> tuple[float, int]:
    return weight(group), len(group)


def _beside(placed: Sequence[Ballot], radius_m: float) -> npt.NDArray[np.bool_]:
    """Which stand beside which, `[ballots, ballots]`; each beside itself."""
    lat, lon = ([getattr(ballot.where, axis) for ballot in placed] for axis in ("lat", "lon"))
    beside: npt.NDArray[np.bool_] = (
        metres(np.array(lat)[:, None], np.array(lon)[:, None], lat, lon) <= radius_m
    )
    return beside | np.eye(len(placed), dtype=np.bool_)


def _alike(placed: Sequence[Ballot]) -> npt.NDArray[np.bool_]:
    """Which may show one view, `[ballots, ballots]`: all but those that look more than `VIEW` apart."""
    headings = np.array([ballot.match.photo.heading for ballot in placed], dtype=np.float64)  # None is NaN
    apart = turn_between(headings[:, None], headings)
    alike: npt.NDArray[np.bool_] = ~(apart > VIEW)
    return alike
