"""A photo's file and its pixels: upright RGB whatever the file, its EXIF, JPEG written with a position."""

from __future__ import annotations

import io
import stat
import threading
import uuid
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.ExifTags import Base

from salad.errors import ModelError, PhotoError
from salad.geo import GeoPoint
from salad.geotags import Position, from_exif, to_exif

MAX_PIXELS = 200_000_000
"""Largest photo that is opened; the largest telephone cameras make 199.8 million pixels."""

_FORMATS = ("JPEG", "MPO", "PNG", "WEBP", "TIFF", "BMP", "GIF", "PPM", "JPEG2000", "AVIF", "HEIF")
_SAMPLINGS = {
    "bilinear": Image.Resampling.BILINEAR,
    "bicubic": Image.Resampling.BICUBIC,
    "lanczos": Image.Resampling.LANCZOS,
    "box": Image.Resampling.BOX,
    "nearest": Image.Resampling.NEAREST,
}
_TURNS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
_PILLOW = threading.Lock()  # guards settings of the whole process that `_quiet_pillow` changes for a moment


def existing(path: Path) -> Path:
    """The path itself, where a file is there.

    Raises:
        PhotoError: where nothing is there, or a folder, or what is no file.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise PhotoError(f"there is no photo at {path} ({reason}): check the name") from error
    if stat.S_ISDIR(status.st_mode):
        raise PhotoError(f"{path} is a folder, not a photo: name a photo in it")
    if not stat.S_ISREG(status.st_mode):
        raise PhotoError(f"{path} is not a file: name a photo")
    return path


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
        with _quiet_pillow():
            image = Image.open(file, formats=_formats())
        if image.width * image.height > MAX_PIXELS:
            raise PhotoError(
                f"{path} has {image.width} x {image.height} pixels, over {MAX_PIXELS} in all: save it smaller"
            )
        if at_least is not None:
            side = max(at_least) * 2  # both ways, since the photo may yet be turned
            image.draft("RGB", (side, side))
        complains = image.format == "TIFF"  # no other format warns while it decodes
        with _quiet_pillow() if complains else nullcontext():
            image.load()
        return _upright(image)


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
    rgb = image if image.mode == "RGB" else _rgb(image)
    return np.array(rgb.resize((width, height), _SAMPLINGS[resample]), dtype=np.uint8)


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
    rgb = _rgb(image if isinstance(image, Image.Image) else Image.fromarray(image))
    buffer = io.BytesIO()
    part = path.with_name(f".{uuid.uuid4().hex}.part")
    try:
        rgb.save(buffer, "JPEG", quality=quality, exif=to_exif(Position(where, heading, time)))
        part.write_bytes(buffer.getvalue())
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise PhotoError(f"{path} cannot be written ({error}): check the folder and the size") from error


def read_exif(path: Path) -> Position:
    """What a photo's EXIF says; nothing where the file is broken, as `open_rgb` will say in a sentence."""
    # Image's own getexif, because PNG's would decode the pixels in search of more
    with suppress(Exception), path.open("rb") as file, _quiet_pillow():
        return from_exif(Image.Image.getexif(Image.open(file, formats=_formats())))
    return Position()


def _upright(image: Image.Image) -> Image.Image:
    turn = _turn(image)
    rgb = _rgb(image)
    rgb = rgb if turn is None else rgb.transpose(turn)
    rgb.info = {}  # its EXIF would turn it a second time
    return rgb


def _turn(image: Image.Image) -> Image.Transpose | None:
    with _quiet_pillow(), suppress(Exception):  # a broken EXIF says nothing
        return _TURNS.get(image.getexif().get(Base.Orientation, 1))
    return None


def _rgb(image: Image.Image) -> Image.Image:
    if image.mode == "F" or image.mode.startswith("I"):
        return _from_deep(image)
    if image.has_transparency_data:
        seen = image.convert("RGBA")
        return Image.alpha_composite(Image.new("RGBA", seen.size, "white"), seen).convert("RGB")
    return image.convert("RGB")


def _from_deep(image: Image.Image) -> Image.Image:
    """Grey of 16 or 32 bits or of real numbers, scaled to eight bits by the range it is kept in."""
    values = np.nan_to_num(np.asarray(image, dtype=np.float64), posinf=0.0, neginf=0.0)
    brightest = float(values.max())
    ranges = (1.0, 255.0, 65535.0) if image.mode == "F" else (65535.0,)
    top = next((top for top in ranges if brightest <= top), brightest)
    grey = (np.clip(values / top, 0, 1) * 255 + 0.5).astype(np.uint8)
    return Image.fromarray(grey).convert("RGB")


def _formats() -> list[str]:
    """The formats of photos that this Pillow reads: no vector graphics, nothing that runs a program."""
    Image.init()
    return [name for name in _FORMATS if name in Image.OPEN]


@contextmanager
def _quiet_pillow() -> Iterator[None]:
    """Pillow without warnings about EXIF and without its own limit of pixels, lower than `MAX_PIXELS`."""
    with _PILLOW, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS = limit


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn whatever is raised inside into a PhotoError that names the file."""
    try:
        yield
    except PhotoError:
        raise
    except UnidentifiedImageError as error:
        raise PhotoError(f"{path} is not an image that can be read: {_advice(path)}") from error
    except Exception as error:  # decoders raise anything at all on broken bytes
        raise PhotoError(
            f"{path} is damaged or cut short ({error}): fetch it again or leave it out"
        ) from error


def _advice(path: Path) -> str:
    with suppress(OSError), path.open("rb") as file:
        if file.read(12)[4:].startswith((b"ftyphei", b"ftyphev", b"ftypmif1", b"ftypmsf1")):
            return "it is HEIC, so save it as JPEG, or register pillow-heif's opener with Pillow"
    return "save it as JPEG or PNG, or leave it out"
