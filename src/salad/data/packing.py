"""Places packed into batches, so that each has its turn once and no two of a batch are near to each other."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from salad.data.nearness import Neighbours

_SLACK = 4 / 3  # batches over those that distances ask for: with fewer, nobody could ever change places
_TRIES = 8  # times that a place with near ones is offered another batch, whenever batches are shuffled


class Packing:
    """Places shared out among batches.

    How many batches there are, and how many places each has room for, is settled once. Every shuffle fills
    them anew: places that are near to no other trade freely; the others trade one for one where that
    brings nobody next to a near one. So every shuffle is sound, and all are of one length.

    Args:
        places: their numbers, each once; at least one.
        near: who is near to whom among them.
        room: most places in a batch.
    """

    def __init__(self, places: Sequence[int], near: Neighbours, *, room: int) -> None:
        self._places = places
        self._foes = _foes(places, near)
        self._home = self._settled(room)

    def shuffled(self, chance: np.random.Generator) -> list[list[int]]:
        """The batches, each a list of places, shared out anew."""
        home = self._home.copy()
        tied = np.array([bool(foes) for foes in self._foes])
        free = np.flatnonzero(~tied)
        home[free] = home[chance.permutation(free)]
        self._trade(home, np.repeat(np.flatnonzero(tied), _TRIES), chance)
        batches: list[list[int]] = [[] for _ in range(int(home.max()) + 1)]
        for place in chance.permutation(len(home)):
            batches[home[place]].append(self._places[place])
        return batches

    def _trade(self, home: NDArray[np.int64], movers: NDArray[np.int64], chance: np.random.Generator) -> None:
        offered = chance.integers(len(home), size=len(movers))
        for one, other in zip(chance.permutation(movers).tolist(), offered.tolist(), strict=True):
            here, there = home[one], home[other]
            if self._fits(home, one, there, without=other) and self._fits(home, other, here, without=one):
                home[one], home[other] = there, here

    def _fits(self, home: NDArray[np.int64], place: int, batch: int, *, without: int) -> bool:
        return all(home[foe] != batch or foe == without for foe in self._foes[place])

    def _settled(self, room: int) -> NDArray[np.int64]:
        """A batch for each place: even ones, and more than the distances ask for, so that there is room to trade.

        Those hard to place come first, and each goes where most room is left.
        """
        order = sorted(range(len(self._places)), key=lambda place: -len(self._foes[place]))
        home = np.full(len(order), -1, dtype=np.int64)
        kinds = _kinds(self._foes, order)
        spare = min(math.ceil(_SLACK * kinds), len(order) // 2) if kinds > 1 else 1
        fill = np.zeros(max(-(-len(order) // room), kinds, spare), dtype=np.int64)
        for place in order:
            fits = fill < room
            fits[[home[foe] for foe in self._foes[place] if home[foe] >= 0]] = False
            if not fits.any():
                fill, fits = np.append(fill, 0), np.append(fits, True)
            home[place] = emptiest = np.argmin(np.where(fits, fill, room + 1))
            fill[emptiest] += 1
        return self._evened(home, fill)

    def _evened(self, home: NDArray[np.int64], fill: NDArray[np.int64]) -> NDArray[np.int64]:
        """Move places out of full batches into emptier ones that were opened late."""
        for place, foes in enumerate(self._foes):
            fits = fill + 1 < fill[home[place]]
            fits[[home[foe] for foe in foes]] = False
            if fits.any():
                emptiest = np.argmin(np.where(fits, fill, fill.max() + 1))
                fill[home[place]] -= 1
                fill[emptiest] += 1
                home[place] = emptiest
        return home


def _kinds(foes: Sequence[Sequence[int]], order: Sequence[int]) -> int:
    """How many batches places need where room is no matter, taking them one by one: colours of a map."""
    kind = [-1] * len(foes)
    for place in order:
        taken = {kind[foe] for foe in foes[place]}
        kind[place] = next(number for number in itertools.count() if number not in taken)
    return max(kind) + 1


def _foes(places: Sequence[int], near: Neighbours) -> list[list[int]]:
    """For each place, where among them those stand that are near to it."""
    at = {place: number for number, place in enumerate(places)}
    return [sorted(at[other] for other in near.of(place).tolist() if other in at) for place in places]
