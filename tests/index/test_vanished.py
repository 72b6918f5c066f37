"""Photos that were deleted, and disks that are away."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from salad.index.vanished import disk_may_be_away


def files(root: Path, *names: str) -> list[Path]:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"x")
    return [root / name for name in names]


@pytest.fixture
def tree(tmp_path: Path) -> list[Path]:
    return files(
        tmp_path, "home/1.jpg", "home/disk/2.jpg", "home/disk/deep/3.jpg", "home/disk/deep/4.jpg", "other/5.jpg"
    )


def test_a_deleted_photo_or_folder_is_no_disk(tree: list[Path], tmp_path: Path) -> None:
    shutil.rmtree(tmp_path / "home" / "disk" / "deep")
    assert disk_may_be_away(tree[2:4], {tmp_path / "home": 4}) == []
    assert disk_may_be_away([], {tmp_path / "home": 4, tmp_path / "nothing held": 0}) == []


def test_an_empty_folder_may_be_the_place_of_a_disk(tree: list[Path], tmp_path: Path) -> None:
    disk = tmp_path / "home" / "disk"
    shutil.rmtree(disk)
    disk.mkdir()
    assert disk_may_be_away(tree[1:4], {tmp_path / "home": 4}) == [f"{disk} is empty, and 3 photos of it are gone"]


def test_all_of_a_folder_may_be_a_disk_too(tree: list[Path], tmp_path: Path) -> None:
    home, link = tmp_path / "home", tmp_path / "link"
    link.symlink_to(home)
    for path in tree[:4]:
        path.unlink()
    files(home, "new.jpg")  # written to the place of the disk while that was away
    (told,) = disk_may_be_away(tree[:4], {link: 4, tmp_path / "other": 1})[:1]
    assert told == f"all 4 photos that the index holds of {link} are gone"
    assert disk_may_be_away(tree[:1], {home: 4}) == []  # one of them
