"""What turns the colours of surfaces into a photo: light, shadow, haze, wet ground, the camera itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from salad.demo.town.camera import Camera
from salad.demo.town.canvas import noise
from salad.demo.town.ground import Field, Ground
from salad.demo.town.raster import DISPLAY, LAMP, LEAF, WINDOW, Floats, Seen

Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """One kind of light; colours are factors about 1, angles degrees, lengths metres.

    Attributes:
        sun: Where the sun stands, degrees clockwise from north and above the horizon.
        direct: Its light; nothing casts a shadow where it is black.
        sky: Light from all sides.
        zenith: The sky's colour above, 0 to 255.
        horizon: The sky's colour below, which distant things fade to.
        sight: How far one sees.
        clouds: Share of the sky they cover.
        lit: Share of windows with a lamp behind them; 0 also leaves the street lamps off.
        wet: How much the road mirrors.
        leaf: Tint of the leaves.
        grain: Noise of the sensor, in grey levels.
        bright: How bright the camera makes a photo's middle, 0 to 255.
        hour: Of the day the light belongs to.
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


# ``day`` is the references' light; the queries take turns through the others.
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

LAMPS_ON = 0.3  # where more windows than that are lit, the street lamps are
LAMP_GLOW = np.array([255, 206, 138], np.float32)
ROOM_LIGHTS = np.array([[1.0, 0.78, 0.46], [1.0, 0.88, 0.66], [0.82, 0.9, 1.0], [1.0, 0.7, 0.36]], np.float32)


def towards(light: Light) -> NDArray[np.float64]:
    """The unit vector to the sun."""
    azimuth, elevation = np.radians(light.sun)
    flat = np.cos(elevation)
    return np.array([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)])


@dataclass(frozen=True)
class Rays:
    """Every pixel's ray, ``[H, W]`` each, as long as it reaches one metre forward."""

    east: Floats
    north: Floats
    up: Floats

    @classmethod
    def of(cls, camera: Camera) -> Rays:
        """The rays of a camera."""
        columns = np.arange(camera.size[0], dtype=np.float32)
        rows = np.arange(camera.size[1], dtype=np.float32)[:, None]
        parts = camera.linear(np.eye(3)).astype(np.float32)
        return cls(*(part[0] * columns + (part[1] * rows + part[2]) for part in parts))


def heavens(rays: Rays, sky: NDArray[np.bool_], light: Light, seed: Sequence[int]) -> Floats:
    """The sky behind everything: gradient, glow of the sun, clouds, hills ``[N, 3]``."""
    east, north, up = rays.east[sky], rays.north[sky], rays.up[sky]
    # Rays are one metre long forwards, not of length one.
    size = np.sqrt(east**2 + north**2 + up**2)
    rise = np.clip(up / size, 0, 1)
    fade = (np.minimum(rise * 2.1, 1) ** 0.6)[:, None]
    colour = np.array(light.horizon, np.float32) * (1 - fade) + np.array(light.zenith, np.float32) * fade
    glow = np.clip((np.stack([east, north, up], -1) @ towards(light).astype(np.float32)) / size, 0, 1)
    # A wide glow and a narrow disc about the sun, in its own colour.
    colour += (70 * glow**12 + 90 * glow**90)[:, None] * np.array(light.direct, np.float32)
    texture = noise((256, 256), [*seed, 62], 3, 6)
    # Clouds lie on a plane overhead: towards the horizon they are seen flatter and closer together.
    tall = np.maximum(up / size, 0.02) + 0.12
    column = ((east / size / tall * 22 + 999).astype(np.int32)) & 255
    row = ((north / size / tall * 22 + 999).astype(np.int32)) & 255
    dense = texture[row, column]
    cover = np.clip((dense - (1.4 - 2.6 * light.clouds)) * 0.8, 0, 1) * np.clip(rise * 6, 0, 1) * 0.92
    relief = np.clip(1.0 - 0.07 * dense, 0.75, 1.06)
    colour += (np.array(light.cloud, np.float32) * relief[:, None] - colour) * cover[:, None]
    angle = np.arctan2(east, north)
    # Sums of sines that fit into the circle, so that the ridge closes in itself.
    hills = 0.055 + 0.022 * np.sin(3 * angle + 1) + 0.012 * np.sin(8 * angle) + 0.006 * np.sin(23 * angle + 2)
    ridge = (rise < hills) & (up > -0.01)
    veil = np.float32(np.exp(-160 / light.sight) * 0.6)
    hill = np.array([74, 92, 78], np.float32) * np.array(light.sky, np.float32) * 1.1
    colour[ridge] += (hill - colour[ridge]) * veil
    return np.asarray(colour, np.float32)


