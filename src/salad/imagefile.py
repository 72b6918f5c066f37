"""A photo's file as Pillow opens it: which formats, how large, and a sentence for whatever goes wrong.

A file says how large its picture is before any of it is decoded; what is too large is refused there, before
memory is taken. Only formats of photos are opened: no vector graphics, nothing that runs a program.
"""

from __future__ import annotations

import importlib
import re
import stat
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from PIL import Image, UnidentifiedImageError

from salad.errors import MissingExtraError, PhotoError

MAX_PIXELS = 200_000_000
"""Largest photo that is opened; the largest telephone cameras make 199.8 million pixels.

Decoded whole, one of that size takes 1.7 GB (about 8 bytes a pixel, measured; HEIC 9, AVIF 11), so that one
photo never takes much over 2 GB."""
MAX_SIDE = 1_000_000
"""Longest side that is opened: a picture one pixel high would take gigabytes to squeeze, not to decode."""
MAX_SCANS = 100
"""Passes over a progressive JPEG that are decoded: each costs time for every pixel, and a dozen is usual."""

_FORMATS = ("JPEG", "MPO", "PNG", "WEBP", "TIFF", "BMP", "GIF", "PPM", "JPEG2000", "AVIF")
_COSTLY = ("WEBP", "JPEG2000")  # their decoders take 16 to 21 bytes a pixel, so half as many are opened
_HEIC = frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs", b"mif1", b"msf1"})
_AVIF = frozenset({b"avif", b"avis"})
_SCAN = b"\xff\xda"
_TILE_WIDTH, _TILE_HEIGHT = 322, 323
_PILLOW = threading.Lock()  # guards settings of the whole process that `quiet_pillow` changes for a moment


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


def opened(path: Path, file: IO[bytes]) -> Image.Image:
    """The image in a file, its size checked and none of its pixels decoded.

    Args:
        path: what sentences call it.
        file: the same file, open.

    Raises:
        PhotoError: where it is too large, or HEIC and the `heic` extra is missing.
        Exception: anything at all for a broken file, which `naming` turns into a PhotoError.
    """
    brands = _brands(file)
    try:
        with quiet_pillow():
            if brands & _HEIC and not brands & _AVIF:
                image: Image.Image = _heic(path, file)
            else:
                image = Image.open(file, formats=_formats())
    except Image.DecompressionBombError as error:  # refused by Pillow in the middle, so its size is not known
        raise PhotoError(f"{path} has {_first_number(error)} pixels, {_over('')}") from error
    _check_size(path, image)
    return image


def check_scans(path: Path, file: IO[bytes], image: Image.Image) -> None:
    """Make sure that a progressive JPEG does not go over its pixels again and again, for minutes.

    Raises:
        PhotoError: where it has over `MAX_SCANS` passes.
    """
    if not image.info.get("progressive"):
        return
    file.seek(0)
    scans = file.read().count(_SCAN)  # within pixels these two bytes never stand side by side
    if scans > MAX_SCANS:
        raise PhotoError(f"{path} has {scans} passes over its pixels, over {MAX_SCANS}: save it anew")


@contextmanager
def quiet_pillow() -> Iterator[None]:
    """Pillow without warnings about EXIF, and with our limit of pixels in place of its own lower one."""
    with _PILLOW, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        limit = Image.MAX_IMAGE_PIXELS
        Image.MAX_IMAGE_PIXELS = (MAX_PIXELS + 1) // 2  # it refuses what has over twice as many
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
        raise PhotoError(
            f"{path} is not an image that can be read: save it as JPEG or PNG, or leave it out"
        ) from error
    except MemoryError as error:
        raise PhotoError(
            f"{path} needs more memory than there is: save it smaller or leave it out"
        ) from error
    except Exception as error:  # decoders raise anything at all on broken bytes
        told = " ".join(str(error).split()) or type(error).__name__
        raise PhotoError(
            f"{path} is damaged or cut short ({told}): fetch it again or leave it out"
        ) from error


def _brands(file: IO[bytes]) -> set[bytes]:
    """What a file of the HEIC and AVIF family says it is; nothing for any other."""
    head = file.read(64)
    file.seek(0)
    if head[4:8] != b"ftyp":
        return set()
    end = min(int.from_bytes(head[:4], "big"), len(head))
    return {head[8:12], *(head[start : start + 4] for start in range(16, end, 4))}


def _heic(path: Path, file: IO[bytes]) -> Image.Image:
    try:
        heif: Any = importlib.import_module("pillow_heif")
    except ImportError as error:
        told = MissingExtraError("reading HEIC", "heic")
        raise PhotoError(f"{path} is HEIC: save it as JPEG, or install what reads it ({told})") from error
    image: Image.Image = heif.HeifImageFile(file)  # as its plugin would, with nothing registered
    return image


def _formats() -> list[str]:
    Image.init()
    return [name for name in _FORMATS if name in Image.OPEN]


def _check_size(path: Path, image: Image.Image) -> None:
    width, height = image.size
    if not width or not height:
        raise PhotoError(f"{path} has no pixels ({width} x {height}): fetch it again or leave it out")
    if width * height > _limit(image.format):
        raise PhotoError(f"{path} has {width} x {height} pixels, {_over(image.format)}")
    if max(width, height) > MAX_SIDE:
        raise PhotoError(f"{path} has {width} x {height} pixels, over {MAX_SIDE} on a side: cut it")
    tags = getattr(image, "tag_v2", {})  # a TIFF may have tiles far larger than itself, decoded whole
    if _number(tags.get(_TILE_WIDTH)) * _number(tags.get(_TILE_HEIGHT)) > MAX_PIXELS:
        raise PhotoError(f"{path} has tiles of over {MAX_PIXELS} pixels: save it anew")


def _limit(format_name: str | None) -> int:
    return MAX_PIXELS // 2 if format_name in _COSTLY else MAX_PIXELS


def _over(format_name: str | None) -> str:
    return f"over {_limit(format_name)} in all: save it smaller"


def _first_number(error: Exception) -> str:
    found = re.search(r"\d+", str(error))
    return found[0] if found else "too many"


def _number(value: object) -> int:
    return value if isinstance(value, int) else 0
