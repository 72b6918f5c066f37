"""Values of a saved result, which somebody else may have written: each is of its very type, and within its bounds."""

from __future__ import annotations

import math
from typing import Any

from salad.evaluation.bootstrap import Interval

_MOST = 1 << 53  # of what is counted: beyond it a float no longer counts by ones


def exactly(kind: type, value: Any) -> Any:
    """The value, which is of that very type: no bool for an int, no list of letters for a str.

    Raises:
        TypeError: If it is not.
    """
    if type(value) is not kind:
        raise TypeError(f"{str(value)[:60]!r} is no {kind.__name__}")
    return value


def count(value: Any, *, least: int = 0) -> int:
    """A whole number that something is counted or numbered by.

    Raises:
        TypeError: If it is none.
        ValueError: If it is below `least`, or beyond counting.
    """
    if not least <= exactly(int, value) < _MOST:
        raise ValueError(f"{str(value)[:60]} counts nothing")
    return int(value)


def real(value: Any) -> float:
    """A finite number.

    Raises:
        TypeError: If it is no number; a bool is none.
        ValueError: If it is not finite, or too large to be.
    """
    if type(value) not in (int, float):
        raise TypeError(f"{str(value)[:60]!r} is no number")
    if not abs(value) < 1e300 or not math.isfinite(value):
        raise ValueError(f"{str(value)[:60]} is not finite")
    return float(value)


def interval(value: Any) -> Interval:
    """An interval, as JSON has it.

    Raises:
        TypeError: If it is not two numbers.
        ValueError: If one is not finite.
    """
    low, high = exactly(list, value)
    return Interval(real(low), real(high))