def halos(rgb: Floats, camera: Camera, depth: Floats, lamps: NDArray[np.float64]) -> None:
    """A glow around every lamp in sight."""
    height, width = depth.shape
    rows, columns = np.arange(height, dtype=np.float32)[:, None], np.arange(width, dtype=np.float32)
    for column, row, away in camera.project(lamps):
        # A lamp outside the picture still glows into its edge.
        if away < 2 or not (-40 < column < width + 40 and -40 < row < height + 40):
            continue
        at = depth[int(np.clip(row, 0, height - 1)), int(np.clip(column, 0, width - 1))]
        # Something nearer hides the lamp, and its glow with it.
        if 0 < at < away - 0.6:
            continue
        radius = np.float32(camera.focal * 0.55 / away + 2)
        square = (rows - np.float32(row)) ** 2 + (columns - np.float32(column)) ** 2
        bloom = np.exp(-square / (2 * radius**2)) * 110 + 46 / (1 + square / radius**2 / 4)
        rgb += (bloom * (bloom > 2))[..., None] * (LAMP_GLOW / 255)


@dataclass(frozen=True)
class Surfaces:
    """What is at every pixel: place in metres, depth (0 is sky), unit normal; ``[H, W]`` each.

    Attributes:
        below: Where it is the ground.
        leaf: Where it is foliage, which has no one direction.
    """

    east: Floats
    north: Floats
    height: Floats
    depth: Floats
    facing: Floats
    below: NDArray[np.bool_]
    leaf: NDArray[np.bool_]

    @classmethod
    def of(cls, camera: Camera, rays: Rays, seen: Seen, normals: NDArray[np.float64]) -> Surfaces:
        """Where the rays ended; those that met no face go on to the ground or the sky."""
        depth = np.where(seen.nearness > 0, 1 / np.maximum(seen.nearness, 1e-6), 0).astype(np.float32)
        below = (seen.face < 0) & (rays.up < -0.004)
        depth[below] = np.float32(camera.position[2]) / -rays.up[below]
        east, north, height = (
            np.float32(start) + ray * depth
            for start, ray in zip(camera.position, (rays.east, rays.north, rays.up), strict=True)
        )
        lengths = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        # The last row is what face -1 finds: the ground looks up.
        table = np.concatenate([normals / lengths, [[0.0, 0.0, 1.0]]]).astype(np.float32)
        return cls(east, north, height, depth, table[seen.face], below, seen.kind == LEAF)

    def daylight(self, light: Light, shade: Field | None, ground: Ground) -> Floats:
        """Light of sun and sky on every pixel, as factors ``[H, W, 3]``."""
        facing, sun = self.facing, towards(light).astype(np.float32)
        # Walls see less of the sky than the ground does; a little more comes from the sun's side.
        open_sky = 0.74 + 0.26 * facing[..., 2] + 0.1 * (facing[..., 0] * sun[0] + facing[..., 1] * sun[1])
        low = (self.height < 3) & (self.depth > 0) & ~self.leaf
        corner = ground.shade.at(self.east[low], self.north[low])[:, 0]
        open_sky[low] *= 1 - 0.62 * corner * np.exp(-np.maximum(self.height[low], 0) / np.float32(1.1))
        total = open_sky[..., None] * np.array(light.sky, np.float32)
        if shade is not None:
            # Leaves face everywhere: most of them catch the sun somehow.
            cosine = np.where(self.leaf, np.float32(0.75), facing @ sun)
            sunny = (cosine > 0) & (self.depth > 0)
            # Half a metre before a wall, or the wall's own height in the map would shade it.
            out = np.float32(0.45)
            east, north = self.east + out * facing[..., 0], self.north + out * facing[..., 1]
            reach = shade.at(east[sunny], north[sunny])[:, 0]
            # A crown is a whole column of shade in the map, so leaves count as higher up than they are.
            above = self.height[sunny] + np.float32(3.0) * self.leaf[sunny] - reach
            sunlight = cosine[sunny] * np.clip(above / np.float32(0.5) + np.float32(0.9), 0, 1)
            total[sunny] += sunlight[:, None] * np.array(light.direct, np.float32)
        return np.asarray(total, np.float32)

    def lamplight(self, lamps: NDArray[np.float64]) -> Floats:
        """How much of the street lamps' light falls on every pixel ``[H, W]``, 0 to 1.6."""
        total = np.zeros(self.depth.shape, np.float32)
        for lamp in lamps.astype(np.float32):
            east, north, up = lamp[0] - self.east, lamp[1] - self.north, lamp[2] - self.height
            square = east**2 + north**2 + up**2 + 1
            slope = east * self.facing[..., 0] + north * self.facing[..., 1] + up * self.facing[..., 2]
            part = np.clip(slope / np.sqrt(square) * np.float32(0.8) + np.float32(0.2), 0, 1)
            total += part * (22 / square)
        total[self.depth <= 0] = 0
        return np.minimum(total, 1.6)


