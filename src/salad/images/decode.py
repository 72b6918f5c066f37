"""The decoder of the house: a photo's file in, upright RGB out, the same bytes for whoever asks.

Only formats of photos are opened: no vector graphics, nothing that runs a program. A file says how large its picture
is before any of it is decoded, and what is too large is refused there, before memory is taken. Whatever goes wrong
is a `PhotoError` that names the file.
"""

from __future__ import annotations

import errno
import importlib
import io
import os
import re
import stat
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from io import BufferedReader
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from PIL import Image, ImageFile, ImageOps, UnidentifiedImageError

from salad.errors import MissingExtraError, ModelError, PhotoError, reason
from salad.files import open_file, read_file
from salad.images import jpeg
from salad.images.kinds import not_read_here
from salad.images.raw import embedded, is_raw
from salad.images.rgb import to_rgb

DECODER = 3
"""Version of what `decode` makes of a file; part of the name of whatever is kept of it (descriptors, tokens).

1 was every pixel decoded, except for `index` and `locate`; 2 was JPEGs reduced while they are decoded, for all; 3 is
deep grey shown by the range that it uses. It is no part of a model's fingerprint: few photos differ from one to the
next, and indexes were made with 2 from the beginning."""
LONGEST = 1 << 30
"""Bytes of the longest file that is read: the largest photos take 800 million without any compression."""
MAX_PIXELS = 200_000_000
"""Largest photo that is opened; the largest telephone cameras make 199.8 million pixels.

Decoded whole, one of that size takes 1.7 GB (about 8 bytes a pixel, measured; HEIC 9, AVIF 11), so that one
photo never takes much over 2 GB."""
MAX_SIDE = 1_000_000
"""Longest side that is opened: a picture one pixel high would take gigabytes to squeeze, not to decode."""

# numpy is brought in by what needs it: it is half of what a process takes to start that reads photos.
if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Pixels = NDArray[np.uint8]


def __getattr__(name: str) -> Any:
    """`Pixels`, for those who import it when numpy is there."""
    if name != "Pixels":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import numpy as np
    from numpy.typing import NDArray

    return NDArray[np.uint8]


_FORMATS = ("JPEG", "MPO", "PNG", "WEBP", "TIFF", "BMP", "GIF", "PPM", "JPEG2000", "AVIF")
_PLUGINS = {"WEBP": "WebP", "JPEG2000": "Jpeg2K"}  # modules of Pillow that are not called after their format
_COSTLY = ("WEBP", "JPEG2000")  # their decoders take 16 to 21 bytes a pixel, so half as many are opened
_REDUCED = ("JPEG", "MPO")  # formats that can be decoded smaller; HEIC's own small picture is another picture
_HEIC = frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs", b"mif1", b"msf1"})
_AVIF = frozenset({b"avif", b"avis"})
_TILE_WIDTH, _TILE_HEIGHT = 322, 323  # tags of a TIFF
_ORIENTATION = 0x0112  # a tag of EXIF
_FORBIDDEN = (errno.EACCES, errno.EPERM)
_RESAMPLINGS = {
    "bilinear": Image.Resampling.BILINEAR,
    "bicubic": Image.Resampling.BICUBIC,
    "lanczos": Image.Resampling.LANCZOS,
    "box": Image.Resampling.BOX,
    "nearest": Image.Resampling.NEAREST,
}
_PILLOW = threading.Lock()  # guards settings of the whole process that `quiet_pillow` changes for a moment


# --- from a file to pixels -----------------------------------------------------------------


