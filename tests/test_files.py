"""Files: what is opened is a file, what is read has an end, what is written is whole."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salad.files import create_file, open_file, open_in_place, parse_json, read_file, read_json

FACTS = {"name": "Zürich", "at": [47.3, 8.5], "none": None}
POSIX = pytest.mark.skipif(os.name != "posix", reason="pipes and devices with names are POSIX's")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.json"
    path.write_text(json.dumps(FACTS), encoding="utf-8")
    return path


@pytest.fixture
def link(file: Path) -> Path:
    path = file.with_name("link.json")
    path.symlink_to(file)
    return path


def test_a_file_is_read_through_a_link_where_that_is_allowed(file: Path, link: Path) -> None:
    assert read_json(file) == read_json(file, follow=False) == read_json(link) == FACTS


def test_no_link_is_followed_where_it_may_not_be(link: Path, tmp_path: Path) -> None:
    (tmp_path / "nowhere").symlink_to(tmp_path / "gone")
    for path in (link, tmp_path / "nowhere"):
        with pytest.raises(OSError, match="it is a link"):
            open_file(path, follow=False)
        with pytest.raises(OSError, match="it is a link"):
            open_in_place(path)


@POSIX
@pytest.mark.parametrize("follow", [True, False])
def test_what_is_no_file_is_refused_at_once(tmp_path: Path, follow: bool) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        refused: list[OSError] = []

        def read(path: Path = path, refused: list[OSError] = refused) -> None:
            try:
                read_file(path, most=10, follow=follow)
            except OSError as error:
                refused.append(error)

        asked = threading.Thread(target=read, daemon=True)  # a pipe that is waited for would hold up the suite
        asked.start()
        asked.join(10)
        assert refused, f"{path} is still being read"
        assert "it is " in str(refused[0].strerror)
        assert refused[0].filename == str(path)


def test_a_file_with_other_names_is_not_written_in_place(file: Path) -> None:
    with open_in_place(file) as opened:
        assert opened.writable()
    os.link(file, file.with_name("other"))
    with pytest.raises(OSError, match="hard link"):
        open_in_place(file)
    assert read_json(file) == FACTS


def test_what_is_longer_than_it_may_be_is_not_read(file: Path) -> None:
    size = file.stat().st_size
    assert len(read_file(file, most=size)) == size
    with pytest.raises(OSError, match="longer than"):
        read_file(file, most=size - 1)


def test_a_new_file_takes_no_place_that_is_taken(file: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    for path in (file, tmp_path / "link"):
        with pytest.raises(FileExistsError):
            create_file(path)
    assert not (tmp_path / "gone").exists()
    with create_file(tmp_path / "new") as opened:
        opened.write(b"all")
    assert (tmp_path / "new").read_bytes() == b"all"


@pytest.mark.parametrize(
    "text", [b"[" * 100_000, b'{"a":' * 100_000, b"\xff", b"", b"{", b"[" * 100_000 + b"]" * 100_000]
)
def test_what_is_no_json_is_a_value_error(text: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse_json(text)


@given(st.binary(max_size=200))
def test_any_bytes_are_json_or_a_value_error(text: bytes) -> None:
    try:
        found = parse_json(text)
    except ValueError:
        return
    assert parse_json(json.dumps(found)) == found or found != found or "nan" in repr(found).lower()
