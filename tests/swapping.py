"""A photo that somebody saves anew while it is read: once at each step of ours."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

import pytest

from salad.evaluation.descriptors import DescriptorCache
from salad.images import decode, photo, worker_process
from salad.images.workers import Workers
from salad.index.index import Index
from salad.models.fake import FakeDescriber

STEPS: list[tuple[Any, str]] = [
    (os, "open"),
    (decode, "existing"),
    (decode, "read_file"),
    (decode, "open_image"),
    (photo, "embedded"),
    (photo, "from_exif"),
    (worker_process, "in_memory"),
    (worker_process, "read_photo"),
    (worker_process, "content_hash"),
    (worker_process, "small"),
    (Workers, "read"),
    (Index, "taken"),
    (Index, "find"),
    (Index, "add"),
    (FakeDescriber, "describe"),
    (DescriptorCache, "keep"),
]
"""What is done on the way from a file to an index or a cache; before and after each, somebody may save the file."""


def renamed(path: Path, content: bytes) -> None:
    """As most programs save: a new file takes the place of the old one, which whoever has it open goes on reading."""
    beside = path.with_name("beside")
    beside.write_bytes(content)
    beside.replace(path)


def overwritten(path: Path, content: bytes) -> None:
    """As others do: the file itself changes."""
    path.write_bytes(content)


WAYS = [renamed, overwritten]


def at_each_step(path: Path, before: bytes, after: bytes, way: Callable[[Path, bytes], None]) -> Iterator[Any]:
    """A context for each step: within it the photo is saved anew at that step, having been put back before."""
    number, met = 0, True
    while met:
        path.write_bytes(before)
        steps = _Steps(number, lambda: way(path, after))
        yield steps.watched()
        met, number = steps.met, number + 1
    assert number > 20  # fewer would mean that nothing was patched


class _Steps:
    def __init__(self, number: int, save: Callable[[], None]) -> None:
        self._left, self._save = number, save
        self._lock = threading.RLock()
        self._saving = self.met = False

    def step(self) -> None:
        with self._lock:
            if self._saving:  # the saving opens files too
                return
            self._left -= 1
            if self._left == -1:
                self.met = self._saving = True
                self._save()
                self._saving = False

    @contextmanager
    def watched(self) -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            for home, name in STEPS:
                patch.setattr(home, name, self._told(getattr(home, name)))
            yield

    def _told(self, work: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(work)
        def told(*arguments: Any, **settings: Any) -> Any:
            self.step()
            value = work(*arguments, **settings)
            self.step()
            return value

        return told
