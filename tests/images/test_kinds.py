"""What is whole and not read here is called what it is; what is damaged is called damaged."""

from __future__ import annotations

import errno
import io
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from salad.errors import PhotoError
from salad.images.decode import open_rgb
from salad.images.finding import find_photos
from salad.images.kinds import not_read_here
from salad.images.workers import Workers


def refused(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(PhotoError) as caught:
        open_rgb(path)
    return str(caught.value).removeprefix(f"{path} ")


def tiff(packing: int = 1, bits: tuple[int, ...] = (8,), numbers: int = 1) -> bytes:
    """A TIFF of 8 x 6 pixels that is packed so; its pixels are whatever they are."""
    pixels, size = b"\1" * 2000, len(bits)
    entries = [(256, 3, 1, 8), (257, 3, 1, 6), (259, 3, 1, packing), (262, 3, 1, 2 if size > 2 else 1)]
    entries += [(273, 4, 1, 400), (277, 3, 1, size), (278, 3, 1, 6), (279, 4, 1, len(pixels)), (339, 3, 1, numbers)]
    entries.append((258, 3, size, bits[0] if size == 1 else 300))
    entries.sort()
    head = b"II*\0" + struct.pack("<LH", 8, len(entries))
    head += b"".join(struct.pack("<HHLL", *entry) for entry in entries) + struct.pack("<L", 0)
    return head.ljust(300, b"\0") + struct.pack(f"<{size}H", *bits).ljust(100, b"\0") + pixels


def jpeg(marker: int = 0xC0, bits: int = 8) -> bytes:
    """A JPEG whose picture says that it is of that kind and depth."""
    file = io.BytesIO()
    Image.effect_noise((40, 30), 40).convert("RGB").save(file, "JPEG")
    data = bytearray(file.getvalue())
    at = data.index(b"\xff\xc0")
    data[at + 1], data[at + 4] = marker, bits
    return bytes(data)


PACKED = [
    (tiff(packing=50001, bits=(8, 8, 8)), "WebP within TIFF"),
    (tiff(packing=34712, bits=(8, 8, 8)), "JPEG 2000 within TIFF"),
    (tiff(packing=50002, bits=(8, 8, 8)), "JPEG XL within TIFF"),
    (tiff(packing=34887), "TIFF of packing 34887"),
    (tiff(bits=(32, 32, 32), numbers=3), "TIFF of 3 x 32 bits"),
    (tiff(bits=(64,), numbers=3), "TIFF of 1 x 64 bits"),
    (tiff(bits=(16,), numbers=3), "TIFF of 1 x 16 bits"),
    (tiff(bits=(8,) * 6), "TIFF of 6 channels"),
    (jpeg(bits=12), "JPEG of 12 bits"),
    (jpeg(marker=0xC7), "a JPEG of another kind than photos have"),
]


@pytest.mark.parametrize(("data", "how"), PACKED, ids=[how for _, how in PACKED])
def test_what_is_packed_otherwise_is_not_called_damaged(
    tmp_path: Path, data: bytes, how: str, capfd: pytest.CaptureFixture[str]
) -> None:
    said = refused(tmp_path / "a.tif", data)
    assert said == f"is packed in a way not read here ({how}): save it as JPEG or PNG, or leave it out"
    assert not capfd.readouterr().err  # where libtiff would speak for itself


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"\xff\x0a" + b"\x7f" * 50, "is JPEG XL, which is packed in a way not read here: save it as JPEG or PNG"),
        (b"\0\0\0\x0cJXL \r\n\x87\n" + b"\0" * 50, "is JPEG XL"),
        (b"<html><body>404</body></html>", "is a web page, not a photo: fetch it again"),
        (b"\xef\xbb\xbf\r\n  <!DOCTYPE HTML>\n<title>", "is a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:aa\n", "is a pointer of Git LFS"),
        (b"\0" * 20_000, "holds zeros in place of a photo"),
        (b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom" + b"\0" * 99, "is a film, not a photo"),
        (b"%PDF-1.7\n", "is a PDF"),
        (b"8BPS\0\1", "is a Photoshop document"),
        (b"PK\3\4" + b"\0" * 30, "is a ZIP archive"),
    ],
)
def test_what_is_no_photo_is_called_what_it_is(tmp_path: Path, data: bytes, says: str) -> None:
    said = refused(tmp_path / "a.jpg", data)
    assert says in said
    assert said.endswith("or leave it out")


@pytest.mark.parametrize("form", ["JPEG", "PNG", "TIFF", "GIF", "BMP", "WEBP"])
def test_what_is_damaged_is_called_that_in_plain_words(tmp_path: Path, form: str) -> None:
    file = io.BytesIO()
    pixels = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(file, form)
    whole = file.getvalue()
    said = refused(tmp_path / "a.jpg", whole[: len(whole) // 2])
    assert said.endswith("or leave it out")
    assert "is damaged or cut short: fetch it again" in said or "is not an image that can be read" in said


def test_a_packed_tiff_that_is_cut_is_damaged(tmp_path: Path) -> None:
    for packing in ("tiff_lzw", "tiff_deflate", "packbits", "jpeg", "zstd", "lzma", "group4"):
        file = io.BytesIO()
        mode = "1" if packing == "group4" else "RGB"
        Image.effect_noise((90, 90), 90).convert(mode).save(file, "TIFF", compression=packing)
        said = refused(tmp_path / "a.tif", file.getvalue()[:8] + b"\0" * 40 + file.getvalue()[48:])
        assert "packed" not in said


def test_sixteen_bits_a_colour_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(tiff(bits=(16, 16, 16)))
    assert open_rgb(tmp_path / "a.tif").size == (8, 6)


@pytest.mark.parametrize("number", [errno.EACCES, errno.EPERM])
@pytest.mark.parametrize("call", ["open", "stat"])
def test_what_may_not_be_read_is_said(tmp_path: Path, number: int, call: str, monkeypatch: pytest.MonkeyPatch) -> None:
    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")

    def forbid(path: object, *_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr(os, call, forbid)
    with pytest.raises(PhotoError) as caught:
        open_rgb(tmp_path / "a.png")
    monkeypatch.undo()
    assert str(caught.value) == f"{tmp_path / 'a.png'} may not be read: ask for permission, or leave it out"


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="whoever administrates may read everything")
def test_nor_by_a_worker(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
    (tmp_path / "a.png").chmod(0)
    with Workers(1) as workers, pytest.raises(PhotoError, match="may not be read: ask for permission"):
        workers.decode(tmp_path / "a.png", 4, 4, "box")


@pytest.mark.parametrize("suffix", [".hif", ".HEICS", ".avif", ".insp"])
def test_endings_that_cameras_and_telephones_use_are_photos(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"a{suffix}").write_bytes(jpeg())
    assert find_photos([tmp_path]) == [tmp_path / f"a{suffix}"]


def test_any_bytes_are_told_apart_without_a_word_of_python() -> None:
    chance = np.random.default_rng(0)
    for beginning in (
        b"",
        b"II*\0\x08\0\0\0",
        b"MM\0*\0\0\0\x08",
        b"\xff\xd8\xff",
        *(data[:300] for data, _ in PACKED),
    ):
        for _ in range(200):
            noise = bytearray(beginning + chance.bytes(int(chance.integers(0, 80))))
            if len(noise) > 12:
                noise[int(chance.integers(4, len(noise)))] = int(chance.integers(0, 256))
            assert isinstance(not_read_here(bytes(noise)), str)
