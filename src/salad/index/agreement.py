"""What an index states in two places must agree before anything is written; and its form is brought up to date.

One digit of `index.json` changed, and every descriptor looks damaged; a table that lists other rows than were
committed has photos written over. So the first change of an open index looks at both sides, refuses to write where
they differ, and gives what an earlier version wrote today's form: `index.json` first, so that a salad that does not
know that form leaves the table alone whatever happens in between.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from salad.errors import StoreError
from salad.index import verify
from salad.index.catalog import Catalog
from salad.index.database import shortened
from salad.index.header import HEADER_FILE, Header
from salad.index.index_folder import settle
from salad.index.vectors import STORED, FileRows

_SAMPLED = 16  # descriptors looked at


def check_header(folder: Path, header: Header, catalog: Catalog) -> None:
    """See that `index.json` and the table speak of the same model.

    Raises:
        StoreError: If they do not.
    """
    with catalog.reading():
        catalog.committed()
        held = catalog.made_with()
    said = header.dim, header.fingerprint
    if held is not None and held != said:
        raise _differ(folder, f"{said[0]} numbers of {said[1]}", shortened(f"{held[0]} of {held[1]}"))


def settle_before_writing(folder: Path, header: Header, catalog: Catalog) -> None:
    """Inside of a change, before anything else of it.

    Raises:
        StoreError: If index.json, the table and the file of descriptors contradict each other; nothing was changed.
    """
    catalog.committed()
    if wrong := catalog.contradiction():
        raise StoreError(
            f"{catalog.path} is damaged ({wrong}), so nothing is written to it: restore it, or index the photos again"
        )
    if catalog.made_with() is None:
        _refuse_other_dim(folder, header, catalog)
    _bring_up_to_date(folder, header, catalog)


def _refuse_other_dim(folder: Path, header: Header, catalog: Catalog) -> None:
    """Format 1 has the dimension in index.json alone: there the descriptors themselves must bear it out."""
    last = catalog.committed()
    rows = FileRows(folder / last.matrix, rows=last.rows, dim=header.dim)
    try:
        whole = rows.path.stat().st_size == last.rows * header.dim * STORED.itemsize
        some = np.unique(np.linspace(0, rows.held - 1, min(rows.held, _SAMPLED)).astype(np.int64))
        if not whole and len(some) and not verify.sound(rows.take(some), catalog.sums_at(some)).any():
            raise StoreError(
                f"{folder / HEADER_FILE} says {header.dim} numbers a descriptor, and none of those looked at in "
                f"{rows.path} is what was written: one of the two is damaged; restore it"
            )
    finally:
        rows.close()


def _bring_up_to_date(folder: Path, header: Header, catalog: Catalog) -> None:
    if catalog.is_todays():
        return
    try:
        header.raised(folder)
        settle(folder)
    except OSError as error:
        raise StoreError(
            f"{folder} has the form of an earlier salad, and cannot be given today's ({error.strerror}): make room, or "
            "check permissions"
        ) from error
    catalog.bring_up_to_date(header.dim, header.fingerprint)


def _differ(folder: Path, said: str, held: str) -> StoreError:
    return StoreError(
        f"{folder / HEADER_FILE} says {said}, and the table of photos {held}: one of the two is damaged; restore it"
    )