def develop(
    camera: Camera,
    seen: Seen,
    normals: NDArray[np.float64],
    *,
    light: Light,
    ground: Ground,
    shade: Field | None,
    lamps: NDArray[np.float64],
    seed: Sequence[int],
) -> Floats:
    """Light what the rays of `camera` saw: float32 ``[H, W, 3]``, 0 to about 255.

    Args:
        camera: The camera.
        seen: What its rays met.
        normals: Of every face ``[F, 3]``, not yet of length 1.
        light: The light and weather.
        ground: Colours the rays that met no face but go down.
        shade: How high the shadows reach; None without a sun.
        lamps: Places of the street lamps near by ``[L, 3]``.
        seed: Decides clouds and lit windows.
    """
    rays = Rays.of(camera)
    surfaces = Surfaces.of(camera, rays, seen, normals)
    east, north, below = surfaces.east, surfaces.north, surfaces.below
    rgb = seen.rgb.astype(np.float32)
    rgb[below] = ground.colours(east[below], north[below], surfaces.depth[below])
    rgb[surfaces.leaf] *= np.array(light.leaf, np.float32)
    own = rgb / np.float32(255)
    # Glass mirrors the sky, by night far less of it.
    glass = (seen.kind >= WINDOW) | (seen.kind == DISPLAY)
    rgb[glass] += np.array(light.horizon, np.float32) * (0.12 if light.lit < 0.3 else 0.03)
    rgb *= surfaces.daylight(light, shade, ground)
    if light.lit > 0:
        if light.lit > LAMPS_ON:
            strength = np.float32(1.0 if light.lit > 0.4 else 0.55)
            rgb += own * LAMP_GLOW * (strength * surfaces.lamplight(lamps))[..., None]
        light_windows(rgb, own, seen, light, np.random.default_rng([*seed, 61]))
    haze = (1 - np.exp(-surfaces.depth / light.sight))[..., None]
    rgb += (np.array(light.horizon, np.float32) - rgb) * haze
    sky = surfaces.depth <= 0
    rgb[sky] = heavens(rays, sky, light, seed)
    # Rain mirrors what is lit already, haze and sky included.
    if light.wet > 0:
        mirror(rgb, below, light.wet, ground.rough(east, north, 2.0))
    if light.lit > LAMPS_ON:
        halos(rgb, camera, surfaces.depth, lamps)
    return rgb


