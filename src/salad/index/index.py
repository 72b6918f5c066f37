"""The index on disk: photos and descriptors in one folder, added, removed and searched, surviving a crash.

A change writes descriptors first and sees them onto the disk, then commits the table of photos, which says
how many rows count. Whatever a crash leaves is either committed or does not exist. docs/index-format.md tells
the folder.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
import numpy.typing as npt

from salad.errors import StoreError, WrongModelError
from salad.images.named import HeldPhoto
from salad.images.photo import Photo, content_hash
from salad.index import index_folder, verify
from salad.index.agreement import check_header, settle_before_writing
from salad.index.catalog import Catalog, Committed
from salad.index.code_table import CodeTable
from salad.index.codes import CodeFile, extend, newest
from salad.index.compact import Compacted, Dropping, compact
from salad.index.compress import Compressed, Progress, compress, is_due, take_away
from salad.index.contents import Page, listed, pages
from salad.index.decoders import decoded_earlier, note_decoder
from salad.index.filter_sql import allowed, compared_by_the_clock
from salad.index.header import Header
from salad.index.vectors import FileRows, Snapshot, append, storable, sums
from salad.index.verify import ChecksumVerifier, IndexInfo
from salad.search.base import Mask, Queries, Searcher, SearcherFactory
from salad.search.compressed import CompressedSearcher
from salad.search.exact import ExactSearcher
from salad.search.filters import Filter
from salad.search.hubness import Centred, Mean, mean_of_some

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike


Floats = npt.NDArray[np.floating]

CODES_FROM = 20_000
"""Photos from which on codes are asked: fewer are searched exactly in 30 ms (benchmarks/speed/codes_or_exact.py)."""


@dataclass(frozen=True, slots=True)
class Match:
    """A reference that looks like the query.

    Attributes:
        photo: The reference.
        score: Dot product of the two descriptors, the cosine of their angle; centred, if that was asked for, on all
            photos of the index. 1 is the same picture.
        row: Row of the index's matrix.
    """

    photo: Photo
    score: float
    row: int


class Index:
    """Photos with their descriptors in a folder. One writer at a time; any number of readers beside it.

    Make one with `Index.create` or `Index.open`; close it, or use it as a context manager. An open index sees
    what others commit: every search looks at the latest commit.
    """

    def __init__(
        self,
        folder: Path,
        header: Header,
        catalog: Catalog,
        *,
        searcher: SearcherFactory | None = None,
    ) -> None:
        self.folder = folder
        self.header = header
        self._catalog = catalog
        self._searcher = searcher
        # What threads share is swapped whole: whoever comes late works out the same once more, and no harm is done.
        self._last: tuple[Snapshot, ChecksumVerifier, Searcher] | None = None
        self._codes: CodeFile | None = None
        self._unusable: list[str] = []  # a sentence for each file of codes that cannot be used
        self._middle: tuple[int, Mean] | None = None  # the mean descriptor, of which generation

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
        return cls.open(index_folder.make(Path(os.path.realpath(folder)), header))

    @classmethod
    def open(cls, folder: str | Path, *, wait: float = 10.0, searcher: SearcherFactory | None = None) -> Index:
        """Open the index in `folder`; a folder that cannot be written can still be searched.

        Where the file of descriptors is cut short, the photos it lost are not found; `verify` names them.

        Args:
            folder: Where.
            wait: Seconds a change waits for another writer before it gives up.
            searcher: What searches the rows of a commit; made anew for each. Where not given, the index's codes
                (`compress`) if it has some and is large, else `ExactSearcher`, which may be given to force it.

        Raises:
            StoreError: If it is no index, a newer salad wrote it, or it is damaged.
        """
        home = Path(os.path.realpath(folder))  # a link bent elsewhere later does not move an open index
        header = Header.read(home)
        catalog = Catalog(home, wait=wait, before_writing=partial(settle_before_writing, home, header))
        index = cls(home, header, catalog, searcher=searcher)
        try:
            check_header(home, header, catalog)
            index._snapshot()  # what is damaged shows here, not at the first search
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
        with self._catalog.reading():
            return self._catalog.count()

    def add(
        self,
        photos: Sequence[Photo],
        descriptors: Floats,
        *,
        identities: Sequence[str] | None = None,
        update_known: bool = True,
    ) -> int:
        """Take in photos; all of them or, on an error, none.

        A content the index already holds keeps its row and descriptor, and takes the new path and whatever is
        newly known of it; the last of several in one call wins. A photo whose file now holds another content
        is removed.

        Args:
            photos: The photos; paths are stored absolute, links resolved.
            descriptors: `[N, dim]`, rows of length 1; stored as float16.
            identities: Content hash of each photo; of the files as they are now where not given. Whoever describes
                files gives those of the bytes that were described (`index_photos` does): a file that was saved anew
                since would get one version's identity with the other's descriptor.
            update_known: Whether contents the index already holds take their new path, or stay as they are.

        Returns:
            How many were new.

        Raises:
            StoreError: If the descriptors do not fit, another program is writing, the disk is full, or the
                file of descriptors is cut short.
            PhotoError: If a photo's content cannot be read to tell its identity.
        """
        rows = storable(descriptors, len(photos), self.dim)
        contents = [content_hash(photo.path) for photo in photos] if identities is None else list(identities)
        placed = _placed(photos)
        with self._catalog.writing():
            last = self._catalog.committed()
            known, first = self._catalog.rows_of(contents), dict[str, int]()
            for number, content in enumerate(contents):
                if content not in known:  # of several with one content, the first gives the descriptor
                    first.setdefault(content, number)
            fresh = list(first.values())
            if fresh:
                self._refuse_gaps(last)
                # Behind all others, and onto the disk, before the commit below says that they count.
                chosen = rows if len(fresh) == len(rows) else rows[fresh]
                append(self.folder / last.matrix, chosen, at=last.rows)
                extend(self._catalog, chosen, matrix=last.matrix, at=last.rows)
                new, names = [placed[n] for n in fresh], [contents[n] for n in fresh]
                self._catalog.insert(new, names, sums(chosen), row=last.rows)
            # All others, those that come a second time in this call too: what they know of a photo is added to it.
            again = [number for number, content in enumerate(contents) if first.get(content) != number]
            if update_known:
                self._catalog.update([placed[n] for n in again], [contents[n] for n in again])
            # Photos from before this call whose file holds another content now; below: not those just written.
            self._catalog.retire([photo.path for photo in placed], contents, below=last.rows)
            self._catalog.commit_rows(last.rows + len(fresh))
        return len(fresh)

    def _refuse_gaps(self, last: Committed) -> None:
        """Write nothing behind descriptors that are lost: the gap would be filled, and pass for theirs."""
        rows = FileRows(self.folder / last.matrix, rows=last.rows, dim=self.dim)
        lost = self._catalog.count(start=rows.held) if rows.held < last.rows else 0
        rows.close()
        if lost:
            raise StoreError(
                f"{rows.path} is truncated and lacks the descriptors of {lost} photos, so nothing was added: restore "
                f"it, or run 'salad compact {self.folder} --drop-damaged', which names those photos and lets go of "
                "them, and index them again"
            )

    def update(self, photos: Sequence[Photo], identities: Sequence[str]) -> None:
        """Give contents the index holds their path and what is newly known of them; pass over others."""
        placed = _placed(photos)
        with self._catalog.writing():
            self._catalog.update(placed, identities)
            self._catalog.retire([photo.path for photo in placed], identities)
            self._catalog.commit_rows(self._catalog.committed().rows)  # none more, but others see a commit

    def remove(self, paths: Sequence[str | Path]) -> int:
        """Forget the photos at these paths, or below them; how many. Their rows never come out again.

        The files themselves are not touched and need not exist.
        """
        return self._remove(index_folder.resolved(paths))

    def remove_missing(self, below: Sequence[str | Path] = ()) -> list[Path]:
        """Forget the photos that `missing` names, and say which they were."""
        gone = self.missing(below)
        if gone:
            self._remove(gone)
        return gone

    def compact(self, *, dropping: Dropping | None = None) -> Compacted:
        """Give back the room of removed photos. Others may search meanwhile; another writer waits.

        Args:
            dropping: Called with the photos whose descriptors are damaged or lost, if there are any, before anything is
                written; then they are let go of.

        Raises:
            StoreError: If photos are damaged and `dropping` is not given, another program is writing, or the disk has
                no room; nothing changed.
        """
        return compact(self.folder, self._catalog, dim=self.dim, dropping=dropping)

    def compress(self, size: int | None = None, *, progress: Progress | None = None) -> Compressed:
        """Give all photos codes, by which a large index is searched in a fraction of the time and of the memory.

        From then on additions, removals and compactions keep them up to date; `compress` again fits them anew where
        the index has outgrown them, and mends what is damaged. Others may search and write meanwhile.

        Args:
            size: Bytes of a code; as many as before where not given, else 256.
            progress: Called with (rows that have codes, rows).

        Raises:
            StoreError: If another program is writing, the disk is full, or the file of descriptors is cut short; what
                was done so far is gone on with next time.
        """
        if size is not None and size < 1:
            raise StoreError(f"codes of {size} bytes cannot be: give 1 or more")
        return compress(self._catalog, self._snapshot, dim=self.dim, size=size, progress=progress)

    def wants_codes(self) -> bool:
        """Whether `compress` has something to do: the index grew large, or out of its codes, or they are cut short.

        Never where `drop_codes` was called last.
        """
        return is_due(self._catalog, self._snapshot, dim=self.dim)

    def drop_codes(self) -> None:
        """Take the codes away; none are made until `compress` is called."""
        take_away(self._catalog)

    @property
    def noticed(self) -> list[str]:
        """What was wrong with the codes and is searched exactly instead, a sentence each."""
        return [*self._unusable, *(self._codes.noticed if self._codes else [])]

    def note_decoder(self, identities: Sequence[str]) -> None:
        """Remember that these contents are described from what today's decoder makes of them."""
        with self._catalog.writing():
            note_decoder(self._catalog, identities)

    def decoded_earlier(self, identities: Sequence[str]) -> set[str]:
        """Which of these contents, of those of which it matters, an earlier decoder showed to the model."""
        with self._catalog.reading():
            return decoded_earlier(self._catalog, identities)

    def known(self, identities: Sequence[str]) -> set[str]:
        """Which of these contents the index holds."""
        with self._catalog.reading():
            return set(self._catalog.rows_of(identities))

    def find(self, identities: Sequence[str]) -> dict[str, Photo]:
        """The photos with these contents, by content."""
        with self._catalog.reading():
            return self._catalog.find(identities)

    def taken(self, paths: Sequence[Path]) -> set[Path]:
        """At which of these absolute paths the index holds a photo."""
        with self._catalog.reading():
            return {path for _, path, _ in self._catalog.at_paths(paths)}

    def search(
        self, descriptors: Floats, *, k: int = 5, where: Filter | None = None, centred: bool = False
    ) -> list[list[Match]]:
        """The best k matches of each query: exact, best first, ties in order of row.

        A photo whose descriptor is damaged is not among them. A large index that has codes is asked by them: scores
        are the same, and of a hundred matches less than one is another (docs/compressed-search.md).

        Args:
            descriptors: `[Q, dim]`, or `[dim]` for one query.
            k: How many; a smaller index gives fewer.
            where: Which photos may be found; it holds before the ranking.
            centred: Whether scores leave out what all photos of the index have in common (`salad.search.hubness`).

        Raises:
            StoreError: If the descriptors are of another dimension or not finite, or k is below 1.
        """
        queries = self._queries(descriptors)
        if k < 1:
            raise StoreError(f"k is {k}: ask for at least one match")
        while True:
            with self._catalog.reading():
                seen, checksums, searcher = self._seen()
                alive = checksums.alive()
                may: Mask | Filter = alive
                if where is not None:
                    may = where if searcher.takes_filters else allowed(where, self._catalog, alive)
            # Outside of a look: a search may last, and nobody can commit during a look.
            seen.rows.keep()
            asked = Centred(searcher, self._mean(seen)) if centred else searcher
            hits = asked.search(queries, k=k, allowed=may)
            found = np.unique(hits.rows[hits.rows >= 0])
            found = found[alive[found]].tolist()  # who takes filters need not know what was removed
            with self._catalog.reading():
                # Again, where a compaction came between the search and the names, or damage came out on top.
                held = self._catalog.photos_at(found, vectors=seen.rows.path.name)
                if held is not None and checksums.passes(self._catalog, found):
                    break
        if where is not None:  # of a photo whose record is damaged nobody knows whether it may be found
            held = {row: known for row, known in held.items() if not known.trouble}
        return [
            [Match(held[row].photo, score, row) for row, score in zip(*best, strict=True) if row in held]
            for best in zip(hits.rows.tolist(), hits.scores.tolist(), strict=True)
        ]

    def compared_by_the_clock(self, where: Filter) -> int:
        """Of how many photos the time has a zone where a bound of this filter has none, or the other way about.

        They are compared by the clocks on the wall, as `Filter` says.
        """
        with self._catalog.reading():
            return compared_by_the_clock(where, self._catalog)

    def _queries(self, descriptors: Floats) -> Queries:
        with np.errstate(over="ignore"):  # a float64 beyond float32 is infinite there, and refused below
            queries = np.atleast_2d(np.asarray(descriptors, dtype=np.float32))
        if queries.ndim != 2 or queries.shape[1] != self.dim:
            raise StoreError(
                f"these descriptors have shape {list(np.shape(descriptors))}, but the index holds descriptors of "
                f"{self.dim} numbers: describe the query with the index's own model"
            )
        if not np.isfinite(queries).all():
            raise StoreError("a query's descriptor holds NaN or infinity: check the model and the photo it came from")
        return queries

    def photos(self) -> Iterator[Photo]:
        """Every photo, in order of row; memory stays small."""
        return (photo for photo, _ in listed(self._catalog))

    def held_photos(self) -> Iterator[HeldPhoto]:
        """Every photo as it may be opened, in order of row: only its own content is, whatever lies at its path now."""
        return (HeldPhoto(photo.path, content) for photo, content in listed(self._catalog))

    def pages(self) -> Iterator[Page]:
        """Every photo with its content and descriptor, as one commit holds them, some at a time.

        Raises:
            StoreError: If another program compacts the index meanwhile.
        """
        return pages(self._catalog, self._snapshot)

    def check_model(self, model: DescriberLike) -> None:
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
        """Read everything and say what is wrong, a sentence each; empty means sound.

        Photos whose descriptors are damaged or lost are named; all others can be used as before.
        """
        return verify.verify(self._catalog, self._snapshot)

    def missing(self, below: Sequence[str | Path] = ()) -> list[Path]:
        """Photos the index holds whose files are gone, of those below these folders where any are named.

        A file that may not be looked at is not gone.
        """
        roots = index_folder.resolved(below)
        paths = (photo.path for photo in self.photos())
        asked = (path for path in paths if not roots or any(path.is_relative_to(root) for root in roots))
        return [path for path in asked if index_folder.is_gone(path)]

    def count_below(self, folder: str | Path) -> int:
        """How many photos the index holds below a folder."""
        (home,) = index_folder.resolved([folder])
        with self._catalog.reading():
            return self._catalog.count_below(home)

    def at_null_island(self) -> int:
        """How many photos the index holds at 0,0, which counts as no position."""
        with self._catalog.reading():
            return self._catalog.at_null_island()

    def info(self) -> IndexInfo:
        """What the index holds, in numbers."""
        return verify.survey(self.folder, self.header, self._catalog)

    def close(self) -> None:
        """Let go of the files; the index cannot be used afterwards."""
        self._last = None
        self._catalog.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _snapshot(self) -> Snapshot:
        return self._seen()[0]

    def _seen(self) -> tuple[Snapshot, ChecksumVerifier, Searcher]:
        """The latest commit, what was checked of it, and what searches it; the same until somebody commits again."""
        # The file it names cannot be deleted under us: that takes a commit, and nobody commits during a look.
        with self._catalog.reading():
            last = self._catalog.committed()
            if self._last is None or self._last[0].generation != last.generation:
                rows = FileRows(self.folder / last.matrix, rows=last.rows, dim=self.dim)
                alive = np.ones(last.rows, dtype=np.bool_)
                alive[self._catalog.dead_rows()] = False
                alive[rows.held :] = False  # lost with the end of the file; the others can still be found
                seen = Snapshot(last.generation, rows, alive)
                self._last = seen, ChecksumVerifier(seen), self._searcher_of(rows)
            return self._last

    def _searcher_of(self, rows: FileRows) -> Searcher:
        """What searches the rows of a commit, inside of a look at it."""
        if self._searcher is not None:
            return self._searcher(rows)
        # Always looked for: what is wrong with codes is told where they are not used, too.
        self._codes, self._unusable = newest(
            CodeTable(self._catalog), matrix=rows.path.name, dim=self.dim, before=self._codes
        )
        if self._codes is None or len(rows) < CODES_FROM:
            return ExactSearcher(rows)
        return CompressedSearcher(rows, self._codes)

    def _mean(self, seen: Snapshot) -> Mean:
        """Of what this commit holds; worked out once."""
        last = self._middle
        if last is None or last[0] != seen.generation:
            self._middle = last = seen.generation, mean_of_some(seen.rows, seen.alive)
        return last[1]

    def _remove(self, paths: Sequence[Path]) -> int:
        with self._catalog.writing():
            removed = sum(self._catalog.remove(path) for path in paths)
            self._catalog.commit_rows(self._catalog.committed().rows)
        return removed


def _placed(photos: Sequence[Photo]) -> list[Photo]:
    paths = index_folder.resolved(photo.path for photo in photos)
    pairs = zip(photos, paths, strict=True)
    # As it is where its path is: to make a photo anew takes longer than all else here.
    return [photo if photo.path is path else replace(photo, path=path) for photo, path in pairs]
