"""What stands before the houses: trees, lamps, cars, and the small parts that stick out of a front."""

from __future__ import annotations

import numpy as np

from salad.demo.town.canvas import Canvas, noise
from salad.demo.town.facade import front_height, paint_front, paint_mansard, paint_side
from salad.demo.town.plan import House, Thing
from salad.demo.town.raster import HOLE, LAMP, LEAF, MATTE, Faces

MANSARD = (2.5, 0.7)  # how high a mansard roof rises and how far it leans back, in metres
MANSARD_SLOPE = float(np.hypot(*MANSARD))
LEAVES = ((72, 94, 46), (90, 106, 52), (58, 82, 50), (104, 112, 60), (82, 102, 66), (66, 80, 42))


def paint_tree(sort: int, variant: int) -> Canvas:
    """A tree as seen from anywhere: 1 metre high and 0.8 wide, to be stretched."""
    rng = np.random.default_rng([sort, variant, 31])
    canvas = Canvas(0.8, 1.0, LEAVES[sort % len(LEAVES)], 320.0)
    canvas.kind[:] = HOLE
    across, up = canvas.grid()
    trunk = np.abs(across - 0.4 - 0.012 * np.sin(up * 9 + variant)) < 0.02 * (1.5 - up) + 0.012 * (up < 0.04)
    # The trunk ends inside the crown.
    canvas.kind[trunk & (up < 0.7)] = MATTE
    canvas.rgb[trunk] = np.array([92, 78, 66]) * (0.75 + 0.5 * (across[trunk] > 0.4))[:, None]
    low, high = rng.uniform(0.26, 0.36), 0.97
    # In random order: sorted by height the tufts would lie like roof tiles.
    for _ in range(44):
        centre_up = rng.uniform(low + 0.08, high - 0.08)
        part = (centre_up - low) / (high - low)
        # Two sorts in three have round crowns, the third is a cone.
        reach = 0.33 * np.sqrt(max(0.05, 1 - (2 * part - 0.9) ** 2)) if sort % 3 else 0.3 * (1.15 - part)
        centre = 0.4 + rng.uniform(-1, 1) * max(reach - 0.05, 0.02)
        # A clump of leaves, bright above and dark below.
        radius, light = rng.uniform(0.06, 0.1), 0.62 + 0.5 * part
        colour = canvas.rgb[0, 0] * rng.uniform(0.85, 1.15)
        angle, far = rng.uniform(0, 2 * np.pi, 240), radius * np.sqrt(rng.random(240))
        x, y = centre + far * np.cos(angle), centre_up + far * np.sin(angle) * 0.8
        shade = light * (1.0 + 0.5 * (y - centre_up) / radius) * rng.uniform(0.7, 1.3, 240)
        inside = (x > 0.03) & (x < 0.76) & (y > 0.05) & (y < 0.97)
        rows = ((canvas.height - y[inside]) * canvas.grain).astype(np.int64)
        columns = (x[inside] * canvas.grain).astype(np.int64)
        for down, aside in np.ndindex(3, 4):
            canvas.rgb[rows + down, columns + aside] = shade[inside, None] * colour
            canvas.kind[rows + down, columns + aside] = LEAF
    return canvas


def paint_lamp() -> Canvas:
    """A street lamp, 5.2 m high and 0.8 m wide."""
    canvas = Canvas(0.8, 5.2, (44, 50, 50))
    canvas.kind[:] = HOLE
    canvas.rect(0.36, 0, 0.44, 4.4, (44, 52, 52), MATTE)
    canvas.rect(0.3, 0, 0.5, 0.9, (40, 46, 46), MATTE)
    canvas.rect(0.32, 4.4, 0.48, 4.46, (40, 46, 46), MATTE)
    canvas.rect(0.24, 4.46, 0.56, 5.0, (228, 222, 204), LAMP)
    for place in (0.24, 0.39, 0.53):
        canvas.rect(place, 4.46, place + 0.03, 5.0, (40, 46, 46), MATTE)
    canvas.rect(0.2, 5.0, 0.6, 5.08, (40, 46, 46), MATTE)
    canvas.rect(0.32, 5.08, 0.48, 5.18, (40, 46, 46), MATTE)
    return canvas


def paint_tiles(colour: tuple[int, int, int]) -> Canvas:
    """Roof tiles, four metres square, repeating."""
    canvas = Canvas(4.0, 4.0, colour, 24.0, fits=False)
    rows, columns = np.indices(canvas.kind.shape)
    shade = np.random.default_rng(sum(colour)).normal(1, 0.09, (16, 16))[
        rows // 6, (columns + rows // 6 % 2 * 3) // 6 % 16
    ]
    shade = shade * (0.84 + 0.05 * (rows % 6)) * (1 + 0.06 * noise(canvas.kind.shape, [sum(colour), 41]))
    canvas.rgb *= shade[..., None].astype(np.float32)
    return canvas


