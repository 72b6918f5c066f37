"""What stands before the houses: trees, lamps, cars, and the small parts that stick out of a front."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salad.data.town.canvas import Canvas, noise
from salad.data.town.facade import front_height
from salad.data.town.plan import House
from salad.data.town.raster import LAMP, LEAF, MATTE, Faces, Texture

MANSARD = (2.5, 0.7)
"""How high a mansard roof rises and how far it leans back, in metres."""
MANSARD_SLOPE = float(np.hypot(*MANSARD))
LEAVES = ((72, 94, 46), (90, 106, 52), (58, 82, 50), (104, 112, 60), (82, 102, 66), (66, 80, 42))


def paint_tree(sort: int, variant: int) -> Texture:
    """A tree as seen from anywhere: 1 metre high and 0.8 wide, to be stretched."""
    rng = np.random.default_rng([sort, variant, 31])
    canvas = Canvas(0.8, 1.0, LEAVES[sort % len(LEAVES)], 320.0)
    canvas.kind[:] = 0
    across, up = canvas.grid()
    trunk = np.abs(across - 0.4 - 0.012 * np.sin(up * 9 + variant)) < 0.02 * (1.5 - up) + 0.012 * (up < 0.04)
    canvas.kind[trunk & (up < 0.7)] = MATTE
    canvas.rgb[trunk] = np.array([92, 78, 66]) * (0.75 + 0.5 * (across[trunk] > 0.4))[:, None]
    low, high = rng.uniform(0.26, 0.36), 0.97
    for _ in range(44):
        centre_up = rng.uniform(low + 0.08, high - 0.08)
        share = (centre_up - low) / (high - low)
        reach = 0.33 * np.sqrt(max(0.05, 1 - (2 * share - 0.9) ** 2)) if sort % 3 else 0.3 * (1.15 - share)
        centre = 0.4 + rng.uniform(-1, 1) * max(reach - 0.05, 0.02)
        _tuft(canvas, rng, centre, centre_up, rng.uniform(0.06, 0.1), 0.62 + 0.5 * share)
    return canvas.texture()


def _tuft(
    canvas: Canvas, rng: np.random.Generator, across: float, up: float, radius: float, light: float
) -> None:
    """A clump of leaves, bright above and dark below."""
    colour = canvas.rgb[0, 0] * rng.uniform(0.85, 1.15)
    angle, reach = rng.uniform(0, 2 * np.pi, 240), radius * np.sqrt(rng.random(240))
    x, y = across + reach * np.cos(angle), up + reach * np.sin(angle) * 0.8
    shade = light * (1.0 + 0.5 * (y - up) / radius) * rng.uniform(0.7, 1.3, 240)
    inside = (x > 0.03) & (x < 0.76) & (y > 0.05) & (y < 0.97)
    rows = ((canvas.height - y[inside]) * canvas.grain).astype(np.int64)
    columns = (x[inside] * canvas.grain).astype(np.int64)
    for down, aside in np.ndindex(3, 4):
        canvas.rgb[rows + down, columns + aside] = shade[inside, None] * colour
        canvas.kind[rows + down, columns + aside] = LEAF


def paint_lamp() -> Texture:
    """A street lamp, 5.2 m high and 0.8 m wide."""
    canvas = Canvas(0.8, 5.2, (44, 50, 50))
    canvas.kind[:] = 0
    canvas.rect(0.36, 0, 0.44, 4.4, (44, 52, 52), MATTE)
    canvas.rect(0.3, 0, 0.5, 0.9, (40, 46, 46), MATTE)
    canvas.rect(0.32, 4.4, 0.48, 4.46, (40, 46, 46), MATTE)
    canvas.rect(0.24, 4.46, 0.56, 5.0, (228, 222, 204), LAMP)
    for place in (0.24, 0.39, 0.53):
        canvas.rect(place, 4.46, place + 0.03, 5.0, (40, 46, 46), MATTE)
    canvas.rect(0.2, 5.0, 0.6, 5.08, (40, 46, 46), MATTE)
    canvas.rect(0.32, 5.08, 0.48, 5.18, (40, 46, 46), MATTE)
    return canvas.texture()


def paint_tiles(colour: tuple[int, int, int]) -> Texture:
    """Roof tiles, four metres square, repeating."""
    canvas = Canvas(4.0, 4.0, colour, 24.0)
    rows, columns = np.indices(canvas.kind.shape)
    shade = np.random.default_rng(sum(colour)).normal(1, 0.09, (16, 16))[
        rows // 6, (columns + rows // 6 % 2 * 3) // 6 % 16
    ]
    shade = shade * (0.84 + 0.05 * (rows % 6)) * (1 + 0.06 * noise(canvas.kind.shape, [sum(colour), 41]))
    canvas.rgb *= shade[..., None].astype(np.float32)
    return canvas.texture(fits=False)


def paint_stripes(colour: tuple[int, int, int], scallops: bool) -> Texture:
    """Awning cloth: white and coloured stripes, a metre square, perhaps with a scalloped lower edge."""
    canvas = Canvas(1.0, 1.0, colour, 32.0)
    across, up = canvas.grid()
    canvas.rgb[(across * 4) % 2 < 1] = (236, 230, 216)
    if scallops:
        canvas.kind[up < 0.5 * np.abs(np.sin(across * np.pi * 4))] = 0
    return canvas.texture(fits=False)


def paint_railing() -> Texture:
    """Iron bars, a metre square."""
    canvas = Canvas(1.0, 1.0, (34, 36, 40), 32.0)
    across, up = canvas.grid()
    canvas.kind[((across * 8) % 1 > 0.3) & (up > 0.12) & (up < 0.9)] = 0
    return canvas.texture(fits=False)


def paint_plain(colour: tuple[int, int, int]) -> Texture:
    """One colour, a metre square."""
    return Canvas(1.0, 1.0, colour, 8.0).texture(fits=False)


def paint_blade(text: str, colour: tuple[int, int, int]) -> Texture:
    """A sign that hangs out over the pavement, 0.9 by 0.7 m."""
    canvas = Canvas(0.9, 0.7, colour, 64.0)
    canvas.rect(0.03, 0.03, 0.87, 0.67, (240, 232, 212))
    canvas.rect(0.06, 0.06, 0.84, 0.64, colour)
    canvas.write(text, 0.1, 0.2, 0.8, 0.5, (244, 236, 214))
    return canvas.texture()


def front_faces(house: House, number: int, *, awning_out: bool) -> Faces:
    """What sticks out of a front: awning, hanging sign, balcony."""
    style, faces = house.style, Faces()
    start = np.array([*house.corners[0], 0.0])
    right = np.array([*((house.corners[1] - house.corners[0]) / house.width), 0.0])
    out, up = np.array([right[1], -right[0], 0.0]), np.array([0.0, 0.0, 1.0])
    if style.awning is not None:
        reach, drop = (1.3, 0.75) if awning_out else (0.35, 0.5)
        hinge = start + right * 0.25 + up * (style.ground - 0.98)
        edge = hinge + out * reach - up * drop
        wide = right * (house.width - 0.5)
        faces.add(edge, wide, hinge - edge, ("stripes", style.awning, False), both=True)
        faces.add(edge - up * 0.24, wide, up * 0.24, ("stripes", style.awning, True), both=True)
    if style.shop and "blade" in style.extras:
        pole = start + right * (house.width - 0.35) + up * (style.ground + 0.1)
        faces.add(pole + out * 0.1, out * 0.9, up * 0.7, ("blade", style.shop, style.accent), both=True)
    if "balcony" in style.extras and style.storeys > 2:
        floor = style.ground + style.storey * ((number % (style.storeys - 1)) if style.storeys > 3 else 0)
        low, wide = start + right * house.width * 0.2 + up * floor, right * house.width * 0.6
        faces.add(low + out * 0.9, wide, -out * 0.9, ("plain", style.trim), both=True)
        faces.add(low + out * 0.9 - up * 0.14, wide, up * 0.16, ("plain", style.trim), both=True)
        faces.add(low + out * 0.9, wide, up * 0.95, ("railing",), both=True)
        for side in (low, low + wide):
            faces.add(side, out * 0.9, up * 0.95, ("railing",), both=True)
    return faces


def house_faces(house: House, number: int) -> Faces:
    """Walls, roof and chimneys."""
    style, faces = house.style, Faces()
    low = np.concatenate([house.corners, np.zeros((4, 1))], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    depth = float(np.linalg.norm(house.corners[3] - house.corners[0]))
    faces.add(low[0], low[1] - low[0], up * front_height(style, house.width), ("front", number))
    for wall in (1, 2, 3):
        gable = style.roof == "eaves" and wall != 2
        height = style.eaves + (depth / 2 * style.rise if gable else 0.0)
        faces.add(low[wall], low[(wall + 1) % 4] - low[wall], up * height, ("side", number, wall))
    eaves = low + up * style.eaves
    if style.roof in ("gable", "stepped"):
        rise = up * house.width / 2 * style.rise
        ridge = (eaves[0] + eaves[1]) / 2 + rise
        faces.add(eaves[3], eaves[0] - eaves[3], ridge - eaves[0], ("tiles", style.tiles), both=True)
        faces.add(eaves[1], eaves[2] - eaves[1], ridge - eaves[1], ("tiles", style.tiles), both=True)
    elif style.roof == "eaves":
        ridge = (eaves[0] + eaves[3]) / 2 + up * depth / 2 * style.rise
        faces.add(eaves[0], eaves[1] - eaves[0], ridge - eaves[0], ("tiles", style.tiles), both=True)
        faces.add(eaves[2], eaves[3] - eaves[2], ridge - eaves[3], ("tiles", style.tiles), both=True)
    elif style.roof == "mansard":
        inward = (low[3] - low[0]) / depth
        faces.add(eaves[0], eaves[1] - eaves[0], up * MANSARD[0] + inward * MANSARD[1], ("mansard", number))
        for wall in (1, 2, 3):
            faces.add(
                eaves[wall], eaves[(wall + 1) % 4] - eaves[wall], up * MANSARD[0], ("tiles", style.tiles)
            )
    if "chimney" in style.extras:
        faces.extend(_chimney(house, low, style.eaves))
    return faces


def _chimney(house: House, low: NDArray[np.float64], height: float) -> Faces:
    faces, style = Faces(), house.style
    across = (low[1] - low[0]) / np.linalg.norm(low[1] - low[0])
    inward = (low[3] - low[0]) / np.linalg.norm(low[3] - low[0])
    share = 0.1 if sum(style.seed) % 2 else 0.8
    foot = low[0] + (low[1] - low[0]) * share + (low[3] - low[0]) * 0.4 + np.array([0, 0, height])
    top = np.array([0, 0, 1.5 + (4.2 * style.rise if style.roof == "eaves" else 2.4)])
    corners = [foot, foot + across * 0.8, foot + across * 0.8 + inward * 0.6, foot + inward * 0.6]
    for number in range(4):
        faces.add(corners[number], corners[(number + 1) % 4] - corners[number], top, ("plain", (124, 82, 66)))
    return faces
