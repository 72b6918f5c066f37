"""Samplers: which photos of which places make up the n-th batch.

A sampler knows no past: its n-th batch depends on its seed and n alone, so a run that was interrupted goes on
with what it would have seen. No two places of a batch should be so near that photos of one show the other, for
they would count as different; all but `MixedSampler` see to that where positions are known.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import NDArray

from salad.datasets.neighbours import Neighbours
from salad.datasets.training_place import TrainingPlace, View, by_city
from salad.errors import BenchmarkError

APART_M = 100.0
"""How far apart, in metres, two places of a batch are at least: GSV-Cities' own distance."""


@dataclass(eq=False, repr=False)  # places may be half a million: no text of them all, no comparing
class Sampler(ABC):
    """Batches of places by their numbers.

    Attributes:
        places: What to draw from.
        per_batch: Most places in a batch.
        views: Photos of each; a place with fewer shows some of them twice.
        seed: Decides everything.
        mirror: Whether half of the places are mirrored.

    Raises:
        BenchmarkError: If there are fewer places than a batch needs; or, where a distance is kept, if none may stand
            beside another.
    """

    places: Sequence[TrainingPlace]
    _: KW_ONLY
    per_batch: int
    views: int
    seed: int
    mirror: bool = False

    def __post_init__(self) -> None:
        if len(self.places) < self.per_batch:
            raise BenchmarkError(
                f"a batch needs {self.per_batch} places, but there are {len(self.places)} to learn from: take photos "
                "of more places, hold a smaller share of them out, or draw fewer for a batch"
            )

    def batch(self, number: int) -> list[View]:
        """The batch of that number, from 0 on: its photos, each place mirrored in all of them or in none."""
        # A generator for each batch, of seed and number: to draw the n-th, none before it need be drawn.
        rng = np.random.default_rng((self.seed, number))
        shown: list[View] = []
        for label, index in enumerate(self._drawn(number, rng)):
            place = self.places[index]
            # The order of these draws decides every batch: runs that are resumed must draw as they did before.
            mirrored = self.mirror and bool(rng.random() < 0.5)
            rounds = math.ceil(self.views / len(place.photos))  # too few photos: some of them are shown twice
            photos = np.concatenate([rng.permutation(len(place.photos)) for _ in range(rounds)])[: self.views]
            shown += [View(place.photos[photo], label, mirrored, place) for photo in photos.tolist()]
        return shown

    @abstractmethod
    def _drawn(self, number: int, rng: np.random.Generator, /) -> Sequence[int]:
        """The numbers of the places in the batch of that number."""


@dataclass(eq=False, repr=False)
class MixedSampler(Sampler):
    """Places of all cities in one batch; a city takes part by the square root of its size.

    It keeps no distance between places: use it for sets whose places lie far enough apart by themselves.
    """

    mirror: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._numbers, self._chances = _chances(self.places)

    def _drawn(self, _: int, rng: np.random.Generator) -> Sequence[int]:
        drawn = rng.choice(len(self._numbers), size=self.per_batch, replace=False, p=self._chances)
        return [self._numbers[index] for index in drawn]


@dataclass(eq=False, repr=False)
class OneCitySampler(Sampler):
    """Each batch within one city, every place once an epoch, as the paper trains; each epoch is shuffled anew.

    Places of one city look more alike than those of two, so that there is more to learn from each batch. Batches
    hold `per_batch` places or fewer, as even as they come: a city's places seldom divide by it. A place that would
    be alone in its batch teaches nothing and is left out of that epoch. An epoch ends every `per_epoch` batches.

    Attributes:
        apart_m: Metres between any two places of a batch, where their positions are known; 0 for no matter.
        per_epoch: Batches in an epoch.
    """

    apart_m: float = APART_M

    def __post_init__(self) -> None:
        super().__post_init__()
        near = Neighbours([place.where for place in self.places], self.apart_m)
        self._packings = [Packing(city, near, room=self.per_batch) for city in by_city(self.places).values()]
        self._epoch, self._batches = -1, list[list[int]]()
        self.per_epoch = len(self._plan(0))
        if not self.per_epoch:
            raise _no_two(self.places, self.apart_m)

    def _drawn(self, number: int, _: np.random.Generator) -> Sequence[int]:
        epoch, within = divmod(number, self.per_epoch)
        return self._plan(epoch)[within]

    def _plan(self, epoch: int) -> list[list[int]]:
        """An epoch's batches; the last one asked for is kept, since its batches are asked for one by one."""
        if epoch != self._epoch:
            # the 1 behind keeps these draws apart from those of a batch: a 0 there would not
            rng = np.random.default_rng((self.seed, epoch, 1))
            packed = [batch for packing in self._packings for batch in packing.shuffled(rng)]
            several = [batch for batch in packed if len(batch) > 1]
            self._batches = [several[place] for place in rng.permutation(len(several))]
            self._epoch = epoch
        return self._batches


