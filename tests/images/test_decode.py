"""Upright RGB whatever the file, and a sentence where there is none."""

from __future__ import annotations

import io
import struct
import tempfile
import threading
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageOps

from salad.errors import ModelError, PhotoError
from salad.geo import GeoPoint
from salad.images import decode
from salad.images.decode import open_rgb, squeeze
from salad.images.exif import save_jpeg
from salad.images.photo import Photo, read_photo

RAMP = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5
COLOURS = np.stack([RAMP, RAMP[::-1], 255 - RAMP], axis=2)


def shown(path: Path, image: Image.Image, **how: object) -> np.ndarray:
    """What `open_rgb` makes of an image after it was saved."""
    image.save(path, **how)
    rgb = open_rgb(path)
    assert rgb.mode == "RGB"
    values: np.ndarray = np.asarray(rgb, dtype=np.int64)
    return values


def grey(values: np.ndarray) -> np.ndarray:
    return np.repeat(values.astype(int)[:, :, None], 3, axis=2)


def smooth(height: int, width: int) -> np.ndarray:
    """A picture with edges and gradients."""
    rows, columns = np.mgrid[0:height, 0:width]
    waves = [np.sin(rows / f + columns / g) for f, g in ((9, 31), (40, 7), (15, 15))]
    stripes = (columns // 37) % 2 * 40
    picture = np.stack(waves, axis=2) * 90 + 128 + stripes[:, :, None]
    return np.asarray(np.clip(picture, 0, 255).astype(np.uint8))


# --- upright RGB ---------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif"])
@pytest.mark.parametrize("orientation", [*range(1, 9), 0, 9, 65535])
def test_every_orientation_comes_out_upright(tmp_path: Path, orientation: int, suffix: str) -> None:
    stored = Image.fromarray(smooth(24, 40))
    exif = Image.Exif()
    exif[0x0112] = orientation
    stored.save(tmp_path / f"a{suffix}", exif=exif)
    with Image.open(tmp_path / f"a{suffix}") as image:
        expected = ImageOps.exif_transpose(image)
    rgb = open_rgb(tmp_path / f"a{suffix}")
    assert np.array_equal(np.asarray(rgb), np.asarray(expected))
    assert np.array_equal(np.asarray(ImageOps.exif_transpose(rgb)), np.asarray(rgb))  # not turned a second time


def test_an_upright_phone_photo_is_taller_than_wide(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    image = np.zeros((4, 8, 3), np.uint8)
    image[:, 0] = 255  # the camera lay on its side: its left edge is up
    Image.fromarray(image).save(tmp_path / "a.png", exif=exif)
    rgb = np.asarray(open_rgb(tmp_path / "a.png"))
    assert rgb.shape == (8, 4, 3)
    assert (rgb[0] == 255).all()
    assert not rgb[1:].any()


def test_colour_and_grey_stay_as_they_are(tmp_path: Path) -> None:
    assert np.array_equal(shown(tmp_path / "c.png", Image.fromarray(COLOURS)), COLOURS)
    assert np.array_equal(shown(tmp_path / "c.bmp", Image.fromarray(COLOURS)), COLOURS)
    assert np.array_equal(shown(tmp_path / "c.ppm", Image.fromarray(COLOURS)), COLOURS)
    assert np.array_equal(shown(tmp_path / "g.png", Image.fromarray(RAMP)), grey(RAMP))


def test_one_bit_is_black_and_white(tmp_path: Path) -> None:
    expected = grey((RAMP > 100) * 255)
    assert np.array_equal(shown(tmp_path / "1.png", Image.fromarray(RAMP > 100)), expected)
    assert np.array_equal(shown(tmp_path / "1.tif", Image.fromarray(RAMP > 100)), expected)


def test_palettes_show_their_colours(tmp_path: Path) -> None:
    palette = Image.new("P", (2, 1))
    palette.putpalette([10, 20, 30, 200, 210, 220])
    palette.putpixel((1, 0), 1)
    for name in ("p.png", "p.gif"):
        assert shown(tmp_path / name, palette).tolist() == [[[10, 20, 30], [200, 210, 220]]]
    clear = shown(tmp_path / "t.png", palette, transparency=bytes([255, 0]))
    assert clear.tolist() == [[[10, 20, 30], [255, 255, 255]]]
    assert shown(tmp_path / "one.png", palette, transparency=1).tolist() == clear.tolist()


def test_what_is_transparent_is_white(tmp_path: Path) -> None:
    rgba = np.dstack([COLOURS, np.full((6, 8), 255, np.uint8)])
    rgba[0, :, 3], rgba[1, :, 3] = 0, 128
    seen = shown(tmp_path / "a.png", Image.fromarray(rgba))
    assert (seen[0] == 255).all()
    assert np.abs(seen[1] - (COLOURS[1] * 128.0 + 255 * 127) / 255).max() <= 1
    assert np.array_equal(seen[2:], COLOURS[2:])

    layers = [Image.fromarray(RAMP), Image.fromarray(rgba[:, :, 3].copy())]
    seen = shown(tmp_path / "la.png", Image.merge("LA", layers))
    assert (seen[0] == 255).all()
    assert np.array_equal(seen[2:], grey(RAMP[2:]))


def test_a_grey_or_colour_named_transparent_is_white(tmp_path: Path) -> None:
    seen = shown(tmp_path / "l.png", Image.fromarray(RAMP), transparency=0)
    assert (seen[0, 0] == 255).all()
    assert np.array_equal(seen[1:], grey(RAMP[1:]))
    seen = shown(tmp_path / "rgb.png", Image.fromarray(COLOURS), transparency=tuple(COLOURS[0, 0].tolist()))
    assert (seen[0, 0] == 255).all()


def test_cmyk_comes_out_in_its_colours(tmp_path: Path) -> None:
    colour = np.full((16, 16, 3), (200, 60, 30), np.uint8)
    for name in ("c.jpg", "c.tif"):
        seen = shown(tmp_path / name, Image.fromarray(colour).convert("CMYK"))
        assert np.abs(seen - colour).max() <= 4


def test_lab_comes_out_in_its_colours(tmp_path: Path) -> None:
    lab = np.full((4, 4, 3), (136, 80, 67), np.uint8)  # L 53, a 80, b 67: red
    seen = shown(tmp_path / "l.tif", Image.frombytes("LAB", (4, 4), lab.tobytes()))
    assert np.abs(seen - [255, 0, 0]).max() <= 12


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_sixteen_bits_are_scaled_to_eight(tmp_path: Path, suffix: str) -> None:
    deep = np.array([[0, 255, 257, 32768], [25700, 65278, 65534, 65535]], np.uint16)
    seen = shown(tmp_path / f"d{suffix}", Image.fromarray(deep))
    assert np.array_equal(seen, grey(np.rint(deep / 257)))


def test_big_endian_and_32_bits_and_real_numbers(tmp_path: Path) -> None:
    deep = np.array([[0, 257, 65535]])
    assert np.array_equal(shown(tmp_path / "b.tif", Image.fromarray(deep.astype(">u2"))), grey(deep / 257))
    assert np.array_equal(shown(tmp_path / "i.tif", Image.fromarray(deep.astype(np.int32))), grey(deep / 257))
    huge = np.array([[-5, 0, 2**30]], np.int32)
    assert shown(tmp_path / "h.tif", Image.fromarray(huge))[0, :, 0].tolist() == [0, 0, 255]
    for top in (1, 255, 65535, 1e9):
        real = np.array([[0, top / 5, top, np.nan, -np.inf]], np.float32)
        assert shown(tmp_path / "f.tif", Image.fromarray(real))[0, :, 0].tolist() == [0, 51, 255, 0, 0]


def test_one_pixel(tmp_path: Path) -> None:
    for name in ("1.png", "1.jpg", "1.webp", "1.gif", "1.tif"):
        assert shown(tmp_path / name, Image.new("RGB", (1, 1), "white")).tolist() == [[[255, 255, 255]]]


# --- a sentence where there is none --------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"GIF? no", "not an image"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "not an image"),  # would start a program
        (b"\xff\xd8\xff\xe0", r"not an image|damaged"),
    ],
)
def test_what_is_no_photo_is_said(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(PhotoError, match=says) as caught:
        open_rgb(tmp_path / "a.jpg")
    assert "a.jpg" in str(caught.value)


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.webp", "a.tif", "a.gif", "a.bmp"])
def test_a_truncated_photo_is_refused(tmp_path: Path, name: str) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(PhotoError, match=r"damaged or cut short|not an image"):
        open_rgb(tmp_path / name)


def png_header(width: int, height: int) -> bytes:
    chunk = b"IHDR" + struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))


