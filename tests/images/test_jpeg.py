"""A JPEG that lacks its end mark is whole; one that was cut in the middle is not, and is never half grey."""

from __future__ import annotations

import io
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from salad.errors import PhotoError
from salad.images import jpeg
from salad.images.decode import decode, open_rgb
from salad.images.jpeg import Frame

KINDS: dict[str, tuple[str, dict[str, object]]] = {
    "plain": ("RGB", {}),
    "fine": ("RGB", {"quality": 97, "subsampling": 0}),
    "coarse": ("RGB", {"quality": 20}),
    "optimised": ("RGB", {"optimize": True}),
    "restarting": ("RGB", {"restart_marker_rows": 1}),
    "often restarting": ("RGB", {"restart_marker_blocks": 3}),
    "progressive": ("RGB", {"progressive": True}),
    "grey": ("L", {}),
    "grey progressive": ("L", {"progressive": True}),
    "cmyk": ("CMYK", {}),
}


def made(kind: str, size: tuple[int, int] = (203, 151), seed: int = 0) -> bytes:
    """A JPEG of smooth noise."""
    mode, how = KINDS[kind]
    coarse = np.random.default_rng(seed).integers(0, 256, (9, 12, 3), dtype=np.uint8)
    file = io.BytesIO()
    Image.fromarray(coarse).resize(size, Image.Resampling.BICUBIC).convert(mode).save(file, "JPEG", **how)
    return file.getvalue()


def pixels(path: Path, data: bytes) -> np.ndarray:
    path.write_bytes(data)
    return np.asarray(open_rgb(path), dtype=np.int64)


@pytest.mark.parametrize("lost", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_what_lacks_its_end_mark_is_as_it_was(tmp_path: Path, kind: str, lost: int) -> None:
    whole = made(kind)
    assert np.array_equal(pixels(tmp_path / "a.jpg", whole[:-lost]), pixels(tmp_path / "b.jpg", whole))
    assert np.array_equal(decode(tmp_path / "a.jpg", 40, 30), decode(tmp_path / "b.jpg", 40, 30))


@pytest.mark.parametrize("after", [b"\0", b"\0" * 5000, b"\xff", b"junk"])
def test_what_follows_in_place_of_the_end_mark_is_no_matter(tmp_path: Path, after: bytes) -> None:
    whole = made("plain")
    assert np.array_equal(pixels(tmp_path / "a.jpg", whole[:-2] + after), pixels(tmp_path / "b.jpg", whole))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.3, 0.5, 0.6, 0.7, 0.8])
def test_what_is_cut_in_the_middle_is_refused(tmp_path: Path, kind: str, share: float) -> None:
    whole = made(kind)
    cut = whole[: int(len(whole) * share)]
    with pytest.raises(PhotoError, match="cut short: fetch it again"):
        pixels(tmp_path / "a.jpg", cut)


@pytest.mark.parametrize("kind", ["restarting", "often restarting"])
def test_nor_is_it_where_it_was_cut_between_two_beginnings(tmp_path: Path, kind: str) -> None:
    whole = made(kind)
    marks = [at for at in range(len(whole) - 1) if whole[at] == 0xFF and whole[at + 1] in range(0xD0, 0xD8)]
    for cut in (marks[len(marks) // 2], marks[len(marks) // 2] + 2):
        with pytest.raises(PhotoError, match="cut short"):
            pixels(tmp_path / "a.jpg", whole[:cut])


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_is_lost_it_opens_nearly_whole_or_is_refused(tmp_path: Path, kind: str) -> None:
    whole = made(kind)
    right = pixels(tmp_path / "b.jpg", whole)
    rows = int(right.shape[0] * 0.9)
    opened = 0
    for lost in [*range(3, 60, 4), *range(60, len(whole) - 700, 97)]:
        with suppress(PhotoError):
            seen = pixels(tmp_path / "a.jpg", whole[:-lost])
            opened += 1
            assert np.abs(seen - right)[:rows].mean() < 1
            assert np.abs(seen - right).mean() < 8
    assert opened < 40


def test_a_large_photo_is_judged_at_a_small_size(tmp_path: Path) -> None:
    whole = made("plain", size=(4100, 3000))
    assert np.array_equal(pixels(tmp_path / "a.jpg", whole[:-2]), pixels(tmp_path / "b.jpg", whole))
    with pytest.raises(PhotoError, match="cut short"):
        pixels(tmp_path / "a.jpg", whole[: len(whole) * 9 // 10])


def test_what_a_jpeg_says_of_its_picture() -> None:
    assert jpeg.frame(made("plain")) == Frame(0xC0, 8, 203, 151)
    assert jpeg.frame(b"before" + made("progressive"), 6) == Frame(0xC2, 8, 203, 151)
    for nothing in (b"", b"\xff\xd8", b"\xff\xd8\xff", b"\xff\xd8\xff\xe0\0\x10JFIF", b"GIF89a", made("plain")[:150]):
        assert jpeg.frame(nothing) is None
