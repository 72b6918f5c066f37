"""How sure a place is: what speaks for it in four numbers, and the calibrated confidence they make."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from salad.config import Calibration
from salad.geo import GeoPoint, metres_between
from salad.place.ballots import Ballot, Group, weight

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


def evidence(group: Group, everyone: Sequence[Ballot], middle: GeoPoint) -> Evidence:
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


def _scattered(ballot: Ballot, middle: GeoPoint) -> float:
    where = ballot.match.photo.where
    if where is None:
        return 1.0
    away = metres_between(where, middle)
    return away / (away + FAR_M)
