"""Where the photos of a set stand: metres on the UTM grid as their files say, and degrees worked out from them.

Published sets measure their radius in the metres they are written in, so these are kept as they are; degrees are for
maps, and for photos of different zones.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import utm  # type: ignore[import-untyped]  # it ships no types
from jaxtyping import Float64, Int64


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Where photos stand, on the map and on the earth, as far as each is known.

    Attributes:
        utm: `[N, 2]` metres east and north, as written.
        zone: `[N]` the UTM zone they are counted in, negative south of the equator, 0 where nobody says.
        lat_lon: `[N, 2]` latitudes and longitudes in degrees, NaN where unknown.
    """

    utm: Float64[np.ndarray, "n 2"]
    zone: Int64[np.ndarray, " n"]
    lat_lon: Float64[np.ndarray, "n 2"]

    @classmethod
    def in_zone(cls, metres: Float64[np.ndarray, "n 2"], zone: str) -> Coordinates:
        """Photos of one zone, such as `17T`; on the map only where the zone is not known."""
        zones = np.full(len(metres), zone_number(zone), dtype=np.int64)
        return cls(metres, zones, lat_lon_of(metres, zones))


def zone_number(text: str) -> int:
    """A zone such as `17T` as a number: negative south of the equator, 0 where the text names no zone."""
    named = re.fullmatch(r"([0-9]{1,2})([C-HJ-NP-Xc-hj-np-x])", text)
    if named is None or not 1 <= int(named[1]) <= 60:
        return 0
    return int(named[1]) if named[2].upper() >= "N" else -int(named[1])


def lat_lon_of(metres: Float64[np.ndarray, "n 2"], zone: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
    """Latitudes and longitudes in degrees, millions at once; NaN where there is no zone, or metres are off the grid.

    Metres are east and north; zones are numbered as in `Coordinates`.
    """
    lat_lon = np.full((len(metres), 2), np.nan)
    east, north = metres.T
    # Sets without positions make metres up (a photo's number times a step), which no formula should be given.
    on_grid = (east >= 100_000) & (east < 1_000_000) & (north >= 0) & (north <= 10_000_000)
    for number in np.unique(zone[on_grid & (zone != 0)]).tolist():
        rows = np.flatnonzero(on_grid & (zone == number))
        lat, lon = utm.to_latlon(east[rows], north[rows], abs(number), northern=number > 0, strict=False)
        lat_lon[rows] = np.stack([lat, lon], axis=1)
    # Metres just inside the grid of a wrong zone can come out beyond a pole.
    lat_lon[~(np.abs(lat_lon[:, 0]) <= 90)] = np.nan
    return lat_lon
