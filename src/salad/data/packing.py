"""Places packed into batches, so that each has its turn once and no two of a batch are near to each other."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from salad.data.nearness import Neighbours
from salad.errors import BenchmarkError

_SLACK = 4 / 3  # batches over those that distances ask for: with fewer, nobody could ever change places
_TRIES = 8  # times that a group with near ones is offered another batch, whenever batches are shuffled


class Packing:
    """Groups of places that stay together, shared out among batches.

    How many batches there are, and how many places each has room for, is settled once. Every shuffle fills
    them anew: groups that are near to no other trade places freely; the others trade one for one where that
    brings nobody next to a near one. So every shuffle is sound, and all are of one length.

    Args:
        groups: numbers of places, each place in one group at most.
        near: who is near to whom among them.
        room: most places in a batch, at least the size of the largest group.

    Raises:
        BenchmarkError: two places of one group are near to each other.
    """

    def __init__(self, groups: Sequence[Sequence[int]], near: Neighbours, *, room: int) -> None:
        self._groups = groups
        self._foes = _foes(groups, near)
        self._sizes = np.array([len(group) for group in groups], dtype=np.int64)
        self._home = self._settled(room)

    def shuffled(self, chance: np.random.Generator) -> list[list[int]]:
        """The batches, each a list of places, shared out anew."""
        home = self._home.copy()
        for size in np.unique(self._sizes):
            alike = np.flatnonzero(self._sizes == size)
            tied = np.array([bool(self._foes[group]) for group in alike])
            free = alike[~tied]
            home[free] = home[chance.permutation(free)]
            self._trade(home, np.repeat(alike[tied], _TRIES), alike, chance)
        batches: list[list[int]] = [[] for _ in range(int(home.max(initial=-1)) + 1)]
        for group in chance.permutation(len(home)):
            batches[home[group]].extend(self._groups[group])
        return batches

    def _trade(
        self,
        home: NDArray[np.int64],
        movers: NDArray[np.int64],
        alike: NDArray[np.int64],
        chance: np.random.Generator,
    ) -> None:
        offered = alike[chance.integers(len(alike), size=len(movers))]
        for one, other in zip(chance.permutation(movers).tolist(), offered.tolist(), strict=True):
            here, there = home[one], home[other]
            if self._fits(home, one, there, without=other) and self._fits(home, other, here, without=one):
                home[one], home[other] = there, here

    def _fits(self, home: NDArray[np.int64], group: int, batch: int, *, without: int) -> bool:
        return all(home[foe] != batch or foe == without for foe in self._foes[group])

    def _settled(self, room: int) -> NDArray[np.int64]:
        """A batch for each group: even ones, and more than the distances ask for, so that there is room to trade.

        Those hard to place come first. Groups of several go where little room is left, so that batches fill
        with them; a place by itself goes where most is left.
        """
        crowded = np.array([len(foes) for foes in self._foes], dtype=np.int64)
        order = np.lexsort((-crowded, -self._sizes)).tolist()
        home = np.full(len(self._groups), -1, dtype=np.int64)
        places, kinds = int(self._sizes.sum()), _kinds(self._foes, order)
        spare = min(math.ceil(_SLACK * kinds), places // 2) if kinds > 1 else 1
        fill = np.zeros(max(-(-places // room), kinds, spare), dtype=np.int64)
        for group in order:
            size = int(self._sizes[group])
            fits = fill + size <= room
            fits[[home[foe] for foe in self._foes[group] if home[foe] >= 0]] = False
            if not fits.any():
                fill, fits = np.append(fill, 0), np.append(fits, True)
            emptiest, fullest = np.argmin(np.where(fits, fill, room + 1)), np.argmax(np.where(fits, fill, -1))
            home[group] = chosen = emptiest if size == 1 else fullest
            fill[chosen] += size
        return self._evened(home, fill)

    def _evened(self, home: NDArray[np.int64], fill: NDArray[np.int64]) -> NDArray[np.int64]:
        """Move places that stand by themselves out of full batches into emptier ones that were opened late."""
        for group in np.flatnonzero(self._sizes == 1).tolist():
            fits = fill + 1 < fill[home[group]]
            fits[[home[foe] for foe in self._foes[group]]] = False
            if fits.any():
                emptiest = np.argmin(np.where(fits, fill, fill.max() + 1))
                fill[home[group]] -= 1
                fill[emptiest] += 1
                home[group] = emptiest
        return home


def _kinds(foes: Sequence[Sequence[int]], order: Sequence[int]) -> int:
    """How many batches groups need where room is no matter, taking them one by one: colours of a map."""
    kind = [-1] * len(foes)
    for group in order:
        taken = {kind[foe] for foe in foes[group]}
        kind[group] = next(number for number in itertools.count() if number not in taken)
    return max(kind, default=-1) + 1


def _foes(groups: Sequence[Sequence[int]], near: Neighbours) -> list[list[int]]:
    """For each group, the other groups with a place near to one of its own."""
    group_of = {place: number for number, group in enumerate(groups) for place in group}
    foes: list[list[int]] = []
    for number, group in enumerate(groups):
        others = (other for place in group for other in near.of(place).tolist())
        met = {group_of[other] for other in others if other in group_of}
        if number in met:
            raise BenchmarkError(
                f"a clique holds two places nearer than {near.apart_m:g} m to each other: mine cliques with at least "
                "the distance they are trained with"
            )
        foes.append(sorted(met))
    return foes
