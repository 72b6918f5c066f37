"""One photo of the town: gather what stands near a camera, cast the rays, light what they met."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from salad.demo.town import things
from salad.demo.town.camera import Shot
from salad.demo.town.ground import Field, Ground, heights, shadows
from salad.demo.town.light import LIGHTS, develop, expose, towards
from salad.demo.town.plan import Thing, TownPlan, park_cars, plan_town
from salad.demo.town.raster import Faces, Skin, Texture, cast

SIGHT = 130.0  # nothing farther away is drawn, in metres
FINER = 1.5  # rays a pixel, along each side: averaged down, they spare roofs and railings their stairs


@dataclass
class Studio:
    """Draws photos of one town; keeps painted walls, shadows and the ground from one photo to the next."""

    plan: TownPlan
    textures: dict[Skin, Texture] = field(default_factory=dict)
    shades: dict[tuple[str, int], Field] = field(default_factory=dict)

    @staticmethod
    @lru_cache(maxsize=1)
    def of(seed: int, viewpoints: int) -> Studio:
        """The studio of a town, kept for the next photo because its painted walls are dear."""
        return Studio(plan_town(seed, viewpoints))

    def __post_init__(self) -> None:
        """Survey the ground and put up the houses."""
        self.ground = Ground.of(self.plan)
        self.houses = [things.house_faces(house) for house in self.plan.houses]
        self.centres = np.array([house.corners.mean(axis=0) for house in self.plan.houses])

    def draw(self, shot: Shot) -> NDArray[np.uint8]:
        """The photo, uint8 ``[H, W, 3]``."""
        size = shot.camera.size
        camera = replace(shot.camera, size=(round(size[0] * FINER), round(size[1] * FINER)))
        light, parked = LIGHTS[shot.light], park_cars(self.plan, shot.visit)
        faces = self.gather(shot, parked)
        seen = cast(camera, faces, self.paint)
        seed = (self.plan.seed, 7, shot.visit)
        linear = develop(
            camera,
            seen,
            faces.outward_normals(camera),
            light=light,
            ground=self.ground,
            shade=self.shade(shot, parked) if any(light.direct) else None,
            lamps=self.lamps(shot),
            seed=seed,
        )
        # The photo's own noise: two photos of one visit share their clouds and windows, not their grain.
        rng = np.random.default_rng([*seed, *shot.name.encode()])
        return expose(linear, light, rng, size=size, shake=0.03 if shot.light == "day" else 0.08)

    def gather(self, shot: Shot, parked: tuple[Thing, ...]) -> Faces:
        """All faces near enough to be seen."""
        place, faces = np.array(shot.camera.position[:2]), Faces()
        rng = np.random.default_rng([self.plan.seed, 8, shot.visit])
        # Awnings are out or in by visit, and for every house, so that a photo does not depend on what it sees.
        out = rng.random(len(self.houses)) < 0.7
        for number in np.flatnonzero(np.linalg.norm(self.centres - place, axis=1) < SIGHT).tolist():
            faces.extend(self.houses[number])
            house = self.plan.houses[number]
            faces.extend(things.front_faces(house, number, awning_out=bool(out[number])))
        for car in parked:
            # A car nearer than that would fill the picture, and one farther than 90 m is a speck behind others.
            if 4.2 < np.hypot(*(np.array(car.where) - place)) < 90:
                faces.extend(things.car_faces(car))
        for number, tree in enumerate(self.plan.trees):
            _stand(faces, tree, place, tree.height * 0.8, (things.paint_tree, tree.sort, number % 5))
        for lamp in self.plan.lamps:
            _stand(faces, lamp, place, 0.8, (things.paint_lamp,))
        return faces

    def lamps(self, shot: Shot) -> NDArray[np.float64]:
        """The lamps near enough to matter ``[L, 3]``."""
        places = np.array([(*lamp.where, 4.75) for lamp in self.plan.lamps], np.float64).reshape(-1, 3)
        near = np.linalg.norm(places[:, :2] - shot.camera.position[:2], axis=1) < 55
        return np.asarray(places[near])

    def shade(self, shot: Shot, parked: tuple[Thing, ...]) -> Field:
        """The shadows of a visit."""
        key = (shot.light, shot.visit)
        if key not in self.shades:
            self.shades = {key: shadows(heights(self.plan, parked), towards(LIGHTS[shot.light]))}
        return self.shades[key]

    def paint(self, skin: Skin) -> Texture:
        """The texture a face asks for, painted at the first asking."""
        if skin not in self.textures:
            painter, *details = skin
            self.textures[skin] = painter(*details).texture()
        return self.textures[skin]


def _stand(faces: Faces, thing: Thing, place: NDArray[np.float64], width: float, skin: Skin) -> None:
    """Put up a flat picture that turns towards the camera."""
    away = np.array(thing.where) - place
    distance = float(np.hypot(*away))
    # Standing in a tree one would see nothing but its picture.
    if 1.5 < distance < SIGHT:
        right = np.array([away[1], -away[0], 0.0]) / distance * width
        foot = np.array([*thing.where, 0.0]) - right / 2
        faces.add(foot, right, (0.0, 0.0, thing.height), skin, both=True)