def light_windows(rgb: Floats, own: Floats, seen: Seen, light: Light, rng: np.random.Generator) -> None:
    """Light some rooms, the shops and the lamps themselves."""
    glass = seen.kind >= WINDOW
    # One number a face and a window, whatever is seen of it: a room does not go dark at the picture's edge.
    lot = rng.random((int(seen.face.max(initial=0)) + 1, 256))[seen.face[glass], seen.kind[glass]]
    rooms = np.zeros((len(lot), 3), np.float32)
    burning = lot < light.lit
    shades = ROOM_LIGHTS[(lot[burning] * 997).astype(np.int64) % len(ROOM_LIGHTS)]
    rooms[burning] = (70 + 210 * own[glass][burning]) * shades * (0.95 if light.lit > 0.2 else 0.6)
    rgb[glass] += rooms
    display = seen.kind == DISPLAY
    rgb[display] += (10 + 190 * own[display]) * ROOM_LIGHTS[1] * np.float32(min(1.0, light.lit * 2.2))
    rgb[seen.kind == LAMP] += LAMP_GLOW * np.float32(min(1.0, light.lit * 2.6))


def mirror(rgb: Floats, below: NDArray[np.bool_], wet: float, rough: Floats) -> None:
    """Let the wet ground show what stands on it upside down, broken by its roughness."""
    rows, columns = np.nonzero(below)
    if not len(rows):
        return
    # The lowest row of each column that is not ground: what is mirrored has its foot there.
    last = below.shape[0] - 1 - np.argmax(~below[::-1], axis=0)
    foot = np.where(below.all(axis=0), 0, last)
    ripple = rough[rows, columns] * 5
    source = np.clip(2 * foot[columns] - rows + ripple, 0, below.shape[0] - 1).astype(np.int32)
    grazing = np.clip(1.15 - (rows - foot[columns]) / (0.42 * below.shape[0]), 0.25, 1)
    puddle = np.clip(0.55 + 0.25 * rough[rows, columns], 0.1, 1)
    mirrored = (wet * grazing * puddle)[:, None].astype(np.float32)
    rgb[rows, columns] = rgb[rows, columns] * (0.8 - 0.45 * mirrored) + rgb[source, columns] * mirrored


def expose(
    linear: Floats, light: Light, rng: np.random.Generator, *, size: tuple[int, int], shake: float
) -> NDArray[np.uint8]:
    """The finished photo: exposure, white balance, tone curve, vignette, sensor noise ``uint8 [H, W, 3]``.

    Args:
        linear: Light per ray, 0 to about 255.
        light: What the camera meters for, and its noise.
        rng: Draws the noise.
        size: Width and height of the photo.
        shake: How far exposure and white balance wander, as a part of it.
    """
    height, width = linear.shape[:2]
    # The camera meters the lower three quarters, as those that distrust the sky do.
    meter = float(np.median(linear[height // 4 :: 3, ::3].mean(axis=-1)))
    auto = float(np.clip((light.bright / max(meter, 1.0)) ** 0.75, 0.75, 1.9))
    gain = auto * (1 + rng.normal(0, shake) + rng.normal(0, shake / 3, 3))
    value = linear * (gain / 255).astype(np.float32)
    # A shoulder instead of a cut: bright sky keeps its clouds.
    bright = value > 0.7
    value[bright] = 0.7 + 0.3 * np.tanh((value[bright] - 0.7) / 0.42)
    # A little less colour, as cheap sensors see it.
    grey = value.mean(axis=-1, keepdims=True)
    value = grey + (value - grey) * np.float32(0.88)
    y, x = np.linspace(-1, 1, height)[:, None], np.linspace(-1, 1, width)
    value *= (255 - 16 * (x**2 + y**2) ** 1.5).astype(np.float32)[..., None]
    rays = Image.fromarray(value.clip(0, 255).astype(np.uint8))
    photo = np.asarray(rays.resize(size, Image.Resampling.LANCZOS), np.float32)
    # Noise comes after shrinking, or averaging would take most of it away; part of it is common to all channels.
    level = rng.standard_normal((*photo.shape[:2], 1), np.float32) * np.float32(light.grain)
    level = level + rng.standard_normal(photo.shape, np.float32) * np.float32(light.grain / 2)
    return (photo + level).clip(0, 255).astype(np.uint8)
