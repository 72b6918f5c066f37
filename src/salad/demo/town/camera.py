"""A pinhole camera in local metres: x east, y north, z up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes:
        position: X east, y north, z up, in metres.
        heading: Degrees clockwise from north.
        pitch: Degrees upwards.
        roll: Degrees; positive turns the camera clockwise, so the world counter-clockwise.
        view: Horizontal angle of view in degrees.
        size: Width and height in pixels.
    """

    position: tuple[float, float, float]
    heading: float
    size: tuple[int, int]
    pitch: float = 0.0
    roll: float = 0.0
    view: float = 72.0

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return float(self.size[0] / 2 / np.tan(np.radians(self.view) / 2))

    def axes(self) -> NDArray[np.float64]:
        """Unit vectors to the right, down and forward in the picture, as rows ``[3, 3]``."""
        heading, pitch, roll = np.radians([self.heading, self.pitch, self.roll])
        forward = np.array([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), np.sin(pitch)])
        level = np.array([np.cos(heading), -np.sin(heading), 0.0])
        # Roll turns the axes about the line of sight, so it comes last.
        below = np.cross(forward, level)
        right = np.cos(roll) * level + np.sin(roll) * below
        return np.stack([right, np.cross(forward, right), forward])

    def project(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Column, row (pixel edges, so a centre is at .5) and depth in metres of `points` ``[..., 3]``."""
        seen = (np.asarray(points, np.float64) - self.position) @ self.axes().T
        depth = seen[..., 2]
        # Points beside the camera have no place in the picture; dividing by nothing would only warn of it.
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        column = self.size[0] / 2 + self.focal * seen[..., 0] / safe
        row = self.size[1] / 2 + self.focal * seen[..., 1] / safe
        return np.stack([column, row, depth], axis=-1)

    def linear(self, vectors: NDArray[np.floating]) -> NDArray[np.float64]:
        """Coefficients ``[..., 3]`` (column, row, constant) of the product of each vector with a pixel's ray.

        Rays are as long as they reach one metre forward, so a ray's length to a point is that point's depth.
        """
        # Dividing by the focal length here makes every later step a sum of products, with no division a pixel.
        scaled = self.axes() / np.array([[self.focal], [self.focal], [1.0]])
        right, down, forward = np.moveaxis(np.asarray(vectors) @ scaled.T, -1, 0)
        # Pixel centres are whole numbers here, so the middle of the picture is half a pixel before half its size.
        constant = forward - right * (self.size[0] - 1) / 2 - down * (self.size[1] - 1) / 2
        return np.stack([right, down, constant], axis=-1)


@dataclass(frozen=True)
class Shot:
    """One photo to take: from where, in which light, on which visit (it decides cars and clouds)."""

    name: str
    camera: Camera
    light: str
    visit: int