def decode(
    path: Path,
    height: int,
    width: int,
    resample: str = "bilinear",
    *,
    file: IO[bytes] | None = None,
    grant: Callable[[float], None] | None = None,
) -> Pixels:
    """A photo as every model sees it: upright, RGB, the whole of it squeezed to one size.

    Training, evaluation, the index and its queries all come here. A JPEG is decoded at a half, a quarter or an
    eighth of its size where that is still twice what is asked for: 12 million pixels for 322 x 322 in a third of the
    time. That moves a descriptor less than saving the JPEG at another quality does (cosine 0.998 to the full
    decoding, where quality 80 in place of 90 makes 0.995); so it must be the same for all who compare descriptors.

    Args:
        path: The file.
        height: In pixels, at least 1.
        width: In pixels, at least 1.
        resample: bilinear, bicubic, lanczos, box or nearest.
        file: The same file where it is held in memory already; read from its beginning.
        grant: Called before pixels are decoded, with how large the photo is: 0 to 1, the largest that is opened.
            Whoever holds the decoder to a time and to memory may then allow it as much as that takes.

    Returns:
        uint8 `[height, width, 3]`.

    Raises:
        PhotoError: If the file is missing, empty, truncated, not an image or has over `MAX_PIXELS` pixels.
        ModelError: If there is no such size or resampling.
    """
    return as_pixels(small(path, height, width, resample, file=file, grant=grant))


def small(
    path: Path,
    height: int,
    width: int,
    resample: str = "bilinear",
    *,
    file: IO[bytes] | None = None,
    grant: Callable[[float], None] | None = None,
) -> Image.Image:
    """As `decode`, before its pixels are an array.

    Raises:
        PhotoError: As `decode`.
        ModelError: As `decode`.
    """
    return _squeezed(_load(path, file, at_least=(height, width), grant=grant), height, width, resample)


def open_rgb(
    path: Path,
    *,
    at_least: tuple[int, int] | None = None,
    file: IO[bytes] | None = None,
    grant: Callable[[float], None] | None = None,
) -> Image.Image:
    """A photo to be shown to people: upright, RGB, eight bits; for a model's eyes there is `decode`.

    Args:
        path: The file.
        at_least: Height and width that the caller will squeeze the photo to. A JPEG may then be decoded at a half, a
            quarter or an eighth of its size, never below twice that. Not given: all pixels are decoded.
        file: The same file where it is held in memory already; read from its beginning.
        grant: As `decode`.

    Raises:
        PhotoError: If the file is missing, empty, truncated, not an image or has over `MAX_PIXELS` pixels.
    """
    rgb = _load(path, file, at_least=at_least, grant=grant)
    if isinstance(rgb, ImageFile.ImageFile):
        rgb = rgb.copy()  # a plain image, without the file it came from
    rgb.info = {}  # its EXIF would turn it a second time
    return rgb


def _load(
    path: Path,
    file: IO[bytes] | None,
    *,
    at_least: tuple[int, int] | None,
    grant: Callable[[float], None] | None = None,
) -> Image.Image:
    path = Path(path)
    source = in_memory(path) if file is None else file
    with naming(path, source):
        turned = None
        data = _all(source)
        if is_raw(path, data):
            picture = embedded(path, data)
            source, turned = io.BytesIO(picture.data), picture.orientation
        image = _decoded(path, source, at_least, grant)
        if turned is not None and _ORIENTATION not in (exif := image.getexif()):
            exif[_ORIENTATION] = turned
        try:
            # Turned before it is converted, and in place: at no time are there more than two copies of it.
            with quiet_pillow():
                ImageOps.exif_transpose(image, in_place=True)
        except MemoryError:
            raise
        except Exception:  # a broken EXIF may raise anything at all; it then says nothing
            pass
        rgb = to_rgb(image)
        if rgb is not image:
            image.close()
        return rgb


def _decoded(
    path: Path, source: IO[bytes], at_least: tuple[int, int] | None, grant: Callable[[float], None] | None
) -> Image.Image:
    """The image as the file has it, its pixels in memory."""
    image = open_image(path, source)
    if grant is not None:
        grant(image.width * image.height / _most_pixels(image))
    data = _all(source)
    if image.info.get("progressive") and jpeg.has_too_many_scans(data):
        raise PhotoError(f"{path} has over {jpeg.MAX_SCANS} passes over its pixels: save it anew")
    if at_least is not None and image.format in _REDUCED:
        side = max(at_least) * 2  # both ways, since the photo may yet be turned
        image.draft("RGB", (side, side))
    complains = image.format == "TIFF"  # no other format warns while it decodes
    if complains and image.info.get("compression") == "webp":  # of which libtiff would speak to the terminal itself
        raise UnidentifiedImageError
    try:
        with quiet_pillow() if complains else nullcontext():
            image.load()
    except OSError as error:
        cut = image.format in _REDUCED and str(error).startswith("image file is truncated")
        ended = jpeg.ended(data) if cut else None
        if ended is None:
            raise
        return _decoded(path, io.BytesIO(ended), at_least, grant)
    return image