def test_too_many_pixels_are_refused_before_they_are_decoded(tmp_path: Path) -> None:
    path = tmp_path / "huge.png"
    path.write_bytes(
        png_header(20_000, 10_001) + struct.pack(">I", 0) + b"IDAT" + struct.pack(">I", zlib.crc32(b"IDAT"))
    )
    with pytest.raises(PhotoError, match=r"200020000 pixels, over 200000000 in all"):
        open_rgb(path)
    assert read_photo(path) == Photo(path)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.gif", "a.webp"])
def test_pillows_own_lower_limit_neither_warns_nor_refuses(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.fromarray(COLOURS).save(tmp_path / name)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    assert open_rgb(tmp_path / name).size == (8, 6)
    assert Image.MAX_IMAGE_PIXELS == 10
    monkeypatch.setattr(decode, "MAX_PIXELS", 47)
    with pytest.raises(PhotoError, match=r"8 x 6 pixels, over (47|23) in all"):
        open_rgb(tmp_path / name)


def test_threads_leave_pillow_and_warnings_as_they_were(tmp_path: Path) -> None:
    Image.fromarray(COLOURS).save(tmp_path / "a.tif")
    limit, filters = Image.MAX_IMAGE_PIXELS, list(warnings.filters)
    threads = [threading.Thread(target=lambda: [open_rgb(tmp_path / "a.tif") for _ in range(20)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert limit == Image.MAX_IMAGE_PIXELS
    assert list(warnings.filters) == filters


def jpeg() -> bytes:
    buffer = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder:
        save_jpeg(smooth(32, 48), Path(folder, "a.jpg"), where=GeoPoint(1, 2), heading=3)
        buffer.write(Path(folder, "a.jpg").read_bytes())
    return buffer.getvalue()


def opens_or_says(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.jpg")
        path.write_bytes(content)
        told = read_photo(path)
        assert told.heading is None or 0 <= told.heading < 360
        try:
            rgb = open_rgb(path)
        except PhotoError as error:
            said = str(error)
            assert "a.jpg" in said
        else:
            assert rgb.mode == "RGB"


JPEG = jpeg()


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(st.integers(0, len(JPEG) - 1), st.integers(0, 255)), min_size=1, max_size=6))
def test_broken_bytes_open_or_are_said(changes: list[tuple[int, int]]) -> None:
    content = bytearray(JPEG)
    for place, byte in changes:
        content[place] = byte
    opens_or_says(bytes(content))


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 220), st.integers(0, 255)), min_size=1, max_size=6))
def test_broken_exif_opens_or_is_said(changes: list[tuple[int, int]]) -> None:
    content = bytearray(JPEG)
    for place, byte in changes:
        content[place] = byte
    opens_or_says(bytes(content))


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(
        [
            b"",
            b"\xff\xd8\xff",
            b"\x89PNG\r\n\x1a\n",
            b"II*\0",
            b"MM\0*",
            b"GIF89a",
            b"RIFF\0\0\0\0WEBP",
            b"BM",
        ]
    ),
    st.binary(max_size=200),
)
def test_random_bytes_open_or_are_said(magic: bytes, rest: bytes) -> None:
    opens_or_says(magic + rest)