@dataclass(eq=False, repr=False)
class CliqueSampler(Sampler):
    """Batches of cliques of places that look alike, in which each city takes part as in mixed ones.

    Whole cliques are drawn, and places of no clique by themselves, each with the mean chance of its places in a
    `MixedSampler`: cliques change whom a place meets, hardly how often it comes. The last drawn is cut where its
    batch is full, and a place near to one that is in it already waits for another batch.

    Attributes:
        cliques: Numbers of places, as `salad.training.mining.mine` gives them.
        apart_m: Metres between any two places of a batch, where their positions are known; 0 for no matter.

    Raises:
        BenchmarkError: If a place is in two cliques, or in none of the places.
    """

    cliques: Sequence[Sequence[int]]
    apart_m: float = APART_M

    def __post_init__(self) -> None:
        super().__post_init__()
        places = self.places
        taken = [place for clique in self.cliques for place in clique]
        if len(set(taken)) < len(taken) or not set(taken) <= set(range(len(places))):
            raise BenchmarkError(
                f"a clique names a place twice, or one that is not among the {len(places)} places: mine the cliques "
                "anew from the places they are to be used with"
            )
        self._near = Neighbours([place.where for place in places], self.apart_m)
        # A place near to all others would be alone in its batch, and teach nothing.
        chance_of = {
            number: chance
            for number, chance in zip(*_chances(places), strict=True)
            if len(self._near.of(number)) < len(places) - 1
        }
        if not chance_of:
            raise _no_two(places, self.apart_m)
        alone = [[place] for place in sorted(set(range(len(places))) - set(taken))]
        together = [[place for place in clique if place in chance_of] for clique in [*self.cliques, *alone]]
        self._groups = [group for group in together if group]
        self._chances = np.array([sum(chance_of[place] for place in group) / len(group) for group in self._groups])

    def _drawn(self, _: int, rng: np.random.Generator) -> Sequence[int]:
        # waiting times: the same as to draw one after another, each by its chance among those that are left
        order = np.argsort(rng.exponential(size=len(self._chances)) / self._chances).tolist()
        drawn, shut = list[int](), set[int]()
        groups = (rng.permutation(self._groups[group]).tolist() for group in order)
        for place in itertools.chain.from_iterable(groups):
            if len(drawn) == self.per_batch:
                break
            if place not in shut:
                drawn.append(place)
                shut.update(self._near.of(place).tolist())
        return drawn


def _no_two(places: Sequence[TrainingPlace], apart_m: float) -> BenchmarkError:
    return BenchmarkError(
        f"no two of the {len(places)} places may stand in one batch, since places of one city lie within "
        f"{apart_m:g} m of each other: take photos of more places, or train with a smaller distance"
    )


def _chances(places: Sequence[TrainingPlace]) -> tuple[list[int], list[float]]:
    """Places' numbers, city by city, and the chance of each: a city's is the square root of its size."""
    cities = list(by_city(places).values())
    # By its size alone one large city would fill every batch; all alike, places of a small one would come too often.
    weights = np.sqrt([len(city) for city in cities])
    chances = [np.full(len(c), w / len(c)) for c, w in zip(cities, weights / weights.sum(), strict=True)]
    return [number for city in cities for number in city], np.concatenate(chances).tolist()


