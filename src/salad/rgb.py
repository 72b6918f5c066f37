"""Any picture as upright RGB of eight bits, in bands, so that nothing is held three times over."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.ExifTags import Base

from salad.imagefile import quiet_pillow

_BAND = 1_000_000  # pixels converted at a time
_TURNS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}


def upright(image: Image.Image) -> Image.Image:
    """RGB, turned as the image's EXIF asks; the image itself is used up."""
    turn = _turn(image)
    rgb = flat(image)
    if rgb is not image:
        image.close()
    if turn is not None:
        rgb = rgb.transpose(turn)
    elif rgb is image:
        rgb = image.copy()  # a plain image, without the file it came from
    rgb.info = {}  # its EXIF would turn it a second time
    return rgb


def flat(image: Image.Image) -> Image.Image:
    """RGB of eight bits: what is transparent over white, deep grey scaled down; RGB is handed back as it is."""
    if image.mode == "RGB" and not image.has_transparency_data:
        return image
    top = _top(image) if _is_deep(image) else 0.0
    rgb = Image.new("RGB", image.size)
    for band in _bands(image.size):
        part = image.crop(band)
        rgb.paste(_from_deep(part, top) if top else _over_white(part), band)
    return rgb


def _turn(image: Image.Image) -> Image.Transpose | None:
    with quiet_pillow(), suppress(Exception):  # a broken EXIF says nothing
        return _TURNS.get(image.getexif().get(Base.Orientation, 1))
    return None


def _bands(size: tuple[int, int]) -> Iterator[tuple[int, int, int, int]]:
    width, height = size
    rows = max(1, _BAND // width)
    for low in range(0, height, rows):
        yield 0, low, width, min(low + rows, height)


def _over_white(image: Image.Image) -> Image.Image:
    if image.mode == "LAB":  # which Pillow converts by profiles only
        return _from_lab(image)
    if not image.has_transparency_data:
        return image.convert("RGB")
    seen = image.convert("RGBA")
    return Image.alpha_composite(Image.new("RGBA", seen.size, "white"), seen).convert("RGB")


def _from_lab(image: Image.Image) -> Image.Image:
    from PIL import ImageCms

    lab, srgb = ImageCms.createProfile("LAB"), ImageCms.createProfile("sRGB")
    converted = ImageCms.profileToProfile(image, lab, srgb, outputMode="RGB")
    assert converted is not None
    return converted


def _is_deep(image: Image.Image) -> bool:
    """Whether it is grey of 16 or 32 bits or of real numbers."""
    return image.mode == "F" or image.mode.startswith("I")


def _top(image: Image.Image) -> float:
    """The top of the range that deep grey is kept in."""
    brightest = max(float(_values(image.crop(band)).max()) for band in _bands(image.size))
    ranges = (1.0, 255.0, 65535.0) if image.mode == "F" else (65535.0,)
    return next((top for top in ranges if brightest <= top), brightest)


def _from_deep(image: Image.Image, top: float) -> Image.Image:
    grey = (np.clip(_values(image) / top, 0, 1) * 255 + 0.5).astype(np.uint8)
    return Image.fromarray(grey)


def _values(image: Image.Image) -> NDArray[np.float64]:
    return np.nan_to_num(np.asarray(image, dtype=np.float64), posinf=0.0, neginf=0.0)
