"""Photos as a page holds them."""

import base64
import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pages import Sharing
from salad.images.decode import Pixels
from salad.images.exif import save_jpeg
from salad.images.workers import Workers
from salad.models.fake import FakeDescriber
from salad.report.strips import Thumbnails


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    pixels = np.random.default_rng(1).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    save_jpeg(np.kron(pixels, np.ones((10, 10, 1), dtype=np.uint8)), tmp_path / "a.jpg")
    return tmp_path / "a.jpg"


def opened(uri: str) -> Image.Image:
    return Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2])))


@pytest.mark.parametrize(("side", "size"), [(100, (100, 75)), (4000, (400, 300))])
def test_a_thumbnail_keeps_the_shape_and_is_never_enlarged(photo: Path, side: int, size: tuple[int, int]) -> None:
    small = Thumbnails().of(photo, "a", side=side)
    assert small is not None
    assert (small.width, small.height) == opened(small.uri).size == size
    assert small.layers == {}


def test_layers_are_those_that_the_page_asks_for(photo: Path) -> None:
    for clusters, names in ((False, ["dustbin"]), (True, ["dustbin", "clusters"])):
        thumbnails = Thumbnails(Sharing(), clusters=clusters)
        small = thumbnails.of(photo, "a", side=100)
        assert small is not None
        assert list(small.layers) == names
        assert {opened(uri).size for uri in small.layers.values()} == {(4, 3)}  # a pixel a token
        assert thumbnails.dustbin == pytest.approx(0.9)
    assert Thumbnails(FakeDescriber()).dustbin is None


def test_each_photo_is_opened_once_for_each_size(photo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    count: list[Path] = []
    whole = Workers.show

    def counting(workers: Workers, path: Path, side: int) -> Pixels:
        count.append(path)
        return whole(workers, path, side)

    monkeypatch.setattr(Workers, "show", counting)
    thumbnails = Thumbnails()
    for side in (100, 100, 50, 100):
        thumbnails.of(photo, "a", side=side)
    assert len(count) == 2


def test_a_missing_photo_is_named_once(photo: Path) -> None:
    thumbnails = Thumbnails()
    assert thumbnails.missing_note == ()
    thumbnails.of(photo, "there", side=50)
    for _ in range(2):
        assert thumbnails.of(photo.with_name("b.jpg"), "b", side=50) is None
    assert thumbnails.missing == ["b"]
    assert "1 of 2 photos to show cannot be opened" in thumbnails.missing_note[0]
