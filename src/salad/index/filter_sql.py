"""Which photos of an index a filter lets through.

What SQLite can tell it tells, with a little room to spare where it cannot tell exactly; numpy and Python decide the
rest.
"""

from __future__ import annotations

import math
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from salad.geo import EARTH_RADIUS_M, GeoPoint, metres, turn_between
from salad.index.catalog import Catalog
from salad.index.facts import PLACED
from salad.search.base import Mask
from salad.search.filters import Box, Filter, in_order

Part = tuple[str, tuple[Any, ...]]  # a condition of SQL with its parameters

_PAGE = 1 << 16  # rows looked at in one go, which keeps memory small for any number of photos
_ZONES = timedelta(days=3)  # more than two zones can make between a photo's date and another's
_SPARE_DEGREES = 1e-6  # 11 cm, against rounding where SQLite's word is not the last


def allowed(filter: Filter, catalog: Catalog, alive: Mask) -> Mask:
    """Which of the living rows `[N]` a filter lets through.

    It belongs in the look that `alive` was taken in, for a compaction gives rows other numbers.
    """
    if filter == Filter(heading_within=filter.heading_within):  # it asks for nothing
        return alive
    parts: list[Part] = [("row >= ? AND row < ?", ())]  # by number: a page is found at once
    if filter.box is not None:
        parts.append(_in_box(filter.box))
    if filter.near is not None and filter.within_m is not None:
        parts.append(_in_box(_around(filter.near, filter.within_m)))
    if filter.heading is not None:
        parts.append(("typeof(heading) = 'real'", ()))  # a damaged table may hold text there
    if filter.since is not None:
        parts.append(("time >= ?", (_day(filter.since, -_ZONES),)))
    if filter.until is not None:
        parts.append(("time <= ?", (_day(filter.until, _ZONES),)))
    conditions = " AND ".join(condition for condition, _ in parts)
    sql = f"SELECT row, lat, lon, heading, time FROM photos WHERE {conditions}"
    given = [value for _, values in parts for value in values]
    passed = np.zeros(len(alive), dtype=np.bool_)
    for start in range(0, len(alive), _PAGE):
        some = catalog.select(sql, [start, min(start + _PAGE, len(alive)), *given])
        if not some:
            continue
        row, lat, lon, heading, time = zip(*some, strict=True)
        keep = np.ones(len(some), dtype=np.bool_)
        if filter.near is not None and filter.within_m is not None:
            keep &= metres(filter.near.lat, filter.near.lon, lat, lon) <= filter.within_m
        if filter.heading is not None:
            keep &= turn_between(heading, filter.heading) <= filter.heading_within
        if filter.since is not None or filter.until is not None:
            keep &= [_in_span(filter, each) for each in time]
        passed[np.asarray(row)[keep]] = True
    return passed & alive


def compared_by_the_clock(filter: Filter, catalog: Catalog) -> int:
    """How many living photos know when they were taken, but not in the way that a bound of the filter does.

    One has a zone and the other has not, so that nobody knows which came first; `Filter` compares clocks on the wall.
    """
    zoned = "substr(time, 11) LIKE '%+__:__%' OR substr(time, 11) LIKE '%-__:__%'"
    bounds = [bound for bound in (filter.since, filter.until) if bound is not None]
    apart = {f"NOT ({zoned})" if bound.utcoffset() is not None else f"({zoned})" for bound in bounds}
    if not apart:
        return 0
    # Damaged tables may hold a text without end there: a time has 32 letters at most.
    known = "removed = 0 AND typeof(time) = 'text' AND length(CAST(time AS BLOB)) <= 40"
    ((count,),) = catalog.select(f"SELECT COUNT(*) FROM photos WHERE {known} AND ({' OR '.join(sorted(apart))})")
    return int(count)


def _in_box(box: Box) -> Part:
    south, west, north, east = box
    across = "lon BETWEEN ? AND ?" if west <= east else "(lon >= ? OR lon <= ?)"
    if west <= east and 180 in (-west, east):
        across = "(lon BETWEEN ? AND ? OR abs(lon) = 180)"  # 180 east and 180 west are one line
    real = "typeof(lat) = 'real' AND typeof(lon) = 'real'"
    return f"{real} AND {PLACED} AND lat BETWEEN ? AND ? AND {across}", (south, north, west, east)


def _around(near: GeoPoint, within_m: float) -> Box:
    """A box that holds the circle, if need be all the way around the earth."""
    arc = within_m / EARTH_RADIUS_M + math.radians(_SPARE_DEGREES)
    up = math.degrees(arc)
    south, north = near.lat - up, near.lat + up
    if south <= -90 or north >= 90:  # a pole lies inside, and with it every longitude
        return (max(south, -90.0), -180.0, min(north, 90.0), 180.0)
    aside = math.degrees(math.asin(min(1.0, math.sin(arc) / math.cos(math.radians(near.lat)))))
    aside += _SPARE_DEGREES
    west, east = near.lon - aside, near.lon + aside
    return (south, west + 360 if west < -180 else west, north, east - 360 if east > 180 else east)


def _day(bound: datetime, room: timedelta) -> str:
    """The day of a bound with room to spare, as times in the table begin."""
    try:
        moved = bound.replace(tzinfo=None) + room
    except OverflowError:  # beyond the years there are
        return "0000" if room < timedelta() else "9999-99"
    return moved.isoformat()[: len("2024-05-01")] + ("" if room < timedelta() else "~")  # behind its hours


def _in_span(filter: Filter, time: str) -> bool:
    try:
        taken = datetime.fromisoformat(time)
    except (TypeError, ValueError):  # a damaged table; `verify` tells of it
        return False
    after = filter.since is None or in_order(filter.since, taken)
    return after and (filter.until is None or in_order(taken, filter.until))