def squeeze(image: Image.Image, height: int, width: int, resample: str = "bilinear") -> Pixels:
    """The whole photo at another size, uncropped and antialiased.

    Args:
        image: A photo of any size and mode.
        height: In pixels, at least 1.
        width: In pixels, at least 1.
        resample: bilinear, bicubic, lanczos, box or nearest.

    Returns:
        uint8 `[height, width, 3]`.

    Raises:
        ModelError: If there is no such size or resampling.
    """
    return as_pixels(_squeezed(image, height, width, resample))


def _squeezed(image: Image.Image, height: int, width: int, resample: str) -> Image.Image:
    if resample not in _RESAMPLINGS or height < 1 or width < 1:
        raise ModelError(
            f"a photo cannot be squeezed to {height} x {width} by {resample!r}: "
            f"give sides of at least 1 pixel and one of {', '.join(_RESAMPLINGS)}"
        )
    made = to_rgb(image).resize((width, height), _RESAMPLINGS[resample])
    made.info = {}  # neither EXIF nor profile is true of it any more
    return made


def as_pixels(image: Image.Image) -> Pixels:
    """The bytes of an image: uint8 `[height, width, 3]`."""
    import numpy as np

    return np.array(image, dtype=np.uint8)


# --- opening: which formats, how large, and a sentence for whatever goes wrong -------------


def in_memory(path: Path) -> io.BytesIO:
    """All of a photo's file, so that whatever is made of it is of the same bytes, whoever writes to it meanwhile.

    Raises:
        PhotoError: If there is no such file, it cannot be read, or is longer than `LONGEST`.
    """
    existing(path)
    with naming(path):
        return io.BytesIO(read_file(path, most=LONGEST))


def on_disk(path: Path) -> BufferedReader:
    """A photo's file, for whoever wants to know what its head says and nothing more.

    Raises:
        PhotoError: As `in_memory`.
    """
    existing(path)
    with naming(path):
        file = open_file(path)
        if os.fstat(file.fileno()).st_size > LONGEST:  # a head may say that it reaches to the end
            file.close()
            raise OSError(errno.EFBIG, f"it is longer than {LONGEST:,} bytes")
        return file


