"""One index into another: photos with the descriptors they have, each content once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salad.index.exchange import wrong_model
from salad.index.store import Index
from salad.photos import Photo


@dataclass(frozen=True, slots=True)
class Merged:
    """What `merge` did.

    Attributes:
        added: Photos that are new in the index.
        held: Photos whose content it held already.
        other: Photos left out since the index holds another content at their path.
        damaged: Photos left out since their descriptors are damaged or lost.
    """

    added: int
    held: int
    other: list[Path]
    damaged: list[Path]


def merge(into: Index, other: Index) -> Merged:
    """Take the photos of another index of the same model; each content is held once.

    A content both hold keeps its place in `into`, which learns what only the other knows of it. Where both
    have a photo at one path with different contents, `into` keeps its own. Interrupted, it goes on when
    called again.

    Raises:
        WrongModelError: If they are of different models.
        StoreError: If `into` cannot be written, or `other` is compacted meanwhile.
    """
    if other.fingerprint != into.fingerprint:
        raise wrong_model(into, other.folder, other.model, other.fingerprint)
    added, held, left, damaged = 0, 0, list[Path](), list[Path]()
    for page in other.pages():
        known = into.find(page.identities)
        taken = into.taken([photo.path for photo in page.photos])
        news = list(zip(page.photos, page.identities, strict=True))
        fresh = [n for n, (photo, i) in enumerate(news) if i not in known and photo.path not in taken]
        added += into.add(
            [page.photos[n] for n in fresh],
            page.descriptors[fresh],
            identities=[page.identities[n] for n in fresh],
        )
        _learn(into, known, news)
        held += len(known)
        left += [photo.path for photo, i in news if i not in known and photo.path in taken]
        damaged += page.damaged
    return Merged(added, held, left, damaged)


def _learn(into: Index, known: dict[str, Photo], news: Sequence[tuple[Photo, str]]) -> None:
    """Tell `into` what only the other index knows of the photos both hold."""
    filled = {
        i: replace(
            known[i],
            where=known[i].where or photo.where,
            heading=photo.heading if known[i].heading is None else known[i].heading,
            time=known[i].time or photo.time,
        )
        for photo, i in news
        if i in known
    }
    more = [i for i, photo in filled.items() if photo != known[i]]
    if more:
        into.update([filled[i] for i in more], more)
