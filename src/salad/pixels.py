"""A photo's pixels: upright RGB whatever the file, its EXIF, JPEG written with a position."""

from __future__ import annotations

import io
from contextlib import nullcontext, suppress
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from salad.errors import ModelError, PhotoError
from salad.geo import GeoPoint
from salad.geotags import Position, from_exif, to_exif
from salad.imagefile import MAX_PIXELS, check_scans, existing, naming, opened, quiet_pillow
from salad.rgb import flat, upright
from salad.wholefile import write_whole

__all__ = ["MAX_PIXELS", "existing", "naming", "open_rgb", "read_exif", "save_jpeg", "squeeze"]

_SAMPLINGS = {
    "bilinear": Image.Resampling.BILINEAR,
    "bicubic": Image.Resampling.BICUBIC,
    "lanczos": Image.Resampling.LANCZOS,
    "box": Image.Resampling.BOX,
    "nearest": Image.Resampling.NEAREST,
}
_QUICK = ("JPEG", "MPO")  # formats that can be decoded smaller; HEIC's own small picture is another picture


def open_rgb(path: Path, *, at_least: tuple[int, int] | None = None) -> Image.Image:
    """The photo's pixels: upright, RGB, eight bits; what is transparent over white, deep grey scaled down.

    Args:
        path: the file.
        at_least: height and width that the caller will squeeze the photo to. A JPEG may then be decoded at a
            half, a quarter or an eighth of its size, never below twice that: 12 million pixels for 322 x 322
            three times as fast, after the squeeze about half a grey level from the full decoding (2.4 for the
            worst of 97 real photos, a noisy night). Not given: all pixels are decoded.

    Raises:
        PhotoError: where the file is missing, empty, truncated, not an image or has over `MAX_PIXELS` pixels.
    """
    path = existing(Path(path))
    with naming(path), path.open("rb") as file:
        if not path.stat().st_size:
            raise PhotoError(f"{path} is empty (0 bytes): fetch it again from where it came from")
        image = opened(path, file)
        check_scans(path, file, image)
        if at_least is not None and image.format in _QUICK:
            side = max(at_least) * 2  # both ways, since the photo may yet be turned
            image.draft("RGB", (side, side))
        complains = image.format == "TIFF"  # no other format warns while it decodes
        with quiet_pillow() if complains else nullcontext():
            image.load()
        return upright(image)


def squeeze(image: Image.Image, height: int, width: int, resample: str = "bilinear") -> NDArray[np.uint8]:
    """The whole photo at another size, uncropped and antialiased: uint8 `[height, width, 3]`.

    Args:
        image: a photo of any size.
        height: in pixels, at least 1.
        width: in pixels, at least 1.
        resample: bilinear, bicubic, lanczos, box or nearest.

    Raises:
        ModelError: for a size or a resampling that there is not.
    """
    if resample not in _SAMPLINGS or height < 1 or width < 1:
        raise ModelError(
            f"a photo cannot be squeezed to {height} x {width} by {resample!r}: "
            f"give sides of at least 1 pixel and one of {', '.join(_SAMPLINGS)}"
        )
    return np.array(flat(image).resize((width, height), _SAMPLINGS[resample]), dtype=np.uint8)


def save_jpeg(
    image: Image.Image | NDArray[np.uint8],
    path: str | Path,
    *,
    where: GeoPoint | None = None,
    heading: float | None = None,
    time: datetime | None = None,
    quality: int = 90,
) -> None:
    """Write a photo as JPEG with its position, heading (to 0.01 degree) and time (to the second) as EXIF.

    Args:
        image: a photo, or uint8 `[H, W, 3]`.
        path: the file; it is replaced whole or not at all.
        where: written to a millionth of a second of arc, 0.03 mm.
        heading: degrees clockwise from north.
        time: its time zone is written where it has one.
        quality: 1 to 95.

    Raises:
        PhotoError: where the file cannot be written.
    """
    path = Path(path)
    rgb = flat(image if isinstance(image, Image.Image) else Image.fromarray(image))
    buffer = io.BytesIO()
    try:
        rgb.save(buffer, "JPEG", quality=quality, exif=to_exif(Position(where, heading, time)))
        write_whole(path, buffer.getvalue())
    except OSError as error:
        raise PhotoError(f"{path} cannot be written ({error}): check the folder and the size") from error


def read_exif(path: Path) -> Position:
    """What a photo's EXIF says; nothing where the file is broken, as `open_rgb` will say in a sentence."""
    with suppress(Exception), path.open("rb") as file:
        image = opened(path, file)
        with quiet_pillow():
            # Image's own getexif, because PNG's would decode the pixels in search of more
            return from_exif(Image.Image.getexif(image))
    return Position()
