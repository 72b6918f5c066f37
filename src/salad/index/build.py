"""From photos to an index: known ones are skipped, unreadable ones named, the rest described and added.

Workers read photos while the model describes the batch before; only a few batches are in memory at any time. A
photo at a path that the index does not know is hashed and decoded in one trip, from the same bytes; one at a path
that it knows is most likely the same still: it is hashed, its EXIF read, and nothing decoded. That is a guess. What
decides is what the index says of a batch's contents before it is described, and, since others may write to it too,
once more inside the commit.

Every few batches are committed, and so is what is described when an interrupt comes, so that it loses little and the
next run goes on where this one stopped.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from salad.errors import SaladError
from salad.images.decode import Pixels
from salad.images.metadata import NOTHING_SAID
from salad.images.photo import Photo, content_hash, placed
from salad.images.photo_table import PhotoTable
from salad.images.worker_process import Size
from salad.images.workers import Workers
from salad.index.changes import Changes
from salad.index.facts import with_news
from salad.index.index import Index
from salad.index.index_folder import resolved

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike

COMMIT_BATCHES = 8  # batches between commits: what a loss of power can cost
_STALE = 1000  # photos to bring up to date in one commit
_PAGE = 1000  # paths the index is asked about at once
OUTDATED = "an earlier salad described it, and may have seen less in it: remove it and index it again"
_FEW = 3  # photos named that know no position


@dataclass(slots=True)
class Indexed:
    """What `index_photos` did; added + skipped + len(unreadable) is the number of photos given.

    Attributes:
        added: Photos that are new in the index.
        skipped: Photos whose content was there already.
        moved: Those of the skipped whose file had another path before, which was updated.
        twins: A sentence for each of the skipped that is a copy of another photo still in its place.
        unreadable: A sentence for each photo that could not be read.
        unplaced: Photos given that are in the index now, and of which it knows no position.
        first_unplaced: The first of them with the reason: `a.jpg (its EXIF says 0,0, which counts as no position)`.
        changes: What the index says otherwise of the skipped.
        decoded_earlier: Those of the skipped whose descriptor is of another picture than is made of them today.
    """

    added: int = 0
    skipped: int = 0
    moved: int = 0
    twins: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)
    unplaced: int = 0
    first_unplaced: list[str] = field(default_factory=list)
    changes: Changes = field(default_factory=Changes)
    decoded_earlier: list[Path] = field(default_factory=list)


State = Literal["added", "held", "copy", "unreadable"]


class Outcome(NamedTuple):
    """What became of one photo.

    Attributes:
        photo: What is known of it now.
        state: Whether it was added, was in the index already, is a copy of another photo that is in its place, or
            could not be read.
        why: Why it is a copy or cannot be read, or knows no position: a text, empty where there is nothing to say.
    """

    photo: Photo
    state: State
    why: str


@dataclass(frozen=True, slots=True)
class _Item:
    """A photo on its way in.

    Attributes:
        path: Its file.
        photo: What is known of it; no more than its path where its file cannot be read.
        content_hash: Which photo it is; empty where its file cannot be read.
        pixels: `[height, width, 3]`, where they were decoded.
        trouble: Why it cannot be read, if so: a sentence.
        deep_grey: Whether it is grey of more than eight bits.
    """

    path: Path
    photo: Photo
    content_hash: str = ""
    pixels: Pixels | None = None
    trouble: str = ""
    deep_grey: bool = False


def index_photos(
    sources: Sequence[Path],
    index: Index,
    model: DescriberLike,
    *,
    table: PhotoTable | None = None,
    batch_size: int = 16,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    on_photo: Callable[[Outcome], None] | None = None,
) -> Indexed:
    """Describe photos and add them to an index.

    A photo is known by its content: one the index holds is not described again, its path and position are
    brought up to date if the file moved, and a copy of a photo that is still in its place is skipped and
    named.

    Args:
        sources: Files, as `salad.images.finding.find_photos` lists them.
        index: Where to; it must have been made with `model`.
        model: What describes them.
        table: Positions of photos, before `@` names and EXIF.
        batch_size: Photos the model takes at a time.
        threads: Photos read at a time; one a processor where not given.
        progress: Called with (photos done, photos given) as they are done.
        on_photo: Called with what became of each photo, in the order in which it is settled.

    Raises:
        WrongModelError: If the index was made with another model.
        StoreError: If the index cannot be written; what was committed before stays.
    """
    index.check_model(model)
    run = _Run(index, model, len(sources), progress, on_photo)
    to = model.preprocessing
    with Workers(len(sources), at_once=threads) as workers:
        read = partial(_read, workers, table, (to.height, to.width, to.resample))
        items = workers.in_order(read, _with_guess(sources, index), ahead=2 * batch_size)
        run.take_in(run.unknown(items, lambda path: workers.submit(read, (path, False)), batch_size), batch_size)
    return run.result


def _with_guess(sources: Sequence[Path], index: Index) -> Iterator[tuple[Path, bool]]:
    """Each path, and whether the index holds a photo there."""
    for low in range(0, len(sources), _PAGE):
        page = sources[low : low + _PAGE]
        places = resolved(page)
        held = index.taken(places)
        yield from ((path, place in held) for path, place in zip(page, places, strict=True))


def _read(workers: Workers, table: PhotoTable | None, size: Size, source: tuple[Path, bool]) -> _Item:
    """One trip to a photo; its pixels are decoded where it is not guessed to be known."""
    path, guessed_known = source
    try:
        found = workers.read(path, None if guessed_known else size)
    except SaladError as error:
        return _Item(path, Photo(path), trouble=str(error))
    return _Item(path, placed(found.photo, table), found.content_hash, found.pixels, found.trouble, found.deep_grey)


class _Run:
    """One run of `index_photos`: what is counted so far, and what waits for the next commit."""

    def __init__(
        self,
        index: Index,
        model: DescriberLike,
        total: int,
        progress: Callable[[int, int], None] | None,
        on_photo: Callable[[Outcome], None] | None,
    ) -> None:
        self.result = Indexed()
        self._index, self._model, self._total = index, model, total
        self._progress, self._on_photo = progress, on_photo
        self._stale: list[_Item] = []
        self._described: list[tuple[_Item, npt.NDArray[np.float32]]] = []
        self._done = 0

    def unknown(
        self, items: Iterator[_Item], decode: Callable[[Path], Future[_Item]], batch_size: int
    ) -> Iterator[_Item]:
        """Pass on the photos whose content the index does not hold, decoded; settle the others.

        Args:
            items: Photos as they were read.
            decode: Begins a second trip to a photo.
            batch_size: Photos the index is asked about at once.
        """
        while batch := list(islice(items, batch_size)):
            held = self._index.find([item.content_hash for item in batch if item.content_hash])
            news = [item for item in batch if item.content_hash not in held]
            # A wrong guess: the file was replaced, or somebody has removed its photo from the index meanwhile.
            again = {item.path: decode(item.path) for item in news if item.pixels is None and not item.trouble}
            for number, item in enumerate(batch):
                if item.path in again:
                    batch[number] = item = again[item.path].result()
                if item.content_hash in held:
                    self._skip(item, held[item.content_hash])
                    self.result.skipped += 1
                    self._count(1)
                elif item.trouble:
                    self.result.unreadable.append(item.trouble)
                    self._tell(Outcome(item.photo, "unreadable", item.trouble))
                    self._count(1)
                else:
                    yield item

    def take_in(self, items: Iterator[_Item], batch_size: int) -> None:
        """Describe what was decoded, batch by batch, and commit it, also where an interrupt comes between."""
        try:
            while batch := list(islice(items, batch_size)):
                pixels = [item.pixels for item in batch if item.pixels is not None]
                rows = self._model.describe(pixels, batch_size=len(batch))
                self._described += zip((replace(item, pixels=None) for item in batch), rows, strict=True)
                self._count(len(batch))
                if len(self._described) >= COMMIT_BATCHES * batch_size:
                    self._commit()
        except SaladError:  # nothing that another try would mend
            raise
        except BaseException:
            self._commit()
            raise
        self._commit()

    def _commit(self) -> None:
        """Add what is described; of copies among it, and of what somebody else has added meanwhile, one is kept."""
        self._bring_up_to_date()  # first: a photo that moved away must not be taken for one that was replaced
        if not self._described:
            return
        items = [item for item, _ in self._described]
        hashes = [item.content_hash for item in items]
        rows = np.stack([row for _, row in self._described])
        if deep := [item.content_hash for item in items if item.deep_grey]:
            self._index.note_decoder(deep)  # before they are held: a kill in between costs a word, not a photo
        added = self._index.add([item.photo for item in items], rows, identities=hashes, update_known=False)
        self._described = []
        self.result.added += added
        self.result.skipped += len(items) - added
        held = self._index.find(hashes) if added < len(items) else {}
        for item in items:
            if item.content_hash in held:  # what was added just now is among them
                self._skip(item, held[item.content_hash], at_its_place="added")
            else:
                self._keep(item.photo, "added")
        self._bring_up_to_date()

    def _bring_up_to_date(self) -> None:
        """Commit new paths and positions of photos the index held already."""
        if self._stale:
            self._index.update([item.photo for item in self._stale], [item.content_hash for item in self._stale])
            self._stale.clear()

    def _skip(self, item: _Item, held: Photo, *, at_its_place: State = "held") -> None:
        """Note what is new of a photo that the index holds: nothing, where it is the one it holds."""
        path, known = Path(os.path.realpath(item.path)), with_news(held, item.photo)
        still_there = False
        if path != held.path:
            with suppress(SaladError):
                still_there = content_hash(held.path) == item.content_hash
        if still_there:
            twin = f"{item.path} is a copy of {held.path}, which is in the index: it was skipped"
            self.result.twins.append(twin)
            self._tell(Outcome(item.photo, "copy", twin))
            return
        self.result.moved += path != held.path
        if self.result.changes.note(held, known) or path != held.path or known.source != held.source:
            self._stale.append(item)
            if len(self._stale) >= _STALE:
                self._bring_up_to_date()
        outdated = item.deep_grey and bool(self._index.decoded_earlier([item.content_hash]))
        if outdated:
            self.result.decoded_earlier.append(item.path)
        self._keep(known, at_its_place if path == held.path else "held", outdated=outdated)

    def _keep(self, photo: Photo, state: State, *, outdated: bool = False) -> None:
        """A photo is in the index: say so, and count it where nobody knows its position."""
        why = photo.remark or (NOTHING_SAID if photo.where is None else "")
        if photo.where is None:
            self.result.unplaced += 1
            if len(self.result.first_unplaced) < _FEW:
                self.result.first_unplaced.append(f"{photo.path.name} ({why})")
        self._tell(Outcome(photo, state, "; ".join(filter(None, [why, OUTDATED if outdated else ""]))))

    def _tell(self, outcome: Outcome) -> None:
        if self._on_photo is not None:
            self._on_photo(outcome)

    def _count(self, photos: int) -> None:
        self._done += photos
        if self._progress is not None:
            self._progress(self._done, self._total)
