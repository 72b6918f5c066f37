"""Options that say which photos of an index may be found."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from salad.errors import SaladError
from salad.geo import GeoPoint

if TYPE_CHECKING:
    from salad.index.filters import Filter

Around = Annotated[str | None, arg(metavar="LAT,LON", help_behavior_hint="")]
Box = Annotated[str | None, arg(metavar="SOUTH,WEST,NORTH,EAST", help_behavior_hint="")]
Moment = Annotated[str | None, arg(metavar="DATE", help_behavior_hint="")]
Degrees = Annotated[float | None, arg(metavar="DEGREES", help_behavior_hint="")]


@dataclass(frozen=True)
class Only:
    """Look only at photos of the index that keep to all of these."""

    near: Around = None
    """Taken around this point."""
    within: Annotated[float, arg(metavar="METRES")] = 500.0
    """How far from it."""
    box: Box = None
    """Taken in this box; one whose west is above its east crosses the date line."""
    since: Moment = None
    """Taken then or later: 2024-05-01, or 2024-05-01T12:00 with or without a zone such as +02:00."""
    until: Moment = None
    """Taken then or before; a day counts to its end."""
    heading: Degrees = None
    """Taken looking this way, clockwise from north."""
    heading_within: Annotated[float, arg(metavar="DEGREES")] = 45.0
    """How far to either side of it."""

    def filter(self) -> Filter | None:
        """The same for a search; None where every photo may be found.

        Raises:
            SaladError: A value makes no sense.
        """
        if all(value is None for value in (self.near, self.box, self.since, self.until, self.heading)):
            return None
        from salad.index.filters import Filter

        near = None if self.near is None else _numbers(self.near, 2, "--near", "LAT,LON")
        box = None if self.box is None else _numbers(self.box, 4, "--box", "SOUTH,WEST,NORTH,EAST")
        return Filter(
            box=None if box is None else (box[0], box[1], box[2], box[3]),
            near=None if near is None else GeoPoint(*near),
            within_m=None if near is None else self.within,
            since=_moment(self.since, "--since"),
            until=_moment(self.until, "--until", to_its_end=True),
            heading=self.heading,
            heading_within=self.heading_within,
        )


def _numbers(text: str, count: int, option: str, form: str) -> list[float]:
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != count:
        raise SaladError(f"{option} {text} cannot be read: write {form}, in degrees")
    return found


def _moment(text: str | None, option: str, *, to_its_end: bool = False) -> datetime | None:
    if text is None:
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise SaladError(f"{option} {text} is no date: write 2024-05-01, or 2024-05-01T12:00") from error
    day_alone = len(text) <= len("2024-05-01")
    return moment + timedelta(days=1, microseconds=-1) if to_its_end and day_alone else moment
