"""Which references may be found: a box, a radius around a point, a span of time, a heading.

A filter holds before the ranking: the best k are the best among the photos it lets through. It says what is wanted;
who holds the photos works out which they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime

from salad.errors import StoreError
from salad.geo import GeoPoint

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Filter:
    """What references may be found: all parts given must hold, and a photo that lacks a fact asked for is out.

    Attributes:
        box: South, west, north, east in degrees, the edges included; west > east crosses the date line.
        near: The middle of a circle; only together with `within_m`.
        within_m: Its radius in metres.
        since: Taken then or later.
        until: Taken then or earlier. A photo's time and a bound that both have a zone are compared as moments;
            where one of them lacks it, the clocks on the wall are compared, as if both hung in the same zone.
        heading: Which way the camera looked, in degrees clockwise from north.
        heading_within: How many degrees it may have looked to either side of that.

    Raises:
        StoreError: Where a value makes no sense; PositionError for `near`, which `GeoPoint` checks.
    """

    box: Box | None = None
    near: GeoPoint | None = None
    within_m: float | None = None
    since: datetime | None = None
    until: datetime | None = None
    heading: float | None = None
    heading_within: float = 45.0

    def __post_init__(self) -> None:
        if self.box is not None:
            south, west, north, east = self.box
            if not (-90 <= south <= north <= 90 and all(-180 <= lon <= 180 for lon in (west, east))):
                raise StoreError(
                    f"the box {list(self.box)} cannot be: give south, west, north, east in degrees, south not above "
                    "north"
                )
        if (self.near is None) != (self.within_m is None):
            raise StoreError("a circle needs a point and a radius: give both, or neither")
        if self.within_m is not None and not 0 <= self.within_m < math.inf:
            raise StoreError(f"a radius of {self.within_m} m cannot be: give metres, 0 or more")
        if self.since and self.until and not in_order(self.since, self.until):
            raise StoreError(f"no photo was taken since {self.since} and until {self.until}: exchange the two")
        if self.heading is not None and not math.isfinite(self.heading):
            raise StoreError(f"a heading of {self.heading} cannot be: give degrees clockwise from north")
        if not 0 <= self.heading_within <= 180:
            raise StoreError(
                f"within {self.heading_within} degrees of a heading cannot be: give 0 to 180, to either side"
            )


def in_order(one: datetime, other: datetime) -> bool:
    """Whether `one` is not later: as moments where both have a zone, else by the clock on the wall."""
    # utcoffset, not tzinfo: a zone that knows no offset is none.
    if one.utcoffset() is None or other.utcoffset() is None:
        return one.replace(tzinfo=None) <= other.replace(tzinfo=None)
    return one <= other
