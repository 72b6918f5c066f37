"""From photos to an index: known ones are skipped, unreadable ones named, the rest described and added.

Helpers hash and decode photos while the model describes the batch before; only a few batches are in memory at
any time. Every few batches are committed, and so is what is described when an interrupt comes, so that it loses
little and the next run goes on where this one stopped.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from salad.errors import SaladError
from salad.images.decode import Pixels
from salad.images.photo import Photo, PhotoTable, content_hash, placed
from salad.images.workers import Here, in_order, reader_for, workers
from salad.index.index import Index

if TYPE_CHECKING:
    from salad.models.describer import Describes
    from salad.network.config import Preprocessing

__all__ = ["Indexed", "Pixels", "in_order", "index_photos", "workers"]

COMMIT_BATCHES = 8  # batches between commits: what a loss of power can cost
_STALE = 1000  # photos to bring up to date in one commit


@dataclass(slots=True)
class Indexed:
    """What `index_photos` did; added + skipped + len(unreadable) is the number of photos given.

    Attributes:
        added: Photos that are new in the index.
        skipped: Photos whose content was there already.
        moved: Those of the skipped whose file had another path before, which was updated.
        twins: A sentence for each of the skipped that is a copy of another photo still in its place.
        unreadable: A sentence for each photo that could not be read.
    """

    added: int = 0
    skipped: int = 0
    moved: int = 0
    twins: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Item:
    """A photo on its way in; `pixels` `[height, width, 3]` come later, `trouble` where it cannot be read."""

    path: Path
    photo: Photo | None = None
    content: str = ""
    pixels: Pixels | None = None
    trouble: str = ""

    @property
    def known(self) -> Photo:
        """The photo with its position and time, where it could be looked at."""
        return self.photo or Photo(self.path)


def index_photos(
    sources: Sequence[Path],
    index: Index,
    model: Describes,
    *,
    table: PhotoTable | None = None,
    batch_size: int = 16,
    progress: Callable[[int, int], None] | None = None,
) -> Indexed:
    """Describe photos and add them to an index.

    A photo is known by its content: one the index holds is not decoded again, its path and position are
    brought up to date if the file moved, and a copy of a photo that is still in its place is skipped and
    named.

    Args:
        sources: Files, as `photos.find_photos` lists them.
        index: Where to; it must have been made with `model`.
        model: What describes them.
        table: Positions of photos, before `@` names and EXIF.
        batch_size: Photos the model takes at a time.
        progress: Called with (photos done, photos given) as they are done.

    Raises:
        WrongModelError: If the index was made with another model.
        StoreError: If the index cannot be written; what was committed before stays.
    """
    index.check_model(model)
    run, to = _Run(index, model, len(sources), progress), model.preprocessing
    with workers() as pool, reader_for(len(sources)) as reader:
        looked = in_order(pool, lambda path: _look(reader, path, table), sources, ahead=4 * batch_size)
        unknown = run.unknown(looked)
        ready = in_order(pool, lambda item: _decode(reader, item, to), unknown, ahead=2 * batch_size)
        run.take_in(ready, batch_size)
    return run.result


class _Run:
    """One run of `index_photos`: what is counted so far, and what waits for the next commit."""

    def __init__(
        self, index: Index, model: Describes, total: int, progress: Callable[[int, int], None] | None
    ) -> None:
        self.result = Indexed()
        self._index, self._model, self._total, self._progress = index, model, total, progress
        self._stale: list[_Item] = []
        self._described: list[tuple[_Item, npt.NDArray[np.float32]]] = []
        self._done = 0

    def unknown(self, looked: Iterable[_Item]) -> Iterator[_Item]:
        """Pass on the photos whose content the index does not hold, settle the others."""
        for item in looked:
            if item.trouble:
                self._give_up(item)
            elif found := self._index.find([item.content]):
                self._skip(item, found[item.content])
                self._count(1)
            else:
                yield item

    def take_in(self, ready: Iterator[_Item], batch_size: int) -> None:
        """Describe what was decoded, batch by batch, and commit it, also where an interrupt comes between."""
        try:
            while batch := list(islice(ready, batch_size)):
                self._describe(batch)
                if len(self._described) >= COMMIT_BATCHES * batch_size:
                    self._commit()
        except SaladError:  # nothing that another try would mend
            raise
        except BaseException:
            self._commit()
            raise
        self._commit()

    def _describe(self, batch: Sequence[_Item]) -> None:
        for item in batch:
            if item.pixels is None:
                self._give_up(item)
        good = [item for item in batch if item.pixels is not None]
        if good:
            pixels = [item.pixels for item in good if item.pixels is not None]
            rows = self._model.describe(pixels, batch_size=len(good))
            slim = (replace(item, pixels=None) for item in good)
            self._described += zip(slim, rows, strict=True)
            self._count(len(good))

    def _commit(self) -> None:
        """Add what is described; copies among it are kept once."""
        self._bring_up_to_date()  # first: a photo that moved away must not be taken for one that was replaced
        first: dict[str, int] = {}
        for number, (item, _) in enumerate(self._described):
            first.setdefault(item.content, number)
        # What was committed since we looked is there already: a copy among the photos before.
        before = self._index.find(list(first))
        fresh = [number for content, number in first.items() if content not in before]
        if fresh:
            self._add([self._described[number] for number in fresh])
        described, self._described = self._described, []
        held = self._index.find(list(first))
        for number in sorted(set(range(len(described))) - set(fresh)):
            item, _ = described[number]
            self._skip(item, held.get(item.content, item.known))
        self._bring_up_to_date()

    def _add(self, described: Sequence[tuple[_Item, npt.NDArray[np.float32]]]) -> None:
        items = [item for item, _ in described]
        rows = np.stack([row for _, row in described])
        contents = [item.content for item in items]
        self.result.added += self._index.add([item.known for item in items], rows, identities=contents)

    def _bring_up_to_date(self) -> None:
        """Commit new paths and positions of photos the index held already."""
        if self._stale:
            self._index.update([item.known for item in self._stale], [item.content for item in self._stale])
            self._stale.clear()

    def _skip(self, item: _Item, held: Photo) -> None:
        self.result.skipped += 1
        path = Path(os.path.realpath(item.path))
        if path != held.path and _in_place(held.path, item.content):
            self.result.twins.append(
                f"{item.path} is a copy of {held.path}, which is in the index: it was skipped"
            )
        elif path != held.path or _tells_more(item.known, held):
            self.result.moved += path != held.path
            self._stale.append(item)
            if len(self._stale) >= _STALE:
                self._bring_up_to_date()

    def _give_up(self, item: _Item) -> None:
        self.result.unreadable.append(item.trouble)
        self._count(1)

    def _count(self, photos: int) -> None:
        self._done += photos
        if self._progress is not None:
            self._progress(self._done, self._total)


def _look(reader: Here, path: Path, table: PhotoTable | None) -> _Item:
    """What is known of a photo without decoding it."""
    try:
        photo, content = reader.look(path)
    except SaladError as error:
        return _Item(path, trouble=str(error))
    return _Item(path, placed(photo, table), content)


def _decode(reader: Here, item: _Item, to: Preprocessing) -> _Item:
    try:
        return replace(item, pixels=reader.decode(item.path, to.height, to.width, to.resample))
    except SaladError as error:
        return replace(item, trouble=str(error))


def _in_place(path: Path, content: str) -> bool:
    """Whether the file at `path` still holds that content."""
    try:
        return content_hash(path) == content
    except SaladError:
        return False


def _tells_more(photo: Photo, held: Photo) -> bool:
    news = (photo.where, held.where), (photo.heading, held.heading), (photo.time, held.time)
    return any(new is not None and new != old for new, old in news)
