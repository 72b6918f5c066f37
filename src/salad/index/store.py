"""The index on disk: photos and descriptors in one folder, added, removed and searched, surviving a crash.

A change writes descriptors first and sees them onto the disk, then commits the table of photos, which says
how many rows count. Whatever a crash leaves is either committed or does not exist. docs/index-format.md tells
the folder.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from salad.errors import StoreError, WrongModelError
from salad.index import health, layout, ledger, matrix
from salad.index.header import Header
from salad.index.search import Floats, Match, Snapshot, as_queries, best_rows
from salad.photos import Photo, identity

if TYPE_CHECKING:
    from salad.model.describer import Describes


class Index:
    """Photos with their descriptors in a folder. One writer at a time; any number of readers beside it.

    Make one with `Index.create` or `Index.open`; close it, or use it as a context manager. An open index sees
    what others commit: every search looks at the latest commit.
    """

    def __init__(self, folder: Path, header: Header, table: ledger.Ledger) -> None:
        self.folder = folder
        self.header = header
        self._ledger = table
        self._last: Snapshot | None = None

    @classmethod
    def create(cls, folder: str | Path, *, dim: int, fingerprint: str, model: str) -> Index:
        """Make an empty index in `folder`, which must not exist or be empty, and open it.

        Args:
            folder: Where; folders above it are made too.
            dim: Numbers in a descriptor.
            fingerprint: The model's fingerprint.
            model: The model's name.

        Raises:
            StoreError: If the folder is in use or cannot be written; nothing is left behind.
        """
        if dim < 1:
            raise StoreError(f"an index of dimension {dim} cannot be: give the model's dimension, 1 or more")
        header = Header(model, fingerprint, dim, datetime.now(UTC).replace(microsecond=0))
        return cls.open(layout.make(Path(os.path.realpath(folder)), header))

    @classmethod
    def open(cls, folder: str | Path, *, wait: float = 10.0) -> Index:
        """Open the index in `folder`; a folder that cannot be written can still be searched.

        Args:
            folder: Where.
            wait: Seconds a change waits for another writer before it gives up.

        Raises:
            StoreError: If it is no index, a newer salad wrote it, or it is damaged.
        """
        home = Path(os.path.realpath(folder))
        index = cls(home, Header.read(home), ledger.Ledger(home / ledger.NAME, wait=wait))
        try:
            index._snapshot()
        except BaseException:
            index.close()
            raise
        return index

    @property
    def dim(self) -> int:
        """Numbers in a descriptor."""
        return self.header.dim

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the model the index was made with."""
        return self.header.fingerprint

    @property
    def model(self) -> str:
        """Name of the model the index was made with."""
        return self.header.model

    def __len__(self) -> int:
        return int(self._snapshot().alive.sum())

    def add(
        self, photos: Sequence[Photo], descriptors: Floats, *, identities: Sequence[str] | None = None
    ) -> int:
        """Take in photos; all of them or, on an error, none.

        A content the index already holds keeps its row and descriptor, and takes the new path and whatever is
        newly known of it; the last of several in one call wins. A photo whose file now holds another content
        is removed.

        Args:
            photos: The photos; paths are stored absolute, links resolved.
            descriptors: `[N, dim]`, rows of length 1; stored as float16.
            identities: Content hash of each photo; read from the files where not given.

        Returns:
            How many were new.

        Raises:
            StoreError: If the descriptors do not fit, another program is writing, or the disk is full.
            PhotoError: If a photo's content cannot be read to tell its identity.
        """
        rows = matrix.storable(descriptors, len(photos), self.dim)
        contents = [identity(photo.path) for photo in photos] if identities is None else list(identities)
        placed = _placed(photos)
        with self._ledger.writing():
            last = self._ledger.committed()
            known = self._ledger.find(contents)
            first = {content: n for n, content in reversed(list(enumerate(contents))) if content not in known}
            fresh = sorted(first.values())
            if fresh:
                matrix.append(self.folder / last.matrix, rows[fresh], at=last.rows)
                self._ledger.insert([placed[n] for n in fresh], [contents[n] for n in fresh], row=last.rows)
            self._place(placed, contents)
            self._ledger.commit_rows(last.rows + len(fresh))
        return len(fresh)

    def update(self, photos: Sequence[Photo], identities: Sequence[str]) -> None:
        """Give contents the index holds their path and what is newly known of them; pass over others."""
        placed = _placed(photos)
        with self._ledger.writing():
            self._place(placed, identities)
            self._ledger.commit_rows(self._ledger.committed().rows)

    def known(self, identities: Sequence[str]) -> set[str]:
        """Which of these contents the index holds."""
        return set(self.find(identities))

    def find(self, identities: Sequence[str]) -> dict[str, Photo]:
        """The photos with these contents, by content."""
        with self._ledger.reading():
            return self._ledger.find(identities)

    def search(self, descriptors: Floats, *, k: int = 5) -> list[list[Match]]:
        """The best k matches of each query: exact, best first, ties in order of row.

        Args:
            descriptors: `[Q, dim]`, or `[dim]` for one query.
            k: How many; a smaller index gives fewer.

        Raises:
            StoreError: If the descriptors are of another dimension or not finite, or k is below 1.
        """
        queries = as_queries(descriptors, self.dim)
        snapshot = self._snapshot()
        found = best_rows(snapshot.descriptors, queries, k=k, allowed=snapshot.alive)
        with self._ledger.reading():
            photos = self._ledger.at_rows({row for best in found for row, _ in best})
        return [[Match(photos[row], score, row) for row, score in best] for best in found]

    def remove(self, paths: Sequence[str | Path]) -> int:
        """Forget the photos at these paths, or below them; how many. Their rows never come out again.

        The files themselves are not touched and need not exist.
        """
        with self._ledger.writing():
            removed = sum(self._ledger.remove(path) for path in layout.resolved(paths))
            self._ledger.commit_rows(self._ledger.committed().rows)
        return removed

    def photos(self) -> Iterator[Photo]:
        """Every photo, in order of row; memory stays small."""
        row = -1
        while True:
            with self._ledger.reading():
                some = self._ledger.after(row)
            if not some:
                return
            yield from (photo for _, photo in some)
            row = some[-1][0]

    def check_model(self, model: Describes) -> None:
        """Make sure that `model` is the one the index was made with.

        Raises:
            WrongModelError: If it is another; the sentence names both and the way out.
        """
        if model.fingerprint != self.fingerprint:
            raise WrongModelError(
                f"{self.folder} was made with {self.model} ({self.fingerprint}), but the model in hand is "
                f"{model.name} ({model.fingerprint}): pass --model {self.model}, or index the photos again "
                "with --to another folder"
            )

    def verify(self) -> list[str]:
        """Read everything and say what is wrong, a sentence each; empty means sound."""
        snapshot = self._snapshot()
        bad = health.bad_rows(snapshot.descriptors, snapshot.alive, tolerance=matrix.UNIT_TOLERANCE)
        with self._ledger.reading():
            said = self._ledger.complaints()
            photos = self._ledger.at_rows(bad)
        return said + [
            f"{photo.path} has a damaged descriptor: remove it and index it again"
            for photo in photos.values()
        ]

    def missing(self) -> list[Path]:
        """Photos the index holds whose files are gone."""
        return [photo.path for photo in self.photos() if not photo.path.exists()]

    def info(self) -> health.IndexInfo:
        """What the index holds, in numbers."""
        with self._ledger.reading():
            positions = self._ledger.positions()
        return health.IndexInfo(
            photos=len(self),
            with_position=len(positions),
            model=self.model,
            fingerprint=self.fingerprint,
            dim=self.dim,
            bytes=sum(file.stat().st_size for file in self.folder.iterdir()),
            created=self.header.created,
            box=health.box(positions),
            format_version=self.header.format_version,
        )

    def close(self) -> None:
        """Let go of the files; the index cannot be used afterwards."""
        self._last = None
        self._ledger.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _snapshot(self) -> Snapshot:
        """The latest commit, mapped; the same object until somebody commits again."""
        with self._ledger.reading():
            last = self._ledger.committed()
            if self._last is None or self._last.generation != last.generation:
                alive = np.ones(last.rows, dtype=np.bool_)
                alive[self._ledger.dead_rows()] = False
                view = matrix.view(self.folder / last.matrix, last.rows, self.dim)
                self._last = Snapshot(last.generation, view, alive)
            return self._last

    def _place(self, placed: Sequence[Photo], contents: Sequence[str]) -> None:
        self._ledger.update(placed, contents)
        self._ledger.retire([photo.path for photo in placed], contents)


def _placed(photos: Sequence[Photo]) -> list[Photo]:
    paths = layout.resolved(photo.path for photo in photos)
    return [replace(photo, path=path) for photo, path in zip(photos, paths, strict=True)]
