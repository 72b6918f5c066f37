"""The lights and weathers a town is photographed in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """One kind of light; colours are factors about 1, angles degrees, lengths metres.

    Attributes:
        sun: where the sun stands, degrees clockwise from north and above the horizon.
        direct: its light; nothing casts a shadow where it is black.
        sky: light from all sides.
        zenith: the sky's colour above, 0 to 255.
        horizon: the sky's colour below, which distant things fade to.
        sight: how far one sees.
        clouds: share of the sky they cover.
        lit: share of windows with a lamp behind them; 0 also leaves the street lamps off.
        wet: how much the road mirrors.
        leaf: tint of the leaves.
        grain: noise of the sensor, in grey levels.
        bright: how bright the camera makes a photo's middle, 0 to 255.
        hour: of the day the light belongs to.
    """

    sun: tuple[float, float]
    direct: Rgb
    sky: Rgb
    zenith: Rgb
    horizon: Rgb
    sight: float = 900.0
    clouds: float = 0.3
    cloud: Rgb = (262, 262, 264)
    lit: float = 0.0
    wet: float = 0.0
    leaf: Rgb = (1.0, 1.0, 1.0)
    grain: float = 2.0
    bright: float = 112.0
    hour: int = 11


LIGHTS: dict[str, Light] = {
    "day": Light((152, 48), (0.74, 0.7, 0.62), (0.66, 0.69, 0.74), (74, 124, 190), (186, 206, 224)),
    "overcast": Light(
        (180, 40), (0, 0, 0), (0.86, 0.88, 0.9), (168, 174, 182), (206, 208, 210), 420.0, 0.95,
        (214, 216, 220), hour=14
    ),
    "golden evening": Light(
        (262, 22), (1.2, 0.78, 0.4), (0.5, 0.49, 0.56), (88, 122, 176), (250, 206, 150), 500.0, 0.45,
        (255, 214, 170), grain=2.5, leaf=(1.1, 1.0, 0.8), hour=19,
    ),
    "dusk": Light(
        (290, 5), (0, 0, 0), (0.36, 0.37, 0.5), (44, 60, 106), (206, 148, 128), 500.0, 0.5, (120, 100, 124),
        lit=0.35, grain=4.0, bright=80.0, hour=21,
    ),
    "night": Light(
        (0, 30), (0, 0, 0), (0.17, 0.18, 0.26), (14, 19, 40), (50, 48, 62), 600.0, 0.5, (34, 34, 46),
        lit=0.42, grain=5.0, bright=56.0, hour=23,
    ),
    "fog": Light(
        (150, 30), (0, 0, 0), (0.8, 0.81, 0.82), (198, 200, 202), (200, 202, 204), 34.0, 1.0, (204, 206, 208),
        bright=150.0, leaf=(1.15, 0.95, 0.7), hour=8,
    ),
    "rain": Light(
        (180, 40), (0, 0, 0), (0.56, 0.58, 0.62), (118, 124, 132), (158, 164, 170), 150.0, 1.0,
        (136, 140, 148),
        lit=0.12, wet=0.75, grain=3.0, bright=98.0, hour=16,
    ),
    "autumn": Light(
        (205, 28), (0.92, 0.82, 0.64), (0.44, 0.47, 0.54), (92, 134, 184), (204, 214, 222), 600.0, 0.6,
        leaf=(2.1, 1.05, 0.5), hour=15,
    ),
}  # fmt: skip
"""``day`` is the references' light; the queries take turns through the others."""

LAMP_GLOW = np.array([255, 206, 138], np.float32)
ROOM_LIGHTS = np.array([[1.0, 0.78, 0.46], [1.0, 0.88, 0.66], [0.82, 0.9, 1.0], [1.0, 0.7, 0.36]], np.float32)


def towards(light: Light) -> NDArray[np.float64]:
    """The unit vector to the sun."""
    azimuth, elevation = np.radians(light.sun)
    flat = np.cos(elevation)
    return np.array([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)])
