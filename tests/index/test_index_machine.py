"""An index against a plain dictionary: any sequence of changes, with kills in between, and what a search finds.

A kill is made by taking a picture: at a chosen moment of a change the folder is copied as it lies on the disk,
and the index goes on from the copy.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import Any
from unittest.mock import patch

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from salad.geo import GeoPoint
from salad.images.photo import Photo
from salad.index.index import Index
from salad.search.filters import Filter

DIM = 6
HOME = Path("/photos")
MEMORY = Path("/dev/shm")  # a disk that costs no time, where there is one

CONTENTS = [str(number) for number in range(12)]
PATHS = ["x/1", "x/2", "xy/1", "x/z/1", "y", "東京/1"]
_drawn = np.random.default_rng(0).standard_normal((len(CONTENTS), DIM))
ROWS = (_drawn / np.linalg.norm(_drawn, axis=1, keepdims=True)).astype(np.float32)

Step = tuple[str, Any]
PAIRS = st.lists(st.tuples(st.sampled_from(PATHS), st.sampled_from(CONTENTS)), max_size=4)
ADDING = st.tuples(st.just("add"), PAIRS)
MOVING = st.tuples(st.just("move"), PAIRS)
REMOVING = st.tuples(st.just("remove"), st.sampled_from([*PATHS, "x", "xy", "nothing", "."]))
COMPACTING = st.tuples(st.just("compact"), st.none())


@dataclass(frozen=True)
class Held:
    """A photo as the dictionary has it."""

    path: str
    lat: float | None


def photo(path: str, content: str) -> Photo:
    """A content with an even number knows where it is."""
    return Photo(HOME / path, GeoPoint(int(content), 7.0) if int(content) % 2 == 0 else None)


def apply(index: Index, step: Step) -> None:
    do, what = step
    if do == "compact":
        index.compact()
    elif do == "remove":
        index.remove([HOME / what])
    else:
        photos, contents = [photo(*pair) for pair in what], [content for _, content in what]
        if do == "move":
            index.update(photos, contents)
        else:
            rows = ROWS[[int(content) for content in contents]].reshape(-1, DIM)
            index.add(photos, rows, identities=contents)


def applied(held: dict[str, Held], step: Step) -> dict[str, Held]:
    """What there must be after a step."""
    do, what = step
    if do == "compact":
        return held
    if do == "remove":
        top = "" if what == "." else f"{what}/"
        return {content: it for content, it in held.items() if not f"{it.path}/".startswith(top)}
    current, here = {content for _, content in what}, {path for path, _ in what}
    now = dict(held)
    for path, content in what:
        if do == "add" or content in held:
            where = photo(path, content).where
            now[content] = Held(path, where.lat if where else None)
    return {content: it for content, it in now.items() if content in current or it.path not in here}


class Camera:
    """Copies a folder at the n-th moment of what happens to it."""

    def __init__(self, folder: Path, to: Path, moment: int) -> None:
        self.taken = False
        self._folder, self._to, self._moment, self._seen = folder, to, moment, 0

    @contextmanager
    def watching(self, index: Index) -> Iterator[None]:
        database = index._catalog._db
        database.set_trace_callback(self._see)  # before every statement of SQL
        with (
            patch.object(os, "fsync", self._before(os.fsync)),
            patch.object(Path, "unlink", self._before(Path.unlink)),
        ):
            yield
        database.set_trace_callback(None)

    def _before(self, function: Any) -> Any:
        def call(*arguments: Any, **settings: Any) -> Any:
            self._see()
            return function(*arguments, **settings)

        return call

    def _see(self, *_: object) -> None:
        self._seen += 1
        if self._seen == self._moment:
            shutil.copytree(self._folder, self._to)
            self.taken = True


class IndexMachine(RuleBasedStateMachine):
    """Index and dictionary side by side, and a reader that stays open for as long as the folder is the same."""

    def __init__(self) -> None:
        super().__init__()
        self.root = Path(mkdtemp(dir=MEMORY if os.access(MEMORY, os.W_OK) else None))
        self.held: dict[str, Held] = {}
        self.copies = 0

    @initialize()
    def begin(self) -> None:
        self.index = Index.create(self.root / "0", dim=DIM, fingerprint="f", model="fake")
        self.reader = Index.open(self.index.folder)

    def teardown(self) -> None:
        self.index.close()
        self.reader.close()
        shutil.rmtree(self.root)

    @rule(step=ADDING | MOVING | REMOVING)
    def change(self, step: Step) -> None:
        apply(self.index, step)
        self.held = applied(self.held, step)

    @rule()
    def compact(self) -> None:
        done = self.index.compact()
        assert (done.kept, done.damaged) == (len(self.held), [])
        assert self.index.info().removed == 0
        assert len(list(self.index.folder.iterdir())) == 3

    @rule()
    def open_again(self) -> None:
        self.index.close()
        self.index = Index.open(self.index.folder)

    @rule(step=ADDING | MOVING | REMOVING | COMPACTING, moment=st.integers(1, 24))
    def be_killed(self, step: Step, moment: int) -> None:
        self.copies += 1
        camera = Camera(self.index.folder, self.root / str(self.copies), moment)
        with camera.watching(self.index):
            apply(self.index, step)
        after = applied(self.held, step)
        if camera.taken:
            self.index.close()
            self.reader.close()
            self.index = Index.open(self.root / str(self.copies))
            self.reader = Index.open(self.index.folder)
            assert self._listed() in (self.held, after)
            after = self._listed()
        self.held = after

    @rule(
        number=st.integers(0, len(CONTENTS) - 1),
        k=st.integers(1, 15),
        south=st.none() | st.integers(0, 10),
        by_reader=st.booleans(),
    )
    def search(self, number: int, k: int, south: int | None, by_reader: bool) -> None:
        index = self.reader if by_reader else self.index
        where = None if south is None else Filter(box=(south, 0.0, 90.0, 10.0))
        (found,) = index.search(ROWS[number], k=k, where=where)
        may = {
            content: it
            for content, it in self.held.items()
            if south is None or (it.lat is not None and it.lat >= south)
        }
        stored = ROWS.astype(np.float16).astype(np.float64) @ ROWS[number].astype(np.float64)
        best = sorted(may, key=lambda content: -stored[int(content)])[:k]
        assert [match.photo.path for match in found] == [HOME / may[content].path for content in best]
        np.testing.assert_allclose(
            [match.score for match in found], stored[[int(content) for content in best]], atol=1e-9
        )

    @invariant()
    def both_hold_the_same(self) -> None:
        assert self._listed() == self.held
        assert len(self.index) == len(self.reader) == len(self.held)
        assert sorted(photo.path for photo in self.reader.photos()) == sorted(
            HOME / it.path for it in self.held.values()
        )
        assert self.index.verify() == []

    def _listed(self) -> dict[str, Held]:
        held: dict[str, Held] = {}
        for page in self.index.pages():
            assert page.damaged == []
            for shown, content, row in zip(page.photos, page.identities, page.descriptors, strict=True):
                np.testing.assert_array_equal(row, ROWS[int(content)].astype(np.float16))
                held[content] = Held(str(shown.path.relative_to(HOME)), shown.where.lat if shown.where else None)
        return held


TestIndexMachine = IndexMachine.TestCase
TestIndexMachine.settings = settings(max_examples=200, stateful_step_count=15, deadline=None)
