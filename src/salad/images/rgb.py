"""RGB of eight bits, whatever an image holds: what is transparent over white, deep grey by the range that it uses.

Grey of more than eight bits says nowhere what is black and what is white. Twelve bits of a camera lie in sixteen,
temperatures in a narrow band far from zero, heights in metres; shown by what the file could hold, all of them would be
nearly one colour, and nothing would be recognised in them.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

from PIL import Image

# numpy is brought in by what needs it: it is half of what a process takes to start that reads photos.
if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_BAND = 1_000_000  # pixels converted at a time
_SAMPLE = 1_000_000  # pixels by which a range is told, at most about twice as many
_WHITES = (255.0, 1023.0, 4095.0, 16383.0, 65535.0)  # brightest values of cameras, by how many bits they have
_CLIPPED = 0.001  # share of the pixels beyond either end of a range: dead and hot ones are far fewer
_SPREAD = 0.25  # share of what its bits can hold over which an image spreads that needs no stretching: fog has more
_NO_DATA = (-9999.0, -32767.0, -32768.0)  # what stands, by custom, where nothing was measured
_HUGE = 1e19  # beyond anything measured, as the other customs for no data are: 1e20, and the largest of all numbers
_GDAL_NODATA = 42113  # tag of a TIFF: the value where nothing was measured, as text


def to_rgb(image: Image.Image) -> Image.Image:
    """RGB of eight bits: what is transparent over white, deep grey by its range; RGB is handed back as it is."""
    if image.mode == "RGB" and not image.has_transparency_data:
        return image
    deep = is_deep_grey(image)
    if deep:
        nothing = _no_data(image)
        black, white = _range(image, nothing)
    rgb = Image.new("RGB", image.size)
    for band in _bands(image.size):  # so that nothing is held three times over
        part = image.crop(band)
        rgb.paste(_eight_bits(part, black, white, nothing) if deep else _over_white(part), band)
    return rgb


def is_deep_grey(image: Image.Image) -> bool:
    """Whether a pixel is a grey of 16 or 32 bits, or a real number."""
    return image.mode == "F" or image.mode.startswith("I")


def _bands(size: tuple[int, int]) -> Iterator[tuple[int, int, int, int]]:
    width, height = size
    rows = max(1, _BAND // width)
    for low in range(0, height, rows):
        yield 0, low, width, min(low + rows, height)


def _over_white(image: Image.Image) -> Image.Image:
    if image.mode == "LAB":  # which Pillow converts by profiles only
        from PIL import ImageCms

        lab, srgb = ImageCms.createProfile("LAB"), ImageCms.createProfile("sRGB")
        converted = ImageCms.profileToProfile(image, lab, srgb, outputMode="RGB")
        assert converted is not None
        return converted
    if not image.has_transparency_data:
        return image.convert("RGB")
    seen = image.convert("RGBA")
    return Image.alpha_composite(Image.new("RGBA", seen.size, "white"), seen).convert("RGB")


# --- deep grey -----------------------------------------------------------------------------


def _range(image: Image.Image, nothing: list[float]) -> tuple[float, float]:
    """Which values become black and white.

    An image that spreads over a quarter of what so many bits can hold is shown as it is, from zero to the most they
    hold: it then looks as its copy of eight bits does, be that bright or dull. Any other has its own range stretched.
    """
    import numpy as np

    step = max(1, image.width * image.height // _SAMPLE)
    sampled = [_values(image.crop(band)).ravel()[::step] for band in _bands(image.size)]
    values = np.concatenate(sampled)
    values = values[_is_measured(values, nothing)]
    if not values.size:
        return 0.0, 1.0
    # Of the values that there are, so that of a few pixels all count.
    low = float(np.quantile(values, _CLIPPED, method="lower"))
    high = float(np.quantile(values, 1 - _CLIPPED, method="higher"))
    whites = (1.0, *_WHITES) if image.mode == "F" else _WHITES
    white = next((white for white in whites if high <= white), None)
    if low >= 0 and white is not None and (high - low >= white * _SPREAD or low == high):
        return 0.0, white
    return (low, high) if low < high else (min(low, 0.0), max(high, 1.0))


def _eight_bits(image: Image.Image, black: float, white: float, nothing: list[float]) -> Image.Image:
    """Grey from black to white; black as well where nothing was measured."""
    import numpy as np

    values = _values(image)
    values[~_is_measured(values, nothing)] = black
    return Image.fromarray((np.clip((values - black) / (white - black), 0, 1) * 255 + 0.5).astype(np.uint8))


def _is_measured(values: NDArray[np.float64], nothing: list[float]) -> NDArray[np.bool_]:
    import numpy as np

    measured = np.abs(values) < _HUGE  # neither is what is no number
    for value in nothing:
        measured &= values != value
    return measured


def _no_data(image: Image.Image) -> list[float]:
    """The values that stand where nothing was measured: those of custom, and what a TIFF says itself."""
    said = getattr(image, "tag_v2", {}).get(_GDAL_NODATA)
    with suppress(ValueError, OverflowError, struct.error):  # absent, or no number
        value = float(str(said).strip(" \0"))
        return [*_NO_DATA, value, *struct.unpack("f", struct.pack("f", value))]  # as the pixels can hold it
    return list(_NO_DATA)


def _values(image: Image.Image) -> NDArray[np.float64]:
    import numpy as np

    return np.array(image, dtype=np.float64)
