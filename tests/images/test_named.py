"""Photos that an index or a result names: the photo that was meant is opened, and nothing else is."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.errors import PhotoError
from salad.images import named
from salad.images.decode import decode
from salad.images.exif import save_jpeg
from salad.images.named import HeldPhoto, NamedPhoto, PhotoBelow
from salad.images.photo import content_hash
from salad.models.fake import FakeDescriber


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    """A photo in `photos/day`, beside a secret that is a photo too."""
    (tmp_path / "photos" / "day").mkdir(parents=True)
    for path in (tmp_path / "secret.jpg", tmp_path / "photos" / "day" / "a.jpg"):
        save_jpeg(np.random.default_rng(len(path.parts)).integers(0, 256, (40, 60, 3), dtype=np.uint8), path)
    return tmp_path / "photos" / "day" / "a.jpg"


@pytest.fixture
def folder(photo: Path) -> Path:
    return photo.parents[1]


def refused(photo: NamedPhoto) -> str:
    with pytest.raises(PhotoError) as told:
        photo.read()
    assert "Errno" not in str(told.value)
    return str(told.value)


def test_a_photo_of_an_index_is_opened_where_it_is_the_same(photo: Path) -> None:
    held = HeldPhoto(photo, content_hash(photo))
    assert held.read() == photo.read_bytes()
    save_jpeg(np.zeros((8, 8, 3), dtype=np.uint8), photo)
    changed = refused(held)
    photo.unlink()
    assert refused(held) == changed  # what else lies on the machine is told to nobody
    photo.mkdir()
    assert refused(held) == changed


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices with names are POSIX's")
def test_neither_waits_for_a_pipe_nor_reads_a_device(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.jpg")
    for path in (tmp_path / "pipe.jpg", Path("/dev/zero")):
        assert "changed or is gone" in refused(HeldPhoto(path, "0" * 32))
        assert "no regular file" in refused(PhotoBelow(path.parent, path.name))


def test_a_photo_larger_than_any_photo_is_not_read(photo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(named, "LONGEST", photo.stat().st_size - 1)
    assert "changed or is gone" in refused(HeldPhoto(photo, content_hash(photo)))
    assert "longer than" in refused(PhotoBelow(photo.parent, photo.name))


@pytest.mark.parametrize("links", [False, True])
@pytest.mark.parametrize("name", ["day/a.jpg", "./day/../day/a.jpg", "../photos/day/a.jpg"])
def test_a_name_below_the_folder(folder: Path, photo: Path, name: str, links: bool) -> None:
    assert PhotoBelow(folder, name, links=links).read() == photo.read_bytes()


@pytest.mark.parametrize("links", [False, True])
@pytest.mark.parametrize("name", ["../secret.jpg", "day/../../secret.jpg", "{}/secret.jpg", "../photos-too/a.jpg"])
def test_a_name_that_leads_out_of_the_folder(folder: Path, tmp_path: Path, name: str, links: bool) -> None:
    (tmp_path / "photos-too").mkdir()
    (tmp_path / "photos-too" / "a.jpg").write_bytes((tmp_path / "secret.jpg").read_bytes())
    assert "does not lie below" in refused(PhotoBelow(folder, name.format(tmp_path), links=links))


def test_links_lead_out_of_the_folder_only_for_whoever_named_it(folder: Path, tmp_path: Path) -> None:
    (folder / "file.jpg").symlink_to(tmp_path / "secret.jpg")
    (folder / "up").symlink_to(tmp_path)
    (folder / "inner.jpg").symlink_to(folder / "day" / "a.jpg")
    for name in ("file.jpg", "up/secret.jpg"):
        assert "does not lie below" in refused(PhotoBelow(folder, name))
        assert PhotoBelow(folder, name, links=True).read() == (tmp_path / "secret.jpg").read_bytes()
    assert PhotoBelow(folder, "inner.jpg").read() == (folder / "day" / "a.jpg").read_bytes()


def test_the_folder_itself_may_be_a_link(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(folder)
    assert PhotoBelow(tmp_path / "link", "day/a.jpg").read() == (folder / "day" / "a.jpg").read_bytes()


@given(name=st.text(max_size=80))
def test_whatever_a_name_holds_it_is_read_below_the_folder_or_refused(
    tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    folder = tmp_path_factory.getbasetemp() / "below"
    folder.mkdir(exist_ok=True)
    refused(PhotoBelow(folder, name))
    refused(HeldPhoto(folder / "a", name))


def test_a_model_sees_the_same_as_in_the_file(folder: Path, photo: Path) -> None:
    model = FakeDescriber()
    plain = model.describe([photo])
    for one in (HeldPhoto(photo, content_hash(photo)), PhotoBelow(folder, "day/a.jpg")):
        np.testing.assert_array_equal(model.describe([one]), plain)
    with pytest.raises(PhotoError, match="changed or is gone"):
        model.describe([HeldPhoto(photo, "0" * 32)])


def test_what_is_decoded_is_what_was_checked(photo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file is another one right after it was read: the model sees the one that was checked."""
    due, held, whole = decode(photo, 64, 64), HeldPhoto(photo, content_hash(photo)), HeldPhoto.read

    def read_and_changed(self: HeldPhoto) -> bytes:
        content = whole(self)
        save_jpeg(np.zeros((40, 60, 3), dtype=np.uint8), photo)
        return content

    monkeypatch.setattr(HeldPhoto, "read", read_and_changed)
    np.testing.assert_array_equal(
        FakeDescriber().describe([held]), FakeDescriber().describe([due]), "the bytes checked, not those of the file"
    )
