"""Parked cars: an outline drawn out across a width."""

from __future__ import annotations

import numpy as np

from salad.data.town.canvas import Canvas
from salad.data.town.plan import Thing
from salad.data.town.raster import MATTE, Faces, Texture

PAINTS = (
    (196, 198, 200), (30, 32, 36), (240, 240, 238), (128, 24, 28), (40, 62, 104), (98, 104, 108),
    (58, 84, 70),
    (178, 150, 92),
)  # fmt: skip
CAR_WIDTH = 1.74
PROFILES: tuple[tuple[tuple[float, float], ...], ...] = (
    (
        (0.0, 0.35),
        (0.02, 0.75),
        (0.95, 0.98),
        (1.7, 1.44),
        (3.0, 1.47),
        (3.75, 1.02),
        (3.95, 0.6),
        (3.95, 0.35),
    ),
    (
        (0.0, 0.35),
        (0.0, 0.68),
        (1.2, 0.92),
        (1.95, 1.38),
        (3.1, 1.38),
        (3.75, 0.98),
        (4.5, 0.9),
        (4.55, 0.35),
    ),
    ((0.0, 0.35), (0.0, 0.9), (0.5, 1.15), (1.05, 1.9), (4.5, 1.95), (4.75, 1.0), (4.8, 0.6), (4.8, 0.35)),
)
"""Outlines from front bumper over roof to rear bumper: a hatchback, a saloon and a van, in metres."""


def paint_car(profile: int, paint: int) -> Texture:
    """A car's side: body, windows and wheels cut out along its profile."""
    outline = np.array(PROFILES[profile])
    canvas = Canvas(outline[:, 0].max() + 0.01, 2.0, PAINTS[paint], 96.0)
    across, up = canvas.grid()
    roof = np.interp(across, outline[1:-1, 0], outline[1:-1, 1])
    canvas.rgb *= (0.72 + 0.4 * np.clip((up - 0.3) / 0.7, 0, 1) - 0.25 * (np.abs(up - 0.62) < 0.03))[
        ..., None
    ]
    waist = 0.93 if profile < 2 else 1.12
    glass = (up > waist) & (up < roof - 0.1) & (across > outline[2, 0] + 0.25)
    glass &= across < outline[5, 0] - 0.1 if profile < 2 else across < outline[3, 0] + 1.0
    canvas.rgb[glass] = (52, 62, 70)
    canvas.rgb[glass & (across + up * 0.6 > outline[3, 0] + 1.5)] = (74, 86, 96)
    for pillar in (outline[3, 0] + 0.62, outline[3, 0] + 0.66):
        canvas.tone(pillar, 0.4, pillar + 0.05, roof.max() - 0.06, 0.55)
    canvas.kind[(up > roof) | (up < 0.24)] = 0
    for wheel in (0.75, canvas.width - 0.8):
        away = np.hypot(across - wheel, up - 0.31)
        canvas.rgb[away < 0.38] = (18, 18, 20)
        canvas.kind[away < 0.31] = MATTE
        canvas.rgb[away < 0.2] = (150, 152, 156)
        canvas.rgb[(away < 0.17) & (np.sin(np.arctan2(up - 0.31, across - wheel) * 5) > 0.2)] = (60, 60, 64)
    canvas.rect(0.0, 0.6, 0.14, 0.74, (236, 232, 214))
    canvas.rect(canvas.width - 0.14, 0.66, canvas.width, 0.86, (150, 26, 24))
    return canvas.texture()


def paint_car_part(paint: int, part: str) -> Texture:
    """A panel across a car: ``body``, ``glass``, ``front`` or ``rear``, one metre square."""
    colour = (58, 70, 80) if part == "glass" else PAINTS[paint]
    canvas = Canvas(1.0, 1.0, colour, 32.0)
    across, up = canvas.grid()
    canvas.rgb *= (0.85 + 0.25 * up)[..., None]
    if part == "glass":
        canvas.rgb += (60 * np.clip(up + 0.4 * across - 0.6, 0, 1))[..., None]
    elif part in ("front", "rear"):
        canvas.rect(0, 0, 1, 0.24, (40, 40, 42))
        lights = (238, 236, 224) if part == "front" else (160, 28, 26)
        for left in (0.04, 0.76):
            canvas.rect(left, 0.55, left + 0.2, 0.82, lights)
        canvas.rect(0.36, 0.26, 0.64, 0.42, (226, 224, 210))
        if part == "front":
            canvas.rect(0.3, 0.5, 0.7, 0.74, (34, 34, 38))
    return canvas.texture()


def car_faces(car: Thing) -> Faces:
    """A parked car: its profile drawn out across its width."""
    profile, paint = (0, 1, 0, 1, 2)[car.sort % 5], car.sort // 5 % len(PAINTS)
    outline = np.array(PROFILES[profile])
    way = np.array([np.cos(car.direction), np.sin(car.direction), 0.0])
    left = np.array([-way[1], way[0], 0.0])
    length = float(outline[:, 0].max()) + 0.01
    nose = np.array([*car.where, 0.0]) + way * length / 2
    faces = Faces()
    rise = np.array([0, 0, 2.0])
    faces.add(nose + left * CAR_WIDTH / 2, -way * length, rise, ("car", profile, paint), both=True)
    faces.add(nose - left * CAR_WIDTH / 2, -way * length, rise, ("car", profile, paint), both=True)
    parts = ("front", "body", "glass", "body", "glass", "body" if profile == 1 else "rear", "rear")
    for part, start, stop in zip(parts, outline[:-1], outline[1:], strict=True):
        first, second = (nose - way * place + np.array([0, 0, up]) for place, up in (start, stop))
        faces.add(
            first - left * CAR_WIDTH / 2,
            left * CAR_WIDTH,
            second - first,
            ("car-part", paint, part),
            both=True,
        )
    return faces
