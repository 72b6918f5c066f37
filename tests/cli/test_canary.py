"""The canary of the command line's tests sings: each thing that may happen beside a folder is noticed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from canary import Canary

HARM: dict[str, Callable[[Path], object]] = {
    "written over": lambda home: (home / "photo.jpg").write_bytes(b""),
    "written over through a link": lambda home: (home / "link").write_bytes(b"x"),
    "made through a link": lambda home: (home / "link-to-nowhere").write_bytes(b"x"),
    "emptied": lambda home: (home / "descriptors.f16").open("wb").close(),
    "taken away": lambda home: (home / "photos.sqlite-journal").unlink(),
    "a folder taken away": lambda home: (home / "draft").rmdir(),
    "made": lambda home: (home / ".draft.0123456789abcdef").mkdir(),
    "made deeper": lambda home: (home / "private" / "new").touch(),
    "permissions": lambda home: (home / "private" / "key").chmod(0o600),
    "a link bent": lambda home: ((home / "link").unlink(), (home / "link").symlink_to("places.csv")),
    "replaced by a link": lambda home: ((home / "photo.jpg").unlink(), (home / "photo.jpg").symlink_to("link")),
}


@pytest.fixture
def laid(tmp_path: Path) -> Canary:
    (tmp_path / "home").mkdir()
    return Canary.beside(tmp_path / "home" / "room")


@pytest.mark.parametrize("harm", HARM)
def test_whatever_happens_beside_a_folder_is_noticed(laid: Canary, harm: str) -> None:
    assert laid.changes() == []
    HARM[harm](laid.folder)
    assert laid.changes()


def test_what_happens_in_the_folder_is_the_test_s_own_affair(laid: Canary) -> None:
    (laid.folder / laid.room / "new").write_bytes(b"x")
    assert laid.changes() == []