def existing(path: Path) -> Path:
    """The path itself, where a file is there.

    Raises:
        PhotoError: If nothing is there, or a folder, or what is no file.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.errno in _FORBIDDEN:  # a folder on the way
            raise _forbidden(path) from error
        raise PhotoError(f"there is no photo at {path} ({reason(error)}): check the name") from error
    if stat.S_ISDIR(status.st_mode):
        raise PhotoError(f"{path} is a folder, not a photo: name a photo in it")
    if not stat.S_ISREG(status.st_mode):
        raise PhotoError(f"{path} is not a file: name a photo")
    return path


@contextmanager
def naming(path: Path, file: IO[bytes] | None = None) -> Iterator[None]:
    """Turn whatever is raised inside into a PhotoError that names the file.

    Args:
        path: What sentences call it.
        file: The same file where it is held in memory: what it is that is no photo can then be said.
    """
    try:
        yield
    except PhotoError:
        raise
    except UnidentifiedImageError as error:
        said = _kind(file) or "is not an image that can be read: save it as JPEG or PNG, or leave it out"
        raise PhotoError(f"{path} {said}") from error
    except MemoryError as error:
        raise PhotoError(f"{path} needs more memory than there is: save it smaller or leave it out") from error
    except OSError as error:
        if error.errno is None or error.strerror is None:  # a decoder's word for bytes that make no sense
            raise _damaged(path, file) from error
        if error.errno in _FORBIDDEN:
            raise _forbidden(path) from error
        advice = "save it smaller" if error.errno == errno.EFBIG else "check the file"
        raise PhotoError(f"{path} cannot be read ({error.strerror}): {advice} or leave it out") from error
    except Exception as error:  # decoders raise anything at all on broken bytes
        raise _damaged(path, file) from error


def _damaged(path: Path, file: IO[bytes] | None) -> PhotoError:
    # What the decoder says of it is the error's cause, and no help to whoever has the photo.
    return PhotoError(f"{path} {_kind(file) or 'is damaged or cut short: fetch it again or leave it out'}")


def _kind(file: IO[bytes] | None) -> str:
    return "" if file is None else not_read_here(_all(file))


def _all(file: IO[bytes]) -> bytes:
    file.seek(0)
    return file.read()  # held in memory already: no copy


def _forbidden(path: Path) -> PhotoError:
    return PhotoError(f"{path} may not be read: ask for permission, or leave it out")


def open_image(path: Path, file: IO[bytes]) -> Image.Image:
    """The image in a file, its size checked and none of its pixels decoded.

    Args:
        path: What sentences call it.
        file: The same file, open; read from its beginning.

    Raises:
        PhotoError: If it is empty or too large, or HEIC and the `heic` extra is missing.
        Exception: Anything at all for a broken file, which `naming` turns into a PhotoError.
    """
    file.seek(0)
    head = file.read(64)
    file.seek(0)
    if not head:
        raise PhotoError(f"{path} is empty (0 bytes): fetch it again from where it came from")
    heif: Any = None
    brands: set[bytes] = set()
    if head[4:8] == b"ftyp":  # the family of HEIC and AVIF, each of whose files lists its brands
        end = min(int.from_bytes(head[:4], "big"), len(head))
        brands = {head[8:12], *(head[start : start + 4] for start in range(16, end, 4))}
    if brands & _HEIC and not brands & _AVIF:
        try:
            heif = importlib.import_module("pillow_heif")
        except ImportError as error:
            missing = MissingExtraError("reading HEIC", "heic")
            raise PhotoError(f"{path} is HEIC: save it as JPEG, or install what reads it ({missing})") from error
    try:
        with quiet_pillow():
            formats = _formats()
            # As pillow_heif's plugin would, but with nothing registered for others to stumble over.
            image = heif.HeifImageFile(file) if heif else Image.open(file, formats=formats)
    except Image.DecompressionBombError as error:
        # Refused by Pillow in the middle of a file, so that the number of pixels stands in its sentence alone.
        found = re.search(r"\d+", str(error))
        raise PhotoError(f"{path} has {found[0] if found else 'too many'} pixels, {_over(MAX_PIXELS)}") from error
    _check_size(path, image)
    return image


@cache
def _formats() -> list[str]:
    """Those of `_FORMATS` that this Pillow was built with."""
    for name in _FORMATS:  # by name: to load all of Pillow's formats takes longer than to decode a photo
        with suppress(ImportError):
            importlib.import_module(f"PIL.{_PLUGINS.get(name, name.title())}ImagePlugin")
    return [name for name in _FORMATS if name in Image.OPEN]


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


def _check_size(path: Path, image: Image.Image) -> None:
    width, height = image.size
    if not width or not height:
        raise PhotoError(f"{path} has no pixels ({width} x {height}): fetch it again or leave it out")
    limit = _most_pixels(image)
    if width * height > limit:
        raise PhotoError(f"{path} has {width} x {height} pixels, {_over(limit)}")
    if max(width, height) > MAX_SIDE:
        raise PhotoError(f"{path} has {width} x {height} pixels, over {MAX_SIDE} on a side: cut it")
    tags = getattr(image, "tag_v2", {})  # a TIFF may have tiles far larger than itself, decoded whole
    wide, high = tags.get(_TILE_WIDTH), tags.get(_TILE_HEIGHT)
    if isinstance(wide, int) and isinstance(high, int) and wide * high > MAX_PIXELS:
        raise PhotoError(f"{path} has tiles of over {MAX_PIXELS} pixels: save it anew")


def _most_pixels(image: Image.Image) -> int:
    return MAX_PIXELS // 2 if image.format in _COSTLY else MAX_PIXELS


def _over(limit: int) -> str:
    return f"over {limit} in all: save it smaller"
