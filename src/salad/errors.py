"""Everything that can go wrong, as one tree.

    SaladError
    ├── PhotoError            a photo cannot be read
    ├── PositionError         a position, a table of positions or an `@` name makes no sense
    ├── WeightsError          weights are missing, unknown, or not what they say
    │   └── FetchError        weights could not be fetched
    ├── ModelError            a model cannot be built or used as asked
    │   └── TooFewTokensError a photo gives fewer tokens than there are clusters
    ├── SearchError           a search was asked for what cannot be
    ├── StoreError            an index on disk cannot be used
    │   └── WrongModelError   an index was made with another model
    ├── BenchmarkError        a data set or its ground truth cannot be read
    ├── TrainingError         a training run cannot begin, go on, or end well
    └── MissingExtraError     an optional dependency is not installed

Every message says what is wrong, with which file or value, and what to do. The command line prints it as it
stands and exits with 2; nothing else in the package catches a `SaladError` it cannot mend.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class SaladError(Exception):
    """Base of every error this package raises on purpose."""


class PhotoError(SaladError):
    """A photo cannot be read: not there, empty, truncated, too large, or not an image."""


class PositionError(SaladError):
    """A position, a table of positions or an `@` name makes no sense."""


class WeightsError(SaladError):
    """Weights are missing, unknown, or not what they say they are."""


class FetchError(WeightsError):
    """Weights could not be fetched; the message names the file to put in place by hand."""


class ModelError(SaladError):
    """A model cannot be built or used as asked."""


class TooFewTokensError(ModelError):
    """A photo gives fewer tokens than the model has clusters."""


class SearchError(SaladError):
    """A search was asked for what cannot be: queries of another dimension or not finite, damaged rows, no match."""


class StoreError(SaladError):
    """An index on disk cannot be opened, read or written."""


class WrongModelError(StoreError):
    """An index holds descriptors of another model than the one in hand."""


class BenchmarkError(SaladError):
    """A data set or its ground truth cannot be read, or does not fit together."""


class TrainingError(SaladError):
    """A training run cannot begin, go on, or end well; what it saved before stays."""


class MissingExtraError(SaladError):
    """An optional dependency is not installed; the message names the extra that brings it."""

    def __init__(self, what: str, extra: str) -> None:
        """Say that `what` needs the extra named `extra`."""
        super().__init__(f"{what} needs the '{extra}' extra: pip install 'salad-vpr[{extra}]'")
        self._made_of = what, extra

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str]]:
        return type(self), self._made_of  # else no other process could make it again of its sentence


def reason(error: BaseException) -> str:
    """Why something went wrong, for the middle of a sentence: what the system says without its number for it."""
    return (isinstance(error, OSError) and error.strerror) or str(error)


@contextmanager
def needs_extra(what: str, extra: str) -> Iterator[None]:
    """Import an optional dependency, or what leans on one, in the block of this.

    Args:
        what: What the import is for, as a sentence begins with it.
        extra: The extra that brings the dependency.

    Raises:
        MissingExtraError: If the dependency is not installed.
    """
    try:
        yield
    except ImportError as error:
        if (error.name or "").partition(".")[0] == "salad":  # one of our own modules: no extra would bring it
            raise
        raise MissingExtraError(what, extra) from error
