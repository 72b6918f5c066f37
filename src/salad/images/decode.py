"""A photo's pixels: upright RGB whatever the file, its EXIF, JPEG written with a position."""

from __future__ import annotations

import importlib
import io
import re
import stat
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from datetime import datetime
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.ExifTags import Base

from salad.errors import MissingExtraError, ModelError, PhotoError
from salad.files import write_whole
from salad.geo import GeoPoint
from salad.images.metadata import Position, from_exif, to_exif

# --- A photo's file as Pillow opens it: which formats, how large, and a sentence for whatever goes wrong ---
#
# A file says how large its picture is before any of it is decoded; what is too large is refused there, before
# memory is taken. Only formats of photos are opened: no vector graphics, nothing that runs a program.


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


# --- Any picture as upright RGB of eight bits, in bands, so that nothing is held three times over ---


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
