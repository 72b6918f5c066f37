"""How an index is: what it holds, and whether its descriptors are what was written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salad.errors import StoreError
from salad.geo import metres
from salad.index import codes as code_files
from salad.index import index_folder, vectors
from salad.index.catalog import Catalog
from salad.index.code_table import CodeTable, way_out
from salad.index.facts import UNKNOWN
from salad.index.header import FORMAT_VERSION, Header
from salad.index.vectors import FileRows, Half, Snapshot
from salad.search.base import UNIT_TOLERANCE, Mask, Numbers
from salad.search.compressed import Bytes
from salad.search.filters import Box

_ROUNDING = 1e-3  # what float16 may take from a length, and add to it: half of 2^-10
_BLOCK = 1 << 22  # numbers looked at in one go
# What may be a time: a stranger's text may have 60 million letters, and is not brought here to be looked at.
_A_TIME = "WHERE typeof(time) = 'text' AND length(CAST(time AS BLOB)) BETWEEN 8 AND 40 AND time GLOB '[0-9]*'"
_OF_CODES = ("bytes_of_codes", "code_bytes", "coded", "codes_fitted_on")
_CHECKED = 1024  # rows found whose checksums are looked up in one go


@dataclass(frozen=True, slots=True)
class IndexInfo:
    """What an index holds.

    Attributes:
        photos: Photos that can be found.
        with_position: Those of them whose position is known.
        with_heading: Those of them whose heading is known.
        with_time: Those of them of which it is known when they were taken.
        removed: Removed photos whose room `compact` would give back.
        model: Name of the model.
        fingerprint: Its fingerprint.
        dim: Numbers in a descriptor.
        bytes: Size of the folder on disk.
        bytes_of_descriptors: How much of that are descriptors.
        bytes_of_codes: How much of that are codes.
        code_bytes: Bytes of codes a photo; None where it has no codes.
        coded: Photos that have codes, removed ones too.
        codes_fitted_on: Photos that the index held when the codes were fitted; None where it has none.
        created: When the index was made, UTC.
        box: South, west, north, east of all positions in degrees; west > east where it crosses the date line.
        span_km: How far that box reaches from south to north and, along its middle, from west to east.
        earliest: When the first of the photos was taken, by the clock where it was; ISO 8601.
        latest: When the last of them was.
        format_version: The form of the folder.
    """

    photos: int
    with_position: int
    with_heading: int
    with_time: int
    removed: int
    model: str
    fingerprint: str
    dim: int
    bytes: int
    bytes_of_descriptors: int
    bytes_of_codes: int
    code_bytes: int | None
    coded: int
    codes_fitted_on: int | None
    created: datetime
    box: Box | None
    span_km: tuple[float, float] | None
    earliest: str | None
    latest: str | None
    format_version: int

    def as_dict(self) -> dict[str, Any]:
        """These facts as JSON holds them; of codes where it has some."""
        told = {**asdict(self), "created": self.created.isoformat()}
        return {name: fact for name, fact in told.items() if self.code_bytes is not None or name not in _OF_CODES}


def survey(folder: Path, header: Header, catalog: Catalog) -> IndexInfo:
    """What the index in `folder` holds, in numbers."""
    with catalog.reading():  # one look, so that the numbers belong together
        last, positions = catalog.committed(), catalog.positions()
        version = FORMAT_VERSION if catalog.is_todays() else header.format_version
        codes = next(iter(CodeTable(catalog).sets(matrix=last.matrix)), None)
        ((photos, with_heading, with_time, earliest, latest),) = catalog.select(
            f"SELECT COUNT(*), COUNT(heading), COUNT(time), MIN(time) FILTER ({_A_TIME}), MAX(time) FILTER ({_A_TIME}) "
            "FROM photos WHERE removed = 0"
        )
    around = box(positions)
    return IndexInfo(
        photos=photos,
        with_position=len(positions),
        with_heading=with_heading,
        with_time=with_time,
        removed=last.rows - photos,
        model=header.model,
        fingerprint=header.fingerprint,
        dim=header.dim,
        bytes=index_folder.size(folder),
        bytes_of_descriptors=last.rows * header.dim * vectors.STORED.itemsize,
        bytes_of_codes=codes.rows * codes.size if codes else 0,
        code_bytes=codes.size if codes else None,
        coded=codes.rows if codes else 0,
        codes_fitted_on=codes.seen if codes else None,
        created=header.created,
        box=around,
        span_km=span_km(around) if around else None,
        earliest=_if_a_time(earliest),
        latest=_if_a_time(latest),
        format_version=version,
    )


def _if_a_time(text: str | None) -> str | None:
    """A time as the table has it; None also where somebody wrote what is none."""
    with suppress(ValueError):
        return text if text and datetime.fromisoformat(text) else None
    return None


def box(positions: npt.ArrayLike) -> Box | None:
    """The smallest box around (latitude, longitude) pairs `[N, 2]`, across the date line where that is smaller."""
    given = np.asarray(positions, dtype=np.float64)
    if not given.size:
        return None
    lats, lons = given.T
    east_of = np.sort(lons)
    gaps = np.diff(east_of, append=east_of[0] + 360)  # the box leaves out the widest of them
    widest = int(gaps.argmax()) if gaps.max() > gaps[-1] else len(gaps) - 1
    west, east = east_of[(widest + 1) % len(east_of)], east_of[widest]
    return float(lats.min()), float(west), float(lats.max()), float(east)


def span_km(around: Box) -> tuple[float, float]:
    """Kilometres from south to north, and from west to east along the middle of a box."""
    south, west, north, east = around
    middle, width = (south + north) / 2, (east - west) % 360
    # Wider than half the globe, the great circle would be the short way round: go by its half.
    across = 2 * float(metres(middle, 0.0, middle, width / 2))
    return round(float(metres(south, 0.0, north, 0.0)) / 1000, 3), round(across / 1000, 3)


def sound(rows: Half, sums: Numbers) -> Mask:
    """Which rows of `[n, dim]` are what was written, by the checksums noted in `sums`.

    Every row is of length 1; rounding to float16 moves it a bit. That alone is looked at where no checksum was noted
    (`UNKNOWN`).
    """
    now = np.array(vectors.sums(rows), dtype=np.int64)
    plausible = np.abs(vectors.lengths(rows) - 1) <= UNIT_TOLERANCE + _ROUNDING
    good: Mask = plausible & ((sums == now) | (sums == UNKNOWN))
    return good


def checked(rows: FileRows, alive: Mask, sums: Numbers) -> Iterator[tuple[int, Half, Mask]]:
    """Every row held, in blocks, and whether it is alive and sound.

    Args:
        rows: The matrix.
        alive: `[rows]`, which of them count.
        sums: `[rows]`, their checksums.

    Yields:
        The first row of a block, the block `[n, dim]`, whose memory is used again, and its mask `[n]`.
    """
    for start, block in rows.blocks(numbers=_BLOCK):
        here = slice(start, start + len(block))
        yield start, block, alive[here] & sound(block, sums[here])


def damaged(rows: FileRows, alive: Mask, sums: Numbers) -> list[int]:
    """Living rows that are not sound; those that the file does not even hold are not among them."""
    bad: list[int] = []
    for start, _, good in checked(rows, alive, sums):
        bad += (start + (alive[start : start + len(good)] & ~good).nonzero()[0]).tolist()
    return bad


class ChecksumVerifier:
    """The rows of one snapshot that were checked so far: what a search hands out is what was written.

    A flipped bit can make a descriptor like another photo's, and nothing in its numbers shows it. To check every row
    at every search would cost more than the search; to check those that come out on top costs next to nothing, and
    each is checked once.
    """

    def __init__(self, snapshot: Snapshot) -> None:
        self._snapshot = snapshot
        self._checked = np.zeros(len(snapshot.alive), dtype=np.bool_)
        self._damaged = np.zeros(len(snapshot.alive), dtype=np.bool_)

    def alive(self) -> Mask:
        """Rows that are alive and not known to be damaged: `[N]`."""
        return self._snapshot.alive & ~self._damaged if self._damaged.any() else self._snapshot.alive

    def passes(self, catalog: Catalog, rows: Iterable[int]) -> bool:
        """Whether these rows are what was written; those that are not will not be alive from now on.

        It belongs in a look in which the rows have the numbers they have in the snapshot.
        """
        found = np.fromiter(rows, dtype=np.int64)
        found = np.sort(found[~self._checked[found]])
        passed = True
        for low in range(0, len(found), _CHECKED):
            some = found[low : low + _CHECKED]
            wrong = ~sound(self._snapshot.rows.take(some), catalog.sums_at(some))
            self._checked[some] = True
            self._damaged[some[wrong]] = True
            passed = passed and not wrong.any()
        return passed


def verify(catalog: Catalog, look: Callable[[], Snapshot]) -> list[str]:
    """Read everything and say what is wrong, a sentence each; empty means sound.

    Args:
        catalog: The photos.
        look: Gives the latest commit.
    """
    said: list[str] = []
    for part in (
        partial(catalog_trouble, catalog),
        partial(vectors_trouble, catalog, look),
        partial(codes_trouble, catalog, look),
    ):
        try:
            said += part()
        except StoreError as error:  # so damaged that it cannot be read: that is what we were asked for
            said.append(str(error))
    return list(dict.fromkeys(said))  # several parts may meet with the same damage


def catalog_trouble(catalog: Catalog) -> list[str]:
    """What is wrong with the table of photos, a sentence each."""
    with catalog.reading():
        catalog.committed()
        said = [text for (text,) in catalog.select("PRAGMA integrity_check") if text != "ok"]
        said += filter(None, [catalog.contradiction()])
        said = [f"{catalog.path} is damaged ({text}): restore it, or index the photos again" for text in said]
        # As they are written, whatever number a row has: a damaged one may have any.
        last = -(1 << 63)
        while page := catalog.after(last, removed=True):
            said += [known.trouble for known in page if known.trouble]
            last = page[-1].row
        return said


def vectors_trouble(catalog: Catalog, look: Callable[[], Snapshot]) -> list[str]:
    """What is wrong with the file of descriptors, a sentence for each photo hit."""
    named = None
    while named is None:  # again, where a compaction came between
        with catalog.reading():
            seen, sums = look(), catalog.sums()
            lost = catalog.live_rows(start=seen.rows.held).tolist()
        bad = damaged(seen.rows, seen.alive, sums)
        named = catalog.photos_at([*bad, *lost], vectors=seen.rows.path.name)
    said = []
    if lost:
        said.append(
            f"{seen.rows.path} is truncated: it holds {seen.rows.held} descriptors, {seen.rows.rows} were "
            "committed; restore it, or let go of the photos whose descriptors it lost and index them again"
        )
    return said + [
        f"{known.photo.path} has {'lost its' if row >= seen.rows.held else 'a damaged'} descriptor: remove it and "
        "index it again"
        for row, known in named.items()
    ]


def codes_trouble(catalog: Catalog, look: Callable[[], Snapshot]) -> list[str]:
    """What is wrong with the codes, a sentence each: whether they are what was written, and codes of these rows."""
    with catalog.reading():
        seen, sums = look(), catalog.sums()
        file, said = code_files.newest(CodeTable(catalog), matrix=seen.rows.path.name, dim=seen.rows.dim)
    if file is None:
        return said
    step = max(1, _BLOCK // seen.rows.dim)
    spare: Half = np.empty((step, seen.rows.dim), np.float16)
    wrong = 0
    for first, codes in file.all():
        for start in range(first, first + (0 if codes is None else len(codes)), step):
            assert codes is not None  # for mypy: else there is nothing to pass through
            some: Bytes = codes[start - first : start - first + step]
            rows = seen.rows.block(start, start + len(some), spare)
            here = slice(start, start + len(rows))
            # Another processor may round a number the other way.
            off = np.abs(file.coding.encode(rows).astype(np.int16) - some[: len(rows)]).max(axis=1) > 1
            wrong += int(np.count_nonzero(off & seen.alive[here] & sound(rows, sums[here])))
    if wrong:
        said.append(f"{file.path} holds codes of other descriptors for {wrong} photos: {way_out(catalog.path.parent)}")
    return said + file.noticed
