"""What the demo measures: every answer beside the truth, its figures, and a table of them for the terminal."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Literal

from rich.table import Table
from rich.text import Text

from salad.demo.town.town import Town
from salad.geo import GeoPoint, metres_between, told_metres
from salad.index.index import Match
from salad.localize.locate import Answer

WITHIN_M = 25.0  # an answer so close to the truth is right: the field's own measure

Verdict = Literal["right", "wrong", "unknown"]
VERDICTS: tuple[Verdict, ...] = ("right", "wrong", "unknown")


@dataclass(frozen=True, slots=True)
class Judged:
    """An answer beside the truth.

    Attributes:
        answer: What the model said.
        truth: Where the query was really taken.
        condition: Its light and weather.
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
        # Unknown is no mistake: a system that says so can ask somebody.
        error = self.error_m
        return "unknown" if error is None else "right" if error <= WITHIN_M else "wrong"

    def off_by(self, match: Match) -> float | None:
        """Metres from a match's position to the truth; None where the match has no position."""
        return None if match.photo.where is None else metres_between(match.photo.where, self.truth)


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What came of the demo.

    Attributes:
        town: The town and its photos.
        judged: Every query's answer beside the truth, in order.
        model: Name of the model.
        fingerprint: Of the model.
        described: Photos described, references and queries together.
        seconds: Taken to index the references and locate the queries: reading, describing, searching.
        seed: The town's.
        page: The page that shows it all.
        index: The index that was built.
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
        return sum(one.verdict == verdict for one in self.judged if condition is None or one.condition == condition)

    @property
    def right_fraction(self) -> float:
        """Right answers among all queries, unknown ones included, 0 to 1; 0 where nothing was asked."""
        return self.count("right") / self.queries if self.queries else 0.0

    def median_error(self, condition: str | None = None) -> float | None:
        """Median metres between place and truth over the answered queries, all or of one condition, if any."""
        # What is unknown has no error: the median is of the answers that were given.
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


def table(result: DemoResult) -> Table:
    """The result as a table: a row for each condition and one for all."""
    caption = (
        f"{result.described} photos described in {result.seconds:.1f} s: {result.photos_a_second:.1f} a second. "
        "The median counts the answered ones."
    )
    title = f"{result.queries} photos located by {result.model}"
    rows = Table(title=Text(title), caption=Text(caption))
    rows.add_column("light and weather")
    for heading in ("photos", f"right within {WITHIN_M:.0f} m", "wrong", "unknown", "median error"):
        rows.add_column(heading, justify="right")
    for condition, photos in result.conditions.items():
        rows.add_row(*_row(result, condition, photos))
    rows.add_section()
    rows.add_row(*_row(result, None, result.queries), style="bold")
    return rows


def _row(result: DemoResult, condition: str | None, photos: int) -> list[Text]:
    right, wrong, unknown = (result.count(verdict, condition=condition) for verdict in VERDICTS)
    percent = f" ({100 * right / photos:.0f} %)" if condition is None and photos else ""
    cells = [condition or "all", str(photos), f"{right}{percent}", str(wrong), str(unknown)]
    # Text, not str: a condition in brackets is no markup of the table's.
    return [Text(cell) for cell in (*cells, distance(result.median_error(condition)))]


def distance(metres: float | None) -> str:
    """Metres for people: `3.2 m`, `48 m`, `1.3 km`, or a dash where unknown."""
    return "–" if metres is None else told_metres(metres)
