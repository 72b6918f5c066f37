"""Photos in, places out: each is described, searched for and voted on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from salad.errors import PhotoError
from salad.images.decode import Pixels
from salad.images.workers import Workers
from salad.localize.voting import GENERIC, RADIUS_M, Place, Voting, vote
from salad.network.config import Calibration

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from salad.index.index import Match
    from salad.models.describer import DescriberLike
    from salad.network.config import Preprocessing
    from salad.search.filters import Filter


class PhotoIndex(Protocol):
    """What `locate` asks of an index: `salad.Index`, or anything that answers the same two questions."""

    def check_model(self, model: DescriberLike) -> None:
        """Make sure that `model` is the one the index was made with.

        Raises:
            WrongModelError: If it is another.
        """
        ...

    def search(
        self, descriptors: npt.NDArray[np.float32], *, k: int, where: Filter | None, centred: bool
    ) -> list[list[Match]]:
        """The best k matches of each query, best first, of the photos that `where` lets through.

        Args:
            descriptors: `[Q, dim]`
            k: How many; a smaller index gives fewer.
            where: Which photos may be found; all where None.
            centred: Whether scores leave out what all photos of the index have in common.
        """
        ...


@dataclass(frozen=True, slots=True)
class Answer:
    """A query, its place, and what that rests on.

    Attributes:
        query: The photo.
        place: Where it was taken; None where unknown.
        matches: The photos of the index most like it, best first.
        others: Places that came after, the heaviest first; one that was not sure enough to be the place leads them.
    """

    query: Path
    place: Place | None
    matches: list[Match]
    others: list[Place] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """This answer as JSON holds it; null for what is unknown, times in ISO 8601."""
        return {
            "query": str(self.query),
            "place": self.place.as_dict() if self.place else None,
            # The score stands behind the path, before what is known of the photo, as it always has.
            "matches": [
                {"path": str(match.photo.path), "score": match.score} | match.photo.as_dict() for match in self.matches
            ],
            "others": [place.as_dict() for place in self.others],
        }


def calibration_of(model: DescriberLike) -> Calibration:
    """What the model's scores are worth; a generic guess where nobody has measured that."""
    # By name, since not every describer has one: the name is part of what a model offers, and must stay.
    own = getattr(model, "calibration", None)
    return own if isinstance(own, Calibration) else GENERIC


def locate(
    query: str | Path,
    *,
    index: PhotoIndex,
    model: DescriberLike,
    k: int = 5,
    where: Filter | None = None,
    radius_m: float = RADIUS_M,
    min_confidence: float | None = None,
    voting: Voting = vote,
) -> Answer:
    """Where a photo was taken.

    Args:
        query: The photo.
        index: The photos whose places are known.
        model: The model the index was made with.
        k: How many matches vote.
        where: Which photos of the index may be found; all where not given.
        radius_m: How far apart, in metres, matches may be and still mean one place.
        min_confidence: A place less sure than this is unknown; the model's own limit where not given.
        voting: How matches become places.

    Raises:
        PhotoError: If the photo cannot be read.
        WrongModelError: If the index was made with another model.
    """
    return next(  # it has one answer, or raises
        locate_many(
            [Path(query)],
            index=index,
            model=model,
            k=k,
            where=where,
            radius_m=radius_m,
            min_confidence=min_confidence,
            voting=voting,
        )
    )


def locate_many(
    queries: Sequence[Path],
    *,
    index: PhotoIndex,
    model: DescriberLike,
    k: int = 5,
    where: Filter | None = None,
    radius_m: float = RADIUS_M,
    min_confidence: float | None = None,
    voting: Voting = vote,
    batch_size: int = 16,
    threads: int | None = None,
    on_unreadable: Callable[[str], None] | None = None,
) -> Iterator[Answer]:
    """Where photos were taken, one answer after another in the order of the queries; memory stays small.

    Args:
        queries: The photos.
        index: The photos whose places are known.
        model: The model the index was made with.
        k: How many matches vote.
        where: Which photos of the index may be found; all where not given.
        radius_m: How far apart, in metres, matches may be and still mean one place.
        min_confidence: A place less sure than this is unknown; the model's own limit where not given.
        voting: How matches become places.
        batch_size: Photos the model takes at a time.
        threads: Photos read at a time; one a processor where not given.
        on_unreadable: Called with a sentence for each photo that cannot be read, which then has no answer;
            where not given, the first such photo raises.

    Raises:
        PhotoError: If a photo cannot be read and `on_unreadable` is not given.
        WrongModelError: If the index was made with another model.
    """
    # Descriptors of two models have nothing to do with one another, whatever their scores.
    index.check_model(model)
    calibration = calibration_of(model)
    limit = calibration.min_confidence if min_confidence is None else min_confidence
    to = model.preprocessing
    with Workers(len(queries), at_once=threads) as workers:
        # Two batches are decoded ahead, so that the model never waits for photos, and no more, so that memory is small.
        decoded = workers.in_order(lambda path: _decoded(workers, path, to), queries, ahead=2 * batch_size)
        readable = _readable(decoded, on_unreadable)
        while batch := list(islice(readable, batch_size)):
            descriptors = model.describe([pixels for _, pixels in batch], batch_size=batch_size)
            # Confidence is only right for the kind of score that the calibration was fitted to.
            found = index.search(descriptors, k=k, where=where, centred=calibration.centred)
            for (query, _), matches in zip(batch, found, strict=True):
                places = voting(matches, radius_m=radius_m, calibration=calibration)
                if places and places[0].confidence >= limit:
                    yield Answer(query, places[0], matches, places[1:])
                else:  # what was not sure enough still leads the others
                    yield Answer(query, None, matches, places)


# A photo that cannot be read must not end the pass over all others: so its error comes along in its place.


def _decoded(workers: Workers, path: Path, to: Preprocessing) -> tuple[Path, Pixels | PhotoError]:
    try:
        return path, workers.decode(path, to.height, to.width, to.resample)
    except PhotoError as error:
        return path, error


def _readable(
    decoded: Iterable[tuple[Path, Pixels | PhotoError]], on_unreadable: Callable[[str], None] | None
) -> Iterator[tuple[Path, Pixels]]:
    for path, pixels in decoded:
        if not isinstance(pixels, PhotoError):
            yield path, pixels
        elif on_unreadable is None:
            raise pixels
        else:
            on_unreadable(str(pixels))