# --- squeezing -----------------------------------------------------------------------------


def test_squeezed_whole_not_cropped() -> None:
    halves = np.zeros((10, 40, 3), np.uint8)
    halves[:, 20:] = 255
    small = squeeze(Image.fromarray(halves), 6, 4)
    assert small.shape == (6, 4, 3)
    assert small.dtype == np.uint8
    assert small.flags.writeable
    assert (small[:, 0] == 0).all()
    assert (small[:, 3] == 255).all()


def test_squeezing_is_antialiased() -> None:
    checks = np.indices((64, 64)).sum(axis=0) % 2 * 255
    small = squeeze(Image.fromarray(checks.astype(np.uint8)), 8, 8)
    assert np.abs(small.astype(int) - 127.5).max() <= 12


@pytest.mark.parametrize("resample", ["bilinear", "bicubic", "lanczos", "box", "nearest"])
def test_a_plain_wall_stays_plain(resample: str) -> None:
    assert (squeeze(Image.new("RGB", (7, 5), (9, 99, 199)), 30, 20, resample) == (9, 99, 199)).all()


@pytest.mark.parametrize(("height", "width", "resample"), [(0, 5, "box"), (5, -1, "box"), (5, 5, "magic")])
def test_sizes_and_resamplings_that_there_are_not(height: int, width: int, resample: str) -> None:
    with pytest.raises(ModelError, match="cannot be squeezed"):
        squeeze(Image.new("RGB", (7, 5)), height, width, resample)


@pytest.mark.parametrize("orientation", [1, 6])
def test_a_jpeg_decoded_smaller_squeezes_to_nearly_the_same(tmp_path: Path, orientation: int) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(smooth(900, 1200)).save(tmp_path / "a.jpg", exif=exif, quality=90)
    fast, slow = open_rgb(tmp_path / "a.jpg", at_least=(128, 128)), open_rgb(tmp_path / "a.jpg")
    assert 256 <= min(fast.size) < min(slow.size)
    apart = np.abs(squeeze(fast, 128, 128).astype(int) - squeeze(slow, 128, 128))
    assert apart.mean() < 1
    assert open_rgb(tmp_path / "a.jpg", at_least=(800, 800)).size == slow.size


def test_real_photos_decoded_smaller_differ_by_less_than_a_level(shared: Path) -> None:
    found = [
        path
        for folder in ("vcl-10", "amos-15", "grief-10")
        for path in sorted((shared / "data/train" / folder).rglob("*.jpg"))[::40]
    ]
    apart = []
    for path in found:
        fast, slow = open_rgb(path, at_least=(48, 48)), open_rgb(path)
        if fast.size != slow.size:
            apart.append(np.abs(squeeze(fast, 48, 48).astype(int) - squeeze(slow, 48, 48)).mean())
    assert len(apart) > 10
    assert np.mean(apart) < 1
    assert max(apart) < 3


def test_an_orientation_that_cannot_be_read_turns_nothing_but_want_of_memory_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.fromarray(COLOURS).save(tmp_path / "a.png")

    def raising(error: Exception) -> None:
        def turn(*_: object, **__: object) -> None:
            raise error

        monkeypatch.setattr(ImageOps, "exif_transpose", turn)

    raising(SyntaxError("not a TIFF file"))
    assert np.array_equal(np.asarray(open_rgb(tmp_path / "a.png")), COLOURS)
    raising(MemoryError())
    with pytest.raises(PhotoError, match="more memory than there is"):
        open_rgb(tmp_path / "a.png")
