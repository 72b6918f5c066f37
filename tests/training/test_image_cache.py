"""The images: photos read ahead and kept within memory; a broken one is never shown, another of its place is."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from salad.datasets.training_place import TrainingPlace, View
from salad.errors import BenchmarkError, PhotoError
from salad.images.decode import Pixels, decode
from salad.network.config import Preprocessing
from salad.training import batches as shelves
from salad.training.batches import ImageCache

SIZE = Preprocessing(4, 6)
BYTES = 4 * 6 * 3


def place(root: Path, name: str, shades: list[int]) -> TrainingPlace:
    """A place whose photos are each of one red; a shade below 0 makes a file that is no photo."""
    (root / name).mkdir(parents=True)
    paths = [root / name / f"{number}.png" for number in range(len(shades))]
    for path, red in zip(paths, shades, strict=True):
        if red < 0:
            path.write_bytes(b"no photo")
        else:
            Image.new("RGB", (9, 8), (red, 0, 0)).save(path)
    return TrainingPlace(name, "city", tuple(paths))


def views(shown: TrainingPlace, *numbers: int, label: int = 0) -> list[View]:
    return [View(shown.photos[number], label, mirrored=False, place=shown) for number in numbers]


def reds(photos: torch.Tensor) -> list[int]:
    assert photos.shape[1:] == (3, 4, 6)
    assert photos.dtype == torch.uint8
    return photos[:, 0, 0, 0].tolist()


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> Counter[Path]:
    """How often each photo was opened."""
    opened: Counter[Path] = Counter()

    def count(path: Path, *size: Any) -> Pixels:
        opened[path] += 1
        return decode(path, *size)

    monkeypatch.setattr(shelves, "decode", count)
    return opened


@pytest.fixture
def images() -> Iterator[ImageCache]:
    with ImageCache(SIZE) as made:
        yield made


def test_a_batch_is_its_photos_in_order(tmp_path: Path, images: ImageCache) -> None:
    one, two = place(tmp_path, "a", [10, 20, 30]), place(tmp_path, "b", [40, 50])
    assert reds(images.photos([*views(one, 2, 0), *views(two, 1, label=1), *views(one, 2)])) == [
        30,
        10,
        50,
        30,
    ]
    assert images.broken == {}
    assert images.newly_unreadable() == ""
    np.testing.assert_array_equal(images.array(one.photos[0]), decode(one.photos[0], 4, 6, "bilinear"))


def test_a_photo_is_read_once(tmp_path: Path, images: ImageCache, read: Counter[Path]) -> None:
    shown = place(tmp_path, "a", [10, 20])
    for _ in range(3):
        assert reds(images.photos(views(shown, 0, 1, 0))) == [10, 20, 10]
    assert set(read.values()) == {1}


def test_memory_is_bounded_and_what_came_first_stays(tmp_path: Path, read: Counter[Path]) -> None:
    shown = place(tmp_path, "a", [10, 20, 30, 40])
    with ImageCache(SIZE, megabytes=1) as images:
        images._room = 2
        for _ in range(3):
            assert reds(images.photos(views(shown, 0, 1, 2, 3, 3))) == [10, 20, 30, 40, 40]
    assert [read[path] for path in shown.photos] == [1, 1, 3, 3]


def test_room_is_counted_in_megabytes() -> None:
    with ImageCache(SIZE, megabytes=3) as images:
        assert images._room == 3_000_000 // BYTES
    with ImageCache(SIZE, megabytes=0) as images:
        assert images._room == 0


def test_what_is_expected_is_read_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = place(tmp_path, "a", [10, 20])
    begun = threading.Event()

    def tell(path: Path, *size: Any) -> Pixels:
        begun.set()
        return decode(path, *size)

    monkeypatch.setattr(shelves, "decode", tell)
    with ImageCache(SIZE) as images:
        images.prefetch(views(shown, 1))
        assert begun.wait(60)
        assert reds(images.photos(views(shown, 1))) == [20]


@pytest.mark.parametrize("before", [True, False])
def test_a_loop_that_looks_ahead_reads_nothing_twice(tmp_path: Path, read: Counter[Path], before: bool) -> None:
    """Whether the next batch is announced before or after this one is fetched."""
    shown = place(tmp_path, "a", [10, 20, 30, 40, 50, 60])
    batches = [views(shown, number, (number + 3) % 6) for number in range(3)]
    with ImageCache(SIZE, megabytes=0) as images:
        images.prefetch(batches[0])
        for number, batch in enumerate(batches):
            if before:
                images.prefetch(batches[(number + 1) % 3])
            fetched = reds(images.photos(batch))
            assert fetched == [10 * (number + 1), 10 * ((number + 3) % 6 + 1)]
            if not before:
                images.prefetch(batches[(number + 1) % 3])
    assert max(read[view.path] for view in [*batches[1], *batches[2]]) == 1


def test_what_was_expected_in_vain_is_let_go(tmp_path: Path) -> None:
    shown = place(tmp_path, "a", [10, 20, 30, 40, 50])
    with ImageCache(SIZE, megabytes=0) as images:
        for number in range(5):
            images.prefetch(views(shown, number))
        assert sum(map(len, images._ahead)) == 2
        assert reds(images.photos(views(shown, 0, 4))) == [10, 50]
        assert sum(map(len, images._ahead)) == 1


def test_another_photo_of_the_place_stands_in(tmp_path: Path, images: ImageCache) -> None:
    one, two = place(tmp_path, "a", [10, -1, 30, 40]), place(tmp_path, "b", [50, 60, 70, -1])
    batch = [*views(one, 1, 2), *views(two, 3, 1, label=1)]
    assert reds(images.photos(batch)) == [40, 30, 50, 60]  # 30 is shown already, so the next but one
    assert set(images.broken) == {one.photos[1], two.photos[3]}
    assert all(str(path) in sentence for path, sentence in images.broken.items())
    with ImageCache(SIZE) as other:
        other.prefetch(batch)
        assert reds(other.photos(batch)) == [40, 30, 50, 60]


def test_where_all_are_shown_one_is_shown_twice(tmp_path: Path, images: ImageCache) -> None:
    shown = place(tmp_path, "a", [10, -1, 30, -1])
    assert reds(images.photos(views(shown, 0, 1, 2, 3))) == [10, 30, 30, 10]
    assert len(images.broken) == 2


def test_two_that_fall_out_are_two_others_where_there_are(tmp_path: Path, images: ImageCache) -> None:
    shown = place(tmp_path, "a", [-1, -1, 30, 40, 50])
    assert reds(images.photos(views(shown, 0, 1))) == [30, 40]


def test_broken_photos_are_told_once_with_their_count(tmp_path: Path, images: ImageCache) -> None:
    shown = place(tmp_path, "a", [10, -1, 30, -1])
    images.photos(views(shown, 1))
    assert images.newly_unreadable().startswith(
        "1 photo cannot be read, and others of their places stand in; the first: "
    )
    images.photos(views(shown, 1))
    assert images.newly_unreadable() == ""
    (tmp_path / "gone").mkdir()
    gone = TrainingPlace("gone", "city", (tmp_path / "gone" / "x.png", *shown.photos))
    images.photos([*views(shown, 3), *views(gone, 0, label=1)])
    assert images.newly_unreadable().startswith("2 photos cannot be read")
    assert tmp_path / "gone" / "x.png" in images.broken


def test_a_place_without_a_readable_photo_is_a_sentence(tmp_path: Path, images: ImageCache) -> None:
    shown = place(tmp_path, "nowhere", [-1, -1])
    with pytest.raises(BenchmarkError, match=r"no photo of the place nowhere in city can be read; the first: .*0\.png"):
        images.photos(views(shown, 0))


def test_a_broken_photo_asked_for_by_itself_is_named(tmp_path: Path, images: ImageCache, read: Counter[Path]) -> None:
    shown = place(tmp_path, "a", [-1])
    for _ in range(2):
        with pytest.raises(PhotoError, match=r"0\.png"):
            images.array(shown.photos[0])
    assert read[shown.photos[0]] == 1
    assert list(images.broken) == [shown.photos[0]]


def test_real_photos_from_the_layout_they_come_in(shared: Path) -> None:
    from salad.datasets.places import find_places
    from salad.datasets.samplers import OneCitySampler

    places = find_places(shared / "data" / "train" / "sfxl-240")
    batch = OneCitySampler(places, per_batch=4, views=2, seed=0).batch(0)
    with ImageCache(Preprocessing(32, 32)) as images:
        photos = images.photos(batch)
    assert photos.shape == (8, 3, 32, 32)
    assert float(photos.float().std(dim=(1, 2, 3)).min()) > 1  # none is a flat picture
    assert images.broken == {}
