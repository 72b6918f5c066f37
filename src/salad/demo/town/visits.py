"""Whence and when the town is photographed: one drive for the references, later visits for the queries."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from salad.demo.town.camera import Camera, Shot
from salad.demo.town.light import LIGHTS
from salad.demo.town.plan import Street, TownPlan, usable
from salad.geo import GeoPoint, shifted

ORIGIN = GeoPoint(47.5, 64.5)  # where the invented town is put: open steppe, where no such town stands
# The lights of later visits, in turn: mostly day, for most photos are taken by day.
CONDITIONS = (
    *("overcast", "golden evening", "autumn", "rain", "overcast"),
    *("dusk", "autumn", "golden evening", "fog", "night"),
)
GLANCE = 38.0  # references look so far to the right and to the left of their way, in degrees
DRIVE = datetime(2024, 6, 12, 10, 30)


def take_references(plan: TownPlan, count: int, size: tuple[int, int]) -> list[Shot]:
    """Photos of one drive through all streets, two from every place: ahead right and ahead left."""
    places = (count + 1) // 2
    # All streets end to end: the drive's places are evenly spaced along this one line.
    lengths = np.cumsum([usable(street) for street in plan.streets])
    shots: list[Shot] = []
    for number, along in enumerate((np.arange(places) + 0.5) * lengths[-1] / places):
        which = int(np.searchsorted(lengths, along))
        street = plan.streets[which]
        # The first five metres belong to the crossing.
        inside = 5.0 + along - (lengths[which - 1] if which else 0.0)
        rng = np.random.default_rng([plan.seed, 71, number])
        for glance in (GLANCE, -GLANCE)[: count - 2 * number]:
            name, turn = f"ref_{len(shots) + 1:04d}.jpg", glance + rng.uniform(-3, 3)
            lens = (2.3, 6.0, 0.0, 72.0)
            shots.append(_shot(name, street, (float(inside), -1.3), turn, lens, size, ("day", 0)))
    return shots


def take_queries(plan: TownPlan, sources: list[Shot], count: int) -> list[Shot]:
    """Photos of later visits, each near one of the references and looking much the same way.

    A query stands 1 to 5 m along the street and up to 1 m aside from its reference and looks up to 8 degrees
    elsewhere, with another lens, in another light, between other cars.
    """
    # Without repeating a reference until all were taken.
    chosen = np.random.default_rng([plan.seed, 72]).permutation(len(sources))
    shots = []
    for number in range(count):
        rng = np.random.default_rng([plan.seed, 73, number])
        source = sources[int(chosen[number % len(sources)])].camera
        street, along, left = plan.nearest(np.array(source.position[:2]))
        step = float(rng.uniform(1, 5)) * float(rng.choice([-1, 1]))
        # Where the street ends, step back into it.
        step = step if 3 < along + step < street.length - 3 else -step
        # Not nearer to the kerb than a car would drive.
        aside = float(np.clip(left + rng.uniform(-1, 1), -1.8, 1.8))
        _, way = street.at(along)
        glance = source.heading - _heading(way) + rng.uniform(-8, 8)
        lens = (rng.uniform(1.8, 2.3), rng.uniform(4, 8), rng.normal(0, 0.7), rng.uniform(68, 76))
        lit = (CONDITIONS[number % len(CONDITIONS)], number + 1)
        name, place = f"query_{number + 1:03d}.jpg", (along + step, aside)
        shots.append(_shot(name, street, place, glance, lens, source.size, lit))
    return shots


def time_of(shot: Shot, number: int) -> datetime:
    """When a photo was taken: the drive's clock for references, some later day for queries."""
    if shot.visit == 0:
        return DRIVE + timedelta(seconds=3 * (number // 2))
    # Autumn is about four months after the drive in June; other visits follow within weeks.
    later = 118 if shot.light == "autumn" else 12 + 3 * (shot.visit % 11)
    day = (DRIVE + timedelta(days=later)).replace(hour=LIGHTS[shot.light].hour, minute=0)
    return day + timedelta(seconds=97 * (shot.visit % 30))


def position_of(shot: Shot) -> GeoPoint:
    """Where on earth a photo is taken."""
    return shifted(ORIGIN, shot.camera.position[1], shot.camera.position[0])


def _shot(
    name: str,
    street: Street,
    place: tuple[float, float],
    glance: float,
    lens: tuple[float, float, float, float],
    size: tuple[int, int],
    lit: tuple[str, int],
) -> Shot:
    """One photo `place` metres along and left of a street, looking `glance` degrees right of its way."""
    point, way = street.at(*place)
    height, pitch, roll, view = (float(part) for part in lens)
    position = (float(point[0]), float(point[1]), height)
    camera = Camera(position, float((_heading(way) + glance) % 360), size, pitch, roll, view)
    return Shot(name, camera, *lit)


def _heading(way: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arctan2(way[0], way[1])))
