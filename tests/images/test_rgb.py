"""Deep grey is shown by the range that it uses, and what was not measured has no say in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from salad.images.decode import decode, open_rgb
from salad.models.model_folder import load


def scene(height: int = 60, width: int = 80) -> np.ndarray:
    """A picture of eight bits that uses most of them, as photos do: stripes upon a slope."""
    rows, columns = np.mgrid[0:height, 0:width]
    return np.asarray(20 + rows * 150 // height + (columns // 9) % 2 * 60, np.uint8)


def seen(path: Path, values: np.ndarray, **how: object) -> np.ndarray:
    """The grey that the house makes of a file with these values."""
    Image.fromarray(values).save(path, **how)
    rgb = np.asarray(open_rgb(path), dtype=np.int64)
    assert (rgb == rgb[:, :, :1]).all()
    return np.asarray(rgb[:, :, 0])


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_so_many_bits_kept_in_sixteen_look_as_their_copy_of_eight(tmp_path: Path, bits: int, suffix: str) -> None:
    deep = scene().astype(np.uint16) << (bits - 8)
    assert np.abs(seen(tmp_path / f"a{suffix}", deep) - scene()).max() <= 1


@pytest.mark.parametrize("contrast", [1.0, 0.5])
def test_what_uses_its_full_range_is_scaled_and_nothing_else(tmp_path: Path, contrast: float) -> None:
    deep = (scene().astype(np.float64) * 257 * contrast + 65535 * (1 - contrast)).astype(np.uint16)
    assert np.array_equal(seen(tmp_path / "a.png", deep), np.rint(deep / 257))


@pytest.mark.parametrize(
    ("scale", "zero", "kind"),
    [
        (12, 27315, np.uint16),  # hundredths of a kelvin
        (1, 7000, np.uint16),  # a thermal camera's own numbers
        (30, -5000, np.int32),
        (3e6, 0, np.int32),
        (0.12, -5, np.float32),  # degrees Celsius
        (0.01, 431.5, np.float32),  # metres above the sea
        (1e-6, 0, np.float32),
    ],
)
def test_a_narrow_band_is_stretched_to_all_of_eight_bits(
    tmp_path: Path, scale: float, zero: float, kind: type[np.generic]
) -> None:
    grey = seen(tmp_path / "a.tif", (scene() * float(scale) + zero).astype(kind))
    assert (grey.min(), grey.max()) == (0, 255)
    low, high = float(scene().min()), float(scene().max())
    assert np.abs(grey - (scene() - low) / (high - low) * 255).max() <= 2


def test_dead_and_hot_pixels_do_not_say_what_is_black_and_white(tmp_path: Path) -> None:
    thermal = (27315 + scene(120, 160).astype(np.uint16) * 12).astype(np.uint16)
    whole = seen(tmp_path / "a.png", thermal)
    broken = thermal.copy()
    broken[3, 5], broken[70, 80] = 0, 65535
    apart = np.abs(seen(tmp_path / "b.png", broken) - whole)
    assert apart[3, 5] == whole[3, 5]
    apart[3, 5] = apart[70, 80] = 0
    assert apart.max() <= 1


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf, -9999, -32767, -32768, 3.4e38, -3.4028235e38, 1e20])
def test_where_nothing_was_measured_nothing_is_said_of_the_rest(tmp_path: Path, nothing: float) -> None:
    heights = (scene() * 0.01 + 431.5).astype(np.float32)
    whole = seen(tmp_path / "a.tif", heights)
    holed = heights.copy()
    holed[:8, 4:50] = nothing
    grey = seen(tmp_path / "b.tif", holed)
    assert not grey[:8, 4:50].any()
    grey[:8, 4:50] = whole[:8, 4:50]
    assert np.abs(grey - whole).max() <= 12  # the hole may have held the darkest


@pytest.mark.parametrize(("value", "said"), [(0, "0"), (65535, "65535\0"), (-7.3, " -7.3 "), (-1e6, "-1e6")])
def test_a_tiff_says_itself_which_value_is_none(tmp_path: Path, value: float, said: str) -> None:
    kind = np.float32 if value < 0 else np.uint16
    values = (27315 + scene() * 12.0).astype(kind)
    values[20:30] = value
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[42113] = said
    grey = seen(tmp_path / "a.tif", values, tiffinfo=tags)
    assert not grey[20:30].any()
    assert grey[30:].max() == 255
    assert len(np.unique(grey[30:])) > 50


@pytest.mark.parametrize("said", ["none", "", "1e999", "nan"])
def test_a_tag_that_says_nothing_is_none(tmp_path: Path, said: str) -> None:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[42113] = said
    deep = scene().astype(np.uint16) << 4
    assert np.abs(seen(tmp_path / "a.tif", deep, tiffinfo=tags) - scene()).max() <= 1


@pytest.mark.parametrize("value", [0, 1, 300, 65535, -40, -9999, np.nan])
def test_an_image_of_one_value_is_one_grey(tmp_path: Path, value: float) -> None:
    assert len(np.unique(seen(tmp_path / "a.tif", np.full((5, 7), value, np.float32)))) == 1


def test_a_large_image_has_one_range_from_top_to_bottom(tmp_path: Path) -> None:
    """Converted band by band, its range told by some of its pixels."""
    deep = (27315 + scene(1500, 2000).astype(np.uint16) * 12).astype(np.uint16)
    grey = seen(tmp_path / "a.tif", deep)
    assert (grey.min(), grey.max()) == (0, 255)
    assert (np.diff(grey[:, 0]) >= 0).all()


def test_deep_photos_are_located_as_their_copies_of_eight_bits(shared: Path) -> None:
    deep = shared / "cases/11-pixels/deep"
    if not deep.is_dir():
        pytest.skip("the cases are not beside this checkout")
    model = load("salad-lite")
    size = model.preprocessing

    def described(folder: str) -> np.ndarray:
        paths = sorted((deep / folder).iterdir())
        return np.asarray(model.describe([decode(path, size.height, size.width, size.resample) for path in paths]))

    places = described("ref")
    for folder in ("q8", "q12", "qk"):
        assert (described(folder) @ places.T).argmax(axis=1).tolist() == list(range(10))
