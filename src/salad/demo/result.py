"""What the demo measures: every answer beside the truth, and the figures drawn from them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Literal

from salad.demo.town.town import Town
from salad.geo import GeoPoint, metres_between
from salad.index.index import Match
from salad.localize.locate import Answer

WITHIN_M = 25.0
"""An answer so close to the truth is right: the field's own measure."""

Verdict = Literal["right", "wrong", "unknown"]
VERDICTS: tuple[Verdict, ...] = ("right", "wrong", "unknown")


@dataclass(frozen=True, slots=True)
class Judged:
    """An answer beside the truth.

    Attributes:
        answer: what the model said.
        truth: where the query was really taken.
        condition: its light and weather.
    """

    answer: Answer
    truth: GeoPoint
    condition: str

    @property
    def error_m(self) -> float | None:
        """Metres from the place found to the truth; None where the place is unknown."""
        place = self.answer.place
        return None if place is None else metres_between(place.where, self.truth)

    @property
    def verdict(self) -> Verdict:
        """Right within `WITHIN_M`, wrong beyond it, or unknown."""
        error = self.error_m
        return "unknown" if error is None else "right" if error <= WITHIN_M else "wrong"

    def off_by(self, match: Match) -> float | None:
        """Metres from a match's position to the truth; None where the match has no position."""
        return None if match.photo.where is None else metres_between(match.photo.where, self.truth)


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What came of the demo.

    Attributes:
        town: the town and its photos.
        judged: every query's answer beside the truth, in order.
        model: name of the model.
        fingerprint: of the model.
        described: photos described, references and queries together.
        seconds: taken to index the references and locate the queries: reading, describing, searching.
        seed: the town's.
        page: the page that shows it all.
        index: the index that was built.
    """

    town: Town
    judged: tuple[Judged, ...]
    model: str
    fingerprint: str
    described: int
    seconds: float
    seed: int
    page: Path
    index: Path

    @property
    def queries(self) -> int:
        """How many photos were asked about."""
        return len(self.judged)

    def count(self, verdict: Verdict, *, condition: str | None = None) -> int:
        """How many answers were right, wrong or unknown, in all or under one condition."""
        return sum(
            one.verdict == verdict for one in self.judged if condition is None or one.condition == condition
        )

    @property
    def answered(self) -> int:
        """How many queries were given a place, right or wrong."""
        return self.queries - self.count("unknown")

    @property
    def right_share(self) -> float:
        """Right answers among all queries, unknown ones included, 0 to 1; 0 where nothing was asked."""
        return self.count("right") / self.queries if self.queries else 0.0

    @property
    def median_error_m(self) -> float | None:
        """Median metres between place and truth over the answered queries; None where none was."""
        return self.median_error(None)

    def median_error(self, condition: str | None) -> float | None:
        """The same under one condition."""
        errors = [
            one.error_m
            for one in self.judged
            if one.error_m is not None and (condition is None or one.condition == condition)
        ]
        return median(errors) if errors else None

    @property
    def photos_a_second(self) -> float:
        """Photos described a second, reading them and searching included."""
        return self.described / self.seconds if self.seconds > 0 else 0.0

    @property
    def conditions(self) -> dict[str, int]:
        """How many queries there are of each condition, in the order they first come."""
        return dict(Counter(one.condition for one in self.judged))