def paint_stripes(colour: tuple[int, int, int], scallops: bool) -> Canvas:
    """Awning cloth: white and coloured stripes, a metre square, perhaps with a scalloped lower edge."""
    canvas = Canvas(1.0, 1.0, colour, 32.0, fits=False)
    across, up = canvas.grid()
    canvas.rgb[(across * 4) % 2 < 1] = (236, 230, 216)
    if scallops:
        canvas.kind[up < 0.5 * np.abs(np.sin(across * np.pi * 4))] = HOLE
    return canvas


def paint_railing() -> Canvas:
    """Iron bars, a metre square."""
    canvas = Canvas(1.0, 1.0, (34, 36, 40), 32.0, fits=False)
    across, up = canvas.grid()
    canvas.kind[((across * 8) % 1 > 0.3) & (up > 0.12) & (up < 0.9)] = HOLE
    return canvas


def paint_plain(colour: tuple[int, int, int]) -> Canvas:
    """One colour, a metre square."""
    return Canvas(1.0, 1.0, colour, 8.0, fits=False)


def paint_blade(text: str, colour: tuple[int, int, int]) -> Canvas:
    """A sign that hangs out over the pavement, 0.9 by 0.7 m."""
    canvas = Canvas(0.9, 0.7, colour, 64.0)
    canvas.rect(0.03, 0.03, 0.87, 0.67, (240, 232, 212))
    canvas.rect(0.06, 0.06, 0.84, 0.64, colour)
    canvas.write(text, 0.1, 0.2, 0.8, 0.5, (244, 236, 214))
    return canvas


def front_faces(house: House, number: int, *, awning_out: bool) -> Faces:
    """What sticks out of a front: awning, hanging sign, balcony."""
    style, faces = house.style, Faces()
    start = np.array([*house.corners[0], 0.0])
    right = np.array([*((house.corners[1] - house.corners[0]) / house.width), 0.0])
    out, up = np.array([right[1], -right[0], 0.0]), np.array([0.0, 0.0, 1.0])
    if style.awning is not None:
        reach, drop = (1.3, 0.75) if awning_out else (0.35, 0.5)  # rolled in, a strip of cloth still shows
        hinge = start + right * 0.25 + up * (style.ground - 0.98)
        edge = hinge + out * reach - up * drop
        wide = right * (house.width - 0.5)
        faces.add(edge, wide, hinge - edge, (paint_stripes, style.awning, False), both=True)
        faces.add(edge - up * 0.24, wide, up * 0.24, (paint_stripes, style.awning, True), both=True)
    if style.shop and "blade" in style.extras:
        pole = start + right * (house.width - 0.35) + up * (style.ground + 0.1)
        faces.add(pole + out * 0.1, out * 0.9, up * 0.7, (paint_blade, style.shop, style.accent), both=True)
    if "balcony" in style.extras and style.storeys > 2:
        floor = style.ground + style.storey * ((number % (style.storeys - 1)) if style.storeys > 3 else 0)
        low, wide = start + right * house.width * 0.2 + up * floor, right * house.width * 0.6
        faces.add(low + out * 0.9, wide, -out * 0.9, (paint_plain, style.trim), both=True)
        faces.add(low + out * 0.9 - up * 0.14, wide, up * 0.16, (paint_plain, style.trim), both=True)
        faces.add(low + out * 0.9, wide, up * 0.95, (paint_railing,), both=True)
        for side in (low, low + wide):
            faces.add(side, out * 0.9, up * 0.95, (paint_railing,), both=True)
    return faces


def house_faces(house: House) -> Faces:
    """Walls, roof and chimneys."""
    style, width, faces = house.style, house.width, Faces()
    low = np.concatenate([house.corners, np.zeros((4, 1))], axis=1)
    sides = np.roll(low, -1, axis=0) - low  # from each corner to the next: the front, and on around the house
    up = np.array([0.0, 0.0, 1.0])
    depth = float(np.linalg.norm(sides[3]))
    faces.add(low[0], sides[0], up * front_height(style, width), (paint_front, style, width))
    for wall in (1, 2, 3):
        gable = style.roof == "eaves" and wall != 2
        height = style.eaves + (depth / 2 * style.rise if gable else 0.0)
        skin = (paint_side, style, float(np.linalg.norm(sides[wall])), wall)
        faces.add(low[wall], sides[wall], up * height, skin)
    eaves, tiles = low + up * style.eaves, (paint_tiles, style.tiles)
    if style.roof in ("gable", "stepped"):
        ridge = (eaves[0] + eaves[1]) / 2 + up * width / 2 * style.rise
        faces.add(eaves[3], sides[3], ridge - eaves[0], tiles, both=True)
        faces.add(eaves[1], sides[1], ridge - eaves[1], tiles, both=True)
    elif style.roof == "eaves":
        ridge = (eaves[0] + eaves[3]) / 2 + up * depth / 2 * style.rise
        faces.add(eaves[0], sides[0], ridge - eaves[0], tiles, both=True)
        faces.add(eaves[2], sides[2], ridge - eaves[3], tiles, both=True)
    elif style.roof == "mansard":
        slope = up * MANSARD[0] - sides[3] / depth * MANSARD[1]
        faces.add(eaves[0], sides[0], slope, (paint_mansard, style, width, MANSARD_SLOPE))
        for wall in (1, 2, 3):
            faces.add(eaves[wall], sides[wall], up * MANSARD[0], tiles)
    if "chimney" in style.extras:
        across, inward = sides[0] / np.linalg.norm(sides[0]), -sides[3] / depth
        foot = eaves[0] + sides[0] * (0.1 if sum(style.seed) % 2 else 0.8) - sides[3] * 0.4
        ring = np.array([foot, foot + across * 0.8, foot + across * 0.8 + inward * 0.6, foot + inward * 0.6])
        top = up * (1.5 + (4.2 * style.rise if style.roof == "eaves" else 2.4))
        for corner, side in zip(ring, np.roll(ring, -1, axis=0) - ring, strict=True):
            faces.add(corner, side, top, (paint_plain, (124, 82, 66)))
    return faces


