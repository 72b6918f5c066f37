"""What a file is that is whole and yet not read here: told apart from one that is damaged, which to fetch again helps.

Only asked once a decoder has given up, so that no photo is refused for what it looks like.
"""

from __future__ import annotations

from salad.files import is_web_page
from salad.images import jpeg, tiff

_PACKED = "packed in a way not read here"
_CONVERT = "save it as JPEG or PNG, or leave it out"
_FETCH = "fetch it again from where it came from, or leave it out"
_BEGINNINGS = {  # what a file begins with: what it is, and what to do about it
    b"\xff\x0a": (f"JPEG XL, which is {_PACKED}", _CONVERT),
    b"\0\0\0\x0cJXL \r\n": (f"JPEG XL, which is {_PACKED}", _CONVERT),
    b"version https://git-lfs": ("a pointer of Git LFS, not the photo itself", "run git lfs pull, or leave it out"),
    b"%PDF-": ("a PDF", _CONVERT),
    b"8BPS": ("a Photoshop document", _CONVERT),
    b"PK\x03\x04": ("a ZIP archive", "unpack it, or leave it out"),
}
_FILMS = (b"isom", b"iso2", b"mp41", b"mp42", b"avc1", b"qt  ", b"M4V ", b"3gp4", b"3gp5")
_ZEROS = 1 << 16  # bytes at a file's beginning that are looked at for anything but zeros

_USUAL_FRAMES = (0xC0, 0xC1, 0xC2)
_DEEP_FRAMES = (12, 16)  # bits of a channel that a JPEG may have beside eight
_TIFF_NAMES = {6: "JPEG of the old kind", 34712: "JPEG 2000", 34892: "JPEG", 50001: "WebP", 50002: "JPEG XL"}
_TIFF_USUAL = (1, 2, 3, 4, 5, 7, 8, 32773, 32946, 34925, 50000)
_TIFF_BITS = {1: (1, 2, 4, 8, 16, 32), 2: (8, 16, 32), 3: (32,)}  # whole numbers, those with a sign, real ones
_TIFF_SAMPLES = 4  # channels at most


def not_read_here(data: bytes) -> str:
    """What a file is and what to do with it, as what follows its name in a sentence; empty where it is but damaged."""
    for beginning, (what, advice) in _BEGINNINGS.items():
        if data.startswith(beginning):
            return f"is {what}: {advice}"
    if is_web_page(data):
        return f"is a web page, not a photo: {_FETCH}"
    if data[4:8] == b"ftyp" and data[8:12] in _FILMS:
        return "is a film, not a photo: save a picture of it as JPEG, or leave it out"
    if len(data) > 8 and not data[:_ZEROS].strip(b"\0"):
        return f"holds zeros in place of a photo: {_FETCH}"
    how = _jpeg(data) or _tiff(data)
    return f"is {_PACKED} ({how}): {_CONVERT}" if how else ""


def _jpeg(data: bytes) -> str:
    frame = jpeg.frame(data) if data.startswith(b"\xff\xd8") else None
    if frame is None:
        return ""
    if frame.bits in _DEEP_FRAMES:
        return f"JPEG of {frame.bits} bits"
    return "" if frame.kind in _USUAL_FRAMES else "a JPEG of another kind than photos have"


def _tiff(data: bytes) -> str:
    tags = next(iter(tiff.directories(data)), {})
    packing, bits = (tags.get(tiff.COMPRESSION) or (1,))[0], tags.get(tiff.BITS) or (1,)
    if packing not in _TIFF_USUAL:
        return f"{_TIFF_NAMES[packing]} within TIFF" if packing in _TIFF_NAMES else f"TIFF of packing {packing}"
    numbers = (tags.get(tiff.SAMPLE_FORMAT) or (1,))[0]
    if len(bits) > _TIFF_SAMPLES:
        return f"TIFF of {len(bits)} channels"
    if set(bits) - set(_TIFF_BITS.get(numbers, ())) or (len(bits) > 1 and max(bits) > 16):
        return f"TIFF of {len(bits)} x {max(bits)} bits"
    return ""
