"""The Earth around simulated vehicles: metres north and east of a point, and back.

PX4 projects its local frame from a sphere with an azimuthal equidistant projection, so distances
and directions from the origin are exact. This module uses the same projection, written
independently of the agents' one. A test compares the two.
"""

from __future__ import annotations

import math
from typing import NamedTuple

_RADIUS_M = 6_371_000.0  # radius of PX4's sphere (CONSTANTS_RADIUS_OF_EARTH)


class EarthPoint(NamedTuple):
    """A point on the Earth or above it."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float  # above the sea


# Origin of PX4's SIH simulator.
ZURICH = EarthPoint(latitude_deg=47.397742, longitude_deg=8.545594, altitude_m=489.4)


def degrees_at(origin: EarthPoint, north_m: float, east_m: float) -> tuple[float, float]:
    """Return latitude and longitude [deg] of a point north and east of an origin."""
    angle = math.hypot(north_m, east_m) / _RADIUS_M
    bearing = math.atan2(east_m, north_m)
    from_latitude = math.radians(origin.latitude_deg)

    # Unit vector to the point, in the frame up, east, north of the origin.
    up = math.cos(angle)
    east = math.sin(angle) * math.sin(bearing)
    north = math.sin(angle) * math.cos(bearing)

    # Rotate the vector into the frame of the equator and the origin's meridian.
    to_meridian = up * math.cos(from_latitude) - north * math.sin(from_latitude)
    to_pole = up * math.sin(from_latitude) + north * math.cos(from_latitude)

    latitude = math.atan2(to_pole, math.hypot(to_meridian, east))
    longitude_deg = origin.longitude_deg + math.degrees(math.atan2(east, to_meridian))
    return math.degrees(latitude), math.remainder(longitude_deg, 360.0)


def metres_from(
    origin: EarthPoint, latitude_deg: float, longitude_deg: float
) -> tuple[float, float]:
    """Return how far north and east [m] of an origin a latitude and a longitude lie."""
    from_latitude = math.radians(origin.latitude_deg)
    latitude = math.radians(latitude_deg)
    turn = math.radians(longitude_deg - origin.longitude_deg)

    # Unit vector to the point, in the frame of the equator and the origin's meridian.
    to_meridian = math.cos(latitude) * math.cos(turn)
    east = math.cos(latitude) * math.sin(turn)
    to_pole = math.sin(latitude)

    # Rotate the vector into the frame up, east, north of the origin.
    up = to_meridian * math.cos(from_latitude) + to_pole * math.sin(from_latitude)
    north = to_pole * math.cos(from_latitude) - to_meridian * math.sin(from_latitude)

    chord = math.hypot(north, east)
    distance_m = _RADIUS_M * math.atan2(chord, up)
    if chord == 0.0:
        return 0.0, 0.0
    return distance_m * north / chord, distance_m * east / chord