_SLACK = 4 / 3  # batches over those that distances ask for: with fewer, nobody could ever change places
_TRIES = 8  # times that a place with near ones is offered another batch, whenever batches are shuffled


class Packing:
    """Places shared out among batches, so that each has its turn once and no two of a batch are near to each other.

    How many batches there are, and how many places each has room for, is settled once. Every shuffle fills
    them anew: places that are near to no other trade freely; the others trade one for one where that
    brings nobody next to a near one. So every shuffle is sound, and all are of one length.

    Args:
        places: Their numbers, each once; at least one.
        near: Who is near to whom among them.
        room: Most places in a batch.
    """

    def __init__(self, places: Sequence[int], near: Neighbours, *, room: int) -> None:
        self._places = places
        at = {place: index for index, place in enumerate(places)}
        # For each place, where among these the places stand that are near to it.
        self._near = [sorted(at[other] for other in near.of(place).tolist() if other in at) for place in places]
        self._batch_of = self._settled(room)

    def shuffled(self, rng: np.random.Generator) -> list[list[int]]:
        """The batches, each a list of places, shared out anew."""
        batch_of = self._batch_of.copy()
        tied = np.array([bool(near) for near in self._near])
        free = np.flatnonzero(~tied)
        # Any place near to no other may stand anywhere, so that these are shuffled freely, without a look.
        batch_of[free] = batch_of[rng.permutation(free)]
        movers = np.repeat(np.flatnonzero(tied), _TRIES)
        offered = rng.integers(len(batch_of), size=len(movers))
        for one, other in zip(rng.permutation(movers).tolist(), offered.tolist(), strict=True):
            here, there = batch_of[one], batch_of[other]
            if self._fits(batch_of, one, there, without=other) and self._fits(batch_of, other, here, without=one):
                batch_of[one], batch_of[other] = there, here
        batches: list[list[int]] = [[] for _ in range(int(batch_of.max()) + 1)]
        for index in rng.permutation(len(batch_of)):
            batches[batch_of[index]].append(self._places[index])
        return batches

    def _fits(self, batch_of: NDArray[np.int64], index: int, batch: int, *, without: int) -> bool:
        return all(batch_of[near] != batch or near == without for near in self._near[index])

    def _settled(self, room: int) -> NDArray[np.int64]:
        """A batch for each place: even ones, and more than the distances ask for, so that there is room to trade.

        Those hard to place come first, and each goes where most room is left.
        """
        order = sorted(range(len(self._places)), key=lambda index: -len(self._near[index]))
        batch_of = np.full(len(order), -1, dtype=np.int64)
        needed = self._colours(order)
        spare = min(math.ceil(_SLACK * needed), len(order) // 2) if needed > 1 else 1
        fill = np.zeros(max(-(-len(order) // room), needed, spare), dtype=np.int64)
        for index in order:
            fits = fill < room
            fits[[batch_of[near] for near in self._near[index] if batch_of[near] >= 0]] = False
            if not fits.any():  # the colours do not count room, so one batch more may be needed
                fill, fits = np.append(fill, 0), np.append(fits, True)
            batch_of[index] = emptiest = np.argmin(np.where(fits, fill, room + 1))
            fill[emptiest] += 1
        # Then out of full batches into emptier ones that were opened late.
        for index, near in enumerate(self._near):
            fits = fill + 1 < fill[batch_of[index]]
            fits[[batch_of[other] for other in near]] = False
            if fits.any():
                emptiest = np.argmin(np.where(fits, fill, fill.max() + 1))
                fill[batch_of[index]] -= 1
                fill[emptiest] += 1
                batch_of[index] = emptiest
        return batch_of

    def _colours(self, order: Sequence[int]) -> int:
        """How many batches places need where room is no matter, taking them one by one: colours of a map."""
        colour = [-1] * len(order)
        for index in order:
            taken = {colour[near] for near in self._near[index]}
            colour[index] = next(number for number in itertools.count() if number not in taken)
        return max(colour) + 1
