"""Where the photos of a set stand: metres on the UTM grid as their files say, and degrees worked out from them.

Published sets measure their radius in the metres they are written in, so these are kept as they are; degrees are for
maps, and for photos of different zones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import utm  # type: ignore[import-untyped]  # it ships no types
from jaxtyping import Float64, Int64

from salad.geo import zone_number


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

    @classmethod
    def on_a_plane(cls, metres: Float64[np.ndarray, "n 2"]) -> Coordinates:
        """Photos of which nobody says in which zone they are counted, if in any."""
        return cls(metres, np.zeros(len(metres), dtype=np.int64), np.full((len(metres), 2), np.nan))


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
