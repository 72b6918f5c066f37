"""What became of queries in one word, and which of them a page shows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Literal, TypeAlias

from salad.evaluation.result import QueryResult

Outcome: TypeAlias = Literal["right", "wrong", "unanswerable"]
OUTCOMES: tuple[Outcome, ...] = ("right", "wrong", "unanswerable")
SHOWN = 8
"""Mistakes of a kind on a page."""
UNANSWERABLE = 4
"""Queries on it that nothing is right for."""


def outcome(one: QueryResult) -> Outcome:
    """Whether the best match is right; a query without a right reference can only be answered wrongly."""
    if not one.positives:
        return "unanswerable"
    return "right" if one.hit(1) else "wrong"


def counts(verdicts: Sequence[QueryResult]) -> dict[Outcome, int]:
    """How many came to what, none left out."""
    found = Counter(map(outcome, verdicts))
    return {each: found[each] for each in OUTCOMES}


def surest(verdicts: Sequence[QueryResult], kind: Outcome = "wrong", *, most: int = SHOWN) -> list[int]:
    """The answers of one kind with the highest scores, the surest first; numbers from 0."""
    scored = [
        (-one.scores[0], number) for number, one in enumerate(verdicts) if one.scores and outcome(one) == kind
    ]
    return [number for _, number in sorted(scored)[:most]]


def worst(verdicts: Sequence[QueryResult], *, besides: Sequence[int] = (), most: int = SHOWN) -> list[int]:
    """The answers farthest from the truth: in metres where known, else by how late the right one came.

    Args:
        verdicts: of all queries.
        besides: numbers of queries that are shown already.
        most: how many.
    """
    wrong = [number for number, one in enumerate(verdicts) if outcome(one) == "wrong"]
    return sorted(set(wrong) - set(besides), key=lambda number: (_badness(verdicts[number]), number))[:most]


def _badness(one: QueryResult) -> tuple[float, ...]:
    """Sorts the worst first: known metres before unknown, never found before found late, sure before unsure."""
    far = 1.0 if one.metres is None else -one.metres
    late = float(one.first_right or 0)
    return far, float(late > 0), -late, -one.scores[0] if one.scores else 0.0
