"""From metres on the UTM grid to latitude and longitude, millions at once."""

from __future__ import annotations

import re

import numpy as np
import utm  # type: ignore[import-untyped]  # it ships no types
from jaxtyping import Float64, Int64

from salad.datasets.neighbours import Coordinates


def zone_number(text: str) -> int:
    """A zone such as `17T` as a number: negative south of the equator, 0 where the text names no zone."""
    told = re.fullmatch(r"([0-9]{1,2})([C-HJ-NP-Xc-hj-np-x])", text)
    if told is None or not 1 <= int(told[1]) <= 60:
        return 0
    return int(told[1]) if told[2].upper() >= "N" else -int(told[1])


def on_earth(grid: Float64[np.ndarray, "n 2"], zone: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
    """Latitudes and longitudes in degrees; NaN where there is no zone, or the metres lie outside the grid.

    Args:
        grid: metres east and north.
        zone: negative south of the equator, 0 where unknown.
    """
    globe = np.full((len(grid), 2), np.nan)
    east, north = grid.T
    sound = (east >= 100_000) & (east < 1_000_000) & (north >= 0) & (north <= 10_000_000)
    for number in np.unique(zone[sound & (zone != 0)]).tolist():
        rows = np.flatnonzero(sound & (zone == number))
        lat, lon = utm.to_latlon(east[rows], north[rows], abs(number), northern=number > 0, strict=False)
        globe[rows] = np.stack([lat, lon], axis=1)
    globe[~(np.abs(globe[:, 0]) <= 90)] = np.nan
    return globe


def spots_in(grid: Float64[np.ndarray, "n 2"], zone: str) -> Coordinates:
    """Places of one zone, such as `17T`; on the map only where the zone is not known."""
    zones = np.full(len(grid), zone_number(zone), dtype=np.int64)
    return Coordinates(grid, zones, on_earth(grid, zones))