PAINTS = (
    (196, 198, 200), (30, 32, 36), (240, 240, 238), (128, 24, 28), (40, 62, 104), (98, 104, 108), (58, 84, 70),
    (178, 150, 92),
)  # fmt: skip
CAR_WIDTH = 1.74
# Outlines from front bumper over roof to rear bumper: a hatchback, a saloon and a van, in metres.
PROFILES: tuple[tuple[tuple[float, float], ...], ...] = (
    ((0.0, 0.35), (0.02, 0.75), (0.95, 0.98), (1.7, 1.44), (3.0, 1.47), (3.75, 1.02), (3.95, 0.6), (3.95, 0.35)),
    ((0.0, 0.35), (0.0, 0.68), (1.2, 0.92), (1.95, 1.38), (3.1, 1.38), (3.75, 0.98), (4.5, 0.9), (4.55, 0.35)),
    ((0.0, 0.35), (0.0, 0.9), (0.5, 1.15), (1.05, 1.9), (4.5, 1.95), (4.75, 1.0), (4.8, 0.6), (4.8, 0.35)),
)  # fmt: skip


def paint_car(profile: int, paint: int) -> Canvas:
    """A car's side: body, windows and wheels cut out along its profile."""
    outline = np.array(PROFILES[profile])
    canvas = Canvas(outline[:, 0].max() + 0.01, 2.0, PAINTS[paint], 96.0)
    across, up = canvas.grid()
    roof = np.interp(across, outline[1:-1, 0], outline[1:-1, 1])
    shade = 0.72 + 0.4 * np.clip((up - 0.3) / 0.7, 0, 1) - 0.25 * (np.abs(up - 0.62) < 0.03)
    canvas.rgb *= shade[..., None]
    # A van's windows begin higher, and only its front has any.
    waist = 0.93 if profile < 2 else 1.12
    glass = (up > waist) & (up < roof - 0.1) & (across > outline[2, 0] + 0.25)
    glass &= across < outline[5, 0] - 0.1 if profile < 2 else across < outline[3, 0] + 1.0
    canvas.rgb[glass] = (52, 62, 70)
    canvas.rgb[glass & (across + up * 0.6 > outline[3, 0] + 1.5)] = (74, 86, 96)
    for pillar in (outline[3, 0] + 0.62, outline[3, 0] + 0.66):
        canvas.tone(pillar, 0.4, pillar + 0.05, roof.max() - 0.06, 0.55)
    canvas.kind[(up > roof) | (up < 0.24)] = HOLE
    for wheel in (0.75, canvas.width - 0.8):
        away = np.hypot(across - wheel, up - 0.31)
        canvas.rgb[away < 0.38] = (18, 18, 20)
        canvas.kind[away < 0.31] = MATTE
        canvas.rgb[away < 0.2] = (150, 152, 156)
        canvas.rgb[(away < 0.17) & (np.sin(np.arctan2(up - 0.31, across - wheel) * 5) > 0.2)] = (60, 60, 64)
    canvas.rect(0.0, 0.6, 0.14, 0.74, (236, 232, 214))
    canvas.rect(canvas.width - 0.14, 0.66, canvas.width, 0.86, (150, 26, 24))
    return canvas


def paint_car_part(paint: int, part: str) -> Canvas:
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
    return canvas


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
    faces.add(nose + left * CAR_WIDTH / 2, -way * length, rise, (paint_car, profile, paint), both=True)
    faces.add(nose - left * CAR_WIDTH / 2, -way * length, rise, (paint_car, profile, paint), both=True)
    # From bumper to bumper; a saloon has a boot between its rear window and its rear.
    parts = ("front", "body", "glass", "body", "glass", "body" if profile == 1 else "rear", "rear")
    for part, start, stop in zip(parts, outline[:-1], outline[1:], strict=True):
        first, second = (nose - way * place + np.array([0, 0, up]) for place, up in (start, stop))
        corner = first - left * CAR_WIDTH / 2
        faces.add(corner, left * CAR_WIDTH, second - first, (paint_car_part, paint, part), both=True)
    return faces
