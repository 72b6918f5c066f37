"""Describing both sides of a benchmark, photo by photo, or from descriptors described before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32

from salad.errors import BenchmarkError, ModelError, PhotoError
from salad.evaluation.ranking import Held, Rows
from salad.photos import Photo

if TYPE_CHECKING:
    from salad.model.describer import Describes

Progress = Callable[[int, int], None]


class Described:
    """How photos become descriptors: by a model, in batches, each checked.

    Args:
        model: what turns photos into descriptors.
        batch_size: photos described at once.
    """

    def __init__(self, model: Describes, *, batch_size: int) -> None:
        self.model, self.batch_size = model, batch_size

    def batch(self, paths: Sequence[Path]) -> Float32[np.ndarray, "photos dim"]:
        """Describe some photos.

        Raises:
            BenchmarkError: one cannot be read: a figure with holes is no figure.
            ModelError: the model gives descriptors of another shape than it says, or numbers that are not finite.
        """
        try:
            described = self.model.describe(paths, batch_size=self.batch_size)
        except PhotoError as error:
            raise unreadable(error) from error
        due = (len(paths), self.model.dim)
        if described.shape != due or not np.isfinite(described).all():
            raise ModelError(
                f"model '{self.model.name}' gave {described.shape} numbers for {len(paths)} photos "
                f"from {paths[0]} on, where {due} finite ones were due: use other weights"
            )
        return described

    def sides(
        self, references: Sequence[Photo], queries: Sequence[Photo], *, progress: Progress | None
    ) -> tuple[Rows, Rows]:
        """Describe references and queries, in memory."""
        total, done, sides = len(references) + len(queries), 0, []
        for photos in (references, queries):
            descriptors = np.empty((len(photos), self.model.dim), dtype=np.float32)
            for start in range(0, len(photos), self.batch_size):
                some = range(start, min(start + self.batch_size, len(photos)))
                descriptors[some.start : some.stop] = self.batch([photos[row].path for row in some])
                done += len(some)
                if progress is not None:
                    progress(done, total)
            sides.append(Held(descriptors))
        return sides[0], sides[1]


def unreadable(error: PhotoError) -> BenchmarkError:
    """What to say of a photo that cannot be read."""
    return BenchmarkError(
        f"a figure with holes is no figure, and a photo cannot be read: {error}; mend it, or take it out of the set"
    )
